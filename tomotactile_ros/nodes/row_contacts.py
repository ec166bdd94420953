"""Rows as they come: contacts after every few of them, and at once where something begins or ends.

Rows never wait for a frame: frames are processed in their own thread as always, and what one tells
of contacts is left for the next row to take in.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from rclpy.node import Node
from std_msgs.msg import Header

from tomotactile_ros.devices import Frame
from tomotactile_ros.devices.health import Trouble
from tomotactile_ros.estimation.row_estimator import RowsState
from tomotactile_ros.nodes.conversions import make_header
from tomotactile_ros.nodes.node_time import PassingTime, seconds_now
from tomotactile_ros.nodes.outputs import Outputs
from tomotactile_ros.nodes.parameters import Spec
from tomotactile_ros.nodes.row_watch import RowWatch
from tomotactile_ros.reconstruction import Pipeline
from tomotactile_ros.reconstruction.beside import Beside
from tomotactile_ros.reconstruction.settings import Result

SPECS = (
    Spec(
        "publish_every",
        8,
        "With rows: contacts after so many of them; 0: contacts come from frames alone",
        low=0,
        high=65535,
    ),
)
_TURNS, _TURN = 2, 0.005  # times, s, that a frame waits for its last rows
_LONGEST = 1.0  # s of work for the rows of one message; those left over then are left out
_PATIENCE = 1.0  # s without rows after which contacts are those of frames again


class Rows:
    """Follows the contacts of one reconstruction node from row to row.

    Parameters
    ----------
    node : the node.
    values : gives its parameters, `SPECS` among them.
    outputs : publishes.
    """

    def __init__(self, node: Node, values: Callable[[], dict[str, Any]], outputs: Outputs):
        self._node, self._values, self._outputs = node, values, outputs
        self._now = PassingTime(node).now
        self.watch = RowWatch(self._now)
        self.withheld = ""  # why contacts of the last row are not known
        self._state: RowsState | None = None
        self._of: tuple = ()  # pipeline and tare of the state
        self._last = -math.inf
        self._since = 0
        self._touching: tuple[int, ...] | None = None
        self._known = False
        self._left_out = False  # the last frame
        self._beside = Beside()

    @property
    def wanted(self) -> bool:
        """Whether rows are to be followed."""
        values = self._values()
        return values["contacts"] and values["publish_every"] > 0

    @property
    def come(self) -> bool:
        """Whether rows come, and are wanted."""
        return self.wanted and self._now() - self._last <= _PATIENCE

    @property
    def followed(self) -> bool:
        """Whether contacts are those of rows now: not before rows have known once what touches, which a
        frame has to tell where something did already when they began."""
        return self._known and self.come

    def take(self, pipeline: Pipeline, rows: Frame, frame_id: str) -> None:
        """Follow rows, and publish what is due."""
        of = pipeline, pipeline.baseline
        new = len(self._of) != len(of) or any(a is not b for a, b in zip(of, self._of))
        state = self._state
        if new or state is None or not self.come:
            self._known = False
            state = self._state = pipeline.rows(waits=False)
            self._of = of
        self._last = self._now()
        begun, every = time.monotonic(), self._values()["publish_every"]
        for i, (voltages, ground) in enumerate(zip(rows.voltages, rows.grounded)):
            now = rows.stamp + i * rows.row_period
            pipeline.follow_row(voltages, int(ground), rows.drive_voltage, now, state)
            self._since += 1
            touching = state.touching
            # rows that begin anew within, after a pause, know no more than at first
            self._known = touching is not None or (self._known and not state.rows.touched_at_once)
            if self._known and (self._since >= every or touching != self._touching):
                self._since, self._touching = 0, touching
                self._publish(pipeline, state, make_header(now, frame_id))
            took = time.monotonic() - begun
            if took > _LONGEST:
                break
        self._last = self._now()
        self.watch.followed(rows.sequence, i + 1, seconds_now(self._node) - now, took)
        if i + 1 < len(rows.grounded):
            self.watch.skip(rows.sequence, len(rows.grounded) - i - 1)

    def leaves_out(self, pipeline: Pipeline, frame: Frame) -> bool:
        """Whether a frame is not worth its time: rows saw something begin or end in it, and know it
        already; the next frame is of one state. Never two frames in turn."""
        state, ended = self._state, frame.stamp + frame.row_period * len(frame.grounded)
        if state is None or self._of[0] is not pipeline:
            self._left_out = False
            return False
        for _ in range(_TURNS):  # its last rows may wait still
            if not state.begun or state.rows.time > ended - 1.5 * frame.row_period:
                break
            time.sleep(_TURN)
        mixed = state.rows_since_change(frame.stamp, ended) is not None
        self._left_out = mixed and not self._left_out
        return self._left_out

    def image(self, pipeline: Pipeline) -> Result | None:
        """An image of what rows tell; None where they do not know all that an image of a frame would show."""
        state = self._state
        if state is None or not state.begun or not state.known or self._of[0] is not pipeline:
            return None
        return pipeline.image_after_row(state)

    def process(self, pipeline: Pipeline, frame: Frame, deadline: float) -> Result:
        """The result of a frame within a `deadline`, s; where rows are followed, from the process beside
        as soon as that is ready."""
        if self.followed and self._beside.takes(pipeline):
            try:
                return self._beside.process(*_words(frame), deadline)
            except ConnectionError as error:
                self._node.get_logger().warning(str(error))
        return pipeline.process(frame, numbered=not self.followed, deadline=deadline)

    def correct(self, pipeline: Pipeline, frame: Frame, deadline: float) -> None:
        """Let a frame, that was processed last if it was at all, correct what rows tell, if they ask for
        it; `deadline` as in `process`."""
        state = self._state
        if state is None or self._of[0] is not pipeline or not state.asks:
            return
        maker = self._beside if self._beside.takes(pipeline) else pipeline
        try:
            maker.correct(state, *_words(frame), deadline=deadline)
        except ConnectionError as error:  # the next frame tells
            self._node.get_logger().warning(str(error))

    def stop(self) -> None:
        """End the process beside; the next frame that rows ask for starts it again."""
        self._beside.stop()

    def troubles(self, publishers: int = 1) -> list[Trouble]:
        """What is wrong with the rows of the last seconds, which so many publish."""
        return self.watch.troubles(publishers, self._values()["max_age"]) if self.come else []

    def late(self) -> str:
        """How many rows of late were told late or not at all, for people; empty where none come."""
        return self.watch.late() if self.come else ""

    def figures(self) -> dict[str, float | int]:
        """Counts and times, where rows come."""
        return self.watch.figures() if self.come else {}

    def _publish(self, pipeline: Pipeline, state: RowsState, header: Header) -> None:
        result = pipeline.after_row(state)
        self.withheld = result.reason
        self._outputs.say_touched(not result.idle, header)
        if result.reason:
            self._outputs.withhold(result.reason, header)
        else:
            self._outputs.publish_contacts(result.contacts, header, alternative=result.alternative)


def _words(frame: Frame) -> tuple[np.ndarray, np.ndarray, float, float, float]:
    """A frame as `Pipeline.process` takes it."""
    return frame.voltages, frame.grounded, frame.drive_voltage, frame.row_period, frame.stamp
