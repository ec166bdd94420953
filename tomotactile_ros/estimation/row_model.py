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
logarithm of their distance, which is averaged over the disc where it reaches the electrode
(`row_shares`). Where electrodes lie is known to a part of a spacing: that is noise of single readings, and
for the grounded electrode of all (`displacement`). Matrices of few columns lie in memory as their transposes.

Readings are those of the contacts as they are. Derivatives change slowly: those of the last row of
the same electrode serve as long as contacts stay nearly where they were then.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg.lapack import dposv

from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.operator import SCREENED, SheetOperator
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.row_shares import Shares
from tomotactile_ros.estimation.row_state import PLACE, STATE, STRENGTH

# of a reading: what elements, electrodes and one patch to a contact err, standard deviation
INEXACT = 0.01
# spacings, and of ln c, that contacts change before derivatives are taken anew
_ALIKE, _AS_STRONG = 0.01, 0.1
# spacings: derivatives by the place of contacts nearer to the rim are those so far inside. On the rim
# of an insulated sheet they vanish: what ended there would stay, and seem to be known nowhere
_INSIDE = 0.1
# spacings that electrodes lie aside along x and y, standard deviation, while nothing was learned of it
_ASIDE = 0.01
_ALL = np.ones(1, bool)  # readings are valid


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


