"""What is known of the contacts between one row and the next: their means, their covariance, their
numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

if TYPE_CHECKING:
    from tomotactile_ros.estimation.row_model import RowModel

STATE = 5  # numbers of a contact: x, y (m), vx, vy (m/s), ln c
PLACE, SPEED, STRENGTH = slice(0, 2), slice(2, 4), 4
_ENDURING = 0.3  # m/s that the velocity changes by in `_WITHIN`, standard deviation
# m/s: the same of a contact that rests: friction. With 0.3, 307 instead of 277 of 13,472 rows of
# taps beside one had a ghost on 4 x 4 electrodes
_HELD = 0.03
_RESTED, MOVING = 32, 0.02  # rows; m/s: what has been there for so many and is slower rests
_WITHIN = 1.0  # s: a hand's mean acceleration; jerks are noticed and told apart
_FORGETTING = 60.0  # s: a minute of rows tells of the sensor, as many touches as a hand makes in it
_PRESSING = 0.08  # of ln c in a millisecond's root: 10 /s over a frame of 64 rows as `solver.RATES`


@dataclass(frozen=True)
class Belief:
    """Gaussian belief of k contacts and of S numbers of the sensor: the sheet's coefficients,
    gains.

    mean (5 k + S,), covariance (5 k + S, 5 k + S) : contacts first, then the sensor's shift from
    what is known sizes (k, 2) ln a and its variance; numbers (k,) that stay; begun (k,) s; rows
    (k,) read since
    """

    mean: np.ndarray
    covariance: np.ndarray
    sizes: np.ndarray
    numbers: tuple[int, ...] = ()
    begun: tuple[float, ...] = ()
    rows: tuple[int, ...] = ()

    @classmethod
    def untouched(cls, deviation: np.ndarray) -> Belief:
        return cls(np.zeros(len(deviation)), np.diag(deviation**2), np.empty((0, 2)))

    @property
    def count(self) -> int:
        return len(self.sizes)

    @property
    def shift(self) -> np.ndarray:
        return self.mean[STATE * self.count :]

    def contacts(self, mean: np.ndarray | None = None) -> np.ndarray:
        """(k, 4) x, y, ln c, ln a of the `mean`."""
        each = (self.mean if mean is None else mean)[: STATE * self.count].reshape(-1, STATE)
        out = np.empty((self.count, 4))
        out[:, :2], out[:, 2], out[:, 3] = each[:, PLACE], each[:, STRENGTH], self.sizes[:, 0]
        return out

    def places(self) -> dict[int, np.ndarray]:
        """{number: place (2,), m} of the contacts."""
        return {
            number: self.mean[STATE * i : STATE * i + 2] for i, number in enumerate(self.numbers)
        }

    def later(self, lasts: float, deviation: np.ndarray, unfaded: float | None = None) -> Belief:
        """What is expected `lasts` s later: contacts go on, with an acceleration of which only the
        size is known.

        The sensor slowly becomes as unknown as before, standard deviation `deviation` (S,): what
        the model lacks makes rows less independent than they are taken for. That may be made up for
        later: `unfaded` s of it are due now, `lasts` without.
        """
        if not self.count or lasts <= 0:
            return self
        contacts, faded = STATE * self.count, lasts if unfaded is None else unfaded
        moved, added = _lasting(self._rest(), lasts)
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[:contacts] = moved @ mean[:contacts]
        own, rest = covariance[:contacts, :contacts], covariance[:contacts, contacts:]
        own[:] = moved @ own @ moved.T + added
        rest[:] = moved @ rest
        covariance[contacts:, :contacts] = rest.T
        if faded > 0:
            kept = math.exp(-faded / _FORGETTING)
            mean[contacts:] *= kept
            covariance[contacts:] *= kept
            covariance[:, contacts:] *= kept
            own = covariance.reshape(-1)[contacts * (len(mean) + 1) :: len(mean) + 1]
            own += (1 - kept**2) * deviation**2
        return self.after(mean, covariance)

    def _rest(self) -> tuple[bool, ...]:
        """(k,) which contacts have come to rest: friction holds them."""
        speeds = self.mean[: STATE * self.count].reshape(-1, STATE)[:, SPEED].tolist()
        return tuple(
            rows >= _RESTED and vx**2 + vy**2 < MOVING**2
            for rows, (vx, vy) in zip(self.rows, speeds)
        )

    def after(
        self, mean: np.ndarray, covariance: np.ndarray, rows: tuple[int, ...] | None = None
    ) -> Belief:
        """The same contacts with another mean and covariance, and `rows` (k,) read since."""
        rows = self.rows if rows is None else rows
        return Belief(mean, covariance, self.sizes, self.numbers, self.begun, rows)

    def loosened(self, variances: ArrayLike) -> Belief:
        """The same with `variances` (5,) added to those of each contact."""
        covariance = self.covariance.copy()
        own = np.arange(STATE * self.count)
        covariance[own, own] += np.tile(variances, self.count)
        return self.after(self.mean, covariance)

    def of_sensor(self) -> Belief:
        """The belief without any contact, whatever those were."""
        own = slice(STATE * self.count, None)
        return Belief(self.mean[own], self.covariance[own, own], np.empty((0, 2)))

    def without(self, which: int) -> Belief:
        """The belief of all contacts but one, whatever that one was."""
        kept = np.ones(len(self.mean), bool)
        kept[STATE * which : STATE * (which + 1)] = False
        rest = [i for i in range(self.count) if i != which]
        return Belief(
            self.mean[kept],
            self.covariance[np.ix_(kept, kept)],
            self.sizes[rest],
            tuple(self.numbers[i] for i in rest),
            tuple(self.begun[i] for i in rest),
            tuple(self.rows[i] for i in rest),
        )

    def with_contact(
        self, mean: np.ndarray, variances: ArrayLike, size: ArrayLike, number: int, begun: float
    ) -> Belief:
        """One contact more, `mean` (5,) with the covariance `variances` (5,) or (5, 5); `size` as
        in `sizes`."""
        at = STATE * self.count
        total = len(self.mean) + STATE
        old = np.r_[0:at, at + STATE : total]
        covariance = np.zeros((total, total))
        covariance[np.ix_(old, old)] = self.covariance
        new = slice(at, at + STATE)
        covariance[new, new] = np.diag(variances) if np.ndim(variances) == 1 else variances
        return Belief(
            np.insert(self.mean, at, mean),
            covariance,
            np.vstack([self.sizes, size]),
            (*self.numbers, number),
            (*self.begun, begun),
            (*self.rows, 0),
        )


@lru_cache(maxsize=64)
def _lasting(rest: tuple[bool, ...], lasts: float) -> tuple[np.ndarray, np.ndarray]:
    """(5 k, 5 k) motion of k contacts in `lasts` s, and what it adds to their covariance; `rest` : which
    of them rest."""
    count = len(rest)
    moved, added = np.eye(STATE * count), np.zeros((STATE * count, STATE * count))
    for i, rests in enumerate(rest):
        own = added[STATE * i : STATE * (i + 1), STATE * i : STATE * (i + 1)]
        q = (_HELD if rests else _ENDURING) ** 2 / _WITHIN * lasts
        for at, by in ((0, 2), (1, 3)):
            moved[STATE * i + at, STATE * i + by] = lasts
            own[by, by] = q
            own[at, by] = own[by, at] = q * lasts / 2
            own[at, at] = q * lasts**2 / 3
        own[STRENGTH, STRENGTH] = _PRESSING**2 * lasts / 1e-3
    return moved, added


def known_for(distance: float) -> float:
    """Time without rows, s, in which a contact goes `distance`, m, standard deviation, by an
    acceleration that nobody saw (`Belief.later`)."""
    return (3 * _WITHIN * (distance / _ENDURING) ** 2) ** (1 / 3)


@dataclass
class RowState:
    """All that lasts from row to row; a new one begins anew.

    confused : surprising rows of late, see `follow`; infinite when there were too many, or where
        something touched already in the first row, until a frame or an untouched row tells
    unfaded : s for which what rows say of the sensor has not faded yet
    untouched : whether the last row is that of an untouched sheet
    misfit : chi-squared per reading of the last row, against what was expected of it
    uneven : `Equations.unevenness` of the sheet, as the last frame had it
    read : rows so far; touched_at_once : whether it is the first row that confused
    time : s, of the last row; last : highest number given; unexplained : rows in a row that no
        contacts explain
    model : `RowModel` of the sensor as known; sums : of the matched filter
    fading : {number: how much likelier rows of late are without the contact}, -2 ln(likelihood)
    distrusted (n,) : rows for which each channel is not read yet, as a row contradicted it
    wide : (number, begun in s, contact) of contacts too wide for rows, as the last frame showed
        them; wide_time : s, of that frame; wide_step : s, since the one before; wide_ways (k, 2) m/s, of
        their discs; wide_carried : s for which these have gone on since
    """

    belief: Belief
    model: RowModel
    sums: np.ndarray
    distrusted: np.ndarray
    time: float = -np.inf
    last: int = 0
    unexplained: int = 0
    confused: float = 0.0
    unfaded: float = 0.0
    untouched: bool = False
    misfit: float = 0.0
    uneven: float = 1.0
    read: int = 0
    touched_at_once: bool = False
    fading: dict[int, float] = field(default_factory=dict)
    wide: list = field(default_factory=list)
    wide_time: float = -np.inf
    wide_step: float = np.inf
    wide_ways: np.ndarray = field(default_factory=lambda: np.empty((0, 2)))
    wide_carried: float = 0.0

    @property
    def touched(self) -> bool:
        """Whether something touches."""
        return bool(self.wide) or self.belief.count > 0
