"""The time of a node: that of this machine, or simulated time from /clock with `use_sim_time`.

`NodeTime` is what a simulated sensor lives in. `PassingTime` is what ages and timeouts are measured with.
docs/topics.md lists who uses which clock.
"""

from __future__ import annotations

import math
import threading
import time
from typing import cast

from rclpy.clock import JumpThreshold, ROSClock, TimeJump
from rclpy.duration import Duration
from rclpy.node import Node

from tomotactile_ros.devices.health import Trouble
from tomotactile_ros.devices.time_source import NO_TIME, TimeSource

_STILL = 1.0  # s without a step of simulated time after which it is taken to stand still
# s by which a step of simulated time is longer than the step before and the real time since that: it was set, and
# did not go by; /clock is usually published at least ten times a second, also where it goes ten times as fast
_SET = 1.0
STANDS_STILL = "simulated time stands still, /clock tells no later time (use_sim_time is set)"


def clock_of(node: Node) -> ROSClock:
    return cast(ROSClock, node.get_clock())


def seconds_now(node: Node) -> float:
    """What stamps of now are, s; 0 while simulated time is not known."""
    return node.get_clock().now().nanoseconds * 1e-9


def is_timeless(node: Node) -> bool:
    """Whether simulated time is wanted, and not known yet."""
    clock = clock_of(node)
    return clock.ros_time_is_active and clock.now().nanoseconds == 0


def troubles_of_time(node: Node) -> list[Trouble]:
    """Why there is no time, where there is none."""
    if not is_timeless(node):
        return []
    return [Trouble("time", True, f"{NO_TIME} (use_sim_time is set)")]


class NodeTime(TimeSource):
    """The time of a node: it goes on in steps where it is simulated."""

    def __init__(self, node: Node):
        self._clock = clock_of(node)
        self._lock = threading.Lock()
        self._waiting: set[threading.Event] = set()
        self._before, self._since = 0.0, -math.inf
        self._steady, self._step = time.monotonic(), 0.0  # s, when the last step was, and how long
        least = Duration(nanoseconds=1)
        threshold = JumpThreshold(
            min_forward=least, min_backward=Duration(nanoseconds=-1), on_clock_change=True
        )
        self._handle = self._clock.create_jump_callback(
            threshold, pre_callback=self._note, post_callback=self._go_on
        )

    def now(self) -> float:
        """The time it is, s."""
        if self._clock.ros_time_is_active:
            return self._clock.now().nanoseconds * 1e-9
        return super().now()

    def before(self) -> float:
        """The time it was before the last step, s."""
        return self._before if self._clock.ros_time_is_active else super().before()

    def since(self) -> float:
        """The time that it was set to last, s."""
        return self._since if self._clock.ros_time_is_active else super().since()

    def stamp(self, when: float) -> float:
        """What a time of `now` is in stamps, s."""
        return when if self._clock.ros_time_is_active else super().stamp(when)

    def wait(self, until: float, news: threading.Event) -> None:
        """Wait until then, until `news` is set, or for the next step."""
        if not self._clock.ros_time_is_active:
            super().wait(until, news)
            return
        with self._lock:
            self._waiting.add(news)
        try:
            if self.now() < until and self._clock.ros_time_is_active:
                news.wait()
        finally:
            with self._lock:
                self._waiting.discard(news)

    def _note(self) -> None:
        self._before = self.now()

    def _go_on(self, jump: TimeJump) -> None:
        now, steady = self.now(), time.monotonic()
        step = now - self._before
        if not 0 <= step <= self._step + steady - self._steady + _SET:
            self._since = now
        self._steady, self._step = steady, step
        with self._lock:
            for news in self._waiting:
                news.set()


class PassingTime:
    """Time that passes for a node, s: it never goes back, and `now` is callable from any thread.

    It goes on as the node's clock does, so that nothing is late in a slow simulation. While that clock
    stands still, for longer than a second, it goes on as this machine's: whether a simulation rests or has
    ended nobody knows, and what is not renewed must not be taken for what is.
    """

    def __init__(self, node: Node):
        self._clock, self._lock = clock_of(node), threading.Lock()
        self._passed = 0.0
        self._steady = self._moved = time.monotonic()
        self._there = 0  # ns, simulated; 0 while there is none

    def stands_still(self) -> bool:
        """Whether simulated time has stood still for longer than a second."""
        self.now()
        return bool(self._there) and time.monotonic() - self._moved > _STILL

    def now(self) -> float:
        """s since it was made."""
        with self._lock:
            steady, simulated = time.monotonic(), self._clock.ros_time_is_active
            there = (
                self._clock.now().nanoseconds if simulated else 0
            )  # asked only then: it takes 10 us
            if not simulated:
                self._passed += steady - self._steady
            elif there != self._there:
                self._moved = steady
                if self._there:  # the first time of all is no step
                    self._passed += max(there - self._there, 0) * 1e-9
            else:
                self._passed += max(steady - max(self._steady, self._moved + _STILL), 0.0)
            self._steady, self._there = steady, there
            return self._passed
