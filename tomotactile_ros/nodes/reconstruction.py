"""Node `reconstruction`: makes a pressure image and contacts of every voltage frame, and follows
contacts from row to row where rows come."""

import sys
import threading
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import Header

from tomotactile_ros.devices import Frame
from tomotactile_ros.devices.health import Trouble
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.layouts.layout_ids import is_bare, matches
from tomotactile_ros.learning.state import SensorState
from tomotactile_ros.nodes import diagnostics
from tomotactile_ros.nodes.conditions import Conditions, Pace
from tomotactile_ros.nodes.conversions import check_frame, later
from tomotactile_ros.nodes.diagnostics import Diagnostics, Report
from tomotactile_ros.nodes.frame_subscriptions import Source, of_frames, of_rows
from tomotactile_ros.nodes.learning import Learning
from tomotactile_ros.nodes.node_time import is_timeless, seconds_now, troubles_of_time
from tomotactile_ros.nodes.outputs import Outputs
from tomotactile_ros.nodes.reconstruction_parameters import (
    OF_THE_NODE,
    SPECS,
    law_in_words,
    settings_of,
)
from tomotactile_ros.nodes.row_contacts import Rows
from tomotactile_ros.nodes.running import Part, run
from tomotactile_ros.nodes.stopping import unless_stopped
from tomotactile_ros.nodes.tare import Taring
from tomotactile_ros.nodes.turns import FairLock
from tomotactile_ros.nodes.watch import FrameWatch
from tomotactile_ros.reconstruction import Pipeline
from tomotactile_ros.reconstruction.deadline import period_of
from tomotactile_ros.reconstruction.settings import Result, doubt_of_noise, doubt_of_settling
from tomotactile_ros.support.errors import InputError

PATIENCE = 1e-4  # s until a thread that computes lets the other one have the interpreter
_EVERY = 5.0  # s between two warnings of a kind
_LOOK = 0.25  # s between two looks whether contacts have grown old: an eighth of `max_age`


