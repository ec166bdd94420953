"""What all programs with a command line have in common."""

from __future__ import annotations

import argparse
import math
import os
import signal
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, NoReturn

from tomotactile_ros.support.errors import Doubt, meant

_SOON = 0.05  # s after which an interrupt that was lost is raised again


def positive(text: str) -> float:
    """Type of an option: a finite number above 0."""
    with suppress(ValueError):
        value = float(text)
        if math.isfinite(value) and value > 0:
            return value
    raise argparse.ArgumentTypeError(f"{text} is not a number above 0")


class Parser(argparse.ArgumentParser):
    """Says in one line what is wrong with a command line.

    An empty value, as of a shell's variable that is not set, is refused: it would be taken for an
    option that was left out.
    """

    also = ""  # what is said beside the choices of one that is none

    def __init__(self, *args: Any, **kwargs: Any):
        super().__init__(*args, **kwargs)
        self.register("type", None, _given)

    def add_subparsers(self, **kwargs: Any) -> Any:
        """The same; values are checked by the parsers of the commands."""
        self.register("type", None, str)
        return super().add_subparsers(**kwargs)

    def _check_value(self, action: argparse.Action, value: Any) -> None:
        try:
            super()._check_value(action, value)
        except argparse.ArgumentError as error:
            names = [str(choice) for choice in action.choices or ()]
            error.message += meant(str(value), names) + self.also
            raise

    def refuse(self, unknown: list[str]) -> NoReturn:
        """End because of arguments that are none, with the option that was probably meant."""
        options = [name for action in self._actions for name in action.option_strings]
        hint = meant(unknown[0].partition("=")[0], options)
        self.error(f"unrecognized arguments: {' '.join(unknown)}{hint}")

    def parse_args(self, args: Any = None, namespace: Any = None) -> Any:
        """The same; what is no argument ends it by `refuse`."""
        found, unknown = self.parse_known_args(args, namespace)
        if unknown:
            self.refuse(unknown)
        return found

    def exit(self, status: int = 0, message: str | None = None) -> NoReturn:
        """The same; who reads the help may have had enough of it."""
        try:
            sys.stdout.flush()
        except BrokenPipeError:
            status = end_of_pipe()
        super().exit(status, message)

    def error(self, message: str) -> NoReturn:
        self.exit(2, f"{self.prog}: {message} (try --help)\n")


def _given(text: str) -> str:
    if not text:
        raise argparse.ArgumentTypeError("is empty; leave it out, or give a value")
    return text


def stop_like_ctrl_c() -> None:
    """Let SIGTERM and SIGHUP end a program as Ctrl-C does; nohup keeps its meaning."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        if signal.getsignal(number) == signal.SIG_DFL:
            signal.signal(number, _interrupt)
    if signal.getsignal(signal.SIGALRM) == signal.SIG_DFL:
        signal.signal(signal.SIGALRM, _end_soon)
        sys.unraisablehook = partial(_not_lost, sys.unraisablehook)


def _interrupt(number: int, frame: object) -> None:
    signal.signal(number, signal.SIG_IGN)  # once is enough: the end is not to be interrupted
    raise KeyboardInterrupt


def _end_soon(number: int, frame: object) -> None:
    raise KeyboardInterrupt


def _not_lost(usual: Callable[[Any], object], lost: Any) -> None:
    """Python drops exceptions that are raised while an object is deleted or in a callback."""
    if lost.exc_type is KeyboardInterrupt:
        signal.setitimer(signal.ITIMER_REAL, _SOON)
    else:
        usual(lost)


def say_doubts(program: str) -> None:
    """From now on a doubt about the input is one line on stderr; other warnings stay as they
    are."""
    usual = warnings.showwarning

    def show(message, category, *where, **more):
        if issubclass(category, Doubt):
            print(f"{program}: {message}", file=sys.stderr)
        else:
            usual(message, category, *where, **more)

    warnings.showwarning = show


def end_of_pipe() -> int:
    """Exit status when the reader of standard output (`| head`) has had enough.

    What is still buffered goes nowhere, so that it does not fail once more at the very end.
    """
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    return 128 + signal.SIGPIPE
