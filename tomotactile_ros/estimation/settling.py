"""Readings taken before the multiplexer has settled: what a reading keeps of the row before.

    v_i = (1 - s_n) V_i + s_n V_(i-1)

with the potentials V of channel n in rows i and i - 1 (`scenes.channels`). Reciprocity tells s
(`reciprocity`), from any touch and before any contact is looked for; then it is taken off all
readings, once. Left in them, half a percent looks like contacts: it is 16 mV where a row is at the
drive voltage and the next at ground.

Most of it is common to all channels, as the multiplexer is.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.estimation.one_state import ROUNDS, Reciprocity, reciprocity
from tomotactile_ros.estimation.prior import Prior

EXPECTED = 0.005  # standard deviation of s: five time constants leave 0.7 %, seven 0.1 %
COMMON = 0.9  # of the variance of s
# standard deviations, of the mean of s and of chi-squared without it: once in a million touches by chance
_CLEAR = 5.0
# chi-squared beyond one an equation that is left at most, in parts of what was there without s
_LEFT = 0.5
_ENOUGH = (
    2e-4  # standard deviation of s: 0.7 mV at most, and 0.1 mV in a usual row; known well enough
)
# chi-squared an equation with s, at most: what moves while rows are read takes some for s, and leaves more
_OF_ONE_STATE = 1.3
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

    def taken_off(self, voltages: np.ndarray, grounded: np.ndarray) -> np.ndarray:
        """(L, E) V of readings (L, E), V, of a scan that goes on and on: the row before the first one
        was the last one."""
        if len(grounded) < 2:
            return voltages
        read = out = np.asarray(voltages, float)
        for _ in range(_PASSES):
            before = np.roll(_with_ground(out, grounded), 1, axis=0)
            out = self._less(read, before)
        return out

    def taken_off_row(
        self, voltages: np.ndarray, before: np.ndarray, grounded_before: int
    ) -> np.ndarray:
        """(E,) V of the readings of a row; `before` : what this made of the row before."""
        return self._less(voltages, _with_ground(before[None], np.array([grounded_before]))[0])

    def _less(self, read, before):
        kept = np.where(np.isnan(before), read, before)
        return (read - self.part * kept) / (1 - self.part)


def _with_ground(voltages, grounded):
    """Readings with the grounded electrode at 0 V where it was not read."""
    out, own = np.array(voltages, float), (np.arange(len(grounded)), grounded)
    out[own] = np.where(np.isnan(out[own]), 0.0, out[own])
    return out


def unsettled(
    without: Reciprocity,
    scan: np.ndarray,
    used: np.ndarray,
    prior: Prior,
    known: Settling | None,
    electrodes: int,
) -> Settling | None:
    """What rows tell of it, beyond what is `known` and was taken off them; None where they do not show
    that there is any, or no more of it.

    without : reciprocity of rows as they are; scan : electrodes that were grounded in turn, also those
        that are not in use; used (n,) those of the rows; electrodes : how many there are
    """
    before = _before(scan, among := used[without.among])
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


def _told(without, before, among, prior, known) -> tuple[Settling, Reciprocity]:
    """What is known with the rows of `without`, and their reciprocity with it."""
    covariance = known.covariance[np.ix_(among, among)]
    precision = np.linalg.inv(covariance)
    beside = np.zeros(len(among)), precision, before
    told = reciprocity(without.rows, prior, ROUNDS, beside)
    follow = known.covariance[:, among] @ precision
    left = known.covariance - follow @ (covariance - _own(told.gains.covariance)) @ follow.T
    return Settling(known.part + follow @ told.gains.settling, left), told


def _own(covariance):
    """The block of settling in that of gains, offsets and settling."""
    count = len(covariance) // 3
    return covariance[2 * count :, 2 * count :]


def _before(scan, among):
    """(n,) for each of the electrodes `among` the number of that which was grounded before it; -1
    where that is none of them."""
    place = {int(electrode): i for i, electrode in enumerate(among)}
    last = {int(electrode): int(other) for other, electrode in zip(np.roll(scan, 1), scan)}
    return np.array([place.get(last.get(int(electrode), -1), -1) for electrode in among])
