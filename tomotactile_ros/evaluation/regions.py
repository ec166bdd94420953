"""Regions of a sheet for which quality is stated: the quadrilaterals between neighbouring
electrodes.

A layout is a grid if its electrodes, in their order, form R rows of C whose quadrilaterals do not
overlap themselves (Kojima et al. 2023, section 2.2: M = (N - 1)^2 regions). Other layouts get 3 x 3
equal blocks.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.region import nearest, proper

_BLOCKS = 3


@dataclass(frozen=True, eq=False)
class Regions:
    """M polygons of four corners.

    rows, cols : M = rows * cols, row by row from the lower left
    corners : (M, 4, 2) counter-clockwise from the lower left, m
    electrodes : whether the corners are electrodes
    """

    rows: int
    cols: int
    corners: np.ndarray
    electrodes: bool

    @property
    def areas(self) -> np.ndarray:
        """(M,) m^2."""
        x, y = np.moveaxis(self.corners, -1, 0)
        return (x * np.roll(y, -1, axis=1) - y * np.roll(x, -1, axis=1)).sum(axis=1) / 2

    def of(self, points) -> np.ndarray:
        """(P,) region of each of the (P, 2) points; the nearest one for points outside all."""
        return nearest(self.corners, points)

    def means(self, owner, points, values) -> np.ndarray:
        """(M,) mean of the `values` (P,) of the `points` (P, 2) that each region owns.

        A region without points gets the value at the point nearest to its middle.
        """
        count = np.bincount(owner, minlength=len(self.corners))
        total = np.bincount(owner, values, minlength=len(self.corners))
        out = total / np.maximum(count, 1)
        for empty in np.flatnonzero(count == 0):
            middle = self.corners[empty].mean(axis=0)
            out[empty] = values[np.linalg.norm(points - middle, axis=1).argmin()]
        return out


def layout_regions(layout: Layout) -> Regions:
    """The quadrilaterals of a layout that is a grid, 3 x 3 blocks of the bounding box otherwise."""
    shape = grid_shape(layout.positions)
    if shape is not None:
        return quadrilaterals(layout.positions, *shape)
    xmin, ymin, xmax, ymax = layout.outline.bounds
    steps = np.linspace(0, 1, _BLOCKS + 1)
    x, y = np.meshgrid(xmin + steps * (xmax - xmin), ymin + steps * (ymax - ymin))
    points = np.column_stack([x.ravel(), y.ravel()])
    corners = quadrilaterals(points, _BLOCKS + 1, _BLOCKS + 1).corners
    return Regions(_BLOCKS, _BLOCKS, corners, False)


def quadrilaterals(positions, rows: int, cols: int) -> Regions:
    """Regions between `rows` x `cols` electrodes at `positions`, row by row from the lower left."""
    p = np.asarray(positions, float).reshape(rows, cols, 2)
    corners = np.stack([p[:-1, :-1], p[:-1, 1:], p[1:, 1:], p[1:, :-1]], axis=2)
    return Regions(rows - 1, cols - 1, corners.reshape(-1, 4, 2), True)


def grid_shape(positions) -> tuple[int, int] | None:
    """(rows, columns) of a grid without crossings, row by row from the lower left."""
    count = len(positions)
    for rows in sorted(range(2, count // 2 + 1), key=lambda rows: abs(rows - count / rows)):
        if count % rows == 0 and is_simple(quadrilaterals(positions, rows, count // rows)):
            return rows, count // rows
    return None


def is_simple(regions: Regions) -> bool:
    """Whether every region is a simple polygon, counter-clockwise and of positive area."""
    return bool(proper(regions.corners).all())
