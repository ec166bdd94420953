"""Puts into a node's log what is wrong with it: one line when it begins, grows worse or better,
and one when it is over, at the level that it has in /diagnostics.

What comes and goes all the time would fill the log: after some lines within a minute there is one
every ten seconds, which tells how it stands and how often it has changed since. What becomes an
error is told at once all the same, unless an error of that name was told within the minute.
"""

import time
from collections import deque
from collections.abc import Callable, Iterable
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


class Pace:
    """Bounds how many lines are logged about one thing: `LINES` within `WINDOW` s as they come, then
    one every `PAUSE` s.

    Parameters
    ----------
    clock : tells the time, s.
    """

    LINES, WINDOW, PAUSE = 6, 60.0, 10.0

    def __init__(self, clock: Callable[[], float] = time.monotonic):
        self._clock = clock
        self._lines: deque[float] = deque(maxlen=self.LINES)
        self._error = -float("inf")

    def allows(self, error: bool = False) -> bool:
        """Whether a line may be logged now; then it is counted. The first error for long may."""
        now = self._clock()
        many = len(self._lines) == self.LINES and now - self._lines[0] < self.WINDOW
        first_error = error and now - self._error > self.WINDOW
        if many and now - self._lines[-1] < self.PAUSE and not first_error:
            return False
        self._lines.append(now)
        if error:
            self._error = now
        return True

    @property
    def idle(self) -> bool:
        """Whether no line was logged for long."""
        return not self._lines or self._clock() - self._lines[-1] > self.WINDOW


class _Condition:
    """One trouble: how it stands, and how often that has changed since it was logged."""

    def __init__(self, pace: Pace):
        self.pace = pace
        self.trouble: Trouble | None = None  # as it is, or was when it lasted
        self.lasts = False
        self.changes = 0

    def take(self, trouble: Trouble | None) -> None:
        """Note how it stands now; None: it is over."""
        before = _state(self.trouble) if self.lasts else None
        self.changes += _state(trouble) != before
        self.lasts = trouble is not None
        self.trouble = trouble or self.trouble

    def line(self) -> tuple[bytes, str] | None:
        """Level and text of what is to be logged now, if anything is."""
        trouble = self.trouble
        if not self.changes or trouble is None:
            return None
        if not self.pace.allows(self.lasts and trouble.serious):
            return None
        often = f" (changed {self.changes} times since the last line)" if self.changes > 1 else ""
        self.changes = 0
        if self.lasts:
            return diagnostics.level_of(trouble), trouble.text + often
        return diagnostics.OK, f"no longer the case: {trouble.text}{often}"


class Conditions:
    """Remembers which troubles are in the log.

    Parameters
    ----------
    log : takes the lines.
    clock : tells the time, s.
    """

    def __init__(self, log: Log, clock: Callable[[], float] = time.monotonic):
        self._log, self._clock = log, clock
        self._known: dict[str, _Condition] = {}

    def say(self, troubles: Iterable[Trouble]) -> None:
        """Log which of these are new or have another level, and which known ones are over.

        Of several with one name the last is taken.
        """
        self._take(troubles)
        for condition in self._known.values():
            if line := condition.line():
                log_at(self._log, *line)
        kept = self._known.items()
        self._known = {n: c for n, c in kept if c.lasts or c.changes or not c.pace.idle}

    def have_been_said(self, troubles: Iterable[Trouble]) -> None:
        """Remember these as logged, and no others: another line has told of them."""
        self._take(troubles)
        for condition in self._known.values():
            condition.changes = 0

    def _take(self, troubles: Iterable[Trouble]) -> None:
        now = {trouble.name: trouble for trouble in troubles}
        for name in now:
            if name not in self._known:
                self._known[name] = _Condition(Pace(self._clock))
        for name, condition in self._known.items():
            condition.take(now.get(name))


def _state(trouble: Trouble | None) -> tuple[bool, str] | None:
    """What of a trouble is worth another line where it changes."""
    return None if trouble is None else (trouble.serious, trouble.which)
