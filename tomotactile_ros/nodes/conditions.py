"""Puts into a node's log what is wrong with it: one line when it begins, grows worse or better,
and one when it is over, at the level that it has in /diagnostics."""

from collections.abc import Iterable
from typing import Protocol

from tomotactile_ros.devices.health import Trouble
from tomotactile_ros.nodes import diagnostics


class Log(Protocol):
    """What is needed of a node's logger."""

    def info(self, message: str) -> object:
        """Log at level INFO."""

    def warning(self, message: str) -> object:
        """Log at level WARN."""

    def error(self, message: str) -> object:
        """Log at level ERROR."""


def log_at(log: Log, level: bytes, text: str) -> None:
    """Log a line at the level of a diagnostic; each has its own call, as rclpy wants it."""
    if level == diagnostics.OK:
        log.info(text)
    elif level == diagnostics.WARN:
        log.warning(text)
    else:
        log.error(text)


class Conditions:
    """Remembers which troubles are in the log.

    Parameters
    ----------
    log : takes the lines.
    """

    def __init__(self, log: Log):
        self._log = log
        self._known: dict[str, Trouble] = {}

    def say(self, troubles: Iterable[Trouble]) -> None:
        """Log which of these are new or have another level, and which known ones are over."""
        now = {trouble.name: trouble for trouble in troubles}
        for name, trouble in now.items():
            before = self._known.get(name)
            if before is None or (before.serious, before.which) != (trouble.serious, trouble.which):
                log_at(self._log, diagnostics.level_of(trouble), trouble.text)
        for name, trouble in self._known.items():
            if name not in now:
                log_at(self._log, diagnostics.OK, f"over: {trouble.text}")
        self._known = now

    def have_been_said(self, troubles: Iterable[Trouble]) -> None:
        """Remember these as logged, and no others: another line has told of them."""
        self._known = {trouble.name: trouble for trouble in troubles}
