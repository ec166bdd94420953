"""The log's side of diagnostics: one line when a trouble begins, at its level, and one at its end."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Protocol

from tomotactile_ros.devices.health import Trouble
from tomotactile_ros.nodes.diagnostics import OK, WARN, level_of

OVER = 5  # reports without a trouble until it is called over: one that flickers is said once


class Log(Protocol):
    """What of a node's logger is needed."""

    def info(self, text: str) -> object:
        """Write a line."""

    def warning(self, text: str) -> object:
        """Write a line of what is not as it should be."""

    def error(self, text: str) -> object:
        """Write a line of what makes data wrong or keeps them away."""


class Teller:
    """Compares the troubles of one report with those of the reports before, and logs the changes.

    A trouble is known by its name. It is said when it begins, again when it becomes serious, and
    called over when `OVER` reports in a row were without it. What becomes less serious says no
    line: it flickers between both where a share is near its limit.

    Parameters
    ----------
    log : gets the lines: errors for serious troubles, warnings for others.
    """

    def __init__(self, log: Log):
        self._log = log
        self._lasting: dict[str, _Lasting] = {}

    def tell(self, troubles: Iterable[Trouble], none_over: bool = False) -> None:
        """Log what is new among all troubles of a report, and what is over.

        Where there is nothing to judge by, a report with `none_over` leaves the others as they are.
        """
        present = {trouble.name: trouble for trouble in troubles}
        for name, trouble in present.items():
            known = self._lasting.get(name)
            if known is None or trouble.serious > known.trouble.serious:
                log_at(self._log, level_of(trouble), trouble.text)
                self._lasting[name] = _Lasting(trouble)
            else:
                known.absent = 0
        if none_over:
            return
        for name in sorted(self._lasting.keys() - present.keys()):
            known = self._lasting[name]
            known.absent += 1
            if known.absent >= OVER:
                del self._lasting[name]
                self._log.info(f"over: {known.trouble.text}")


class _Lasting:
    """A trouble as it was said, and how many reports in a row were without it."""

    def __init__(self, trouble: Trouble):
        self.trouble = trouble
        self.absent = 0


def log_at(log: Log, level: bytes, text: str) -> None:
    """Log a line at a level of diagnostics; rclpy wants a line of code for each."""
    if level == OK:
        log.info(text)
    elif level == WARN:
        log.warning(text)
    else:
        log.error(text)
