"""Node `reconstruction`: makes a pressure image and contacts of every voltage frame."""

import threading
import time
from collections import deque
from typing import Any

import numpy as np
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from std_srvs.srv import Trigger

from tomotactile_ros.contact import ContactLaw
from tomotactile_ros.devices import Frame
from tomotactile_ros.errors import InputError
from tomotactile_ros.layout import Layout, load_layout
from tomotactile_ros.msg import VoltageFrame
from tomotactile_ros.nodes import diagnostics
from tomotactile_ros.nodes.conversions import check_frame, make_header, message_to_frame
from tomotactile_ros.nodes.diagnostics import Diagnostics, Report
from tomotactile_ros.nodes.life import PlainNode, run
from tomotactile_ros.nodes.outputs import Outputs
from tomotactile_ros.nodes.parameters import Parameters, Spec
from tomotactile_ros.nodes.watch import FrameWatch
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.calibration import load_calibration
from tomotactile_ros.reconstruction.settings import PROFILES
from tomotactile_ros.sheet import MODELS

SPECS = (
    Spec("layout", "equal-8x8", "Electrodes: a layout file or an installed name", read_only=True),
    Spec("frame_id", "", "Frame in all headers; empty: that of the voltage frame", read_only=True),
    Spec("profile", "fast", "How much work goes into an image", choices=PROFILES),
    Spec("deadline", 0.05, "For auto: s, what a frame may take", low=1e-4, high=10.0),
    Spec("resolution", 40, "Cells of the image along the longer side", low=4, high=200),
    Spec(
        "regularization",
        0.0,
        "lambda_J^2 of eq. 1; 0: chosen from the noise",
        low=0.0,
        high=1e30,
    ),
    Spec("noise", 0.001, "Noise of a reading, V rms", low=1e-7, high=1.0),
    Spec("calibration", "", "File of `tomotactile calibrate`; overrides the contact law below"),
    Spec("contact_coefficient", 1e-4, "c of the contact law g = c p^m", low=1e-12, high=1e6),
    Spec("contact_exponent", 1.0, "m of the contact law g = c p^m", low=0.1, high=10.0),
    Spec("contact_radius", 0.005, "Typical radius of a contact, m", low=1e-5, high=1.0),
    Spec("threshold", 3.0, "Idle below this many times the noise", low=0.1, high=1000.0),
    Spec(
        "model", "auto", "Of the sheet; auto: the cheapest that the layout allows", choices=MODELS
    ),
    Spec("excluded", (), "Electrodes that are never used", low=0, high=65535),
    Spec("tare_frames", 16, "Frames that ~/tare averages", low=1, high=1000),
    Spec("view_range", 0.0, "Brightest colour, Pa; 0: the peak of each image", low=0.0, high=1e9),
    Spec("view_overlay", True, "Draw electrodes and contacts into pressure_view"),
    Spec("view_size", 320, "Longer side of pressure_view, pixels", low=4, high=4096),
)
_OF_THE_VIEW = {"view_range", "view_overlay", "view_size"}
_PLAIN_SETTINGS = (
    "profile",
    "resolution",
    "noise",
    "contact_radius",
    "deadline",
    "excluded",
    "threshold",
    "model",
)
_EVERY = 5.0  # s between two warnings of a kind


