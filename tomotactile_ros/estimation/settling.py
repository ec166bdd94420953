"""Readings taken before the multiplexer has settled: what a reading keeps of the row before.

    v_i = (1 - s_n) V_i + s_n V_(i-1)

with the potentials V of channel n in rows i and i - 1 (`scenes.channels`). Reciprocity tells s
(`reciprocity`), from any touch that rests and before any contact is looked for; then it is taken off
all readings, once. Left in them, half a percent looks like contacts: it is 16 mV where a row is at the
drive voltage and the next at ground.

Most of it is common to all channels, as the multiplexer is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.estimation.one_state import ROUNDS, Reciprocity, reciprocity
from tomotactile_ros.estimation.prior import Prior

EXPECTED = 0.005  # standard deviation of s: five time constants leave 0.7 %, seven 0.1 %
# of its variance: common to all channels, as the multiplexer is; channels that differ by half of it
# are told all the same
COMMON = 0.9
# standard deviations of its mean, and of chi^2 without it, from which on it is taken off; by
# chance once in a million touches. Less than 0.15 % stays: 0.1 % costs 0.014 mm of place on 8 × 8,
# and 0.06 mm on 4 × 4
_CLEAR = 5.0
# chi-squared beyond one an equation that is left at most, in parts of what was there without s
_LEFT = 0.5
# part of the row before: standard deviation from which on no more is learned: 0.1 mV in a usual
# row. On 4 × 4, where one touch tells 7e-4, places after it are 0.16 mm off in the median instead
# of 0.18
_ENOUGH = 2e-4
# chi^2 an equation: what is left with it, at most: 0.6 to 1.1 at rest; without this bound 7 of 67
# touches that move in frames with taps and slides on 8 × 8 were taken for settling of -1 to 8 %,
# with it none
_OF_ONE_STATE = 1.3
# of the largest reading of a row: all are at least that: nothing was grounded, and the electrode
# that should have been was at the drive voltage like all others
_FLAT = 0.95
_PASSES = 3  # of taking off: each leaves a part s of what the last one left


@dataclass(frozen=True)
class Settling:
    """What a reading of each channel keeps of the row before: `part` (E,), and its covariance (E, E)."""

    part: np.ndarray
    covariance: np.ndarray

    @classmethod
    def expected(cls, electrodes: int) -> Settling:
        """Before any touch."""
        own = (1 - COMMON) * np.eye(electrodes)
        return cls(np.zeros(electrodes), EXPECTED**2 * (COMMON + own))

    def taken_off(
        self, voltages: np.ndarray, grounded: np.ndarray, first: np.ndarray | None = None
    ) -> np.ndarray:
        """(L, E) V of readings (L, E), V; NaN where the row before has no reading. `first` : as for
        `rows_before`."""
        read = out = np.asarray(voltages, float)
        if len(read):
            for _ in range(_PASSES):
                known = np.where(np.isnan(out), read, out)
                out = self.less(read, rows_before(known, grounded, first))
        return out

    def less(self, read: np.ndarray, before: np.ndarray) -> np.ndarray:
        """(..., E) V of readings, with the potentials in the rows `before`, V."""
        return (read - self.part * before) / (1 - self.part)


def rows_before(
    voltages: np.ndarray, grounded: np.ndarray, first: np.ndarray | None = None
) -> np.ndarray:
    """(L, E) V, potentials in the row before each of the rows (L, E), V.

    first : (E,) those before the first row, NaN where they are not known; None: those of the last
        row, as where rows of one state are read again and again
    """
    out = np.roll(with_ground(voltages, grounded), 1, axis=0)
    if first is not None:
        out[0] = first
    return out


def with_ground(voltages: np.ndarray, grounded: np.ndarray) -> np.ndarray:
    """(L, E) V, readings with that of the grounded electrode where it was not read: 0 V, or that of all
    others where these read the same, as its wire is open."""
    out, own = np.array(voltages, float), (np.arange(len(grounded)), grounded)
    others = np.isfinite(out)
    others[own] = False
    high = np.where(others, out, -np.inf).max(axis=1)
    low = np.where(others, out, np.inf).min(axis=1)
    flat = (low > _FLAT * high) & (low > 0) & (np.count_nonzero(others, axis=1) > 1)
    out[own] = np.where(np.isnan(out[own]), np.where(flat, high, 0.0), out[own])
    return out


def unsettled(
    without: Reciprocity,
    before: np.ndarray,
    used: np.ndarray,
    prior: Prior,
    known: Settling | None,
) -> Settling | None:
    """What rows tell of it, beyond what is `known` and was taken off them; None where they do not show
    that there is any, or no more of it.

    without : reciprocity of rows as they are; before (E, E), potentials in the row before the one in
        which each electrode is grounded, in parts of the drive, NaN: not known; used (n,) electrodes
        of the rows
    """
    electrodes, among = len(before), used[without.among]
    before = before[np.ix_(among, among)]
    if known is not None and without.misfit < _OF_ONE_STATE:
        if (known.covariance.diagonal()[among] < _ENOUGH**2).all():
            return None
        return _told(without, before, among, prior, known)[0]
    if without.excess < _CLEAR * np.sqrt(2 * without.equations):
        return None
    expected = Settling.expected(electrodes)
    start = expected if known is None else replace(known, covariance=expected.covariance)
    found, told = _told(without, before, among, prior, start)
    more, spread = told.gains.settling.mean(), _own(told.gains.covariance).mean()
    if abs(more) < _CLEAR * np.sqrt(spread) or told.misfit > _OF_ONE_STATE:
        return None
    explained = told.excess < _LEFT * reciprocity(without.rows, prior, ROUNDS).excess
    return found if explained and found.part.mean() > -_CLEAR * np.sqrt(spread) else None


def _told(
    without: Reciprocity, before: np.ndarray, among: np.ndarray, prior: Prior, known: Settling
) -> tuple[Settling, Reciprocity]:
    """What is known with the rows of `without`, and their reciprocity with it."""
    covariance = known.covariance[np.ix_(among, among)]
    precision = np.linalg.inv(covariance)
    told = reciprocity(without.rows, prior, ROUNDS, (precision, before))
    follow = known.covariance[:, among] @ precision
    left = known.covariance - follow @ (covariance - _own(told.gains.covariance)) @ follow.T
    return Settling(known.part + follow @ told.gains.settling, left), told


def _own(covariance: np.ndarray) -> np.ndarray:
    """The block of settling in that of gains, offsets and settling."""
    count = len(covariance) // 3
    return covariance[2 * count :, 2 * count :]
