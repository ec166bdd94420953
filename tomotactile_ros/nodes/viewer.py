"""Node `viewer`: one or several sensors, on the robot if their poses are known, as a page for the
browser.

It needs no layout file: all that is shown comes by topics.
"""

import time
from collections import deque
from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray
from rclpy.node import Node
from scipy.spatial.transform import Rotation
from sensor_msgs.msg import Image

from tomotactile_ros.msg import ContactArray, SensorLayout
from tomotactile_ros.nodes.contact_messages import (
    message_to_alternative,
    message_to_contacts,
    message_to_spatial,
)
from tomotactile_ros.nodes.conversions import message_to_image, stamp_of, vectors
from tomotactile_ros.nodes.listener import RECONSTRUCTION
from tomotactile_ros.nodes.namespaces import full_namespaces
from tomotactile_ros.nodes.node_time import seconds_now
from tomotactile_ros.nodes.parameters import Spec
from tomotactile_ros.nodes.poses import POSES, Locate, make_locator
from tomotactile_ros.nodes.running import Part, run
from tomotactile_ros.nodes.topics import subscription
from tomotactile_ros.spatial import Pose
from tomotactile_ros.support.errors import InputError, printable
from tomotactile_ros.view.display import Shot
from tomotactile_ros.view.page import LOCALHOST, PORT, Page

SPECS = (
    Spec(
        "sensors", (), "Namespaces of the sensors; []: that of the node", items=str, read_only=True
    ),
    Spec(
        "frame_id", "", "Frame of the robot; empty: sensors lie beside each other", read_only=True
    ),
    POSES,
    Spec(
        "host",
        LOCALHOST,
        "Address to listen at; 0.0.0.0: everybody who reaches the robot",
        read_only=True,
    ),
    Spec("port", PORT, "Or the next free one", low=0, high=65535, read_only=True),
)
_APART = 1.2  # of a sheet's size, from one that is not placed to the next
_LEFT_OUT = "left out, see the diagnostics"


class Viewer(Part):
    """What the node does."""

    name, specs = "viewer", SPECS

    def __init__(self, node: Node):
        super().__init__(node)
        self._page: Page | None = None
        self.parameters.warn_of_typos()

    def configure(self) -> None:
        """Open the page and listen to the sensors."""
        values, node = self.parameters, self._node
        names = values["sensors"] or (node.get_namespace(),)
        namespaces = full_namespaces(node, names)
        locate = None
        if values["frame_id"]:
            locate = make_locator(node, values["frame_id"], values["poses"])
        title = ", ".join(name for name in names if name != "/")
        self._page = Page(title, values["host"], values["port"])
        self._sensors = {
            namespace: _Sensor(node, self._page, namespace, number, locate)
            for number, namespace in enumerate(namespaces)
        }
        node.create_subscription(DiagnosticArray, "/diagnostics", self._on_diagnostics, 10)
        node.get_logger().info(f"the page is {self._page.url}")

    def deactivate(self) -> None:
        """Close the page."""
        if self._page is not None:
            self._page.__exit__()
            self._page = None

    def _on_diagnostics(self, message: DiagnosticArray) -> None:
        for status in message.status:
            namespace = f"/{status.name.removesuffix(RECONSTRUCTION).strip('/')}"
            if status.name.endswith(RECONSTRUCTION) and namespace in self._sensors:
                self._sensors[namespace].note({v.key: v.value for v in status.values})


class _Sensor:
    """Puts together what is known of one sensor: the last contacts, and under them the newest image."""

    def __init__(self, node: Node, page: Page, namespace: str, number: int, locate: Locate | None):
        self._node, self._page, self._namespace = node, page, namespace
        self._number, self._locate = number, locate
        self._layout: SensorLayout | None = None
        self._image: tuple[float, np.ndarray] | None = None  # stamp, s, and Pa
        self._arrivals: deque[float] = deque(maxlen=32)  # of images
        self._begun: float | None = None  # s
        self._late, self._faults = "", dict[int, str]()
        for kind, name, listen in (
            (SensorLayout, "layout", self._on_layout),
            (Image, "pressure", self._on_pressure),
            (ContactArray, "contacts", self._on_contacts),
        ):
            topic, take = f"{namespace.rstrip('/')}/{name}", partial(self._unless_wrong, listen)
            subscription(node, kind, topic, take, latched=kind is SensorLayout)

    def note(self, values: dict[str, str]) -> None:
        """What the reconstruction says of itself."""
        self._late = printable(values.get("late", ""))
        numbers = values.get("electrodes_left_out", "").replace(",", " ").split()
        self._faults = {int(number): _LEFT_OUT for number in numbers if number.isdigit()}

    def _unless_wrong(self, listen: Callable[[Any], None], message: Any) -> None:
        try:
            listen(message)
        except (InputError, ValueError) as error:  # of another program: what it says does not fit
            text = printable(f"{self._namespace}: {error}")
            self._node.get_logger().warning(text, throttle_duration_sec=5.0)

    def _on_layout(self, message: SensorLayout) -> None:
        self._layout = message
        self._show_sheet(message, np.ones((message.height, message.width), bool))

    def _show_sheet(self, layout: SensorLayout, inside: np.ndarray) -> None:
        """The sheet with those cells of the image that are on it."""
        cells = vectors(layout.cells).reshape(*inside.shape, 3)
        electrodes = vectors(layout.electrodes)
        size = layout.cell_width, layout.cell_height
        shape = cells, size, inside, electrodes, layout.electrode_radius
        self._sheet = self._page.add_sheet(self._namespace, *shape, None, self._number)
        if self._locate is None:
            aside = np.array([self._number * _APART * np.ptp(cells[..., 0]), 0.0, 0.0])
            self._page.place(self._sheet, Pose(aside, Rotation.identity()))

    def _on_pressure(self, message: Image) -> None:
        image = message_to_image(message)
        self._arrivals.append(time.monotonic())
        self._image = stamp_of(message.header), image
        inside = np.isfinite(image)
        if self._layout is not None and not np.array_equal(inside, self._sheet.inside):
            self._show_sheet(self._layout, inside)

    def _on_contacts(self, message: ContactArray) -> None:
        if self._layout is None:
            return
        if self._locate is not None:
            self._page.place(self._sheet, self._locate(message.header))
        span = self._arrivals[-1] - self._arrivals[0] if self._arrivals else 0.0
        holds = stamp_of(message.header)
        self._begun = holds if self._begun is None else min(self._begun, holds)
        shown, image = self._image or (holds, None)
        shot = Shot(
            image,
            message_to_contacts(message, None),
            holds - self._begun,
            rate=(len(self._arrivals) - 1) / span if span > 0 else 0.0,
            age=seconds_now(self._node) - holds,
            reason=printable(message.reason),
            image_age=max(holds - shown, 0.0),
            late=self._late,
            faults={k: why for k, why in self._faults.items() if k < len(self._layout.electrodes)},
            complete=message.complete,
            alternative=message_to_alternative(message, None),
        )
        self._sheet.show(shot, message_to_spatial(message))


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run(lambda make: [make(Viewer)], args, __doc__, {Viewer.name: SPECS}, threads=False)
