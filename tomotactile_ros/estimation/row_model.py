"""The sensor as rows see it, and what stands between two contacts; one row's model and fit are compiled
(`core/include/tomotactile/rows.hpp`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.operator import SCREENED, SheetOperator
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
    row, fit, idle_fit, limited, shares : of the compiled model
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
        seen = self.impedance, fields, background is not None
        self.core = compiled.RowModel(operator, known, alone, known.aside, unsure, *seen)
        self.fit, self.idle_fit, self.limited = self.core.fit, self.core.idle_fit, self.core.limited
        self.row, self.shares = self.core.row, self.core.shares
        self._mutual = np.empty((0, 4)), np.empty((0, 0))  # contacts, and D between them

    def mutual(self, contacts: np.ndarray) -> np.ndarray | None:
        """(k, k) D between contacts (k, 4), ohm; 0 for each with itself and where electrodes screen
        them; None where they do everywhere. As derivatives, it is kept while contacts stay."""
        if not _near(contacts.tolist(), SCREENED * self.operator.pitch):
            return None
        if not self.core.alike(self._mutual[0], contacts):
            self._mutual = contacts, self._mutual_of(contacts)
        return self._mutual[1]

    def _mutual_of(self, contacts: np.ndarray) -> np.ndarray:
        count = len(contacts)
        out = np.zeros((count, count))
        apart = np.hypot(*(contacts[:, None, :2] - contacts[:, :2]).transpose(2, 0, 1))
        close = (apart < SCREENED * self.operator.pitch) & ~np.eye(count, dtype=bool)
        chosen = np.flatnonzero(close.any(axis=1))
        places, radii = contacts[chosen, :2], np.exp(contacts[chosen, 3])
        block = self.operator.mutual(places, radii, np.arange(len(chosen)))
        potentials = self.operator.potentials(places)[0]
        inverse = self.operator.bordered[:-1]
        solved = inverse[:, :-1] @ potentials.T + inverse[:, -1:]
        border = self.operator.bordered[-1]
        block = block - potentials @ solved - (border[:-1] @ potentials.T + border[-1])
        block = np.maximum((block + block.T) / 2, 0.0)
        out[np.ix_(chosen, chosen)] = block
        return np.where(close, out, 0.0)


def _near(places: list, reach: float) -> bool:
    """Whether some two of few places (x, y, ...) are within `reach`, m."""
    for i, (x, y, *_) in enumerate(places):
        for u, v, *_ in places[:i]:
            if abs(x - u) < reach and (x - u) ** 2 + (y - v) ** 2 < reach**2:
                return True
    return False
