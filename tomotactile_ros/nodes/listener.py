"""Listens to a driver and its reconstruction: contacts at once, the image under them when there is one."""

import time
from collections import deque

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import Image

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.msg import ContactArray, VoltageFrame
from tomotactile_ros.nodes.contact_messages import message_to_alternative, message_to_contacts
from tomotactile_ros.nodes.conversions import message_to_image, stamp_of
from tomotactile_ros.reconstruction.settings import DEFAULT_LAW
from tomotactile_ros.support.errors import printable
from tomotactile_ros.view.display import Shot

NODES = ("driver", "reconstruction")
RECONSTRUCTION = "reconstruction: reconstruction"


class Listener(Node):
    """Puts together what is known now: the last contacts, and under them the newest image.

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
        self._begun: float | None = None  # s, when the scene did, as its frames are stamped
        self._image: tuple[float, np.ndarray] | None = None  # stamp, s, and Pa
        self._arrivals: deque[float] = deque(maxlen=32)  # of images
        self._heard: set[str] = set()
        self._complaints: dict[str, str] = {}
        self._late = ""
        self._shot: Shot | None = None
        reliable = QoSProfile(depth=2, reliability=ReliabilityPolicy.RELIABLE)
        self.create_subscription(VoltageFrame, "voltage_frame", self._on_frame, reliable)
        self.create_subscription(Image, "pressure", self._on_pressure, reliable)
        self.create_subscription(ContactArray, "contacts", self._on_contacts, reliable)
        self.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)

    def take(self) -> Shot | None:
        """What has come to be known since the last call, if anything has."""
        shot, self._shot = self._shot, None
        return shot

    def complaints(self) -> str:
        """What the nodes say is wrong."""
        silent = [f"{name} is still starting" for name in NODES if name not in self._heard]
        said = [f"{name}: {message}" for name, message in self._complaints.items()]
        return "; ".join(silent + said) or "driver and reconstruction report nothing wrong"

    def _on_frame(self, message: VoltageFrame) -> None:
        self._begun = stamp_of(message.header) - message.sequence / self._rate

    def _on_pressure(self, message: Image) -> None:
        image = message_to_image(message)
        shown = image if self._calibrated else DEFAULT_LAW.conductance(image)
        self._image = stamp_of(message.header), shown
        self._arrivals.append(time.monotonic())

    def _on_contacts(self, message: ContactArray) -> None:
        if self._begun is None:
            return
        span = self._arrivals[-1] - self._arrivals[0] if self._arrivals else 0.0
        holds = stamp_of(message.header)
        shown, image = self._image or (holds, None)
        self._shot = Shot(
            image,
            message_to_contacts(message, self._layout),
            holds - self._begun,
            rate=(len(self._arrivals) - 1) / span if span > 0 else 0.0,
            age=self.get_clock().now().nanoseconds * 1e-9 - holds,
            reason=message.reason,
            image_age=max(holds - shown, 0.0),
            late=self._late,
            complete=message.complete,
            alternative=message_to_alternative(message, self._layout),
        )

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            self._heard.add(status.name.split(":")[0].rsplit("/")[-1])
            self._complaints.pop(status.name, None)
            if status.name.endswith(RECONSTRUCTION):
                self._late = next((v.value for v in status.values if v.key == "late"), "")
            if status.level != DiagnosticStatus.OK:
                self._complaints[status.name] = printable(status.message)