@dataclass(slots=True)
class Row:
    """A row as predicted, of k contacts.

    readings (n,) parts of V0
    changes (5 k + J, n) derivatives by the numbers of each contact (`row_state.STATE`) and by the
        sheet's coefficients, 0 for readings that are not valid
    driven (n,) 1 - rho, derivatives by gains
    variance (n,) of what is not known of single readings; common (3, n) standard deviations that
        all share (R_l, the place of the grounded electrode)
    ratio (n,) rho; own : N, ohm
    spread (k, n) Q^T, matrix (k, k) A, lifted (n,) p / s^(1/2), see the module
    """

    readings: np.ndarray
    changes: np.ndarray
    driven: np.ndarray
    variance: np.ndarray
    common: np.ndarray
    ratio: np.ndarray
    own: float
    spread: np.ndarray
    matrix: np.ndarray
    lifted: np.ndarray

    def added(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the rank that contacts, the grounded electrode and the floating sheet add to Zb: two
        (k + 2, n) with M = Zb - ones^T others."""
        z = self.own * self.ratio
        ones = np.concatenate([self.spread, [z, self.lifted]])
        solved = _solved(self.matrix, self.spread)
        return ones, np.concatenate([solved, [self.ratio, -self.lifted]])


class RowModel:
    """Predicts rows of a sensor that is `known`.

    background (n, n) what wide contacts add to the admittance, S; fields (2, n, n) at the electrodes
        with them (`displacement`); None: there are none
    impedance (n, n) Zb, ohm; shares : of small contacts in the electrodes
    """

    def __init__(
        self,
        operator: SheetOperator,
        known: Known,
        background: np.ndarray | None = None,
        fields: np.ndarray | None = None,
    ):
        self.operator, self.known = operator, known
        self._fields = operator.displacement.fields() if fields is None else fields
        admittance = operator.admittance_of(known.sheet)
        added = np.trace(admittance) / operator.count**2 if background is None else background
        impedance = np.linalg.inv(admittance + added)
        self.impedance = (impedance + impedance.T) / 2
        change = operator.admittance_change(known.sheet).reshape(-1, operator.count)
        self._change = change.astype(np.float32)  # memory is what it costs, once a row
        self.shares = Shares(operator, known.sheet)
        self._inverse = operator.bordered[:-1]
        self._alone = known.variance + known.deviations[1] ** 2
        self._none = np.zeros((0, operator.count))
        least = 0.0 if known.learned else _ASIDE * operator.pitch
        self._aside = np.maximum(np.array(known.deviations[3:]), least)
        size = np.array(operator.layout.outline.size)
        self._inside = size / 2 - _INSIDE * operator.pitch
        self._kept: dict[int, tuple] = {}
        self._mutual: tuple[list, np.ndarray | None] = [], None

    def row(
        self, contacts: np.ndarray, ground: int, shift: np.ndarray, mutual=None, valid=_ALL
    ) -> Row:
        """The row with electrode `ground` (of those in use) grounded.

        contacts (k, 4) x, y, ln c, ln a; mutual (k, k) D, ohm, None: none
        shift (J + n,) of the sheet's coefficients and of gains from those known
        valid (n,) of the readings, bool
        """
        known, zb = self.known, self.impedance
        if not len(contacts) and known.wide is None:
            return self.idle()
        count = len(contacts)
        share, slopes = self.shares.at(contacts) if count else (self._none, self._none)
        way, spread = np.exp(-contacts[:, 2]), share @ zb
        matrix = spread @ share.T
        matrix.reshape(-1)[:: count + 1] += way
        if mutual is not None:
            matrix += mutual
        right = np.ones((count, 2))
        right[:, 0] = spread[:, ground]
        drawn, lifting = _solved(matrix, right).T
        z, lifted = zb[ground] - drawn @ spread, np.zeros(len(zb))
        if known.wide is None:
            if not lifting.sum() > 0:
                raise np.linalg.LinAlgError("contacts conduct less than nothing")
            lifted = (1 - lifting @ spread) / math.sqrt(lifting.sum())
            z += lifted * lifted[ground]
        own = float(z[ground] + known.resistance[ground])
        ratio = z / own
        driven = 1 - ratio
        row = Row(
            driven, self._none, driven, driven, self._none, ratio, own, spread, matrix, lifted
        )
        here, read = contacts.tolist(), valid.tobytes()
        kept = self._kept.get(ground)
        if kept is None or kept[1] != read or not self._alike(kept[0], here):
            between = np.diag(way) if mutual is None else np.diag(way) + mutual
            changes, aside = self._changes(contacts, ground, row, share, slopes, between)
            self._kept[ground] = kept = here, read, changes * (known.gain * valid), *aside
        row.changes, modes = kept[2], len(known.sheet)
        row.variance = self._alone + INEXACT**2 * driven**2 + kept[4]
        row.common = np.concatenate([ratio[None] * (known.deviations[2][ground] / own), kept[5]])
        row.common *= known.gain
        row.readings = (known.gain + shift[modes:]) * (driven + kept[3]) + known.offset
        row.readings += shift[:modes] @ row.changes[STATE * count :]
        return row

    def _changes(self, contacts, ground, row: Row, share, slopes, between):
        """(5 k + J, n) derivatives, for gains of 1, and of electrodes that lie aside: (n,) what they
        change; what is not known of that, (n,) variance of each, (2, n) deviations that all share.

        share (k, n), slopes (k, 2, n) : of contacts; between (k, k) : C^-1
        """
        count, modes, n = len(contacts), len(self.known.sheet), len(row.ratio)
        if (np.abs(contacts[:, :2]) > self._inside).any():
            inside = contacts.copy()
            inside[:, :2] = np.clip(contacts[:, :2], -self._inside, self._inside)
            slopes = self.shares.at(inside)[1]
        ones, others = row.added()
        impedance = self.impedance - ones.T @ others
        fed = np.linalg.solve(between, share)
        current = fed @ row.ratio
        changes = np.empty((STATE * count + modes, n))
        if count:
            by_strength = np.exp(-contacts[:, 2]) * current
            by_contact = _by_contact(slopes, row.ratio, fed, current, by_strength)
            np.matmul(by_contact, impedance, out=changes[: STATE * count])
        single = row.ratio.astype(np.float32)
        currents = (self._change @ single).reshape(-1, n)
        if count:
            moved = self.shares.by_sheet(contacts)
            currents += (current.astype(np.float32) @ moved.reshape(count, -1)).reshape(-1, n)
            currents += (moved @ single).T @ fed.astype(np.float32)
        np.matmul(currents, impedance.astype(np.float32), out=changes[STATE * count :])
        seen = self._fields, ground, row.ratio, row.own, impedance
        columns, ways = self.operator.displacement.row(*seen, contacts[:, :2], share.T, fed.T)
        aside, unsure = self.known.aside, self._aside
        moved = (aside * columns).sum(axis=0) + aside[:, ground] @ ways
        variance = ((unsure * columns) ** 2).sum(axis=0)
        return changes, (moved, variance, unsure[:, ground, None] * ways)

    def _alike(self, ones: list, others: list) -> bool:
        """Whether contacts x, y, ln c, ln a are nearly the same."""
        near = _ALIKE * self.operator.pitch
        return len(ones) == len(others) and all(
            abs(x - u) < near and abs(y - v) < near and abs(c - d) < _AS_STRONG and a == b
            for (x, y, c, a), (u, v, d, b) in zip(ones, others)
        )

    def idle(self) -> Row:
        """The row of an untouched sheet, whatever electrode is grounded."""
        known, count, none = self.known, self.operator.count, np.zeros(self.operator.count)
        return Row(
            known.offset,
            np.zeros((len(known.sheet), count)),
            none,
            self._alone,
            np.zeros((3, count)),
            np.ones(count),
            np.inf,
            self._none,
            np.zeros((0, 0)),
            none,
        )

    def mutual(self, contacts: np.ndarray) -> np.ndarray | None:
        """(k, k) D between contacts (k, 4), ohm; 0 for each with itself and where electrodes screen
        them; None where they do everywhere. As derivatives, it is kept while contacts stay."""
        here = contacts.tolist()
        if not _near(here, SCREENED * self.operator.pitch):
            return None
        if not self._alike(self._mutual[0], here):
            self._mutual = here, self._mutual_of(contacts)
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
        inverse = self._inverse
        solved = inverse[:, :-1] @ potentials.T + inverse[:, -1:]
        border = self.operator.bordered[-1]
        block = block - potentials @ solved - (border[:-1] @ potentials.T + border[-1])
        block = np.maximum((block + block.T) / 2, 0.0)
        out[np.ix_(chosen, chosen)] = block
        return np.where(close, out, 0.0)


def _solved(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """(k, m) solution with a small positive definite `matrix` of `right` (k, m)."""
    if not len(matrix):
        return right
    _, found, failed = dposv(matrix, right)
    return found if not failed else np.linalg.solve(matrix, right)


def _by_contact(slopes, ratio, fed, current, by_strength) -> np.ndarray:
    """(5 k, n) currents dY rho into the electrodes by the numbers of each contact.

    slopes (k, 2, n) of shares; fed (k, n), current, by_strength (k,) see `RowModel.row`
    """
    count, n = fed.shape
    out = np.zeros((count, STATE, n))
    np.multiply(slopes, current[:, None, None], out=out[:, PLACE])
    out[:, PLACE] += (slopes @ ratio)[:, :, None] * fed[:, None]
    np.multiply(fed, by_strength[:, None], out=out[:, STRENGTH])
    return out.reshape(-1, n)


def _near(places: list, reach: float) -> bool:
    """Whether some two of few places (x, y, ...) are within `reach`, m."""
    for i, (x, y, *_) in enumerate(places):
        for u, v, *_ in places[:i]:
            if abs(x - u) < reach and (x - u) ** 2 + (y - v) ** 2 < reach**2:
                return True
    return False
