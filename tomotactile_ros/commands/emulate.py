"""`tomotactile emulate`: a sensor without hardware that speaks the real wire protocol."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from contextlib import suppress

from tomotactile_ros.devices import emulator

HELP = "act as a sensor without hardware, on a pseudo-terminal or a TCP port"


def add_arguments(parser: ArgumentParser) -> None:
    emulator.add_arguments(parser)


def run(args: Namespace) -> None:
    with suppress(KeyboardInterrupt):  # the way to end it
        emulator.serve(args)
