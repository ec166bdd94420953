"""Listens to a driver and its reconstruction, and puts together what belongs together."""

import time
from collections import OrderedDict, deque

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.msg import ContactArray, VoltageFrame
from tomotactile_ros.nodes.contact_messages import message_to_contacts
from tomotactile_ros.nodes.conversions import message_to_image, stamp_of
from tomotactile_ros.support.errors import printable
from tomotactile_ros.view.display import Shot

NODES = ("driver", "reconstruction")
PARTS = ("scene_time", "pressure", "contacts")
_KEPT = 16  # frames whose parts are waited for


class Listener(Node):
    """Collects image, contacts and frame number of equal stamps.

    Parameters
    ----------
    rate : of the simulated sensor, frames/s: frame k begins k / rate into the scene.
    layout : of the sensor.
    profile : of the reconstruction, which says for which time contacts hold (`Pipeline.holds_for`).
    """

    def __init__(self, rate: float, layout: Layout, profile: str):
        super().__init__("live")
        self._layout = layout
        self._rate = rate
        self._part = 0.5 if profile == "fast" else 1.0  # of a frame, until contacts hold
        self._parts: OrderedDict[float, dict] = OrderedDict()
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
        return "; ".join(silent + said) or "driver and reconstruction are well, it must be near"

    def _on_frame(self, message: VoltageFrame) -> None:
        lasts = message.row_period * (len(message.grounded) - 1)
        scene_time = message.sequence / self._rate + self._part * lasts
        self._add(message.header, "scene_time", scene_time)

    def _on_pressure(self, message: Image) -> None:
        self._add(message.header, "pressure", message_to_image(message))

    def _on_contacts(self, message: ContactArray) -> None:
        self._add(message.header, "contacts", message_to_contacts(message, self._layout))

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._heard.add(status.name.split(":")[0].rsplit("/")[-1])
            self._complaints.pop(status.name, None)
            if status.level != DiagnosticStatus.OK:
                self._complaints[status.name] = printable(status.message)

    def _add(self, header, key: str, value: object) -> None:
        stamp = stamp_of(header)
        parts = self._parts.setdefault(stamp, {})
        parts[key] = value
        if len(parts) == len(PARTS):
            self._complete(stamp, parts)
        while len(self._parts) > _KEPT:
            self._parts.popitem(last=False)

    def _complete(self, stamp: float, parts: dict) -> None:
        self._arrivals.append(time.monotonic())
        span = self._arrivals[-1] - self._arrivals[0]
        rate = (len(self._arrivals) - 1) / span if span > 0 else 0.0
        age = self.get_clock().now().nanoseconds * 1e-9 - stamp
        self._shot = Shot(**parts, rate=rate, age=age)
