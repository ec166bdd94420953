"""What the reconstruction publishes: image, picture, contacts, whether something touches, wrench,
markers, curved surface.

Whatever takes time and nobody listens to is not made.
"""

import threading
from typing import Any

import numpy as np
from geometry_msgs.msg import WrenchStamped
from rclpy.node import Node
from rclpy.publisher import Publisher
from sensor_msgs.msg import Image, PointCloud2
from std_msgs.msg import Bool, Header
from visualization_msgs.msg import MarkerArray

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.msg import ContactArray, SensorLayout
from tomotactile_ros.nodes.contact_messages import (
    contacts_to_message,
    layout_to_message,
    withheld_message,
    wrench_to_message,
)
from tomotactile_ros.nodes.conversions import cloud_to_message, image_to_message, stamp_of
from tomotactile_ros.nodes.markers import ContactMarkers, layout_markers
from tomotactile_ros.nodes.node_time import PassingTime, seconds_now
from tomotactile_ros.nodes.topics import publisher
from tomotactile_ros.spatial import in_space
from tomotactile_ros.support.checks import plain
from tomotactile_ros.view.colours import (
    LEAST_PRESSURE,
    Overlay,
    SteadyScale,
    colour,
    palette,
    scale_bar,
)

_UNKNOWN = np.full(3, np.nan)


