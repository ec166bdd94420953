"""A sheet that differs from another one by a change of its outline, such as a tear.

    G = G_whole + (G_changed - G_same)

with the best model of the whole sheet, and the finite elements of both: what these err beside electrodes,
contacts and rims is alike in both, and cancels.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.sheet.transfer import Sheet, Transfer


class ChangedSheet:
    """The sheet `whole` as finite elements of it, `same`, become `changed`."""

    def __init__(self, whole: Sheet, same: FemSheet, changed: FemSheet):
        self.layout, self.model = whole.layout, changed.model
        self._whole, self._same, self._changed = whole, same, changed
        self.electrode_electrode = (
            whole.electrode_electrode + changed.electrode_electrode - same.electrode_electrode
        )

    def transfer(self, points: ArrayLike, radius: ArrayLike) -> Transfer:
        """`Transfer` to contacts at `points` (K, 2), discs of `radius` (scalar or (K,)), m."""
        whole, same, changed = (
            each.transfer(points, radius) for each in (self._whole, self._same, self._changed)
        )

        def green(i: np.ndarray, j: np.ndarray) -> np.ndarray:
            return whole.green(i, j) + changed.green(i, j) - same.green(i, j)

        return Transfer(
            self.model,
            whole.points,
            self.electrode_electrode,
            whole.electrode_point + changed.electrode_point - same.electrode_point,
            whole.point_self + changed.point_self - same.point_self,
            whole.electrode_of,
            green,
        )

    def prepare(self, points: ArrayLike) -> None:
        """Solve ahead for contacts that will touch the sheet around `points` (Q, 2)."""
        for each in (self._whole, self._same, self._changed):
            each.prepare(points)
