"""One row as contacts that are small against the spacing make it, and its derivatives, fast enough
for every row.

The forward model is that of `forward` with one patch to a contact. With Zb the impedance of sheet
and wide contacts, H the shares of the small ones, C^-1 = diag(1/c) + D (0 on the diagonal, as c
includes it), and electrode l grounded through R_l

    z = Zb e_l - Q A^-1 Q_l,     Q = Zb H,    A = C^-1 + H^T Q         (Woodbury)
    rho = z / N,   N = z_l + R_l,   v = a (1 - rho) + o,   dv = a M dY rho,   M = Zb - Q A^-1 Q^T -
    z z^T / N

Without wide contacts the sheet floats, Y0 1 = 0, and Zb is infinite along 1. Any generalised
inverse then serves as Zb if M and z are given what a potential of all electrodes adds, p p^T / s
with w = A^-1 1, s = 1^T w, p = 1 - Q w; so that a row costs one product of Zb with as many columns
as there are unknowns. The share of a disc in an electrode is that of its centre but for the
logarithm of their distance, which is averaged over the disc where it reaches the electrode.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.operator import SCREENED, SheetOperator
from tomotactile_ros.estimation.solver import Prior

# of a reading: what elements, electrodes and one patch to a contact err, standard deviation
INEXACT = 0.01


@dataclass(frozen=True)
class Known:
    """What is known of the sensor, about which rows are linear in the rest.

    sheet (J,), gain, offset, resistance (n,) : means, units as in `Unknowns`
    sheet_deviation (J,), deviations : standard deviations, of gain, offset and resistance (n,) each
    variance : of the noise of a reading, parts of V0 squared
    wide : contacts too wide for a patch, as the last frame showed them, or None
    """

    sheet: np.ndarray
    gain: np.ndarray
    offset: np.ndarray
    resistance: np.ndarray
    sheet_deviation: np.ndarray
    deviations: tuple[np.ndarray, np.ndarray, np.ndarray]
    variance: float
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
            prior.sheet_deviation,
            prior.deviations,
            variance,
        )

    def moved(self, shift: np.ndarray, wide: Unknowns | None) -> Known:
        """The same sensor with `shift` (J + n,) added to the sheet's coefficients and to gains, and
        what is wide."""
        modes = len(self.sheet)
        sheet, gain = self.sheet + shift[:modes], self.gain + shift[modes:]
        return replace(self, sheet=sheet, gain=gain, wide=wide)


@dataclass(frozen=True)
class Row:
    """A row as predicted.

    readings (n,) parts of V0; by_contact (n, 3 k) derivatives by x, y, ln c of each contact;
        by_sheet (n, J)
    driven (n,) 1 - rho, derivatives by gains
    variance (n,) of what is not known of single readings; common (n,) standard deviation that all
        share (R_l)
    ratio (n,) rho; own : N, ohm; z (n,), solved (n, k) Q, inner (k, k) A^-1, lifted (n,) p /
        s^(1/2): see the module
    """

    readings: np.ndarray
    by_contact: np.ndarray
    by_sheet: np.ndarray
    driven: np.ndarray
    variance: np.ndarray
    common: np.ndarray
    ratio: np.ndarray
    own: float
    z: np.ndarray
    solved: np.ndarray
    inner: np.ndarray
    lifted: np.ndarray


class RowModel:
    """Predicts rows of a sensor that is `known`.

    impedance (n, n) Zb, ohm
    """

    def __init__(self, operator: SheetOperator, known: Known, background: np.ndarray | None = None):
        self.operator, self.known = operator, known
        admittance = operator.admittance_of(known.sheet)
        added = np.trace(admittance) / operator.count**2 if background is None else background
        impedance = np.linalg.inv(admittance + added)
        self.impedance = (impedance + impedance.T) / 2
        change = operator.admittance_change(known.sheet).reshape(-1, operator.count)
        self._change = change.astype(np.float32)  # memory is what it costs, once a row
        self._moved = operator.share_table
        self._added = None
        if known.sheet.any():
            self._added = np.matmul(known.sheet.astype(np.float32), self._moved)
        self._inverse = operator.bordered[:-1]

    def shares(self, places: np.ndarray, radii: np.ndarray):
        """H (n, k) of discs, its slopes (2, n, k), 1/m, and the stencil of `operator.lattice` at
        their places."""
        inverse = self._inverse
        potentials, steep = self.operator.potentials(places, radii)
        share = inverse[:, :-1] @ potentials.T + inverse[:, -1:]
        slopes = inverse[:, :-1] @ steep.transpose(0, 2, 1)
        points, weights, slants = self.operator.lattice.stencil(places)
        if self._added is not None:
            around = self._added[points]
            share = share + np.einsum("qi,qin->nq", weights, around)
            slopes = slopes + np.einsum("dqi,qin->dnq", slants, around)
        return share, slopes, points, weights

    def row(self, contacts: np.ndarray, ground: int, shift: np.ndarray, mutual=0.0) -> Row:
        """The row with electrode `ground` (of those in use) grounded.

        contacts (k, 4) x, y, ln c, ln a; mutual (k, k) D, ohm
        shift (J + n,) of the sheet's coefficients and of gains from those known
        """
        count, known = len(contacts), self.known
        if not count and known.wide is None:
            return self._idle()
        zb, gain = self.impedance, known.gain
        share, slopes, points, weights = self.shares(contacts[:, :2], np.exp(contacts[:, 3]))
        way = np.diag(np.exp(-contacts[:, 2])) + mutual
        strength = np.linalg.inv(way)
        solved = zb @ share
        inner = np.linalg.inv(way + share.T @ solved)
        z = zb[ground] - solved @ (inner @ solved[ground])
        lifted = np.zeros(len(z))  # p over the root of s
        if known.wide is None:
            weight = inner.sum(axis=1)
            lifted = (1 - solved @ weight) / np.sqrt(weight.sum())
        z = z + lifted * lifted[ground]
        own = float(z[ground] + known.resistance[ground])
        ratio = z / own
        fed = share @ strength
        current = strength @ (share.T @ ratio)
        modes = len(known.sheet)
        changes = np.empty((len(z), 3 * count + modes))
        by_sheet = changes[:, 3 * count :]
        by_sheet[:] = (self._change @ ratio.astype(np.float32)).reshape(modes, -1).T
        for i in range(count):
            slope = slopes[:, :, i].T
            changes[:, 3 * i : 3 * i + 2] = slope * current[i] + np.outer(fed[:, i], ratio @ slope)
            changes[:, 3 * i + 2] = fed[:, i] * (way[i, i] * current[i])
            around = self._moved[points[i]].reshape(len(points[i]), -1)
            moved = (weights[i].astype(np.float32) @ around).reshape(modes, -1)
            by_sheet += moved.T * current[i] + np.outer(fed[:, i], moved @ ratio)
        fell = solved @ (inner @ (solved.T @ changes)) + np.outer(ratio, z @ changes)
        changes = zb @ changes - fell + np.outer(lifted, lifted @ changes)
        changes *= gain[:, None]
        driven = 1 - ratio
        readings = (gain + shift[modes:]) * driven + known.offset
        readings += changes[:, 3 * count :] @ shift[:modes]
        variance = known.variance + known.deviations[1] ** 2
        variance = variance + INEXACT**2 * driven**2
        common = gain * ratio / own * known.deviations[2][ground]
        return Row(
            readings,
            changes[:, : 3 * count],
            changes[:, 3 * count :],
            driven,
            variance,
            common,
            ratio,
            own,
            z,
            solved,
            inner,
            lifted,
        )

    def _idle(self) -> Row:
        known, none = self.known, np.zeros((self.operator.count, 0))
        count = self.operator.count
        return Row(
            known.offset,
            none,
            np.zeros((count, len(known.sheet))),
            np.zeros(count),
            known.variance + known.deviations[1] ** 2,
            np.zeros(count),
            np.ones(count),
            np.inf,
            np.zeros(count),
            none,
            np.zeros((0, 0)),
            np.zeros(count),
        )

    def mutual(self, contacts: np.ndarray) -> np.ndarray:
        """(k, k) D between contacts (k, 4), ohm; 0 for each with itself and where electrodes screen
        them."""
        count = len(contacts)
        out = np.zeros((count, count))
        apart = np.hypot(*(contacts[:, None, :2] - contacts[:, :2]).transpose(2, 0, 1))
        close = (apart < SCREENED * self.operator.pitch) & ~np.eye(count, dtype=bool)
        chosen = np.flatnonzero(close.any(axis=1))
        if not len(chosen):
            return out
        places, radii = contacts[chosen, :2], np.exp(contacts[chosen, 3])
        block = self.operator.mutual(places, radii, np.arange(len(chosen)))
        potentials = self.operator.potentials(places)[0]
        inverse = self._inverse
        solved = inverse[:, :-1] @ potentials.T + inverse[:, -1:]
        border = self.operator.bordered[-1]
        block = block - potentials @ solved - (border[:-1] @ potentials.T + border[-1])
        block = np.maximum((block + block.T) / 2, 0.0)
        out[np.ix_(chosen, chosen)] = block
        return np.where(close, out, 0.0)
