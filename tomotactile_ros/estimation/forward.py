"""What the readings should be: the forward model of the estimator, and its derivatives.

Row l of a scan grounds electrode l through the resistance R_l. With Y = Y0 + H C H^T and Z = Y^-1
(equations a and b of `reconstruction.grounded`)

    v_ln / V0 = a_n (1 - rho_ln) + o_n,     rho_ln = Z_ln / N_l,    N_l = Z_ll + R_l

and any change dY of the admittance changes a row by

    d rho_l = -(Z - z_l z_l^T / N_l) dY rho_l,    z_l = Z e_l

the bracket being the impedance with electrode l grounded. All rows at once are two products of
matrices.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tomotactile_ros.estimation.displacement import displaced, shift
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.touch import CONDUCTANCE, MOVING, PARAMETERS, RADIUS, Touches, X, Y

RATED = (X, Y, CONDUCTANCE)  # parameters of contacts that may change while rows are read


@dataclass(frozen=True)
class Unknowns:
    """A point in the space of all that is estimated.

    contacts (k, 6), see `touch`; across: patches to the width of each; free (k, 6) which of them
        are estimated
    rates (k, 3) how fast x, y (m/s) and ln c (1/s) change; moving (k,) for which contacts they are
        estimated
    bond (k, k) inverse covariance of the conductances c of contacts that are the cells of a shape
        (`shape`), 1/S^2; None of discs
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
    rates: np.ndarray | None = None
    moving: np.ndarray | None = None
    bond: np.ndarray | None = None

    def __post_init__(self):
        if self.rates is None:
            count = len(self.contacts)
            object.__setattr__(self, "rates", np.zeros((count, len(RATED))))
            object.__setattr__(self, "moving", np.zeros(count, bool))

    def with_contacts(self, contacts, across, free) -> Unknowns:
        """The same with other contacts, all at rest."""
        contacts = {"contacts": contacts, "across": tuple(across), "free": free}
        return replace(self, **contacts, rates=None, moving=None, bond=None)

    def joined_by(self, contact: np.ndarray, across: int, free, moving: bool = False) -> Unknowns:
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

    def in_motion(self, moving: bool = True) -> Unknowns:
        """The same with all contacts free to move while rows are read, or none."""
        rates = self.rates if moving else None
        return replace(self, rates=rates, moving=None if rates is None else self.moving | True)

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


