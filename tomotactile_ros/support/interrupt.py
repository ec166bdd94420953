"""Work in a thread of its own, which whoever started it may leave alone, or end.

Nothing breaks a computation off from outside: it asks `check` between two of its steps.
"""

from __future__ import annotations

import sys
import threading
from collections.abc import Callable
from typing import Any

_PATIENCE = 1e-4  # s until a thread that computes lets one that was waiting have the interpreter
_own = threading.local()


class Interrupted(Exception):
    """The work of this thread is to end."""


def check() -> None:
    """Raise `Interrupted` where this thread's work was told to end, or the program ends."""
    told = getattr(_own, "told", None)
    if told is not None and (told.is_set() or not threading.main_thread().is_alive()):
        raise Interrupted


class Job(threading.Thread):
    """`work` in a thread of its own, which begins at once.

    The interpreter's switch interval is set to 0.1 ms: who waits until a time goes on at that time.
    """

    def __init__(self, work: Callable[[], Any]):
        super().__init__(name="job")
        sys.setswitchinterval(min(sys.getswitchinterval(), _PATIENCE))
        self._work, self._told, self._ended = work, threading.Event(), threading.Event()
        self._outcome: Any = None
        self._error: Exception | None = None
        self.start()

    def run(self) -> None:
        _own.told = self._told
        try:
            self._outcome = self._work()
        except Interrupted:
            pass
        except Exception as error:  # noqa: BLE001 - whoever asks is told
            self._error = error
        finally:
            self._ended.set()

    def wait(self, seconds: float | None = None) -> bool:
        """Whether the work ends within so many seconds; None: as long as it takes."""
        return self._ended.wait(None if seconds is None else max(seconds, 0.0))

    def stop(self) -> None:
        """Let the work end, and wait for that."""
        self._told.set()
        self._ended.wait()

    @property
    def outcome(self) -> Any:
        """What the work came to, None before it has ended and where it was stopped; its error is
        raised."""
        if self._error is not None:
            raise self._error
        return self._outcome
