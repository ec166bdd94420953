"""The time that a source without hardware lives in: this machine's, unless another is given.

Simulated time goes in steps, at any pace, stands still and may be set back. A source waits for it
with an event that the time sets whenever it goes on, and asks again.
"""

from __future__ import annotations

import math
import threading
import time

NO_TIME = "no simulated time: nobody publishes /clock, or it still says 0"


class TimeSource:
    """Time, s, of a clock of this machine that is never set; stamps are Unix time. Others have a time of
    their own, 0 while it is not known."""

    def now(self) -> float:
        """The time it is."""
        return time.monotonic()

    def before(self) -> float:
        """The time it was before the last step: what was due since then is not late. Of a time that
        goes evenly: `now`."""
        return self.now()

    def since(self) -> float:
        """The time that it was set to last: what was due before then is of no use, and not lost."""
        return -math.inf

    def stamp(self, when: float) -> float:
        """What a time of `now` is in stamps."""
        return unix_time(when)

    def wait(self, until: float, news: threading.Event) -> None:
        """Wait until then, until `news` is set, or until a time that goes in steps goes on."""
        news.wait(max(0.0, until - time.monotonic()))


def unix_time(monotonic: float) -> float:
    """Unix time of a `monotonic` time, s, to some µs, so that stamps keep their order.

    The two clocks are read one after the other; where the process was held up in between, again.
    """
    for _ in range(10):
        before, now, after = time.monotonic(), time.time(), time.monotonic()
        if after - before < 2e-5:
            break
    return monotonic + now - before
