"""What the readings should be: a point in the space of all that is estimated, and what is predicted
there (`core/include/tomotactile/forward.hpp` has the formulas).

`Prediction(operator, unknowns, rows, touches=None, times=None)` holds the readings of rows (L,) that
ground these electrodes, at `times` (L,), s, or all at once; `touches` where they are known.

readings (L, n) in parts of V0; ratio (L, n) rho; own (L,) N, ohm; impedance (n, n) Z, ohm
added (n, n) what contacts add to Y, S; fields (2, n, n) at electrodes while another is at 1 V, 1/m
conductances (k,) g of each contact, S; means (k,) mean D, ohm; covered (k,) the part on the sheet
contact_columns(unknowns) (F, L, n), sheet_columns() (J, L, n), way_columns() (k, L, n) : derivatives
    of the readings by what is free of the contacts, by the sheet, by the logarithm of D
force_slope(i, exponent), strength_slope(i) (6,) : of the logarithms of the force, and of what contact
    i and the way to it conduct
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.touch import CONDUCTANCE, X, Y

Prediction: Any = compiled.Prediction

RATED = (X, Y, CONDUCTANCE)  # parameters of contacts that may change while rows are read
_AT_REST: Any = None  # zeros, as many as there are contacts


@dataclass(frozen=True)
class Unknowns:
    """A point in the space of all that is estimated.

    contacts (k, 6), see `touch`; across: patches to the width of each; free (k, 6) which of them
        are estimated
    rates (k, 3) how fast x, y (m/s) and ln c (1/s) change; moving (k,) for which contacts they are
        estimated
    bond (m, m) inverse covariance of the conductances c of the last m contacts, which are cells
        (`shape`), 1/S^2; None: there are none
    sheet (J,) coefficients of the field; gain (n,); offset (n,) in parts of V0; resistance (n,) R,
        ohm; aside (2, n) how far electrodes lie aside of where the layout has them, m
    """

    contacts: np.ndarray
    across: tuple[int, ...]
    free: np.ndarray
    sheet: np.ndarray
    gain: np.ndarray
    offset: np.ndarray
    resistance: np.ndarray
    aside: np.ndarray
    rates: np.ndarray = _AT_REST
    moving: np.ndarray = _AT_REST
    bond: np.ndarray | None = None

    def __post_init__(self) -> None:
        if self.rates is _AT_REST:
            count = len(self.contacts)
            object.__setattr__(self, "rates", np.zeros((count, len(RATED))))
            object.__setattr__(self, "moving", np.zeros(count, bool))

    def with_contacts(
        self, contacts: np.ndarray, across: Iterable[int], free: np.ndarray
    ) -> Unknowns:
        """The same with other contacts, all at rest."""
        return replace(
            self,
            contacts=contacts,
            across=tuple(across),
            free=free,
            rates=_AT_REST,
            moving=_AT_REST,
            bond=None,
        )

    def joined_by(
        self, contact: np.ndarray, across: int, free: np.ndarray, moving: bool = False
    ) -> Unknowns:
        """The same with one `contact` (6,) more, at the end, at rest; `moving` if its rates are
        estimated, as they are if others' are."""
        moving = moving or bool(self.moving.any())
        return replace(
            self,
            contacts=np.vstack([self.contacts, contact]),
            across=(*self.across, across),
            free=np.vstack([self.free, free]),
            rates=np.vstack([self.rates, np.zeros(len(RATED))]),
            moving=np.append(self.moving, moving),
            bond=None,
        )

    @property
    def alone(self) -> int:
        """Number of contacts that are no cells."""
        return len(self.contacts) - (0 if self.bond is None else len(self.bond))

    def in_motion(self, moving: bool = True) -> Unknowns:
        """The same with all contacts free to move while rows are read, or none."""
        if not moving:
            return replace(self, rates=_AT_REST, moving=_AT_REST)
        return replace(self, moving=self.moving | True)

    def same_point(self, other: Unknowns) -> bool:
        """Whether all that the readings depend on is the same, and nothing moves."""
        names = "contacts", "across", "sheet", "gain", "offset", "resistance", "aside"
        if self.moving.any() or other.moving.any():
            return False
        return all(np.array_equal(getattr(self, each), getattr(other, each)) for each in names)

    def after(self, lasts: float) -> Unknowns:
        """The same `lasts` s later, contacts moved on."""
        contacts = self.contacts.copy()
        contacts[:, list(RATED)] += lasts * self.rates
        return replace(self, contacts=contacts)

    @classmethod
    def at_rest(cls, operator: SheetOperator) -> Unknowns:
        """No contact, an even sheet, perfect channels."""
        count = operator.count
        return cls(
            np.empty((0, 6)),
            (),
            np.empty((0, 6), bool),
            np.zeros(operator.modes),
            np.ones(count),
            np.zeros(count),
            np.zeros(count),
            np.zeros((2, count)),
        )
