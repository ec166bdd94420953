"""What the readings should be: the forward model of the estimator, and its derivatives.

Row l of a scan grounds electrode l through the resistance R_l. With Y = Y0 + H C H^T and Z = Y^-1 (equations a
and b of `reconstruction.grounded`)

    v_ln / V0 = a_n (1 - rho_ln) + o_n,     rho_ln = Z_ln / N_l,    N_l = Z_ll + R_l

and any change dY of the admittance changes a row by

    d rho_l = -(Z - z_l z_l^T / N_l) dY rho_l,    z_l = Z e_l

the bracket being the impedance with electrode l grounded. All rows at once are two products of matrices.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.touch import CONDUCTANCE, PARAMETERS, RADIUS, conductance, touches


@dataclass(frozen=True)
class Unknowns:
    """A point in the space of all that is estimated.

    contacts (k, 6), see `touch`; across: patches to the width of each; free (k, 6) which of them are estimated
    sheet (J,) coefficients of the field; gain (n,); offset (n,) in parts of V0; resistance (n,) R, ohm
    """

    contacts: np.ndarray
    across: tuple[int, ...]
    free: np.ndarray
    sheet: np.ndarray
    gain: np.ndarray
    offset: np.ndarray
    resistance: np.ndarray

    def with_contacts(self, contacts, across, free) -> Unknowns:
        return replace(self, contacts=contacts, across=tuple(across), free=free)

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
        )


class Prediction:
    """Readings of the rows `rows` (L,) under `unknowns`; derivatives on demand.

    Attributes
    ----------
    readings : (L, n) in parts of V0
    ratio : (L, n) rho; own : (L,) N, ohm; impedance : (n, n) Z, ohm
    conductances : (k,) g of each contact, S; covered : (k,) the part of each that lies on the sheet
    """

    def __init__(self, operator: SheetOperator, unknowns: Unknowns, rows: np.ndarray):
        self.operator, self.unknowns, self.rows = operator, unknowns, rows
        admittance = operator.admittance_of(unknowns.sheet)
        self.touches, mutual = [], np.empty((0, 0))
        if len(unknowns.contacts):
            fixed = np.zeros(unknowns.free.shape, bool)
            self.touches, mutual = touches(
                operator, unknowns.contacts, unknowns.across, fixed, unknowns.sheet
            )
            self._connect(mutual)
            admittance = admittance + self.share @ self.strength @ self.share.T
            admittance = admittance + np.diag(self.direct)
            self.impedance = np.linalg.inv(admittance)
            self.impedance = (self.impedance + self.impedance.T) / 2
        else:
            self.conductances = self.covered = np.empty(0)
            self.impedance = operator.untouched
        columns = self.impedance[rows]
        self.own = columns[np.arange(len(rows)), rows] + unknowns.resistance[rows]
        self.ratio = columns / self.own[:, None]
        self.readings = unknowns.gain * (1 - self.ratio) + unknowns.offset

    def _connect(self, mutual):
        """C of all patches together: (diag(1/g) + D)^-1, also where a patch has no weight."""
        found = [conductance(t, c) for t, c in zip(self.touches, self.unknowns.contacts)]
        self.conductances, self.rates, self.by_mean = np.array(found).T
        self.covered = np.array([t.covered for t in self.touches])
        self.parts = np.cumsum([0] + [len(t.weight) for t in self.touches])
        self.weights = np.concatenate(
            [g * t.weight for g, t in zip(self.conductances, self.touches)]
        )
        self.share = np.concatenate([t.share for t in self.touches], axis=1)
        self.direct = sum(g * t.direct for g, t in zip(self.conductances, self.touches))
        # (1 + D G)^-1
        self.damping = np.linalg.inv(np.eye(len(mutual)) + mutual * self.weights)
        strength = self.weights[:, None] * self.damping
        self.strength = (strength + strength.T) / 2

    def contact_columns(self) -> np.ndarray:
        """(F, L, n) derivatives of the readings by the free parameters of the contacts, in their order."""
        u, changes = self.unknowns, []
        if not len(u.contacts):
            return np.empty((0, *self.ratio.shape))
        moved, _ = touches(self.operator, u.contacts, u.across, u.free, u.sheet)
        for i, (touch, free) in enumerate(zip(moved, u.free)):
            changes += [self._contact_change(i, touch, which) for which in np.flatnonzero(free)]
        return self._columns(np.array(changes))

    def _contact_change(self, i, touch, which):
        """(n, n) derivative of Y by one parameter of contact i, with its `touch`."""
        g = self.conductances[i]
        part = slice(self.parts[i], self.parts[i + 1])
        share, strength = self.share, self.strength
        damped = self.damping[part].T  # rows of (1 + G D)^-1 that act on patches of i
        if which == CONDUCTANCE:
            rate = self.rates[i] * g
            inner = share @ (self.damping[part].T)
            return inner * (rate * touch.weight) @ inner.T + np.diag(rate * touch.direct)
        k = which if which < CONDUCTANCE else which - 1
        changed = touch.d_impedance[k]
        d_weight, d_direct = touch.d_weight[k], touch.d_direct[k]
        mean = touch.mean_change(k)
        d_g = g * self.by_mean[i] * mean
        d_conductance = d_g * touch.weight + g * d_weight
        inner = share @ damped
        out = (inner * d_conductance) @ inner.T
        moved = touch.d_share[k] @ strength[part] @ share.T
        out += moved + moved.T
        fed = share @ strength[:, part]
        out -= fed @ changed @ fed.T
        return out + np.diag(d_g * touch.direct + g * d_direct)

    def force_slope(self, i: int, touch, exponent: float) -> np.ndarray:
        """(6,) derivatives of the logarithm of the force of contact i, by a contact law g = c p^exponent.

        `touch` with its derivatives. Force is pressure times area, and the area goes with the square of the radius.
        """
        out = np.zeros(PARAMETERS)
        out[CONDUCTANCE] = self.rates[i] / exponent
        for which in range(PARAMETERS):
            if which != CONDUCTANCE:
                k = which if which < CONDUCTANCE else which - 1
                out[which] = self.by_mean[i] * touch.mean_change(k) / exponent
        out[RADIUS] += 2 * (1 - 1 / exponent)
        return out

    def sheet_columns(self) -> np.ndarray:
        """(J, L, n) derivatives of the readings by the coefficients of the sheet."""
        operator = self.operator
        change = operator.admittance_change(self.unknowns.sheet)
        if self.touches:
            places = np.concatenate([t.places for t in self.touches])
            fed = self.share @ self.strength
            moved = np.matmul(fed, operator.share_change(places))
            change = change + moved + moved.transpose(0, 2, 1)
            field = operator.field_at(self.unknowns.contacts[:, :2])
            for i, touch in enumerate(self.touches):
                part = slice(self.parts[i], self.parts[i + 1])
                own = fed[:, part] @ touch.impedance @ fed[:, part].T
                own = own - self._held(i, touch)
                change = change + field[i][:, None, None] * own
        return self._columns(change)

    def _held(self, i, touch):
        """(n, n) what 1/c = 1/g + mean D takes back when D changes by a factor."""
        rate = self.conductances[i] * self.by_mean[i] * touch.mean
        part = slice(self.parts[i], self.parts[i + 1])
        inner = self.share @ self.damping[part].T
        return (inner * (rate * touch.weight)) @ inner.T + np.diag(rate * touch.direct)

    def _columns(self, changes):
        """(P, L, n) derivatives of the readings by parameters that change Y by `changes` (P, n, n)."""
        moved = np.matmul(np.matmul(self.ratio, changes), self.impedance)
        at_ground = moved[:, np.arange(len(self.rows)), self.rows]
        moved -= self.ratio * at_ground[:, :, None]
        return moved * self.unknowns.gain
