"""Learning while the reconstruction runs: its thread, the topic `sensor_state`, the sensor's file.

Frames are looked at as they come; what is worth learning from is fitted in a process beside, for which the
thread waits, and whoever uses the sensor is told of what came out. The file is written after the first touches, then at most
every half minute, and at the end.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher

from tomotactile_ros.devices import Frame
from tomotactile_ros.devices.health import Trouble
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.learning.beside import LearnerBeside
from tomotactile_ros.learning.file import load_sensor, save_sensor
from tomotactile_ros.learning.live import KINDS, OFF, LiveLearner
from tomotactile_ros.learning.state import SensorState
from tomotactile_ros.msg import SensorState as SensorMessage
from tomotactile_ros.nodes.node_time import clock_of
from tomotactile_ros.nodes.parameters import Spec
from tomotactile_ros.nodes.sensor_messages import sensor_to_message
from tomotactile_ros.nodes.topics import publisher
from tomotactile_ros.support.errors import InputError

SPECS = (
    Spec(
        "sensor",
        "",
        "File of `tomotactile learn`: what is known of this sensor; kept there with learn",
        read_only=True,
    ),
    Spec(
        "learn",
        OFF,
        "Learn from touches: off, gains, offsets and resistances, or the sheet, too",
        choices=KINDS,
        read_only=True,
    ),
)
_SAVED_EVERY = 30.0  # s
_PATIENCE = 2.0  # s until a thread that learns is left alone at the end


class Learning:
    """What a reconstruction node knows and learns of its sensor.

    Parameters
    ----------
    node : the node.
    values : gives its parameters, `SPECS` among them.
    use : takes what is known by now; called from the thread.
    frame_id : gives the sensor's frame.
    """

    def __init__(
        self,
        node: Node,
        values: Callable[[], dict[str, Any]],
        use: Callable[[SensorState], None],
        frame_id: Callable[[], str],
    ):
        self._node, self._values, self._use, self._frame_id = node, values, use, frame_id
        self._learner: LiveLearner | None = None
        self._wake, self._ended = threading.Event(), threading.Event()  # of the thread at work
        self._thread: threading.Thread | None = None
        self._unsaved, self._saved, self._complaint = False, -math.inf, ""
        self._publisher: Publisher | None = None
        if values()["sensor"] or values()["learn"] != OFF:
            self._publisher = publisher(node, SensorMessage, "sensor_state", latched=True)

    @property
    def known(self) -> SensorState | None:
        """What is known of the sensor; None where neither a file nor touches have told anything."""
        learner = self._learner
        return learner.state if learner is not None and _is_known(learner.state) else None

    def configure(self, layout: Layout) -> None:
        """Read the file, if there is one; InputError where it cannot be used."""
        values = self._values()
        self._learner = None
        if self._publisher is None:
            return
        state = None
        if values["sensor"] and (values["learn"] == OFF or Path(values["sensor"]).exists()):
            state = load_sensor(values["sensor"], layout, values["model"])
        self._learner = LearnerBeside(
            layout,
            noise=values["noise"],
            radius=values["contact_radius"],
            model=values["model"],
            excluded=values["excluded"],
            kind=values["learn"],
            state=state,
        )
        self._publish(self._learner)

    def start(self) -> None:
        """Begin to learn."""
        learner = self._learner
        if learner is None or self._values()["learn"] == OFF:
            return
        self._wake, self._ended = threading.Event(), threading.Event()
        self._thread = threading.Thread(
            target=self._work, args=(learner, self._wake, self._ended), name="learning", daemon=True
        )
        self._thread.start()

    def stop(self) -> None:
        """Stop; what was learned is in the file, what is being learned is left."""
        if self._thread is None:
            return
        self._ended.set()
        self._wake.set()
        self._thread.join(_PATIENCE)
        if self._learner is not None:
            self._learner.stop()
        self._thread = None
        self._save()

    def offer(self, frame: Frame) -> None:
        """Look at a frame that was processed."""
        if self._thread is None or self._learner is None:
            return
        if self._learner.offer(frame.voltages, frame.grounded, frame.drive_voltage, frame.stamp):
            self._wake.set()

    def figures(self) -> dict[str, str | int]:
        """What was learned so far."""
        learner = self._learner
        if learner is None:
            return {}
        figures: dict[str, str | int] = {"learned_from_touches": learner.state.touches}
        if learner.unexplained:
            figures["touches_not_explained"] = learner.unexplained
        if learner.moved:
            figures["touches_that_moved"] = learner.moved
        return figures

    def troubles(self) -> list[Trouble]:
        """What is wrong with the learning, and with the sensor."""
        found = [Trouble("sensor", False, self._complaint)] if self._complaint else []
        for each in self._learner.findings if self._learner is not None else ():
            since = self._date(each.since)
            sure = f", {each.sure:.0f} standard deviations" if math.isfinite(each.sure) else ""
            text = f"{each.text} (since {since}{sure})"
            found.append(Trouble(f"health {each.name}", False, text))
        return found

    def _date(self, stamp: float) -> str:
        """A stamp, s, for people; simulated time has no date."""
        if clock_of(self._node).ros_time_is_active:
            return f"{stamp:.1f} s"
        return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(stamp))

    def _work(self, learner: LiveLearner, wake: threading.Event, ended: threading.Event) -> None:
        while True:
            # what was learned last is kept, too, where nothing more is learned before a crash
            woken = wake.wait(self._until_saved() if self._unsaved else None)
            wake.clear()
            if ended.is_set():
                return
            if not woken:
                self._save()
                continue
            state = None
            try:
                state = learner.work()
            except (InputError, ConnectionError) as error:
                self._complaint = f"nothing can be learned: {error}"
            if ended.is_set():
                return
            if state is None:
                continue
            self._complaint, self._unsaved = "", bool(self._values()["sensor"])
            self._use(state)
            self._publish(learner)
            if not self._until_saved():
                self._save()

    def _until_saved(self) -> float:
        """Seconds until the file is written again."""
        return max(self._saved + _SAVED_EVERY - time.monotonic(), 0.0)

    def _publish(self, learner: LiveLearner) -> None:
        if self._publisher is None:
            return
        known = learner.state, learner.operator, learner.layout
        message = sensor_to_message(*known, self._frame_id())
        try:
            self._publisher.publish(message)
        except Exception:
            if self._node.context.ok():  # otherwise a stop came in between
                raise

    def _save(self) -> None:
        path, learner = self._values()["sensor"], self._learner
        if learner is None or not self._unsaved:
            return
        self._saved = time.monotonic()
        try:
            save_sensor(path, learner.layout, learner.operator, learner.state)
        except InputError as error:
            self._complaint = f"what was learned is not kept: {error}"
        else:
            self._unsaved = False


def _is_known(state: SensorState) -> bool:
    return bool(state.touches or state.idle)
