"""Readings of contacts that move while rows are read.

Every row sees contacts where they are at its time. Rows near each other in time share one evaluation
of the forward model, in the middle of their times, and what they differ from it by is first order in
the way between.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from tomotactile_ros.estimation.forward import RATED, Prediction, Unknowns
from tomotactile_ros.estimation.operator import SheetOperator

# what contacts change by on both sides of a time for which they are evaluated, spacings and ln c: half as
# much takes twice the time, and what the model errs where contacts cross electrodes is more
_WAY, _STRENGTH = 0.2, 0.1


def predicted(
    operator: SheetOperator, unknowns: Unknowns, grounded: np.ndarray, times: np.ndarray | None
) -> Prediction | Moving:
    """What rows should read that ground electrodes `grounded` (L,) at `times` (L,), s, with
    contacts that are where `unknowns` say at the time 0; None: all at once."""
    if times is None or not unknowns.moving.any():
        return Prediction(operator, unknowns, grounded)
    return Moving(operator, unknowns, grounded, times)


class Moving:
    """A `Prediction` for every few rows, in the order of the rows; all that has no row is that of
    the time 0.

    Parameters
    ----------
    grounded, times : (L,), in s against the middle of the first and last of them
    """

    def __init__(
        self, operator: SheetOperator, unknowns: Unknowns, grounded: np.ndarray, times: np.ndarray
    ):
        self.operator, self.unknowns = operator, unknowns
        self._grounded, self._times = grounded, times
        last = float(np.abs(times).max(initial=0.0))
        speed = np.hypot(*unknowns.rates[:, :2].T) / (_WAY * operator.pitch)
        growth = np.abs(unknowns.rates[:, 2]) / _STRENGTH
        changes = last * float(np.maximum(speed, growth).max())
        aside = int(
            np.ceil(max(changes - 1.0, 0.0) / 2.0)
        )  # evaluations before, and after the middle
        lasts = 2 * last / (2 * aside + 1)
        nearest = np.rint(times / lasts).astype(int) if lasts > 0 else np.zeros(len(times), int)
        nearest = np.clip(nearest, -aside, aside)
        wanted = unknowns.free.copy()
        wanted[np.ix_(unknowns.moving, RATED)] = True
        rated = np.zeros_like(wanted)
        rated[np.ix_(unknowns.moving, RATED)] = True
        self._is_free, self._is_rated = unknowns.free[wanted], rated[wanted]
        rates = unknowns.rates[unknowns.moving].ravel()
        shape = len(times), operator.count
        self.readings, self.ratio, self.own = np.empty(shape), np.empty(shape), np.empty(len(times))
        self._columns = np.empty((len(self._is_free), *shape))
        self._parts: list[tuple[np.ndarray, Prediction]] = []
        for each in range(-aside, aside + 1):
            rows, here = np.flatnonzero(nearest == each), unknowns.after(each * lasts)
            if each == 0 or len(rows):
                part = Prediction(operator, here, grounded[rows])
                self._parts.append((rows, part))
                columns = part.columns(wanted)
                since = times[rows] - each * lasts
                drift = np.tensordot(rates, columns[self._is_rated], 1) * since[:, None]
                self._columns[:, rows] = columns
                self.readings[rows] = part.readings + drift
                self.ratio[rows], self.own[rows] = part.ratio, part.own
            if each == 0:
                self._middle = part

    def __getattr__(self, name: str):
        return getattr(self._middle, name)

    def freed(self, unknowns: Unknowns) -> Moving:
        """The same for `unknowns` that differ in what is free only."""
        return Moving(self.operator, unknowns, self._grounded, self._times)

    @property
    def size(self) -> int:
        """Number of patches, what the cost of an evaluation goes with."""
        return sum(part.size for _, part in self._parts)

    def contact_columns(self) -> np.ndarray:
        """(F, L, n) derivatives of the readings by the contacts' free parameters, in their order,
        then by rates."""
        by_rate = self._columns[self._is_rated] * self._times[:, None]
        return np.concatenate([self._columns[self._is_free], by_rate])

    def sheet_columns(self) -> np.ndarray:
        """(J, L, n) derivatives of the readings by the coefficients of the sheet."""
        return self._by_part(Prediction.sheet_columns, self.operator.modes)

    def way_columns(self) -> np.ndarray:
        """(k, L, n) derivatives of the readings by the logarithm of D of each contact."""
        return self._by_part(Prediction.way_columns, len(self.unknowns.contacts))

    @cached_property
    def aside(self) -> tuple[np.ndarray, np.ndarray]:
        """(2, L, n) each, as of a `Prediction`."""
        out = np.empty((2, 2, *self.readings.shape))
        for rows, part in self._parts:
            if len(rows):
                out[:, :, rows] = part.aside
        return out[0], out[1]

    def _by_part(self, columns, count: int) -> np.ndarray:
        out = np.empty((count, *self.readings.shape))
        for rows, part in self._parts:
            if len(rows):
                out[:, rows] = columns(part)
        return out
