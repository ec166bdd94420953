"""Shares of small discs in the electrodes, for who asks for few places and often.

H and its slopes are those of the tables (`PotentialTable`), taken once for each cell of a fine
grid and carried on from its middle to first order: what is left is less than 5e-4 of a share
beside an electrode and 1e-4 elsewhere. A contact at rest costs nothing so. The derivative by the
sheet's coefficients changes slowly and is that of the middle of a coarser cell.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.row_rims import rim_shares

_FINE, _COARSE = 256, 32  # cells to a spacing: of shares, and of their derivatives by the sheet
_KEPT = 128  # cells: what some contacts pass in a frame


class Shares:
    """Shares of discs in the n electrodes of `operator`, on a sheet with coefficients `sheet`
    (J,)."""

    def __init__(self, operator: SheetOperator, sheet: np.ndarray):
        self._operator = operator
        self._inverse = operator.bordered[:-1]
        self._moved = operator.share_table
        self._modes = len(sheet)
        self._added = None
        if sheet.any():
            self._added = np.matmul(sheet.astype(np.float32), self._moved)
        self._fine: dict[tuple, tuple] = {}
        self._coarse: dict[tuple, np.ndarray] = {}
        self._last: tuple = (None,)

    def at(self, contacts: np.ndarray):
        """H (k, n) of the discs `contacts` (k, 4) x, y (m), ln c, ln a, and its slopes (k, 2, n),
        1/m."""
        step = self._operator.pitch / _FINE
        keys, off = [], np.empty((len(contacts), 1, 2))
        for i, (x, y, _, size) in enumerate(contacts.tolist()):
            across, up = round(x / step), round(y / step)
            keys.append((across, up, size))
            off[i, 0] = x - step * across, y - step * up
        if self._last[0] != keys:
            found = [self._cell(key, step) for key in keys]
            self._last = keys, *(np.array([each[i] for each in found]) for i in range(2))
        _, share, slopes = self._last
        return share + (off @ slopes)[:, 0], slopes

    def by_sheet(self, contacts: np.ndarray) -> np.ndarray:
        """(k, J, n) derivative of H by the sheet's coefficients, single precision."""
        step = self._operator.pitch / _COARSE
        cells = np.rint(contacts[:, :2] / step).astype(int).tolist()
        return np.array([self._by_sheet(tuple(cell), step) for cell in cells])

    def added(self, stencil) -> np.ndarray | float:
        """(n, K) what the sheet adds to H of an even one, with a `stencil` of the lattice."""
        if self._added is None:
            return 0.0
        points, weights = stencil.points, stencil.weights
        return np.matmul(weights[:, None], self._added[points])[:, 0].T

    def _cell(self, key: tuple, step: float):
        """Share (n,) and slopes (2, n) in the middle of a fine cell."""
        found = self._fine.get(key)
        if found is None:
            x, y = step * key[0], step * key[1]
            radius = float(np.exp(key[2]))
            shares = rim_shares(self._operator, x, y, radius)
            if shares is None:
                potentials = self._operator.potentials.at(x, y, radius)
                shares = potentials @ self._inverse[:, :-1].T
                shares[0] += self._inverse[:, -1]
            if self._added is not None:
                points, weights = self._operator.lattice.around(x, y)
                shares += weights @ self._added[points]
            found = shares[0], shares[1:]
            _keep(self._fine, key, found)
        return found

    def _by_sheet(self, key: tuple[int, int], step: float) -> np.ndarray:
        """(J, n) derivative by the sheet's coefficients in the middle of a coarse cell."""
        found = self._coarse.get(key)
        if found is None:
            points, weights = self._operator.lattice.around(step * key[0], step * key[1])
            near = self._moved[points].reshape(len(points), -1)
            found = (weights[0].astype(np.float32) @ near).reshape(self._modes, -1)
            _keep(self._coarse, key, found)
        return found


def even_shares(operator: SheetOperator, places: np.ndarray, radii: np.ndarray) -> np.ndarray:
    """H (n, K) of many discs of `radii` (K,) at `places` (K, 2), m, on an even sheet."""
    inverse = operator.bordered[:-1]
    return inverse[:, :-1] @ operator.potentials(places, radii)[0].T + inverse[:, -1:]


def _keep(cells: dict, key: tuple, found) -> None:
    if len(cells) >= _KEPT:
        cells.clear()
    cells[key] = found
