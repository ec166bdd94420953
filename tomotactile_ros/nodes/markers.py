"""Markers for rviz: contacts as arrows and discs, electrodes and outline of the layout.

Contacts of successive frames are not the same objects, so each frame's markers replace the last
ones: marker k shows the k-th strongest contact, and markers without a contact are deleted. Should
the node end, they vanish by their lifetime.
"""

from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Quaternion, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.spatial import SpatialContacts

METRES_PER_NEWTON = 0.01  # length of an arrow
_LIFETIME = Duration(sec=1)
_FLAT = 0.001  # m, thickness of discs
_ARROW = Vector3(x=0.002, y=0.005, z=0.005)  # shaft, head diameter, head length
_ORANGE = ColorRGBA(r=1.0, g=0.5, b=0.1, a=1.0)
_GLASS = ColorRGBA(r=1.0, g=0.5, b=0.1, a=0.5)
_GREY = ColorRGBA(r=0.7, g=0.7, b=0.7, a=1.0)
_UPRIGHT = Quaternion(w=1.0)


class ContactMarkers:
    """Makes the markers of each frame; remembers how many the last one had."""

    def __init__(self):
        self._shown = 0

    def of(self, contacts: Sequence, placed: SpatialContacts, header: Header) -> MarkerArray:
        """Arrows as long as the force, onto discs of the contacts' radius."""
        places, normals = placed.positions, placed.frames[:, :, 2]
        markers = []
        for k, contact in enumerate(contacts):
            markers.append(_arrow(header, k, places[k], normals[k], float(contact.force)))
            markers.append(_disc(header, k, places[k], normals[k], float(contact.radius)))
        for k in range(len(contacts), self._shown):
            for space in ("force", "contact"):
                markers.append(Marker(header=header, ns=space, id=k, action=Marker.DELETE))
        self._shown = len(contacts)
        return MarkerArray(markers=markers)


def layout_markers(layout: Layout, header: Header) -> MarkerArray:
    """The outline as lines, each electrode as a disc and its number above it."""
    markers = []
    for k, ring in enumerate([layout.outline.shell, *layout.outline.holes]):
        line = _marker(header, "outline", k, Marker.LINE_STRIP, _GREY)
        line.scale.x = _FLAT
        places = layout.surface.to_3d(_dense(np.vstack([ring, ring[:1]])))
        line.points = [_point(p) for p in places]
        markers.append(line)
    places = layout.surface.to_3d(layout.positions)
    normals = layout.surface.normals(layout.positions)
    for k, (position, normal) in enumerate(zip(places, normals, strict=True)):
        disc = _disc(header, k, position, normal, layout.radius)
        disc.ns, disc.color, disc.lifetime = "electrode", _GREY, Duration()
        markers.append(disc)
        text = _marker(header, "number", k, Marker.TEXT_VIEW_FACING, _GREY)
        text.pose.position = _point(position + 0.005 * normal)
        text.scale.z = 0.006
        text.text = str(k)
        markers.append(text)
    return MarkerArray(markers=markers)


def _dense(ring: np.ndarray) -> np.ndarray:
    """A ring with points in between, so that it can follow a curved surface."""
    steps = np.arange(len(ring))
    fine = np.linspace(0, len(ring) - 1, 16 * (len(ring) - 1) + 1) if len(ring) < 64 else steps
    return np.column_stack([np.interp(fine, steps, ring[:, axis]) for axis in (0, 1)])


def _marker(header: Header, space: str, number: int, kind: int, color: ColorRGBA) -> Marker:
    marker = Marker(header=header, ns=space, id=number, type=kind, color=color)
    marker.pose.orientation = _UPRIGHT
    return marker


def _arrow(
    header: Header, number: int, position: np.ndarray, normal: np.ndarray, force: float
) -> Marker:
    arrow = _marker(header, "force", number, Marker.ARROW, _ORANGE)
    tail = position + METRES_PER_NEWTON * force * normal
    arrow.points = [_point(tail), _point(position)]
    arrow.scale, arrow.lifetime = _ARROW, _LIFETIME
    return arrow


def _disc(
    header: Header, number: int, position: np.ndarray, normal: np.ndarray, radius: float
) -> Marker:
    disc = _marker(header, "contact", number, Marker.CYLINDER, _GLASS)
    disc.pose.position = _point(position)
    disc.pose.orientation = _turn_to(normal)
    disc.scale = Vector3(x=2 * radius, y=2 * radius, z=_FLAT)
    disc.lifetime = _LIFETIME
    return disc


def _turn_to(normal: np.ndarray) -> Quaternion:
    """The rotation that turns z into a unit normal which does not point straight down."""
    x, y, z = (float(v) for v in normal)
    turn = np.array([-y, x, 0.0, 1.0 + z])
    length = float(np.linalg.norm(turn))
    if length < 1e-6:
        return Quaternion(y=1.0, w=0.0)
    return Quaternion(x=turn[0] / length, y=turn[1] / length, z=0.0, w=turn[3] / length)


def _point(position: np.ndarray) -> Point:
    x, y, z = position
    return Point(x=float(x), y=float(y), z=float(z))
