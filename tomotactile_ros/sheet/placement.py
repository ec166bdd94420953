"""Where the nodes of a mesh lie: on the rim, on rings around electrodes, on a lattice between.

The local element size is `h` far from electrodes and shrinks in proportion to the distance near
one: rings of nodes around each electrode, the first on its rim, each further out by as much as its
nodes are apart, so that the logarithmic field of a small electrode is resolved as well as that of a
large one. Along a cut or a hole that is narrower than elements, nodes are as far apart as it is wide:
triangles follow its rim then, and none lies across it.
"""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
import shapely
from scipy.spatial import cKDTree

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.sheet.rim import Arc, Segment, curves

_TINY = 1e-6  # keeps counts of elements from rounding either way
_ON_LINE = 0.5  # of the local element size between nodes on a line
_NARROW = 0.9  # of the width of a cut between nodes on its rim: no other is nearer to two of them
_GROWS = 0.5  # of the distance to a cut: element size there
_SAMPLED = 0.25  # elements along a rim, at which it is asked how wide the cut is
_CROWDED = 0.4  # nodes closer than this part of the local element size are thinned out


def place_nodes(
    layout: Layout, size: LocalSize, lines: Sequence[np.ndarray] = ()
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes (N, 2) and radius (E,) of the outermost ring around each electrode, m."""
    corners, along = _rim(layout, size)
    rings, last = _rings(layout, size)
    groups = [corners, rings, along, _background(layout, size, last)]
    if lines:
        groups.insert(1, _on_lines(layout, size, lines))
    return _thin(groups, size), last


class LocalSize:
    """The local element size."""

    def __init__(self, layout: Layout, h: float, ring: int, inner: int):
        self.h = h
        self.ring = 4 * int(np.ceil(max(ring, 4 * np.pi * layout.radius / h) / 4 - _TINY))
        self.step = 2 * np.pi / self.ring
        self.radius = layout.radius
        self.inner = self.radius * (1 + self.step) ** -np.arange(1.0, inner + 1)
        self._nearest = layout.nearest
        places, self._widths = _narrow(layout.outline, h)
        self._narrow = cKDTree(places) if len(places) else None

    def __call__(self, points: np.ndarray) -> np.ndarray:
        size = self.at(self._nearest(points)[0])
        if self._narrow is not None:
            distance, nearest = self._narrow.query(points)
            beyond = np.maximum(distance - self.h * _SAMPLED, 0.0)
            size = np.minimum(size, np.maximum(self._widths[nearest], _GROWS * beyond))
        return size

    def at(self, distance: np.ndarray) -> np.ndarray:
        """Element size at a distance from the nearest electrode's centre."""
        smallest = min([self.radius, *self.inner])
        return np.clip(distance * self.step, smallest * self.step, self.h)


def _narrow(outline: Outline, h: float) -> tuple[np.ndarray, np.ndarray]:
    """(m, 2) points of rims beyond which, nearer than `h`, the sheet goes on: on either side of a cut or a
    hole; (m,) how far apart nodes are there, m."""
    if outline.is_uniform_rectangle:
        return np.empty((0, 2)), np.empty(0)
    rings = [*([] if outline.kind == "circle" else [outline.shell]), *outline.holes]
    places, beyond = [], []
    for corner, end in ((a, b) for ring in rings for a, b in pairwise([*ring, ring[0]])):
        along = end - corner
        part = np.arange(0.5, np.ceil(np.linalg.norm(along) / (h * _SAMPLED)))
        at = corner + part[:, None] / max(len(part), 1) * along
        across = np.array([along[1], -along[0]]) / np.linalg.norm(along)
        tried = at + 1e-6 * h * across
        out = np.where(outline.contains(tried)[:, None], -across, across)
        places.append(at)
        beyond.append(out)
    if not places:
        return np.empty((0, 2)), np.empty(0)
    at, out = np.concatenate(places), np.concatenate(beyond)
    ways = np.stack([at + 1e-6 * h * out, at + h * out], axis=1)
    rims = shapely.multilinestrings([shapely.linestrings([*ring, ring[0]]) for ring in rings])
    width = shapely.distance(
        shapely.points(at), shapely.intersection(shapely.linestrings(ways), rims)
    )
    found = np.isfinite(width) & (width > 0)
    return at[found], _NARROW * width[found]


def _rim(layout: Layout, size: LocalSize) -> tuple[np.ndarray, np.ndarray]:
    """Corners of the rim and its crossings with electrodes; nodes between them, by local size."""
    pieces = []  # curve, samples of its parameter
    for curve in curves(layout.outline):
        crossings = np.sort(curve.crossings(layout.positions, size.radius))
        crossings = crossings[(crossings > 1e-9) & (crossings < 1 - 1e-9)]
        for start, end in pairwise([0.0, *crossings, 1.0]):
            samples = 4 * (end - start) * curve.length / (size.radius * size.step)
            pieces.append((curve, np.linspace(start, end, int(np.clip(samples, 32, 20000)) + 1)))
    return np.array([curve(t[0]) for curve, t in pieces]), _between(pieces, size)


def _on_lines(layout: Layout, size: LocalSize, lines: Sequence[np.ndarray]) -> np.ndarray:
    """Nodes along polylines on the sheet, outside electrodes.

    They are half as far apart as others and from these at least `_CROWDED`: no other node comes
    into a circle over two of them, so that Delaunay triangles follow the line.
    """
    pieces, ends = [], []
    for line in lines:
        for part in layout.outline.parts_of(line):
            ends.append(part)
            for start, end in pairwise(part):
                curve = Segment(start, end)
                steps = np.clip(4 * curve.length / (size.radius * size.step), 32, 20000)
                pieces.append((curve, np.linspace(0, 1, int(steps) + 1)))
    if not pieces:
        return np.empty((0, 2))
    points = np.concatenate([*ends, _between(pieces, size, _ON_LINE)])
    clear = size.radius * (1 + size.step / 2)
    return points[layout.nearest(points)[0] > clear]


def _between(
    pieces: Sequence[tuple[Segment | Arc, np.ndarray]], size: LocalSize, part: float = 1.0
) -> np.ndarray:
    """Nodes between the ends of `pieces` of curves, apart by a `part` of the local size."""
    local = part * size(np.concatenate([curve((t[1:] + t[:-1]) / 2) for curve, t in pieces]))
    ends = np.cumsum([len(t) - 1 for _, t in pieces])[:-1]
    between = []
    for (curve, t), spacing in zip(pieces, np.split(local, ends)):
        measure = np.concatenate([[0], np.cumsum(np.diff(t) * curve.length / spacing)])
        count = max(1, round(measure[-1] - _TINY))
        wanted = np.arange(1, count) / count * measure[-1]
        between.append(curve(np.interp(wanted, measure, t)))
    return np.concatenate(between)


def _rings(layout: Layout, size: LocalSize) -> tuple[np.ndarray, np.ndarray]:
    """Rings of every electrode, out to the local size h or half way to the next electrode.

    Returns the nodes, centres included, and the radius of each electrode's last ring.
    """
    angle = size.step * np.arange(size.ring)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    centres, half_way = layout.positions, layout.pitches / 2
    points = [centres]
    for inner in size.inner:
        points.append((centres[:, None] + inner * circle).reshape(-1, 2))
    last = np.full(len(half_way), size.radius)
    radius, growing = size.radius, np.full(len(half_way), True)
    while growing.any():
        last[growing] = radius
        points.append((centres[growing, None] + radius * circle).reshape(-1, 2))
        finest = radius == size.radius
        radius *= 1 + size.step
        spacing = radius * size.step
        growing = (radius < half_way - spacing / 3) & (finest or spacing < size.h)
    nodes = np.concatenate(points)
    apart, owner = layout.nearest(nodes)
    to_rim = layout.outline.rim_distance(centres)[owner] - apart  # at least
    doubtful = np.flatnonzero(to_rim < size.h)
    to_rim[doubtful] = layout.outline.rim_distance(nodes[doubtful])
    kept = (to_rim > _CROWDED * size.at(apart)) | (apart < size.radius * (1 + 1e-9))
    kept[doubtful] &= layout.outline.contains(nodes[doubtful])
    return nodes[kept | (to_rim < 1e-9 * max(layout.outline.size))], last


def _background(layout: Layout, size: LocalSize, last: np.ndarray) -> np.ndarray:
    """Square lattice outside the last rings, symmetric about the centre."""
    a, b = layout.outline.size
    x, y = (
        np.linspace(-side / 2, side / 2, int(np.ceil(side / size.h - _TINY)) + 1) for side in (a, b)
    )
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    distance, nearest = layout.nearest(points)
    spacing = 0.6 * size.at(distance)
    clear = distance - last[nearest] > spacing
    clear &= layout.outline.rim_distance(points) > spacing
    return points[clear & layout.outline.contains(points)]


def _thin(groups: Sequence[np.ndarray], size: LocalSize) -> np.ndarray:
    """Points of all groups but those too close to a point of the same or an earlier group."""
    points = np.concatenate(groups)
    rank = np.repeat(np.arange(len(groups)), [len(group) for group in groups])
    local = size(points)
    pairs = cKDTree(points).query_pairs(_CROWDED * size.h, output_type="ndarray")
    first, second = np.sort(pairs, axis=1).T
    limit = _CROWDED * np.minimum(local[first], local[second])
    limit[rank[first] == rank[second]] /= 2
    limit[rank[second] == 0] *= 1e-6  # points come in the order of their ranks
    x, y = (points[first] - points[second]).T
    close = np.flatnonzero(np.hypot(x, y) < limit)
    close = close[np.lexsort((second[close], first[close]))]
    gone = np.zeros(len(points), bool)
    for one, other in zip(first[close], second[close]):
        if not gone[one]:
            gone[other] = True
    return points[~gone]
