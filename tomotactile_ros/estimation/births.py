"""Where a new contact would explain what a row has beyond what was expected: a matched filter over
a coarse lattice.

A current alpha that a new contact at x feeds in changes the row by alpha s(x), s = M h(x)
(`row_model`), whatever else touches, exactly; alpha = c (h . rho) / (1 + c h . s) > 0 bounds it.
With the covariance S of what was not expected

    gain(x) = (s^T S^-1 e)^2 / (s^T S^-1 s)

is the square of a standard normal number where there is nothing new, and counts for alpha > 0 only.
The threshold is exceeded somewhere once in `HOURS` of rows: the probability for a row is divided by
the number of places and of sums over rows that are looked at (Bonferroni), one-sided.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from scipy.linalg.lapack import dtrtrs
from scipy.special import ndtri

from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.row_model import RowModel
from tomotactile_ros.layouts.grid import Grid

HOURS, RATE = 10.0, 1000.0  # h, rows/s: noise alone shows one contact in so long
_SUMS = 2  # sums over rows that are looked at: this row alone, and with those just before
_FADING = 0.75  # weight that the rows before keep from row to row: four rows
_PER_PITCH = 3  # places to one spacing: a fit from a sixth of it off converges
_APART = 1.0  # spacings between places that are tried as starts
STARTS = 3  # of fits, the likeliest place and others of nearly as large a gain
_NEARLY = 0.5  # of the largest gain


class Births:
    """Gains of a new contact at the `places` (K, 2), m, of a lattice."""

    def __init__(self, operator: SheetOperator, radius: float):
        self._operator = operator
        across = int(np.ceil(max(operator.layout.outline.size) / operator.pitch * _PER_PITCH))
        self.places = Grid.for_outline(operator.layout.outline, max(across, 2)).pixels
        self._even = operator.core.even_discs(self.places, radius)
        false_alarms = 1 / (HOURS * 3600 * RATE)
        self.threshold = float(ndtri(false_alarms / (_SUMS * len(self.places))) ** 2)
        self._limit = float(operator.admittance.diagonal().max())
        self._model: RowModel | None = None
        self._shares = self._spread = np.empty(0)  # of the model

    def nothing(self) -> np.ndarray:
        """(2, K) sums over rows before any row."""
        return np.zeros((2, len(self.places)))

    def look(
        self, model: RowModel, fit: Any, ground: int, sums: np.ndarray, gain: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Gains (K,) of this row or with those before, conductances (K,), S, and the sums to go on
        with.

        fit : what the model says of the row without it; gain (n,) of channels
        """
        row, misfit, root = fit.row, fit.misfit, fit.root
        if self._model is not model:
            self._shares = self._even + model.core.shares_added(self.places)
            self._spread = model.impedance @ self._shares
            self._model = model
        share, spread = self._shares, self._spread
        # nothing touches: what is common to all electrodes is infinite and cancels
        if np.isinf(row.own):
            z = model.impedance[ground]
            shape = spread - z[:, None] - z @ share + z[ground]
        else:
            ones, others = _added(row)
            shape = spread - others.T @ (ones @ share)
        own = np.einsum("nk,nk->k", share, shape)
        driven = row.ratio @ share
        white = dtrtrs(root, np.column_stack([shape * gain[:, None], misfit]), lower=1)[0]
        white, left = white[:, :-1], white[:, -1]
        along, power = left @ white, np.maximum(np.einsum("nk,nk->k", white, white), 1e-300)
        most = np.maximum(driven / np.maximum(own, 1e-12), 0.0)  # of a bare conductor
        alpha = np.clip(along / power, 0.0, most)
        alone = 2 * alpha * along - alpha**2 * power
        sums = _FADING * sums + np.array([along, power])
        several = np.where(sums[0] > 0, sums[0], 0.0) ** 2 / np.maximum(sums[1], 1e-300)
        rest = np.maximum(driven - alpha * own, 1e-3 * driven)
        conductance = np.clip(alpha / np.maximum(rest, 1e-12), 1e-6 * self._limit, self._limit)
        return np.maximum(alone, several), conductance, sums

    def starts(self, gains: np.ndarray, conductances: np.ndarray) -> list[np.ndarray]:
        """Some (x, y, ln c) to begin a fit with, that of the largest gain first."""
        found: list[np.ndarray] = []
        for each in np.argsort(-gains)[: 40 * STARTS]:
            if gains[each] < _NEARLY * gains.max() or len(found) == STARTS:
                break
            place = self.places[each]
            if all(np.hypot(*(place - f[:2])) > _APART * self._operator.pitch for f in found):
                found.append(np.array([*place, np.log(conductances[each])]))
        return found


def _added(row: Any) -> tuple[np.ndarray, np.ndarray]:
    """Of the rank that the contacts of a `row`, the grounded electrode and the floating sheet add to Zb:
    two (k + 2, n) with M = Zb - ones^T others."""
    ones = np.concatenate([row.spread, [row.own * row.ratio, row.lifted]])
    solved = np.linalg.solve(row.matrix, row.spread) if len(row.matrix) else row.spread
    return ones, np.concatenate([solved, [row.ratio, -row.lifted]])
