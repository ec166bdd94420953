"""How long what a device sends has waited on the line, from the round trips of commands.

Times in packets cannot tell all of it.  A line that is a little slower than the sensor looks like a
device clock that is a little slow, and a device clock that gains hides any delay that grows with
it: readings would be seconds old and stamped as new.  But an answer comes behind the rows that were
sent before it, so that what waits on the line delays it as much.
"""

from __future__ import annotations

import math

_KEPT = 64  # commands whose answers may be under way


class RoundTrips:
    """Round trips of commands on a line that was empty at first; all times in s.

    Attributes
    ----------
    hidden : float
        How much longer than the shortest the last round trip was, beyond what the times of rows
        told.
    """

    HIDDEN = 0.25  # more than this and a frame's period: a device may send a frame all at once
    IN_A_ROW = 3  # a single answer may be late for other reasons

    def __init__(self) -> None:
        self.hidden = 0.0
        self._asked: dict[int, float] = {}
        self._shortest = math.inf
        self._many = 0

    def ask(self, tag: int, now: float) -> None:
        """A command with this tag is sent."""
        self._asked[tag] = now
        if len(self._asked) > _KEPT:
            del self._asked[next(iter(self._asked))]

    def asked(self, tag: int) -> bool:
        """Whether the answer to this tag is still awaited."""
        return tag in self._asked

    def answer(self, tag: int, now: float, known: float, period: float) -> None:
        """Its answer has come, while rows were `known` to be late, in a stream of frames of this
        period."""
        sent = self._asked.pop(tag, None)
        if sent is None:
            return
        self._shortest = min(self._shortest, now - sent)
        self.hidden = now - sent - self._shortest - known
        self._many = self._many + 1 if self.hidden > self.HIDDEN + period else 0

    @property
    def wait(self) -> bool:
        """Whether rows wait on the line, and their times do not tell."""
        return self._many >= self.IN_A_ROW
