"""Puts into a node's log what is wrong with it: one line when it begins, grows worse or better,
and one when it is over, at the level that it has in /diagnostics."""

from collections.abc import Iterable
from typing import Protocol

from tomotactile_ros.devices.health import Trouble
from tomotactile_ros.nodes import diagnostics

QUIET = 5  # reports, one a second


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

    What is over or better is said when it was so for `QUIET` reports in a row: a share that comes
    and goes at its limit, or contacts that are withheld now and then, would fill the log otherwise.

    Parameters
    ----------
    log : takes the lines.
    """

    def __init__(self, log: Log):
        self._log = log
        self._known: dict[str, Trouble] = {}
        self._quiet: dict[str, int] = {}  # reports in a row in which it was over or better

    def say(self, troubles: Iterable[Trouble]) -> None:
        """Log which of these are new or have another level, and which known ones are over."""
        now = {trouble.name: trouble for trouble in troubles}
        for name, trouble in now.items():
            before = self._known.get(name)
            if before is None or trouble.which != before.which or trouble.serious > before.serious:
                self._log_level(trouble)
            elif trouble.serious == before.serious:
                self._quiet[name] = 0
            elif self._has_been_quiet(name):
                self._log_level(trouble)
        for name in [name for name in self._known if name not in now]:
            if self._has_been_quiet(name):
                log_at(self._log, diagnostics.OK, f"over: {self._known.pop(name).text}")

    def have_been_said(self, troubles: Iterable[Trouble]) -> None:
        """Remember these as logged, and no others: another line has told of them."""
        self._known = {trouble.name: trouble for trouble in troubles}
        self._quiet = {}

    def _log_level(self, trouble: Trouble) -> None:
        self._known[trouble.name], self._quiet[trouble.name] = trouble, 0
        log_at(self._log, diagnostics.level_of(trouble), trouble.text)

    def _has_been_quiet(self, name: str) -> bool:
        self._quiet[name] = self._quiet.get(name, 0) + 1
        return self._quiet[name] >= QUIET
