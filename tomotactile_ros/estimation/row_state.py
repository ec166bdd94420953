"""All that lasts from row to row: the compiled belief about contacts (`core/include/tomotactile/belief.hpp`), and what
frames have said of those that are too wide for rows."""

from __future__ import annotations

import numpy as np

from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.row_model import RowModel

Belief = compiled.Belief
STATE: int = compiled.STATE  # numbers of a contact: x, y (m), vx, vy (m/s), ln c
SPEED, STRENGTH = slice(2, 4), 4


class RowState(compiled.RowState):
    """All that lasts from row to row; a new one begins anew.

    Compiled (`follow.hpp`): belief, distrusted, time, last, unexplained, confused, untouched, misfit,
    read, touched_at_once

    model : `RowModel` of the sensor as known
    uneven : `Equations.unevenness` of the sheet, as the last frame had it
    wide : (number, s when it began, `Contact`) of contacts too wide for rows, as the last frame showed
        them; wide_time : s, of that frame; wide_step : s, since the one before; wide_ways (k, 2) m/s, of
        their discs; wide_carried : s for which these have gone on since
    """

    def __init__(self, model: RowModel):
        super().__init__(Belief.untouched(model.known.shift_deviation))
        self.go_on(model)
        self.uneven = 1.0
        self.wide: list = []
        self.wide_time, self.wide_step = -np.inf, np.inf
        self.wide_ways = np.empty((0, 2))
        self.wide_carried = 0.0

    def go_on(self, model: RowModel) -> None:
        """From here on with another model of the sensor."""
        self.model = model
        self.take_model(model)

    @property
    def touched(self) -> bool:
        """Whether something touches."""
        return bool(self.wide) or self.belief.count > 0


def known_for(distance: float) -> float:
    """Time without rows, s, in which a contact goes `distance`, m, standard deviation, by an
    acceleration that nobody saw (`belief.hpp`)."""
    return float((3 * compiled.WITHIN * (distance / compiled.ENDURING) ** 2) ** (1 / 3))