class Reconstruction:
    """What the reconstruction does, in whichever node it is put.

    Parameters
    ----------
    node : the node.
    subscribe : whether frames come by the topic; otherwise they are handed to `accept`.
    """

    name = "reconstruction"

    def __init__(self, node: Node, subscribe: bool = True):
        self._node = node
        self._log = node.get_logger()
        self.parameters = Parameters(node, SPECS, self._change)
        self._lock = threading.Lock()  # guards the pipeline against frames from another thread
        self._layout: Layout | None = None
        self._pipeline: Pipeline | None = None
        self._recent: deque[Frame] = deque(maxlen=self.parameters["tare_frames"])
        self._active = False
        self._excluded: tuple[int, ...] = ()
        self._outputs = Outputs(node)
        topic = node.resolve_topic_name("voltage_frame")
        self._watch = FrameWatch(node, topic)
        if subscribe:
            self._subscribe()
        node.create_service(Trigger, "~/tare", self._tare)
        self._diagnostics = Diagnostics(node, "reconstruction", topic, self.report)
        self.parameters.warn_of_typos()

    def configure(self) -> None:
        """Read the layout and prepare the reconstruction."""
        self._layout = load_layout(self.parameters["layout"])
        pipeline = Pipeline(self._layout, _settings(self.parameters.values))
        self._use(pipeline, self.parameters.values)

    def activate(self) -> None:
        """Begin to process frames."""
        self._watch.restart()
        self._active = True

    def deactivate(self) -> None:
        """Stop processing frames."""
        with self._lock:
            self._active = False

    def cleanup(self) -> None:
        """Forget layout, pipeline and frames."""
        with self._lock:
            self._layout = self._pipeline = None
            self._recent.clear()

    def accept(self, frame: Frame, layout_id: str, frame_id: str) -> None:
        """Process a frame and publish what comes out, or refuse it with a warning."""
        with self._lock:
            if not self._active:
                return
            try:
                self._process(frame, layout_id, frame_id)
            except InputError as error:
                self._watch.refuse(str(error))
                self._log.warning(f"frame refused: {error}", throttle_duration_sec=_EVERY)

    def report(self) -> Report:
        """State for /diagnostics; why there are no frames is also logged."""
        if not self._active:
            return Report(diagnostics.WARN, "not active")
        figures = {"profile": self._pipeline.profile, **self._watch.figures()}
        complaint = self._watch.complaint()
        if complaint:
            self._log.warning(complaint, throttle_duration_sec=_EVERY)
            return Report(diagnostics.ERROR, complaint, figures)
        if self._excluded:
            electrodes = ", ".join(map(str, self._excluded))
            return Report(diagnostics.WARN, f"electrodes left out: {electrodes}", figures)
        return Report(diagnostics.OK, "images are made", figures)

    def _process(self, frame: Frame, layout_id: str, frame_id: str) -> None:
        start = time.monotonic()
        if layout_id != self._layout.id:
            raise InputError(f"its layout is '{layout_id}', this node has '{self._layout.id}'")
        check_frame(frame, self._layout)
        result = self._pipeline.process(frame.voltages, frame.grounded, frame.drive_voltage)
        if not np.isfinite(self._pipeline.grid.gather(result.pressure)).all():
            raise InputError("the voltages are too extreme for an image")
        header = make_header(frame.stamp, self.parameters["frame_id"] or frame_id)
        self._outputs.publish(result.pressure, result.contacts, header)
        self._recent.append(frame)
        self._excluded = result.excluded
        now = self._node.get_clock().now().nanoseconds * 1e-9
        self._watch.accepted(frame.sequence, now - frame.stamp, time.monotonic() - start)

    def _change(self, changed: set[str], values: dict[str, Any]) -> None:
        if self._pipeline is None:
            return
        pipeline = self._pipeline
        if changed - _OF_THE_VIEW - {"tare_frames"}:
            pipeline = pipeline.with_settings(_settings(values))
        with self._lock:
            self._use(pipeline, values)

    def _use(self, pipeline: Pipeline, values: dict[str, Any]) -> None:
        if pipeline is not self._pipeline:
            self._log.info(pipeline.report)
        self._pipeline = pipeline
        self._recent = deque(self._recent, maxlen=values["tare_frames"])
        frame_id = values["frame_id"] or "tactile_link"
        self._outputs.configure(self._layout, pipeline.grid, frame_id, values)

    def _tare(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            frames = [(frame.voltages, frame.grounded) for frame in self._recent]
            try:
                if not self._active:
                    raise InputError("the reconstruction is not active")
                if not frames:
                    raise InputError(self._watch.complaint() or "no frame has arrived yet")
                self._pipeline.tare(frames)
            except InputError as error:
                response.message = str(error)
            else:
                response.success = True
                response.message = f"zero is now the mean of the last {len(frames)} frames"
        return response

    def _subscribe(self) -> None:
        try:
            from rclpy.event_handler import SubscriptionEventCallbacks
        except ImportError:  # Humble
            from rclpy.qos_event import SubscriptionEventCallbacks
        self._node.create_subscription(
            VoltageFrame,
            "voltage_frame",
            self._on_message,
            QoSProfile(
                history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.BEST_EFFORT
            ),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            event_callbacks=SubscriptionEventCallbacks(incompatible_qos=self._on_incompatible_qos),
        )

    def _on_message(self, message: VoltageFrame) -> None:
        try:
            frame = message_to_frame(message)
        except InputError as error:
            self._watch.refuse(str(error))
            self._log.warning(f"frame refused: {error}", throttle_duration_sec=_EVERY)
            return
        self.accept(frame, message.layout_id, message.header.frame_id)

    def _on_incompatible_qos(self, event) -> None:
        self._watch.incompatible_qos(_policy_name(event.last_policy_kind))


def _policy_name(kind) -> str:
    from rclpy.qos import QoSPolicyKind

    try:
        return QoSPolicyKind(int(kind)).name.lower()
    except ValueError:
        return str(kind)


def _settings(values: dict[str, Any]) -> Settings:
    return Settings(
        regularization=values["regularization"] or None,
        contact_law=_contact_law(values),
        **{key: values[key] for key in _PLAIN_SETTINGS},
    )


def _contact_law(values: dict[str, Any]) -> ContactLaw:
    if values["calibration"]:
        return load_calibration(values["calibration"])
    return ContactLaw(values["contact_coefficient"], values["contact_exponent"])


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run(lambda: [PlainNode(Reconstruction)], args)
