"""Delaunay mesh that follows the outline and the electrodes.

The local element size is `h` far from electrodes and shrinks in proportion to the distance near one:
rings of `ring` nodes around each electrode, the first on its rim, each further out by as much as its nodes
are apart, so that the logarithmic field of a small electrode is resolved as well as that of a large one.
A regular polygon of n corners has the capacity of a slightly smaller disc; the corners are moved out until
the polygon has the area of the electrode, which makes up for it.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.spatial import Delaunay, cKDTree

from tomotactile_ros.errors import InputError
from tomotactile_ros.layout import Layout

_TINY = 1e-6  # keeps counts of elements from rounding either way
_CROWDED = 0.4  # nodes closer than this part of the local element size are thinned out


@dataclass(frozen=True, eq=False)
class Mesh:
    """Linear triangles of a sheet.

    points      (N, 2), m
    triangles   (T, 3) node indices, counter-clockwise
    electrodes  for each electrode the nodes on it: rim first, centre last
    rims        for each electrode how many of these lie on its rim
    ring        nodes on the rim of an electrode that lies wholly inside the outline
    last        (E,) radius of the outermost ring of nodes around each electrode, m
    locate      locate(points (Q, 2)) -> triangle (Q,) and barycentric weights (Q, 3); those of the
                nearest node where a point is outside
    """

    points: np.ndarray
    triangles: np.ndarray
    electrodes: tuple[np.ndarray, ...]
    rims: tuple[int, ...]
    ring: int
    last: np.ndarray
    locate: Callable[[np.ndarray], tuple[np.ndarray, np.ndarray]]

    def log_excess(self) -> float:
        """What the rings lack in the field of their electrode, per unit of ln(distance) and sheet resistance.

        Between regular polygons of n corners, each q times as large as the one before, linear elements pass
        n tan(pi/n) (q + 1) / (q - 1) siemens at unit conductance; a ring of a true disc 2 pi / ln q.
        """
        n, q = self.ring, 1 + 2 * np.pi / self.ring
        return 1 / (2 * np.pi) - (q - 1) / (q + 1) / (n * np.tan(np.pi / n) * np.log(q))


def make_mesh(layout: Layout, h: float, ring: int = 16, *, inner: int = 0) -> Mesh:
    """Mesh of `layout` with element size `h` (m) and `ring` nodes on each electrode's rim at least.

    `inner` rings inside each electrode are needed where it is no equipotential.

    Raises InputError where the triangles do not fill the outline, with a size that would.
    """
    scale = max(layout.outline.size)
    size = _Size(layout, h, ring, inner)
    corners, along = _rim(layout, size)
    rings, last = _rings(layout, size)
    groups = [corners, rings, along, _background(layout, size, last)]
    points = _thin(groups, size)
    delaunay = Delaunay(points / scale)
    triangles = delaunay.simplices
    a, b, c = (points[triangles[:, i]] for i in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    kept = np.abs(area) > 1e-9 * scale**2 / len(points) ** 2
    kept &= layout.outline.contains((a + b + c) / 3)
    triangles = np.where(area[:, None] > 0, triangles, triangles[:, ::-1])
    covered, wanted = np.abs(area[kept]).sum(), layout.outline.area
    if abs(covered - wanted) > 0.01 * wanted:
        raise InputError(
            f"layout {layout.name!r}: a mesh of {h * 1e3:.3g} mm covers {covered / wanted:.1%} of the "
            f"outline; narrow parts need elements of {h * 5e2:.3g} mm or less"
        )
    used = np.zeros(len(points), bool)
    used[triangles[kept]] = True
    number = np.cumsum(used) - 1
    element = np.where(kept, np.cumsum(kept) - 1, -1)
    electrodes, rims = _electrode_nodes(layout, points[used], size)

    corners = number[triangles[kept]]
    tree = cKDTree(points[used])
    some_triangle = np.empty(len(points[used]), int)
    some_triangle[corners] = np.arange(len(corners))[:, None]

    def locate(where):
        simplex = delaunay.find_simplex(np.asarray(where, float) / scale)
        found = np.where(simplex >= 0, element[simplex], -1)
        transform = delaunay.transform[simplex]
        first = np.einsum("qij,qj->qi", transform[:, :2], where / scale - transform[:, 2])
        weights = np.column_stack([first, 1 - first.sum(axis=1)])
        weights = np.where((area[simplex] <= 0)[:, None], weights[:, ::-1], weights)
        lost = np.flatnonzero(found < 0)
        if len(lost):
            node = tree.query(where[lost])[1]
            found[lost] = some_triangle[node]
            weights[lost] = corners[found[lost]] == node[:, None]
        return found, weights

    return Mesh(points[used], corners, electrodes, rims, size.ring, last, locate)


class _Size:
    """The local element size."""

    def __init__(self, layout, h, ring, inner):
        self.h = h
        self.ring = 4 * int(np.ceil(max(ring, 4 * np.pi * layout.radius / h) / 4 - _TINY))
        self.positions = layout.positions
        self.step = 2 * np.pi / self.ring
        self.radius = layout.radius
        self.inner = self.radius * (1 + self.step) ** -np.arange(1.0, inner + 1)
        self.tree = cKDTree(layout.positions)

    def __call__(self, points):
        distance = self.tree.query(points)[0]
        smallest = min([self.radius, *self.inner])
        return np.clip(distance * self.step, smallest * self.step, self.h)


class _Segment:
    """A straight piece of a rim, t in [0, 1]."""

    def __init__(self, start, end):
        self.start, self.way = start, end - start
        self.length = np.linalg.norm(self.way)

    def __call__(self, t):
        return self.start + np.multiply.outer(t, self.way)

    def crossings(self, centres, radius):
        """Where the line meets circles: |start + t way - centre| = radius."""
        to_start = self.start - centres
        half = to_start @ self.way / self.length**2
        square = half**2 - ((to_start**2).sum(axis=1) - radius**2) / self.length**2
        root = np.sqrt(square[square > 0])
        return np.concatenate([-half[square > 0] - root, -half[square > 0] + root])


class _Arc:
    """A quarter of a circle around the origin, t in [0, 1]."""

    def __init__(self, radius, quarter):
        self.radius, self.first = radius, quarter * np.pi / 2
        self.length = radius * np.pi / 2

    def __call__(self, t):
        angle = self.first + np.pi / 2 * np.asarray(t)
        return self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)

    def crossings(self, centres, radius):
        """Where the arc meets circles, by the law of cosines."""
        apart = np.linalg.norm(centres, axis=1)
        centres, apart = centres[apart > 0], apart[apart > 0]
        cosine = (self.radius**2 + apart**2 - radius**2) / (2 * self.radius * apart)
        met = np.abs(cosine) < 1
        middle = np.arctan2(centres[met, 1], centres[met, 0])
        half = np.arccos(cosine[met])
        angle = np.concatenate([middle - half, middle + half]) - self.first
        return (angle + np.pi) % (2 * np.pi) / (np.pi / 2) - 2


def _curves(outline):
    """The rim as smooth pieces."""
    polygons = list(outline.holes)
    curves = []
    if outline.kind == "circle":
        curves = [_Arc(outline.radius, quarter) for quarter in range(4)]
    else:
        polygons.append(outline.shell)
    for polygon in polygons:
        curves += [_Segment(p, q) for p, q in zip(polygon, np.roll(polygon, -1, axis=0))]
    return curves


def _rim(layout, size):
    """Nodes on the rim: corners and crossings with electrodes; and nodes between them by local size."""
    corners, between = [], []
    for curve in _curves(layout.outline):
        crossings = np.sort(curve.crossings(size.positions, size.radius))
        crossings = crossings[(crossings > 1e-9) & (crossings < 1 - 1e-9)]
        for start, end in pairwise([0.0, *crossings, 1.0]):
            corners.append(curve(start))
            length = (end - start) * curve.length
            samples = int(np.clip(4 * length / (size.radius * size.step), 32, 20000))
            t = np.linspace(start, end, samples + 1)
            inverse = length / samples / size(curve((t[1:] + t[:-1]) / 2))
            measure = np.concatenate([[0], np.cumsum(inverse)])
            count = max(1, round(measure[-1] - _TINY))
            wanted = np.arange(1, count) / count * measure[-1]
            between.append(curve(np.interp(wanted, measure, t)))
    return np.array(corners), np.concatenate(between)


def _rings(layout, size):
    """Rings of every electrode, out to the local size h or half way to the next electrode.

    Returns the nodes, centres included, and the radius of each electrode's last ring.
    """
    angle = size.step * np.arange(size.ring)
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    half_way = size.tree.query(size.positions, k=2)[0][:, 1] / 2
    points = [size.positions]
    for inner in size.inner:
        points.append((size.positions[:, None] + inner * circle).reshape(-1, 2))
    last = np.full(len(half_way), size.radius)
    radius, growing = size.radius, np.full(len(half_way), True)
    while growing.any():
        last[growing] = radius
        points.append((size.positions[growing, None] + radius * circle).reshape(-1, 2))
        finest = radius == size.radius
        radius *= 1 + size.step
        spacing = radius * size.step
        growing = (radius < half_way - spacing / 3) & (finest or spacing < size.h)
    points = np.concatenate(points)
    tiny = 1e-9 * max(layout.outline.size)
    points = points[layout.outline.contains(points, tiny)]
    distance = layout.outline.rim_distance(points)
    return points[
        (distance > _CROWDED * size(points)) | (distance < tiny) | _on_electrode(points, size)
    ], last


def _on_electrode(points, size):
    return size.tree.query(points)[0] < size.radius * (1 + 1e-9)


def _background(layout, size, last):
    """Square lattice outside the last rings, symmetric about the centre."""
    a, b = layout.outline.size
    x, y = (
        np.linspace(-side / 2, side / 2, int(np.ceil(side / size.h - _TINY)) + 1) for side in (a, b)
    )
    points = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    points = points[layout.outline.contains(points)]
    distance, nearest = size.tree.query(points)
    points = points[distance - last[nearest] > 0.6 * size(points)]
    return points[layout.outline.rim_distance(points) > 0.6 * size(points)]


def _thin(groups, size):
    """Points of all groups but those too close to a point of the same or an earlier group."""
    points = np.concatenate(groups)
    rank = np.repeat(np.arange(len(groups)), [len(group) for group in groups])
    local = size(points)
    pairs = cKDTree(points).query_pairs(_CROWDED * size.h, output_type="ndarray")
    distance = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    limit = np.where(
        rank[pairs].max(axis=1) == rank[pairs].min(axis=1), 0.5 * _CROWDED, _CROWDED
    ) * local[pairs].min(axis=1)
    limit = np.where((rank[pairs] == 0).all(axis=1), 1e-6 * limit, limit)
    close = pairs[distance < limit]
    gone = np.zeros(len(points), bool)
    for first, second in close[np.lexsort((close[:, 1], close[:, 0]))]:
        if not gone[first]:
            gone[second] = True
    return points[~gone]


def _electrode_nodes(layout, points, size):
    """For each electrode the nodes on it, from the rim to the centre, and the number on the rim."""
    tree = cKDTree(points)
    tolerance = 1e-6 * size.radius
    electrodes, rims = [], []
    for centre in layout.positions:
        nodes = np.array(tree.query_ball_point(centre, size.radius + tolerance), int)
        distance = np.linalg.norm(points[nodes] - centre, axis=1)
        electrodes.append(nodes[np.argsort(-distance, kind="stable")])
        rims.append(np.count_nonzero(distance > size.radius - tolerance))
    return tuple(electrodes), tuple(rims)
