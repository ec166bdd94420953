"""The sensor as rows see it; one row's model and fit are compiled (`core/include/tomotactile/rows.hpp`)."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import Prior

# spacings: deviation of places of electrodes while nothing was learned: 0.3 mm at 8 x 8 on 200 mm.
# With electrodes 1 mm off, of 30 touches 6 had ghosts with 0 or 0.003, 1 with 0.01 and 0.02
# (`benchmark/rows.py --sensor aside`); exact sensors have the same places with all of these, but
# 0.2 N on an electrode beside 20 N was not seen by rows in 4 of 10 places instead of 1
_ASIDE = 0.01


@dataclass(frozen=True)
class Known:
    """What is known of the sensor, about which rows are linear in the rest.

    sheet (J,), gain, offset, resistance (n,), aside (2, n) : means, units as in `Unknowns`
    sheet_deviation (J,), deviations : standard deviations, of gain, offset, resistance and ways aside
        (n,) each
    variance : of the noise of a reading, parts of V0 squared
    learned : whether the sensor has shown all this itself
    wide : contacts too wide for a patch, as the last frame showed them, or None
    """

    sheet: np.ndarray
    gain: np.ndarray
    offset: np.ndarray
    resistance: np.ndarray
    aside: np.ndarray
    sheet_deviation: np.ndarray
    deviations: tuple[np.ndarray, ...]
    variance: float
    learned: bool = False
    wide: Unknowns | None = None

    @property
    def shift_deviation(self) -> np.ndarray:
        """(J + n,) of what is estimated of the sensor beside contacts: the sheet's coefficients,
        and gains."""
        return np.concatenate([self.sheet_deviation, self.deviations[0]])

    @classmethod
    def before(cls, prior: Prior, variance: float) -> Known:
        """Before any frame: what is expected of the sensor."""
        return cls(
            prior.sheet,
            prior.gain,
            prior.offset,
            prior.resistance,
            prior.aside,
            prior.sheet_deviation,
            prior.deviations,
            variance,
            prior.learned,
        )

    def moved(self, shift: np.ndarray, wide: Unknowns | None) -> Known:
        """The same sensor with `shift` (J + n,) added to the sheet's coefficients and to gains, and
        what is wide."""
        modes = len(self.sheet)
        sheet, gain = self.sheet + shift[:modes], self.gain + shift[modes:]
        return replace(self, sheet=sheet, gain=gain, wide=wide)


class RowModel:
    """Predicts and fits rows of a sensor that is `known`.

    background (n, n) what wide contacts add to the admittance, S; fields (2, n, n) at the electrodes
        with them (`displacement`); None: there are none
    impedance (n, n) Zb, ohm
    row, shares, mutual : of the compiled model
    """

    def __init__(
        self,
        operator: SheetOperator,
        known: Known,
        background: np.ndarray | None = None,
        fields: np.ndarray | None = None,
    ):
        self.operator, self.known = operator, known
        admittance = operator.admittance_of(known.sheet)
        added = np.trace(admittance) / operator.count**2 if background is None else background
        impedance = np.linalg.inv(admittance + added)
        self.impedance = (impedance + impedance.T) / 2
        alone = known.variance + known.deviations[1] ** 2
        least = 0.0 if known.learned else _ASIDE * operator.pitch
        unsure = np.maximum(np.array(known.deviations[3:]), least)
        fields = operator.displacement.fields() if fields is None else fields
        wide = np.empty((0, 4)) if known.wide is None else known.wide.contacts[:, :4]
        seen = self.impedance, fields, wide
        self.core = compiled.RowModel(operator, known, alone, known.aside, unsure, *seen)
        self.row, self.shares, self.mutual = self.core.row, self.core.shares, self.core.mutual
