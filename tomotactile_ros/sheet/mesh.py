"""Delaunay mesh that follows the outline and the electrodes.

The nodes of `placement` are joined to triangles; those outside the outline are left out. A regular
polygon of n corners has the capacity of a slightly smaller disc; that of its rings is known exactly
(`log_excess`).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import Delaunay

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.sheet.locate import Locator
from tomotactile_ros.sheet.placement import LocalSize, place_nodes
from tomotactile_ros.support.checks import plain
from tomotactile_ros.support.errors import InputError

# Nodes of a lattice lie on common circles. Moved by this part of the longer side they do not, which
# spares Qhull more than half of its time; the triangles then join the nodes where they are.
_JOGGLE = "QJ1e-9"
# area of a triangle, in parts of its longest edge squared, that only joggled nodes on a line have
_FLAT = 1e-7


@dataclass(frozen=True, eq=False)
class Mesh:
    """Linear triangles of a sheet.

    points      (N, 2), m
    triangles   (T, 3) node indices, counter-clockwise
    electrodes  for each electrode the nodes on it: rim first, centre last
    rims        for each electrode how many of these lie on its rim
    ring        nodes on the rim of an electrode that lies wholly inside the outline
    last        (E,) radius of the outermost ring of nodes around each electrode, m
    locate      locate(points (Q, 2)) -> triangle (Q,) and barycentric weights (Q, 3); outside,
                those of a corner of the nearest triangle
    """

    points: np.ndarray
    triangles: np.ndarray
    electrodes: tuple[np.ndarray, ...]
    rims: tuple[int, ...]
    ring: int
    last: np.ndarray
    locate: Locator

    def log_excess(self) -> float:
        """What the rings lack in their electrode's field, per ln(distance) and sheet resistance.

        Between regular polygons of n corners, each q times as large as the one before, linear
        elements pass n tan(pi/n) (q + 1) / (q - 1) siemens at unit conductance; a ring of a true
        disc 2 pi / ln q.
        """
        n, q = self.ring, 1 + 2 * np.pi / self.ring
        return 1 / (2 * np.pi) - (q - 1) / (q + 1) / (n * np.tan(np.pi / n) * np.log(q))


def make_mesh(
    layout: Layout,
    h: float,
    ring: int = 16,
    *,
    inner: int = 0,
    lines: Sequence[np.ndarray] = (),
) -> Mesh:
    """Mesh of `layout` with element size `h` (m) and `ring` nodes on each electrode's rim at least.

    `inner` rings inside each electrode are needed where it is no equipotential; triangles follow
    `lines`, polylines (V, 2), outside electrodes.

    Raises InputError where the triangles do not fill the outline, with a size that would.
    """
    scale = max(layout.outline.size)
    size = LocalSize(layout, h, ring, inner)
    points, last = place_nodes(layout, size, lines)
    hull = Delaunay(points / scale, qhull_options=_JOGGLE)
    triangles, neighbours = hull.simplices, hull.neighbors
    a, b, c = (points[triangles[:, i]] for i in range(3))
    area = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    turned = area < 0
    for each in triangles, neighbours:
        each[turned] = each[turned, ::-1]
    area = np.abs(area)
    longest = np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    kept = area > _FLAT * longest
    kept &= layout.outline.contains((a + b + c) / 3)
    covered, wanted = area[kept].sum(), layout.outline.area
    if abs(covered - wanted) > 0.01 * wanted:
        raise InputError(
            f"layout {layout.name!r}: a mesh of {plain(h * 1e3)} mm covers {covered / wanted:.1%} of "
            f"the outline; narrow parts need elements of {plain(h * 5e2)} mm or less"
        )
    locate = Locator(points, triangles, neighbours, kept)
    used = np.zeros(len(points), bool)
    used[triangles[kept]] = True
    points, corners = points[used], (np.cumsum(used) - 1)[triangles[kept]]
    electrodes, rims = _electrode_nodes(layout, points)
    return Mesh(points, corners, electrodes, rims, size.ring, last, locate)


def _electrode_nodes(
    layout: Layout, points: np.ndarray
) -> tuple[tuple[np.ndarray, ...], tuple[int, ...]]:
    """For each electrode the nodes on it, from the rim to the centre, and the number on the rim."""
    distance, nearest = layout.nearest(points)
    on = np.flatnonzero(distance < layout.radius * (1 + 1e-6))
    on = on[np.lexsort((-distance[on], nearest[on]))]
    ends = np.arange(1, layout.electrodes)
    electrodes = np.split(on, np.searchsorted(nearest[on], ends))
    at_rim = on[distance[on] > layout.radius * (1 - 1e-6)]
    rims = np.bincount(nearest[at_rim], minlength=layout.electrodes)
    return tuple(electrodes), tuple(rims)
