"""Threads of one process compute in turn.

Only one thread of Python runs at a time. Where several want to, they wake, wait for each other and
move between processors at every call of numpy that lets go of the interpreter: eight 4 x 4 sheets
then cost more than twice the processor time per image that one costs. Whoever waits for a turn
instead does not disturb; it does not wait for long, as an image of another sensor may take seconds.
"""

import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Turns:
    """One at a time, as far as possible.

    longest : s that somebody waits for a turn, and then computes beside whoever has it
    """

    def __init__(self, longest: float):
        self._longest = longest
        self._lock = threading.Lock()

    @contextmanager
    def mine(self) -> Iterator[None]:
        """Compute within it."""
        alone = self._lock.acquire(timeout=self._longest)
        try:
            yield
        finally:
            if alone:
                self._lock.release()


class FairLock:
    """A lock that whoever waits for gets before whoever has it gets it again.

    Frames that take all the time until the next one would keep a service waiting for ever otherwise.
    """

    def __init__(self) -> None:
        self._door, self._lock = threading.Lock(), threading.Lock()

    def __enter__(self) -> None:
        with self._door:  # one waits here for the lock, all others for the door
            self._lock.acquire()

    def __exit__(self, *_: object) -> None:
        self._lock.release()

    def locked(self) -> bool:
        """Whether somebody has it."""
        return self._lock.locked()
