"""What rows say by reciprocity alone, without sheet or contacts: gains and offsets of the channels,
which channels contradict all others, how much readings scatter, and whether something changed while
the rows were read.

Readings of any sheet under any contacts obey it: what it leaves over, no contacts explain.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.reciprocity import Gains, fit_gains
from tomotactile_ros.estimation.scatter import variance_of

# chi-squared an equation of reciprocity, from which on rows are of several states or channels broken: 1 to
# 2.4 of one, also with gains off by 5 %; 150 and more where a touch begins or slides at 0.2 m/s
# within a frame
TORN = 12.0
ROUNDS = 3  # of a fit that judges it
_PAIRS = 4  # rows: fewer have no more equations than unknowns
# standard deviations of chi^2 an equation, which may be noise: only what is beyond counts for the
# other readings in `Reciprocity.least`
_CHANCE = 2.0
# of chi^2 an equation: what is left at most without channels that contradict all others: one that
# reads at random leaves 8,900, and 1.0 without it
_HELPS = 0.25


@dataclass(frozen=True)
class Channels:
    """gain (n,), offset (n,), in parts of V0."""

    gain: np.ndarray
    offset: np.ndarray


@dataclass(frozen=True)
class Reciprocity:
    """How far `rows` obey it, with the `gains` that let them most; `among` : the electrodes (m,) that are
    grounded, which alone have equations."""

    rows: Rows
    among: np.ndarray
    gains: Gains

    @property
    def misfit(self) -> float:
        """Chi-squared an equation."""
        return float(self.gains.misfit[0])

    @property
    def chi_squared(self) -> float:
        """What contacts leave over at least, whatever they are."""
        return float((self.gains.left[0] ** 2).sum() / 2)

    @property
    def equations(self) -> float:
        """Number of them, less the unknowns of the frame."""
        return self.chi_squared / max(self.misfit, 1e-9)

    def least(self, count: int) -> float:
        """Chi-squared a reading, of `count` of them, that contacts leave over whatever they are: what
        these equations leave, and of the other readings as much as is sure of the equations; less than 1 where
        these are sure to scatter less than was said."""
        chance = _CHANCE * np.sqrt(2 / max(self.equations, 1.0))
        noise = min(self.misfit + chance, 1.0)
        others = max(count - self.equations, 0.0) * max(self.misfit - chance, noise)
        return max((self.chi_squared + others) / count, noise)

    @property
    def excess(self) -> float:
        """Chi-squared beyond what noise leaves."""
        return self.chi_squared - self.equations

    @property
    def electrodes(self) -> int:
        """Number of those that have equations."""
        return int(np.count_nonzero((self.gains.left[0] != 0).any(axis=0)))

    @property
    def worst(self) -> int:
        """The electrode whose equations leave most over."""
        return int(self.among[(self.gains.left[0] ** 2).sum(axis=1).argmax()])

    def scatter(self, places: np.ndarray) -> float | None:
        """Variance of the readings' noise in parts of what it was taken for, of electrodes at `places`
        (n, 2); None where too little was read to tell."""
        e = self.gains.left[0]
        return variance_of(e, e != 0, np.arange(len(e)), places[self.among])


def reciprocity(
    rows: Rows, prior: Prior, steps: int = 1, settling: tuple[np.ndarray, np.ndarray] | None = None
) -> Reciprocity:
    """Of rows, by so many `steps`; by more where these do not obey it at once.

    settling : as for `fit_gains`, of the electrodes that are grounded, in parts of the drive; None:
        readings have settled
    """
    among, at = np.unique(rows.grounded, return_inverse=True)
    frame = np.full((len(among),) * 2, np.nan)
    frame[at] = np.where(rows.weights > 0, rows.readings, np.nan)[:, among]
    noise = float(np.median(rows.weights[rows.weights > 0])) ** -0.5
    gain, offset, gain_deviation, offset_deviation = (
        each[among] for each in (prior.gain, prior.offset, *prior.deviations[:2])
    )
    expected = (gain, gain_deviation), (offset, offset_deviation)
    gains = fit_gains(frame[None], 1.0, noise, *expected, steps, settling)
    found = Reciprocity(rows, among, gains)
    if steps < ROUNDS and found.misfit > TORN:
        return reciprocity(rows, prior, ROUNDS, settling)
    return found


def channels_alone(found: Reciprocity, prior: Prior) -> tuple[Channels, np.ndarray, np.ndarray]:
    """Gains and offsets as rows tell them by themselves, and their standard deviations (n,); those
    expected where rows do not tell."""
    gains = found.gains
    told = gains.gain, gains.offset, *np.sqrt(gains.covariance.diagonal()).reshape(2, -1)
    expected = [each.copy() for each in (prior.gain, prior.offset, *prior.deviations[:2])]
    for each, known in zip(expected, told):
        each[found.among] = known
    gain, offset, gain_deviation, offset_deviation = expected
    return Channels(gain, offset), gain_deviation, offset_deviation


def without_contradicting(
    found: Reciprocity, prior: Prior, most: int
) -> tuple[Reciprocity, list[int]]:
    """Of the same rows without the electrodes that contradict all others, `most` of them, and these: the
    worst ones in turn, where that explains most of what is left over."""
    fewer = found
    left_out: list[int] = []
    while len(left_out) < most and fewer.misfit > TORN and fewer.electrodes > _PAIRS:
        rows, worst = fewer.rows, fewer.worst
        weights = rows.weights.copy()
        weights[:, worst] = weights[rows.grounded == worst] = 0.0
        fewer = reciprocity(replace(rows, weights=weights), prior, ROUNDS)
        left_out.append(worst)
    return (fewer, left_out) if fewer.misfit < _HELPS * found.misfit else (found, [])


def of_one_state(rows: Rows, prior: Prior) -> int:
    """How many of the last rows may be of one state of the sheet, whatever that is: those among which
    reciprocity holds; it does not of all."""
    whole = len(rows.grounded)

    def holds(count: int) -> bool:
        part = rows.part(slice(whole - count, None))
        return reciprocity(part, prior, ROUNDS).misfit < TORN

    if whole <= _PAIRS:
        return whole
    least, most = _PAIRS, whole - 1
    while least < most:
        count = (least + most + 1) // 2
        least, most = (count, most) if holds(count) else (least, count - 1)
    return least