class Reconstruction(Part):
    """What the reconstruction does, in whichever node it is put."""

    name, specs = "reconstruction", SPECS

    def __init__(self, node: Node):
        super().__init__(node)
        self._lock = FairLock()  # guards the pipeline against frames from another thread
        self._rows_lock = threading.Lock()  # the same of rows, which do not wait for frames
        self._pipeline: Pipeline | None = None
        self._active = False
        self._complaint, self._complained = "", 0.0  # why no images, as the log has it, and when
        self._said: tuple[str, ...] = ()  # about the pipeline
        self._pace, self._conditions = Pace(), Conditions(self._log)
        self._excluded: tuple[int, ...] = ()
        self._withheld = ""
        self._noise = np.nan  # V rms of a reading, as the last frame showed it
        self._settling = 0.0  # part of the row before that readings keep
        self._rest = 0.0  # s that the last frame took beside its reconstruction
        self._bare = False  # frames name their layout without the hash
        self._outputs = Outputs(node)
        self._rows = Rows(node, lambda: self.parameters.values, self._outputs)
        topic = node.resolve_topic_name("voltage_frame")
        self._watch = FrameWatch(node, topic)
        self._rows_topic = node.resolve_topic_name("voltage_rows")
        self._sources = self._make_sources()
        self._taring = Taring(
            node,
            lambda: self.parameters.values,
            self._lock,
            lambda: self._pipeline if self._active else None,
            self._watch.complaint,
        )
        self._learning = Learning(
            node, lambda: self.parameters.values, self._use_sensor, lambda: self._outputs.frame_id
        )
        self._timer = node.create_timer(
            _LOOK,
            self._look,
            callback_group=MutuallyExclusiveCallbackGroup(),
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )
        self._diagnostics = Diagnostics(node, "reconstruction", self._hardware_id, self.report)
        self.parameters.warn_of_typos()

    def _make_sources(self) -> Sequence[Source]:
        """Where frames and rows come from: their topics."""
        incompatible, skip = self._watch.incompatible_qos, self._rows.watch.skip
        return [
            of_frames(self._node, self.accept, self.refuse, incompatible),
            of_rows(self._node, self.accept_rows, skip, self.refuse),
        ]

    def configure(self) -> None:
        """Read the layout and prepare the reconstruction."""
        layout = load_layout(self.parameters["layout"])
        settings = settings_of(self.parameters.values)
        self._learning.configure(layout)
        pipeline = Pipeline(layout, settings, sensor=self._learning.known)
        self._taring.restore(pipeline)
        self._use(pipeline, self.parameters.values)

    def activate(self) -> None:
        """Begin to process frames."""
        self._watch.restart()
        self._learning.start()
        with unless_stopped(self._node):
            self._outputs.begin()
        self._active = True
        for each in self._sources:
            each.start()

    def deactivate(self) -> None:
        """Stop processing frames, and say last that it is not known any more what touches."""
        with self._lock, self._rows_lock:
            self._active = False
            if self._pipeline is not None:
                self._pipeline.stop()
        if self._node.context.ok():
            with unless_stopped(self._node):
                self._outputs.take_back("the reconstruction was stopped")
        for each in self._sources:
            each.stop()
        self._rows.stop()
        self._learning.stop()

    def cleanup(self) -> None:
        """Forget pipeline and frames."""
        with self._lock, self._rows_lock:
            self._pipeline = None
            self._taring.forget()

    def accept(self, frame: Frame, layout_id: str, header: Header) -> None:
        """Process a frame and publish what comes out, or refuse it with a warning."""
        with self._lock, unless_stopped(self._node):
            pipeline = self._pipeline
            if not self._active or pipeline is None or is_timeless(self._node):
                return  # how old they are nobody knows
            try:
                self._process(pipeline, frame, layout_id, header)
            except InputError as error:
                self.refuse(str(error))
            except Exception:
                if self._node.context.ok():  # otherwise a stop came in between
                    raise

    def accept_rows(self, rows: Frame, layout_id: str, header: Header) -> None:
        """Follow rows of a frame and publish what comes out, or refuse them with a warning."""
        with self._rows_lock, unless_stopped(self._node):
            pipeline = self._pipeline
            if not self._active or pipeline is None or not self._rows.wanted:
                return
            if is_timeless(self._node):
                return
            try:
                _check(pipeline.layout, rows, layout_id)
                self._rows.take(pipeline, rows, self.parameters["frame_id"] or header.frame_id)
            except InputError as error:
                self.refuse(str(error))

    def refuse(self, reason: str) -> None:
        """Count a frame that is not used, and say why."""
        self._watch.refuse(reason)
        self._log.warning(f"frame refused: {reason}", throttle_duration_sec=_EVERY)

    def report(self) -> Report:
        """State for /diagnostics; why there are no frames is also logged."""
        pipeline = self._pipeline  # another thread may take it away
        if not self._active or pipeline is None:
            return Report(diagnostics.WARN, "not active")
        figures = {
            "profile": pipeline.profile,
            "contact law": law_in_words(self.parameters.values),
            "cut": self._watch.cut(),
            "late": self._rows.late() or self._watch.late(),
            "electrodes_left_out": ", ".join(map(str, self._excluded)),
            **self._watch.figures(),
            **self._rows.figures(),
            **self._taring.figures(),
            **self._learning.figures(),
        }
        complaint = self._watch.complaint()
        if complaint and self._lock.locked():  # a thread of its own makes the images
            complaint = "one image takes seconds: choose a faster profile or a lower resolution"
        if complaint:
            self._complain(complaint)
            return Report(diagnostics.ERROR, complaint, figures)
        if self._complaint:
            self._complaint = ""
            self._log.info("images are made again")
        troubles = [
            *troubles_of_time(self._node),
            *self._watch.troubles(self.parameters["max_age"]),
            *self._rows.troubles(self._node.count_publishers(self._rows_topic)),
            *self._taring.troubles(),
            *self._learning.troubles(),
        ]
        if self._excluded:
            electrodes = ", ".join(map(str, self._excluded))
            text = f"electrodes left out: {electrodes}"
            troubles.append(Trouble("excluded", False, text, which=electrodes))
        if self._withheld:
            text = f"contacts are withheld: {self._withheld}"
            troubles.append(Trouble("withheld", False, text, which=self._withheld))
        if text := doubt_of_noise(self._noise, pipeline.settings.noise):
            troubles.append(Trouble("noise", False, text))
        if text := doubt_of_settling(self._settling):
            troubles.append(Trouble("settling", False, text))
        if text := pipeline.made_otherwise:
            troubles.append(Trouble("sheet", False, text))
        if self._bare:
            text = f"frames name their layout without the hash of its geometry: whether it is {pipeline.layout.id} is not known"
            troubles.append(Trouble("bare layout", False, text))
        self._conditions.say(troubles)
        if self._watch.waits and not troubles:
            return Report(diagnostics.WARN, "waiting for the first frame", figures)
        level = max(map(diagnostics.level_of, troubles), default=diagnostics.OK)
        message = "; ".join(trouble.text for trouble in troubles) or "images are made"
        return Report(level, message, figures)

    def _complain(self, complaint: str) -> None:
        """Log why there are no images: when that is so, and every some seconds."""
        now = time.monotonic()
        new = complaint != self._complaint and self._pace.allows()
        if new or now - self._complained > _EVERY:
            self._complaint, self._complained = complaint, now
            self._log.error(complaint)

    def _look(self) -> None:
        if self._active:
            with unless_stopped(self._node):
                self._outputs.watch()

    def _process(self, pipeline: Pipeline, frame: Frame, layout_id: str, header: Header) -> None:
        start, sought, values = time.monotonic(), 0.0, self.parameters.values
        _check(pipeline.layout, frame, layout_id)
        followed, result = self._rows.followed, None
        self._rows.watch.frame_has(len(frame.grounded))
        left_out = followed and self._rows.leaves_out(pipeline, frame)
        if followed:
            result = self._drawn_by_rows(pipeline)
        if result is None and left_out:
            return
        limit = values["deadline"] or period_of(frame)
        if result is None:
            begun = time.monotonic()
            result = self._rows.process(pipeline, frame, max(limit - self._rest, 0.0))
            sought = time.monotonic() - begun
            followed = followed or self._rows.followed  # since: they know better by now
        frame_id = self.parameters["frame_id"] or header.frame_id
        header = Header(stamp=header.stamp, frame_id=frame_id)
        self._taring.remember(frame)
        self._learning.offer(frame)
        self._withheld = self._rows.withheld if followed else result.reason
        holds = later(header, result.holds)
        if not followed:
            self._outputs.say_touched(not result.idle, holds)
        shown = result
        if followed and result.reason:  # rows may know meanwhile
            shown = self._drawn_by_rows(pipeline) or result
        drawn = values["image"] != "none"
        finite = drawn and bool(np.isfinite(pipeline.grid.gather(shown.pressure)).all())
        if drawn and not finite and not shown.reason:
            raise InputError(
                "the image has infinite pressures: are the voltages in V, and is the contact law right?"
            )
        if not followed:  # before the pictures, which may take long
            if shown.reason:
                self._outputs.withhold(shown.reason, holds, shown.complete)
            elif values["contacts"]:
                known = shown.complete, shown.alternative
                self._outputs.publish_contacts(shown.contacts, holds, *known)
        if finite:  # with the time of its frame, which may be one before
            when = header if shown.holds >= 0 else holds
            self._outputs.publish(shown.pressure, shown.contacts, when, shown.complete)
        self._excluded = result.excluded
        if not np.isnan(result.noise):  # it is the sensor's, also while no frame shows it
            self._noise = result.noise
        self._settling = result.settling or self._settling
        self._bare = is_bare(layout_id, pipeline.layout.id)
        now, took = seconds_now(self._node), time.monotonic() - start
        self._rest = took - sought
        lasts = frame.row_period * len(frame.grounded)
        self._watch.accepted(
            frame.sequence, frame.stamp, now - frame.stamp, took, lasts, limit, result.complete
        )
        if self._rows.come and not left_out:
            self._rows.correct(pipeline, frame, max(limit - took, 0.0))

    def _drawn_by_rows(self, pipeline: Pipeline) -> Result | None:
        """`Rows.image`."""
        with self._rows_lock:
            return self._rows.image(pipeline)

    def _use_sensor(self, sensor: SensorState) -> None:
        """Go on with what was learned."""
        with self._lock:
            if self._pipeline is not None:
                self._pipeline.use_sensor(sensor)

    def _change(self, changed: set[str], values: dict[str, Any]) -> None:
        if self._pipeline is None:
            return
        pipeline = self._pipeline
        if changed - OF_THE_NODE:
            pipeline = pipeline.with_settings(settings_of(values))
        with self._lock:
            self._use(pipeline, values)

    def _use(self, pipeline: Pipeline, values: dict[str, Any]) -> None:
        if pipeline is not self._pipeline:
            lines = pipeline.report, f"forces by the contact law {law_in_words(values)}"
            for line in [each for each in lines if each not in self._said]:
                self._log.info(line)
            self._said = lines
            if self._pipeline is not None:
                self._pipeline.stop()
        with self._rows_lock:
            self._pipeline = pipeline
            self._outputs.configure(pipeline.layout, pipeline.grid, values)

    def _hardware_id(self) -> str:
        """Which sensor: as the parameters say, otherwise by the frame of its messages."""
        return self.parameters["hardware_id"] or self._outputs.frame_id


def _check(layout: Layout, frame: Frame, layout_id: str) -> None:
    """Refuse, as InputError, what is not of this layout."""
    if not matches(layout_id, layout.id):
        raise InputError(f"its layout is {layout_id[:80]!r}, this node has {layout.id!r}")
    check_frame(frame, layout)


def main(args: list[str] | None = None, managed: bool = False) -> int:
    """Run the node."""
    sys.setswitchinterval(PATIENCE)
    specs = {Reconstruction.name: SPECS}
    return run(lambda make: [make(Reconstruction)], args, __doc__, specs, managed=managed)
