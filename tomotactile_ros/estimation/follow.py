"""Contacts row by row: the compiled follower of one set of electrodes (`core/include/tomotactile/follow.hpp`), with the
places where something may begin and the probabilities with which it does."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.special import chdtri, ndtri

from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import RATES
from tomotactile_ros.estimation.row_model import Known, RowModel
from tomotactile_ros.estimation.row_state import RowState
from tomotactile_ros.layouts.grid import Grid

# probabilities of a chi-squared as large: such rows are looked at again; are counted: noise makes two in ten once in two
# weeks; are explained by nothing: one in 12 days at 1 kHz
_SURPRISING, _CONFUSING, _UNEXPLAINED = 0.01, 1e-5, 1e-9
_HOURS, _RATE = 10.0, 1000.0  # h, rows/s: noise alone shows one contact in so long
_SUMS = 2  # sums over rows that are looked at: each row alone, and with those just before
_PER_PITCH = 3  # places to one spacing: a fit from a sixth of it off converges
YOUNG: int = compiled.YOUNG  # rows within which a new contact may turn out to be elsewhere


class Follower:
    """Follows contacts of one set of electrodes.

    Parameters
    ----------
    radius, spread : of contacts, m, and standard deviation of its logarithm, as of `solver.Prior`
    """

    def __init__(self, operator: SheetOperator, radius: float, spread: float):
        self.operator = operator
        across = int(np.ceil(max(operator.layout.outline.size) / operator.pitch * _PER_PITCH))
        places = Grid.for_outline(operator.layout.outline, max(across, 2)).pixels
        alarms = 1 / (_HOURS * 3600 * _RATE * _SUMS * len(places))
        counts = np.arange(1, operator.count + 1)[:, None]
        limits = chdtri(counts, [_SURPRISING, _CONFUSING, _UNEXPLAINED])
        threshold = float(ndtri(alarms) ** 2)
        self._core = compiled.Follower(
            operator, places, threshold, radius, spread, RATES[0], limits
        )

    def begin(self, known: Known) -> RowState:
        """Nothing touches, no row was read."""
        return RowState(RowModel(self.operator, known))

    def follow(
        self, state: RowState, readings: np.ndarray, valid: np.ndarray, ground: int, time: float
    ) -> None:
        """Takes a row into `state`.

        readings (n,) parts of V0 of the electrodes in use; valid (n,) bool; ground : the grounded
            one of them
        time : s, of the row, not before the one before
        """
        self._core.follow(state, readings, valid, ground, time)
        self._passed(state)

    def wait(self, state: RowState, readings: np.ndarray, valid: np.ndarray, time: float) -> None:
        """Takes a row into `state` that is not believed, as a frame has to tell first: all that it says
        is whether anything touches. Arguments as of `follow`."""
        self._core.wait(state, readings, valid, time)
        self._passed(state)

    def _passed(self, state: RowState) -> None:
        """Where nothing touches, nothing wide does."""
        if state.untouched and state.model.known.wide is not None:
            state.go_on(RowModel(self.operator, replace(state.model.known, wide=None)))
            state.wide = []
