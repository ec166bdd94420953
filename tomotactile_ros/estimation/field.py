"""What is not known of a sheet: the logarithm of its conductance as a Gaussian random field.

Two lengths: unevenness of the sheet's make, alike over a quarter of a side, and slow changes over
half of one. The field is cut into cells of half a spacing, its Karhunen-Loeve modes are those of
the largest variance, and its mean over the sheet is 0: the mean is part of the calibration, a
common factor of all conductances. Two coefficients more tell a uniform anisotropy: half the
difference of the logarithms along x and y, and along the diagonals.
"""

from __future__ import annotations

from copy import copy

import numpy as np

from tomotactile_ros.layouts.layout import Layout

# standard deviation of the logarithm: knitted and sprayed sheets, shared by both lengths
UNEVEN = 0.15
ANISOTROPIC = 0.15  # of half the logarithm of the ratio: 1.5 : 1 is 0.2
_SHORT = 0.6  # part of the variance that is alike over _NEAR only
_NEAR = 0.25  # longer sides
_FAR = 0.5  # longer sides: the long length: slow change over the sheet
_MODES = 40  # keep 99.9 % of the variance at 8 x 8
_PAIR = 0.99  # ratio of variances above which two modes are a pair
_CELLS = 12, 16  # along the longer side, at least and at most


class SheetField:
    """Cells of a sheet and the modes of its field.

    centres : (C, 2) of cells, m; modes : (C, F) value of each mode with variance 1
    left : (C,) standard deviation, in the cells, of what the modes do not show of a field of variance 1
    count : number F of modes; deviation : (F + 2,) prior standard deviation of their coefficients and
        of the anisotropy
    reach : m, over which cells are averaged for a smooth field; nodes (C, F) what is averaged
    owner : (T,) cell of each element; order, ends: elements sorted by cell, and where each cell
        begins
    """

    def __init__(self, layout: Layout, places: np.ndarray, areas: np.ndarray, pitch: float):
        size = max(layout.outline.size)
        across = int(np.clip(np.ceil(2 * size / pitch), *_CELLS))
        cell = np.clip(((places / size + 0.5) * across).astype(int), 0, across - 1)
        _, owner = np.unique(cell[:, 0] * across + cell[:, 1], return_inverse=True)
        self._own(owner, owner.max() + 1)
        cells = len(self.ends) - 1
        area = np.bincount(self.owner, areas)
        self.centres = np.stack(
            [np.bincount(self.owner, areas * places[:, i]) / area for i in range(2)], axis=-1
        )
        self.reach = 0.6 * size / across
        squared = ((self.centres[:, None] - self.centres) ** 2).sum(axis=-1)
        covariance = _SHORT * np.exp(-squared / (2 * (_NEAR * size) ** 2))
        covariance += (1 - _SHORT) * np.exp(-squared / (2 * (_FAR * size) ** 2))
        weight = area / area.sum()
        centring = np.eye(cells) - weight
        covariance = centring @ covariance @ centring.T
        root = np.sqrt(weight)
        variance, vectors = np.linalg.eigh(root[:, None] * covariance * root)
        order = np.argsort(-variance)
        count = min(_MODES, cells - 1)
        while count < cells - 1 and variance[order[count]] > _PAIR * variance[order[count - 1]]:
            count += 1  # modes that a symmetry of the outline makes equal are kept together
        kept = order[:count]
        scale = np.sqrt(np.maximum(variance[kept], 0.0))
        self.modes = vectors[:, kept] / root[:, None] * scale
        left = covariance.diagonal() - (self.modes**2).sum(axis=1)
        self.left = np.sqrt(np.maximum(left, 0.0))
        self.deviation = np.full(len(kept) + 2, UNEVEN)
        self.deviation[-2:] = ANISOTROPIC
        self.nodes = np.linalg.solve(self._weights(self.centres), self.modes)

    def _own(self, owner: np.ndarray, cells: int) -> None:
        self.owner, self.order = owner, np.argsort(owner, kind="stable")
        self.ends = np.searchsorted(owner[self.order], np.arange(cells + 1))

    def on(self, places: np.ndarray) -> SheetField:
        """The same field for other elements, with their middles at `places` (T, 2)."""
        other = copy(self)
        other._own(self.cell_of(places), len(self.centres))
        return other

    def at(self, places: np.ndarray) -> np.ndarray:
        """(Q, F) the field at `places` (Q, 2): smooth, and in the centres of cells as they have it."""
        return self._weights(places) @ self.nodes

    @property
    def count(self) -> int:
        return self.modes.shape[1]

    def _weights(self, places: np.ndarray) -> np.ndarray:
        """(Q, C) of a smooth mean over cells nearby."""
        squared = ((places[:, None] - self.centres) ** 2).sum(axis=-1)
        weights = np.exp(-(squared - squared.min(axis=1, keepdims=True)) / (2 * self.reach**2))
        return weights / weights.sum(axis=1, keepdims=True)

    def cell_values(self, places: np.ndarray) -> np.ndarray:
        """(Q, F) the field of the cell that each of `places` (Q, 2) lies in."""
        return self.modes[self.cell_of(places)]

    def cell_of(self, places: np.ndarray) -> np.ndarray:
        """(Q,) number of the cell that each of `places` (Q, 2) lies in."""
        return ((places[:, None] - self.centres) ** 2).sum(axis=-1).argmin(axis=1)