class Prediction:
    """Readings of the rows `rows` (L,) under `unknowns`, contacts at rest; derivatives on demand.

    `touches` : of these contacts on this sheet, where they are known.

    Attributes
    ----------
    readings : (L, n) in parts of V0
    ratio : (L, n) rho; own : (L,) N, ohm; impedance : (n, n) Z, ohm
    conductances : (k,) g of each contact, S; means : (k,) mean D of each, ohm; covered : (k,) the part of each that lies on the sheet
    """

    def __init__(
        self,
        operator: SheetOperator,
        unknowns: Unknowns,
        rows: np.ndarray,
        touches: Touches | None = None,
    ):
        self.operator, self.unknowns, self.rows = operator, unknowns, rows
        admittance = operator.admittance_of(unknowns.sheet)
        self._by_parameter: dict[tuple[int, int], np.ndarray] = {}
        self.touches = touches
        if len(unknowns.contacts):
            if touches is None:
                self.touches = Touches(operator, unknowns.contacts, unknowns.across, unknowns.sheet)
            self._connect(self.touches)
            self.impedance = np.linalg.inv(admittance + self.added)
            self.impedance = (self.impedance + self.impedance.T) / 2
        else:
            self.conductances = self.covered = self.means = np.empty(0)
            self.impedance = operator.untouched
        columns = self.impedance[rows]
        self.own = columns[np.arange(len(rows)), rows] + unknowns.resistance[rows]
        self.ratio = columns / self.own[:, None]
        moved = self.ratio
        if unknowns.aside.any():
            along = operator.displacement.along(unknowns.aside, *self._of_patches)
            moved = moved - shift(along, self.impedance, self.ratio, self.own, rows)
        self.readings = unknowns.gain * (1 - moved) + unknowns.offset

    @cached_property
    def added(self) -> np.ndarray:
        """(n, n) what contacts add to Y, S."""
        added = self.share @ self._fed.T
        added[np.diag_indices(len(added))] += self._direct
        return added

    @property
    def size(self) -> int:
        """Number of patches, what the cost of an evaluation goes with."""
        return 0 if self.touches is None else len(self.touches.owner)

    def _connect(self, touches: Touches):
        """C of all patches together: (diag(1/g) + D)^-1, also where a patch has no weight."""
        count = len(self.unknowns.contacts)
        found = [touches.conductance(i) for i in range(count)]
        self.conductances, self._rates, self._by_mean = np.array(found).T
        self.covered, self.share, self.means = touches.covered, touches.share, touches.mean
        weights = self.conductances[touches.owner] * touches.weight
        self._direct = self.conductances @ touches.direct
        # C = S (1 + S D S)^-1 S with S^2 = G
        root = np.sqrt(weights)
        between = touches.impedance * root * root[:, None]
        between[np.diag_indices(len(between))] += 1.0
        self._fed = _solved(between, (self.share * root).T).T * root
        # H (1 + G D)^-1: what a change of the patches' conductances acts through
        self._inner = self.share - self._fed @ touches.impedance

    @cached_property
    def aside(self) -> tuple[np.ndarray, np.ndarray]:
        """(2, L, n) each: derivatives of readings without gains by how far aside the electrode that
        is read lies, and the one that is grounded, 1/m."""
        return displaced(self.fields, self.impedance, self.ratio, self.own, self.rows)

    @property
    def fields(self) -> np.ndarray:
        """(2, n, n) at the first electrode while the second is at 1 V, 1/m (`displacement`)."""
        return self.operator.displacement.fields(*self._of_patches)

    @property
    def _of_patches(self) -> tuple:
        """What `Displacement` asks of them; nothing where nothing touches."""
        touches = self.touches
        return () if touches is None else (touches.kernel, self.share, self._fed)

    def freed(self, unknowns: Unknowns) -> Prediction:
        """The same for `unknowns` that differ in what is free only."""
        other = copy(self)
        other.unknowns = unknowns
        return other

    def contact_columns(self) -> np.ndarray:
        """(F, L, n) derivatives of the readings by the contacts' free parameters, in their
        order."""
        return self.columns(self.unknowns.free)

    def columns(self, free: np.ndarray) -> np.ndarray:
        """(F, L, n) the same by the parameters that `free` (k, 6) names; each is worked out once."""
        wanted = [(int(i), int(which)) for i, which in np.argwhere(free)]
        missing = [each for each in wanted if each not in self._by_parameter]
        strengths = [each for each in missing if each[1] == CONDUCTANCE]
        others = [each for each in missing if each[1] != CONDUCTANCE]
        for each in strengths:
            self._by_parameter[each] = self._strength_column(each[0])
        if others:
            changes = np.array([self._contact_change(*each) for each in others])
            self._by_parameter.update(zip(others, self._columns(changes)))
        found = [self._by_parameter[each] for each in wanted]
        return np.array(found).reshape(len(wanted), *self.ratio.shape)

    def _contact_change(self, i: int, which: int) -> np.ndarray:
        """(n, n) derivative of Y by the parameter `which` of contact i, but ln c.

        It is a change of D and H, A fed^T + fed A^T, and one of conductances.
        """
        touches, g, part = self.touches, self.conductances[i], self.touches.parts[i]
        inner, weight, direct = self._inner[:, part], touches.weight[part], touches.direct[i]
        k = MOVING.index(which)
        d_weight, d_direct = (each[k] for each in touches.d_covered(i))
        by_mean = self._by_mean[i] * touches.mean_changes(i)[k]
        move, slopes = touches.moves(i)[k], touches.patches.slopes[:, :, part]
        moved = slopes[0] * move[:, 0] + slopes[1] * move[:, 1]
        moved = moved - self._fed[:, touches.near(i)] @ touches.d_impedance(i)[k].T
        change = moved @ self._fed[:, part].T
        change += change.T
        change += (inner * (g * (by_mean * weight + d_weight))) @ inner.T
        change[np.diag_indices(len(change))] += g * (by_mean * direct + d_direct)
        return change

    def _strength_column(self, i: int) -> np.ndarray:
        """(L, n) derivative of the readings by ln c of contact i: Y changes by a matrix of the rank of
        its patches."""
        touches, part = self.touches, self.touches.parts[i]
        rate = self._rates[i] * self.conductances[i]
        driven, felt = self._driven
        on = np.flatnonzero(touches.direct[i])
        moved = (driven[:, part] * (rate * touches.weight[part])) @ felt[part]
        moved += (self.ratio[:, on] * (rate * touches.direct[i, on])) @ self.impedance[on]
        at_ground = moved[np.arange(len(self.rows)), self.rows]
        return (moved - self.ratio * at_ground[:, None]) * self.unknowns.gain

    @cached_property
    def _driven(self) -> tuple[np.ndarray, np.ndarray]:
        """(L, P) and (P, n): what drives each patch in each row, and what its current does."""
        return self.ratio @ self._inner, self._inner.T @ self.impedance

    def strength_slope(self, i: int) -> np.ndarray:
        """(6,) derivatives of ln 1 / (1/g + mean D), of what contact i and the way to it conduct.

        That is ln c, but for bare conductors: there ln c can be anything beyond -ln mean D.
        """
        touches, g = self.touches, self.conductances[i]
        out = self.force_slope(i, 1.0) / g
        out[list(MOVING)] -= touches.mean_changes(i)
        return out / (1 / g + touches.mean[i])

    @property
    def answering(self) -> np.ndarray:
        """(k,) derivatives of ln 1 / (1/g + mean D) by ln c: 1, but for bare conductors."""
        return self._rates / (1 + self.conductances * self.touches.mean)

    def force_slope(self, i: int, exponent: float) -> np.ndarray:
        """(6,) derivatives of the logarithm of the force of contact i, by a contact law g = c
        p^exponent.

        Force is pressure times area, and the area goes with the square of the radius.
        """
        changes = self.touches.mean_changes(i)
        out = np.zeros(PARAMETERS)
        out[CONDUCTANCE] = self.force_by_strength(exponent)[i]
        out[list(MOVING)] = self._by_mean[i] * changes / exponent
        out[RADIUS] += 2 * (1 - 1 / exponent)
        return out

    def force_by_strength(self, exponent: float) -> np.ndarray:
        """(k,) derivatives of the logarithms of the forces by those of the conductances c."""
        return self._rates / exponent

    def force_by_impedance(self, i: int, exponent: float) -> float:
        """Derivative of the logarithm of the force of contact i by that of its mean D, c held."""
        return float(self._by_mean[i] * self.touches.mean[i] / exponent)

    def sheet_columns(self) -> np.ndarray:
        """(J, L, n) derivatives of the readings by the coefficients of the sheet; none where nothing
        touches, whatever leaks away."""
        operator, touches = self.operator, self.touches
        if touches is None:
            return np.zeros((operator.modes, *self.ratio.shape))
        moved = operator.share_change(touches.patches.around, self._fed)
        change = moved + moved.transpose(0, 2, 1)
        change += operator.admittance_change(self.unknowns.sheet)
        field = operator.field_at(self.unknowns.contacts[:, :2])
        for i in range(len(touches.parts)):
            change -= np.multiply.outer(field[i], self._by_way(i))
        return self._columns(change)

    def pressure_columns(self) -> np.ndarray:
        """(k Q, L, n) derivatives of the readings by the `pressure_modes` of all contacts, discs."""
        changes = []
        for i, across in enumerate(self.unknowns.across):
            inner, g = self._inner[:, self.touches.parts[i]], self.conductances[i]
            for weight, direct in zip(*self.touches.d_pressure(i, across), strict=True):
                changes.append((inner * (g * weight)) @ inner.T + np.diag(g * direct))
        return self._columns(np.array(changes))

    def way_columns(self) -> np.ndarray:
        """(k, L, n) derivatives of the readings by the logarithm of D of each contact, c held."""
        count = len(self.unknowns.contacts)
        changes = [self._by_way(i) for i in range(count)]
        return self._columns(np.array(changes).reshape(count, *self.impedance.shape))

    def _by_way(self, i):
        """(n, n) derivative of Y by the logarithm of D of contact i."""
        touches = self.touches
        part = touches.parts[i]
        felt = self._fed[:, part] @ (touches.impedance[part] @ self._fed.T)
        return self._held(i, part) - (felt + felt.T) / 2

    def _held(self, i, part):
        """(n, n) what 1/c = 1/g + mean D takes back when D changes by a factor."""
        touches = self.touches
        rate = self.conductances[i] * self._by_mean[i] * touches.mean[i]
        inner = self._inner[:, part]
        return (inner * (rate * touches.weight[part])) @ inner.T + np.diag(rate * touches.direct[i])

    def _columns(self, changes):
        """(P, L, n) derivatives of the readings by parameters that change Y by `changes`
        (P, n, n)."""
        count = len(self.impedance)
        driven = np.matmul(self.ratio, changes)
        moved = (driven.reshape(-1, count) @ self.impedance).reshape(driven.shape)
        at_ground = moved[:, np.arange(len(self.rows)), self.rows]
        np.multiply(self.ratio, at_ground[:, :, None], out=driven)
        moved -= driven
        moved *= self.unknowns.gain
        return moved


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution (P, n) for a symmetric matrix (P, P), which is positive definite unless tables are off."""
    try:
        factor = cho_factor(matrix, check_finite=False)
    except np.linalg.LinAlgError:
        return np.linalg.solve(matrix, right)
    return cho_solve(factor, right, check_finite=False)
