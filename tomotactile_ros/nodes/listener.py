"""Listens to a driver and its reconstruction, and puts together what belongs together."""

import time
from collections import OrderedDict, deque
from dataclasses import dataclass

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.msg import ContactArray, VoltageFrame
from tomotactile_ros.nodes.contact_messages import message_to_contacts
from tomotactile_ros.nodes.conversions import message_to_image, stamp_of
from tomotactile_ros.reconstruction.settings import DEFAULT_LAW
from tomotactile_ros.support.errors import printable
from tomotactile_ros.view.display import Shot

NODES = ("driver", "reconstruction")
_KEPT = 16  # frames whose parts are waited for
_CONTACTS = 512  # messages of contacts: rows send several in a frame, which is waited for meanwhile
_ROUNDING = 1e-5  # s, of stamps and of what is added to them


@dataclass
class _Frame:
    """A frame of which parts are still to come: when it began in the scene and how long it lasts, s."""

    began: float | None = None
    lasts: float = 0.0
    pressure: np.ndarray | None = None


class Listener(Node):
    """Puts together a frame's number and image, which have its stamp, and the last contacts that hold
    for a time within it.

    Parameters
    ----------
    rate : of the simulated sensor, frames/s: frame k begins k / rate into the scene.
    layout : of the sensor.
    calibrated : whether pressures are known; otherwise images are turned back into conductances,
        with the law that the reconstruction has by default.
    """

    def __init__(self, rate: float, layout: Layout, calibrated: bool = True):
        super().__init__("live")
        self._layout, self._rate, self._calibrated = layout, rate, calibrated
        self._frames: OrderedDict[float, _Frame] = OrderedDict()
        self._contacts: deque[tuple[float, list, str]] = deque(maxlen=_CONTACTS)
        self._arrivals: deque[float] = deque(maxlen=32)
        self._heard: set[str] = set()
        self._complaints: dict[str, str] = {}
        self._shot: Shot | None = None
        reliable = QoSProfile(depth=2, reliability=ReliabilityPolicy.RELIABLE)
        self.create_subscription(VoltageFrame, "voltage_frame", self._on_frame, reliable)
        self.create_subscription(Image, "pressure", self._on_pressure, reliable)
        self.create_subscription(ContactArray, "contacts", self._on_contacts, reliable)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def take(self) -> Shot | None:
        """The newest complete image since the last call, if any."""
        shot, self._shot = self._shot, None
        return shot

    def complaints(self) -> str:
        """What the nodes say is wrong."""
        silent = [f"{name} is still starting" for name in NODES if name not in self._heard]
        said = [f"{name}: {message}" for name, message in self._complaints.items()]
        return "; ".join(silent + said) or "driver and reconstruction report nothing wrong"

    def _on_frame(self, message: VoltageFrame) -> None:
        frame = self._frame(message.header)
        frame.began = message.sequence / self._rate
        frame.lasts = message.row_period * (len(message.grounded) - 1)
        self._put_together()

    def _on_pressure(self, message: Image) -> None:
        image = message_to_image(message)
        shown = image if self._calibrated else DEFAULT_LAW.conductance(image)
        self._frame(message.header).pressure = shown
        self._put_together()

    def _on_contacts(self, message: ContactArray) -> None:
        contacts = message_to_contacts(message, self._layout)
        self._contacts.append((stamp_of(message.header), contacts, message.reason))
        self._put_together()

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._heard.add(status.name.split(":")[0].rsplit("/")[-1])
            self._complaints.pop(status.name, None)
            if status.level != DiagnosticStatus.OK:
                self._complaints[status.name] = printable(status.message)

    def _frame(self, header: Header) -> _Frame:
        """What is known of the frame of this stamp."""
        frame = self._frames.setdefault(stamp_of(header), _Frame())
        while len(self._frames) > _KEPT:
            self._frames.popitem(last=False)
        return frame

    def _put_together(self) -> None:
        """Make a shot of every frame whose parts are all there."""
        for stamp, frame in list(self._frames.items()):
            if frame.pressure is None or frame.began is None:
                continue
            for holds, contacts, reason in reversed(self._contacts):
                since = holds - stamp
                if -_ROUNDING < since < frame.lasts + _ROUNDING:
                    del self._frames[stamp]
                    shown = contacts, frame.began + since, reason
                    self._complete(stamp, frame.pressure, *shown)
                    break

    def _complete(self, stamp: float, pressure, contacts, scene_time: float, reason: str) -> None:
        self._arrivals.append(time.monotonic())
        span = self._arrivals[-1] - self._arrivals[0]
        rate = (len(self._arrivals) - 1) / span if span > 0 else 0.0
        age = self.get_clock().now().nanoseconds * 1e-9 - stamp
        self._shot = Shot(pressure, contacts, scene_time, rate=rate, age=age, reason=reason)
