"""Which triangle of a Delaunay triangulation a point lies in."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

_INSIDE = -1e-9  # least barycentric weight of a point that counts as inside


class Locator:
    """Finds triangles by walking: from a triangle at the nearest node, always across the side that the
    point lies beyond most. In a Delaunay triangulation such a walk ends, here after a step or two.

    points (N, 2); triangles (T, 3), counter-clockwise, of their convex hull; neighbours (T, 3) triangle
    opposite each corner, -1 for none; kept (T,) which triangles belong to the mesh.
    """

    def __init__(self, points, triangles, neighbours, kept):
        self._points, self._triangles, self._neighbours = points, triangles, neighbours
        self._number = np.where(kept, np.cumsum(kept) - 1, -1)
        self._at_node = np.full(len(points), -1)  # some kept triangle there
        self._at_node[triangles[kept]] = np.flatnonzero(kept)[:, None]
        self._nodes = np.flatnonzero(self._at_node >= 0)
        self._tree = cKDTree(points[self._nodes])

    def __call__(self, where) -> tuple[np.ndarray, np.ndarray]:
        """Number of the triangle among those kept, (Q,), and barycentric weights (Q, 3) of (Q, 2) points.

        A point in none of them gets the weights of the nearest node.
        """
        where = np.asarray(where, float)
        node = self._nodes[self._tree.query(where)[1]]
        found = self._at_node[node]
        parts = np.empty((len(where), 3))  # of each triangle's area
        walking = np.arange(len(where))
        while len(walking):
            triangle = found[walking]
            corner = self._points[self._triangles[triangle]] - where[walking, None]
            x, y = corner[:, [1, 2, 0]], corner[:, [2, 0, 1]]
            parts[walking] = part = x[..., 0] * y[..., 1] - x[..., 1] * y[..., 0]
            beyond = self._neighbours[triangle, part.argmin(axis=1)]
            onward = (part.min(axis=1) < _INSIDE * part.sum(axis=1)) & (beyond >= 0)
            walking = walking[onward]
            found[walking] = beyond[onward]
        whole = parts.sum(axis=1)
        lost = (self._number[found] < 0) | (parts.min(axis=1) < _INSIDE * whole)
        node = node[lost]
        found[lost], whole[lost] = self._at_node[node], 1.0
        parts[lost] = self._triangles[found[lost]] == node[:, None]
        return self._number[found], parts / whole[:, None]
