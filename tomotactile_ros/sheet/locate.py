"""Which triangle of a Delaunay triangulation a point lies in."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

_MANY = 400  # points at a time, from which on a raster pays
_SQUARES = 4  # of it, for each triangle
_INSIDE = -1e-9  # least barycentric weight of a point that counts as inside


class Locator:
    """Finds triangles by walking, from the one with the nearest centre.

    A step goes across the side that the point lies beyond most. In a Delaunay triangulation such a
    walk ends, here after a step or two; where rounding made another of it and a walk goes round, all
    triangles are looked at.

    points (N, 2); triangles (T, 3), counter-clockwise, of their convex hull; neighbours (T, 3)
    triangle opposite each corner, -1 for none; kept (T,) which triangles belong to the mesh.
    """

    def __init__(
        self, points: np.ndarray, triangles: np.ndarray, neighbours: np.ndarray, kept: np.ndarray
    ):
        self._corners, self._neighbours = points[triangles], neighbours
        self._to_weights = _to_weights(self._corners)
        self._number = np.where(kept, np.cumsum(kept) - 1, -1)
        self._kept = np.flatnonzero(kept)
        self._raster: tuple[np.ndarray, float, np.ndarray] | None = None
        self._asked = 0  # points so far
        self._tree = cKDTree(self._corners[kept].sum(axis=1) / 3, balanced_tree=False)

    def __call__(self, where: ArrayLike) -> tuple[np.ndarray, np.ndarray]:
        """(Q,) triangle, numbered among those kept, (Q, 3) barycentric weights of (Q, 2) points.

        A point in none of them gets the weights of the nearest corner of the nearest triangle.
        """
        where = np.asarray(where, float)
        found = self._kept[self._start(where)]
        weights = self._weights(found, where)
        walking = np.flatnonzero(_least(weights) < _INSIDE)
        for _ in range(len(self._corners)):
            if not len(walking):
                break
            beyond = self._neighbours[found[walking], weights[:, walking].argmin(axis=0)]
            walking, beyond = walking[beyond >= 0], beyond[beyond >= 0]
            found[walking] = beyond
            weights[:, walking] = new = self._weights(beyond, where[walking])
            walking = walking[_least(new) < _INSIDE]
        for each in walking:
            of_all = self._weights(slice(None), where[each])
            found[each] = _least(of_all).argmax()
            weights[:, each] = of_all[:, found[each]]
        lost = np.flatnonzero((self._number[found] < 0) | (_least(weights) < _INSIDE))
        if len(lost):
            found[lost] = self._kept[self._tree.query(where[lost])[1]]
            apart = np.linalg.norm(self._corners[found[lost]] - where[lost, None], axis=2)
            weights[:, lost] = np.eye(3)[:, apart.argmin(axis=1)]
        return self._number[found], weights.T

    def _start(self, where: np.ndarray) -> np.ndarray:
        """(Q,) kept triangle to begin with: that with the nearest centre, or, for many points,
        the one nearest to the middle of the square of a raster that the point lies in; it is made once
        more have been asked for than it has squares.
        """
        self._asked += len(where)
        if len(where) < _MANY or self._raster is None and self._asked < _SQUARES * len(self._kept):
            return self._tree.query(where)[1]
        if self._raster is None:
            self._raster = self._make_raster()
        low, cell, table = self._raster
        column, row = np.clip((where - low) / cell, 0, np.array(table.shape) - 1).astype(int).T
        return table[column, row]

    def _make_raster(self) -> tuple[np.ndarray, float, np.ndarray]:
        """Lower left corner, side of a square, (columns, rows) triangle nearest to its middle."""
        centres = self._tree.data
        low, high = centres.min(axis=0), centres.max(axis=0)
        cell = np.sqrt(np.prod(high - low) / (_SQUARES * len(centres)))
        columns, rows = (np.ceil((high - low) / cell) + 1).astype(int)
        middles = np.stack(np.meshgrid(np.arange(columns), np.arange(rows), indexing="ij"), axis=-1)
        return low, cell, self._tree.query(low + cell * (middles + 0.5))[1]

    def _weights(self, triangle: np.ndarray | slice, where: np.ndarray) -> np.ndarray:
        """(3, Q) barycentric weights of points in their triangles."""
        x, y = where.T
        at_x, at_y, over_x, over_y, up_x, up_y = self._to_weights[triangle].T
        x, y = x - at_x, y - at_y
        second, third = x * over_x + y * over_y, x * up_x + y * up_y
        return np.stack([1 - second - third, second, third])


def _to_weights(corners: np.ndarray) -> np.ndarray:
    """(T, 6) first corner of each triangle, m, and the gradients of the other two's weights."""
    first = corners[:, 0]
    over, up = corners[:, 1] - first, corners[:, 2] - first
    twice = over[:, 0] * up[:, 1] - over[:, 1] * up[:, 0]
    with np.errstate(divide="ignore"):
        scale = np.where(twice > 0, 1 / twice, 0.0)[:, None]  # flat ones on a hull have no inside
    second = scale * np.column_stack([up[:, 1], -up[:, 0]])
    third = scale * np.column_stack([-over[:, 1], over[:, 0]])
    return np.hstack([first, second, third])


def _least(weights: np.ndarray) -> np.ndarray:
    """(Q,) smallest of three (3, Q)."""
    return np.minimum(np.minimum(weights[0], weights[1]), weights[2])
