"""A frame's result at the latest when its time is over.

How long a search takes is only known when it has ended, and half of one tells nothing. So it is never
cut: it goes on in a thread of its own, and who waits for it leaves in time with what a glance at the
frame tells. What it finds is the result of the frame during which it ends, with the time for which it
holds, and the next search begins where it ended: with something that stays it is a short one then.
"""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Generic, TypeVar

from tomotactile_ros.frame import Frame
from tomotactile_ros.reconstruction.settings import IN_TIME
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.interrupt import Job

Found = TypeVar("Found")
_REMEMBERED = 32  # glances, of which the longest says when the next one has to begin


def period_of(frame: Frame) -> float:
    """s until the next frame, if these follow one another; `IN_TIME` where the frame has no times."""
    return len(frame.grounded) * frame.row_period or IN_TIME


class Within(Generic[Found]):
    """Gives results of searches in time; for one thread at a time."""

    def __init__(self) -> None:
        self._job: Job | None = None
        self._cut = False  # nobody waits for the job any more
        self._glances: deque[float] = deque(maxlen=_REMEMBERED)  # s that they took
        self._late: Found | None = None  # of a search that was not waited for, untold

    def result(
        self,
        search: Callable[[], Found],
        glance: Callable[[], Found],
        seconds: float,
        is_result: Callable[[Found], bool],
    ) -> Found:
        """What `search` finds, or where that takes longer than so many seconds, what the search of a call
        before has found since, if that `is_result` here, or `glance` finds; errors are those of either."""
        begun = time.monotonic()
        if not self._glances:
            self._glance(glance)
        self._late = None
        found = self._sought(search, begun + seconds - max(self._glances))
        if found is not None:
            return found
        if not self._cut and self._late is not None and is_result(self._late):
            self._cut, late = True, self.taken_late()
            return late
        seen = self._glance(glance)
        if not self._cut and self._ends_by(begun):  # meanwhile
            return self._taken()
        self._cut = True
        return seen

    def sought(self, search: Callable[[], Found], seconds: float) -> Found | None:
        """What `search` finds within so many seconds, if none goes on; None where that takes longer."""
        found = self._sought(search, time.monotonic() + seconds)
        self._cut = self._cut or found is None
        return found

    @property
    def busy(self) -> bool:
        """Whether a search goes on that was not waited for."""
        return not self._ends_by(0.0)

    def taken_late(self) -> Found | None:
        """What a search has found that was not waited for, once; None where that is not known, or was
        taken."""
        late, self._late = self._late, None
        return late

    def stop(self) -> None:
        """End the search that goes on, if any; what it found is nobody's."""
        if self._job is not None:
            self._job.stop()
        self._job = self._late = None

    def _sought(self, search: Callable[[], Found], latest: float) -> Found | None:
        if not self._ends_by(latest):
            return None
        self._job, self._cut = Job(search), False
        return self._taken() if self._ends_by(latest) else None

    def _glance(self, glance: Callable[[], Found]) -> Found:
        begun = time.monotonic()
        seen = glance()
        self._glances.append(time.monotonic() - begun)
        return seen

    def _ends_by(self, latest: float) -> bool:
        """Whether there is no search, or it ends by then (`time.monotonic`); one that was not waited for
        has been taken then."""
        if self._job is None:
            return True
        if not self._job.wait(latest - time.monotonic()):
            return False
        if self._cut:
            try:
                self._late = self._taken()
            except InputError:  # of which its own call has told
                pass
        return True

    def _taken(self) -> Found:
        job, self._job = self._job, None
        assert job is not None
        return job.outcome
