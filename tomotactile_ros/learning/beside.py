"""A sensor that learns in a process of its own, so that rows and frames do not wait for it.

One thread of Python computes at a time. What is learned from a touch takes a tenth of a second, from the first twelve
together some seconds; in the thread of a node that took half of the interpreter from rows that come every
millisecond. Which frames are worth it is still decided here (`LiveLearner.offer`).
"""

from __future__ import annotations

from typing import Any

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.learning.health import Finding
from tomotactile_ros.learning.live import LiveLearner
from tomotactile_ros.learning.state import SensorState
from tomotactile_ros.support.beside import Process

_NICE = 10  # rows and frames go first where there are fewer processors than processes


class LearnerBeside(LiveLearner):
    """The same, whose work is done by a process that the first touch starts, and another where that has ended
    by itself: a ConnectionError of `work`."""

    def __init__(self, layout: Layout, **how: Any):
        super().__init__(layout, **how)
        self._how, self._findings = how, super().findings
        self._process = Process(_Learner, _NICE, "the process that learns has ended")

    @property
    def findings(self) -> list[Finding]:
        """What is broken, as far as is known."""
        return self._findings

    def stop(self) -> None:
        """End the process."""
        self._process.stop()

    def _learn(self, touched: list, idle: list) -> None:
        if not self._process.runs:
            self._process.stop()
            self._process.start()
            self._process.make(self.layout, {**self._how, "state": self.state})
        state, *rest = self._process.ask("learn", touched, idle)
        self.state = self.state if state is None else state
        self._together, self.unexplained, self.moved, self._findings = rest


class _Learner(LiveLearner):
    """What the process does."""

    def __init__(self, layout: Layout, how: dict[str, Any]):
        super().__init__(layout, **how)

    def learn(self, touched: list, idle: list) -> tuple:
        """What is known after these touches and untouched frames, None where nothing new is; and what else
        `LearnerBeside` is told."""
        before = self.state
        self._learn(touched, idle)
        state: SensorState | None = None if self.state is before else self.state
        return state, self._together, self.unexplained, self.moved, self.findings
