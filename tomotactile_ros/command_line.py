"""What all programs with a command line do alike."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from typing import NoReturn


class Parser(argparse.ArgumentParser):
    """Says in one line what is wrong with a command line."""

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message} (try --help)\n")


def stop_like_ctrl_c() -> None:
    """Let SIGTERM and SIGHUP end a program as Ctrl-C does; nohup keeps its meaning."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, _interrupt)


def _interrupt(number: int, frame: object) -> None:
    signal.signal(number, signal.SIG_IGN)  # once is enough: the end is not to be interrupted
    raise KeyboardInterrupt


def end_of_pipe() -> int:
    """Exit status when the reader of standard output (`| head`) has had enough.

    What is still buffered goes nowhere, so that it does not fail once more at the very end.
    """
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 128 + signal.SIGPIPE