class Outputs:
    """Publishers of one reconstruction node; `frame_id` is the frame of what they publish."""

    def __init__(self, node: Node):
        self._node = node
        self._pressure = publisher(node, Image, "pressure")
        self._view = publisher(node, Image, "pressure_view")
        self._contacts = publisher(node, ContactArray, "contacts")
        self._touched = publisher(node, Bool, "touched", latched=True)
        self._touched_before: bool | None = None
        self._wrench = publisher(node, WrenchStamped, "wrench")
        self._layout_message = publisher(node, SensorLayout, "layout", latched=True)
        self._markers = publisher(node, MarkerArray, "contact_markers")
        self._layout_markers = publisher(node, MarkerArray, "layout_markers", latched=True)
        self._surface: Publisher | None = None
        self._points: np.ndarray | None = None  # (K, 3) m, of pixels on a sheet that is not flat
        self.frame_id = "tactile_link"
        self._layout: Layout  # of `configure`
        self._grid: Grid
        self._shown: tuple[Layout, Grid] | None = None
        self._max_age = 0.0
        self._order = threading.Lock()  # of contacts, their markers, and what takes them back
        self._now = PassingTime(node).now
        self._valid_since: float | None = None  # s, by `_now`; None where what was said last is not

    def configure(self, layout: Layout, grid: Grid, values: dict[str, Any]) -> None:
        """Prepare for images of this layout and grid, drawn as the parameters say."""
        self._max_age = values["max_age"]
        self._range, self._draw = values["view_range"], values["view_overlay"]
        self._scale = SteadyScale(LEAST_PRESSURE)
        zoom = max(1, round(values["view_size"] / max(grid.shape)))
        self._overlay = Overlay(grid, zoom, layout.positions, layout.radius)
        palette()  # loads the colours now and not with the first frame
        self._contact_markers = ContactMarkers()
        frame_id = values["frame_id"] or self.frame_id
        if (layout, grid) != self._shown or frame_id != self.frame_id:
            self._layout, self._grid = self._shown = layout, grid
            self._points = None
            self._show_layout(frame_id)
        if layout.surface.kind != "flat":
            if self._surface is None:
                self._surface = publisher(self._node, PointCloud2, "surface")
            self._points = layout.surface.to_3d(grid.pixels)

    def publish(
        self, pressure: np.ndarray, contacts: list, header: Header, complete: bool = True
    ) -> None:
        """Publish an (H, W) image, Pa, and a picture of it with contacts; `header` is the frame's,
        `complete` is whether all was tried in time."""
        if self._pressure.get_subscription_count() > 0:
            self._pressure.publish(image_to_message(pressure, header))
        contacts = _strongest_first(contacts)
        if self._view.get_subscription_count() > 0:
            picture = self._picture(pressure, contacts, complete)
            self._view.publish(image_to_message(picture, header))
        surface, points = self._surface, self._points
        if surface is not None and points is not None and surface.get_subscription_count() > 0:
            surface.publish(cloud_to_message(points, self._grid.gather(pressure), header))

    def publish_contacts(
        self,
        contacts: list,
        header: Header,
        complete: bool = True,
        alternative: list | None = None,
    ) -> None:
        """Publish contacts that are known; `header` has the time for which they hold, `complete` is
        whether all was tried in time, `alternative` are others that may be as well, if any.

        Where that is longer ago than `max_age` they are not valid, and the wrench is not known.
        """
        contacts = _strongest_first(contacts)
        placed = in_space(self._layout.surface, contacts)
        others = None if alternative is None else _strongest_first(alternative)
        beside = None if others is None else (others, in_space(self._layout.surface, others))
        stale = self._too_old(header)
        with self._order:
            told = contacts_to_message(contacts, placed, header, stale, complete, beside)
            self._contacts.publish(told)
            if self._wrench.get_subscription_count() > 0:
                wrench = (_UNKNOWN, _UNKNOWN) if stale else placed.wrench()
                self._wrench.publish(wrench_to_message(*wrench, header))
            self._valid_since = None if stale else self._now()
        if header.frame_id != self.frame_id:  # the driver has another than was thought
            self._show_layout(header.frame_id)
        if self._markers.get_subscription_count() > 0:
            with self._order:
                shown = self._contact_markers
                markers = shown.none(header) if stale else shown.of(contacts, placed, header)
                self._markers.publish(markers)

    def say_touched(self, touched: bool, header: Header) -> None:
        """Publish whether something touches at the time of `header`, or that is not known, where
        that has changed."""
        touched = touched or bool(self._too_old(header))
        if touched != self._touched_before:
            self._touched_before = touched
            self._touched.publish(Bool(data=touched))

    def withhold(self, reason: str, header: Header, complete: bool = True) -> None:
        """Say that contacts are not known at the time of `header`, whether or not all was tried."""
        with self._order:
            self._withhold(withheld_message(header, reason, complete=complete))

    def watch(self) -> None:
        """Take back what was said last, once, where nothing has been said for `max_age`."""
        if 0 < self._max_age:
            self.take_back(f"no contacts for {self._max_age:g} s (max_age)", self._max_age)

    def take_back(self, reason: str, age: float = 0.0) -> None:
        """Say that it is not known what touches, with the reason, unless that was said last, or
        what was said last is younger than `age`, s."""
        with self._order:
            since = self._valid_since
            if since is None or self._now() - since < age:
                return
            header = self._header_of_now()
            self._withhold(withheld_message(header, reason, ContactArray.STALE))
        self.say_touched(True, header)

    def begin(self) -> None:
        """Say that it is not known yet whether something touches."""
        self.say_touched(True, self._header_of_now())

    def _header_of_now(self) -> Header:
        return Header(stamp=self._node.get_clock().now().to_msg(), frame_id=self.frame_id)

    def _withhold(self, message: ContactArray) -> None:
        self._valid_since = None
        self._contacts.publish(message)
        self._wrench.publish(wrench_to_message(_UNKNOWN, _UNKNOWN, message.header))
        if self._markers.get_subscription_count() > 0:
            self._markers.publish(self._contact_markers.none(message.header))

    def _too_old(self, header: Header) -> str:
        """Why contacts of this time are not valid any more, or nothing."""
        age = seconds_now(self._node) - stamp_of(header)
        if not 0 < self._max_age < age:
            return ""
        return f"readings of {plain(age)} s ago (max_age {self._max_age:g} s)"

    def _show_layout(self, frame_id: str) -> None:
        self.frame_id = frame_id
        header = self._header_of_now()
        self._layout_message.publish(layout_to_message(self._layout, self._grid, header))
        self._layout_markers.publish(layout_markers(self._layout, header))

    def _picture(self, pressure: np.ndarray, contacts: list, complete: bool) -> np.ndarray:
        """The image in colours, contacts and electrodes in it, and the scale at its right."""
        peak = float(np.nanmax(pressure, initial=0.0))
        scale = self._range or self._scale(peak, self._now())
        rgb = colour(pressure, scale)
        drawn = self._overlay.draw(rgb, contacts if self._draw else (), self._draw, complete)
        return np.hstack([drawn, scale_bar(len(drawn), scale)])


def _strongest_first(contacts: list) -> list:
    return sorted(contacts, key=lambda contact: contact.force, reverse=True)
