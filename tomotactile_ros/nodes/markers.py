"""Markers for rviz: contacts as arrows and discs with their ids and trails, electrodes and outline
of the layout.

A contact keeps its markers as long as it lasts: their id is its own. Where nobody follows contacts,
marker k shows the k-th strongest one. Markers without a contact are deleted; should the node end,
they vanish by their lifetime.
"""

import math
from collections.abc import Sequence

import numpy as np
from builtin_interfaces.msg import Duration
from geometry_msgs.msg import Point, Quaternion, Vector3
from std_msgs.msg import ColorRGBA, Header
from visualization_msgs.msg import Marker, MarkerArray

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.nodes.conversions import stamp_of, vector
from tomotactile_ros.spatial import SpatialContacts
from tomotactile_ros.view.trails import METRES_PER_NEWTON, Trails

_LIFETIME = Duration(sec=1)
_IDS = 2**31  # a marker's id has a bit less than a contact's
_DRAWN_EVERY = 0.04  # s between two times that trails are drawn; rviz shows 30 pictures/s
_ABOVE = 0.005  # m from an electrode or an arrow to what is written above it
_LETTER = 0.006  # m high
_FLAT = 0.001  # m, thickness of discs
_ARROW = Vector3(x=0.002, y=0.005, z=0.005)  # shaft, head diameter, head length
_ORANGE = ColorRGBA(r=1.0, g=0.5, b=0.1, a=1.0)
_GLASS = ColorRGBA(r=1.0, g=0.5, b=0.1, a=0.5)
_GREY = ColorRGBA(r=0.7, g=0.7, b=0.7, a=1.0)
_UPRIGHT = Quaternion(w=1.0)


class ContactMarkers:
    """Makes the markers of each message of contacts; remembers which are shown."""

    def __init__(self) -> None:
        self._shown: set[tuple[str, int]] = set()
        self._gone: dict[tuple[str, int], float] = {}  # when markers were deleted first, s
        self._trails, self._drawn = Trails(), -math.inf

    def of(self, contacts: Sequence, placed: SpatialContacts, header: Header) -> MarkerArray:
        """Arrows as long as the force, onto discs of the contacts' radius; ids and trails of those
        that are followed."""
        places, normals = placed.positions, placed.frames[:, :, 2]
        markers = []
        followed = all(contact.id for contact in contacts)
        for k, contact in enumerate(contacts):
            number, force = contact.id % _IDS if followed else k, float(contact.force)
            markers.append(_arrow(header, number, places[k], normals[k], force))
            markers.append(_disc(header, number, places[k], normals[k], float(contact.radius)))
            if followed:
                tip = places[k] + (METRES_PER_NEWTON * force + _ABOVE) * normals[k]
                text = _text(header, "id", number, tip, f"#{contact.id}", _ORANGE)
                text.lifetime = _LIFETIME
                markers.append(text)
        shown = {(marker.ns, marker.id) for marker in markers}
        markers += self._but(shown, header)
        markers += self._trails_of(contacts, places, header)
        return MarkerArray(markers=markers)

    def none(self, header: Header) -> MarkerArray:
        """What takes the contacts shown out of the picture; their trails end by themselves."""
        return MarkerArray(markers=self._but(set(), header))

    def _but(self, shown: set[tuple[str, int]], header: Header) -> list[Marker]:
        """Deletes what was shown and is not any more, again and again for as long as it may live: a
        message may be lost where many come."""
        now, lasts = stamp_of(header), float(_LIFETIME.sec)
        gone = {**self._gone, **dict.fromkeys(self._shown - shown, now)}
        self._shown = shown
        self._gone = {
            each: since
            for each, since in gone.items()
            if each not in shown and 0 <= now - since <= lasts
        }
        deleted = sorted(self._gone)
        return [Marker(header=header, ns=ns, id=k, action=Marker.DELETE) for ns, k in deleted]

    def _trails_of(self, contacts: Sequence, places: np.ndarray, header: Header) -> list[Marker]:
        """Trails, as often as somebody could see them."""
        now = stamp_of(header)
        self._trails.add(contacts, places, now)
        if 0 <= now - self._drawn < _DRAWN_EVERY:
            return []
        self._drawn = now
        return [_trail(header, n, t) for n, t in self._trails.items() if len(t) > 1]


def layout_markers(layout: Layout, header: Header) -> MarkerArray:
    """The outline as lines, each electrode as a disc and its number above it."""
    markers = []
    for k, ring in enumerate([layout.outline.shell, *layout.outline.holes]):
        line = _marker(header, "outline", k, Marker.LINE_STRIP, _GREY)
        line.scale.x = _FLAT
        places = layout.surface.to_3d(_dense(np.vstack([ring, ring[:1]])))
        line.points = [vector(Point, p) for p in places]
        markers.append(line)
    places = layout.surface.to_3d(layout.positions)
    normals = layout.surface.normals(layout.positions)
    for k, (position, normal) in enumerate(zip(places, normals, strict=True)):
        disc = _disc(header, k, position, normal, layout.radius)
        disc.ns, disc.color, disc.lifetime = "electrode", _GREY, Duration()
        markers.append(disc)
        markers.append(_text(header, "number", k, position + _ABOVE * normal, str(k), _GREY))
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
    arrow.points = [vector(Point, tail), vector(Point, position)]
    arrow.scale, arrow.lifetime = _ARROW, _LIFETIME
    return arrow


def _disc(
    header: Header, number: int, position: np.ndarray, normal: np.ndarray, radius: float
) -> Marker:
    disc = _marker(header, "contact", number, Marker.CYLINDER, _GLASS)
    disc.pose.position = vector(Point, position)
    disc.pose.orientation = _turn_to(normal)
    disc.scale = Vector3(x=2 * radius, y=2 * radius, z=_FLAT)
    disc.lifetime = _LIFETIME
    return disc


def _text(
    header: Header, space: str, number: int, position: np.ndarray, words: str, color: ColorRGBA
) -> Marker:
    text = _marker(header, space, number, Marker.TEXT_VIEW_FACING, color)
    text.pose.position = vector(Point, position)
    text.scale.z = _LETTER
    text.text = words
    return text


def _trail(header: Header, number: int, places: np.ndarray) -> Marker:
    trail = _marker(header, "trail", number % _IDS, Marker.LINE_STRIP, _GLASS)
    trail.points = [vector(Point, place) for place in places]
    trail.scale.x, trail.lifetime = _FLAT, _LIFETIME
    return trail


def _turn_to(normal: np.ndarray) -> Quaternion:
    """The rotation that turns z into a unit normal which does not point straight down."""
    x, y, z = (float(v) for v in normal)
    turn = np.array([-y, x, 0.0, 1.0 + z])
    length = float(np.linalg.norm(turn))
    if length < 1e-6:
        return Quaternion(y=1.0, w=0.0)
    return Quaternion(x=turn[0] / length, y=turn[1] / length, z=0.0, w=turn[3] / length)
