"""What rows say by reciprocity alone, without sheet or contacts: gains and offsets of the channels,
and whether something changed while the rows were read."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.reciprocity import Gains, fit_gains

# chi-squared an equation of reciprocity, from which on rows are of several states: 1 to 2.4 of one,
# also with gains off by 5 %; 150 and more where a touch begins or slides at 0.2 m/s within a frame
_TORN = 12.0
_ROUNDS = 3  # of a fit that judges it
_PAIRS = 4  # rows: fewer have no more equations than unknowns


@dataclass(frozen=True)
class Channels:
    """gain (n,), offset (n,), in parts of V0."""

    gain: np.ndarray
    offset: np.ndarray


def channels_alone(rows: Rows, prior: Prior) -> tuple[Channels, np.ndarray, np.ndarray]:
    """Gains and offsets as rows tell them by themselves, and their standard deviations (n,); those
    expected where rows do not tell."""
    among, found = _fitted(rows, prior, 1)
    expected = prior.gain, prior.offset, *prior.deviations[:2]
    told = found.gain, found.offset, *np.sqrt(found.covariance.diagonal()).reshape(2, -1)
    gain, offset, *deviations = (each.copy() for each in expected)
    for each, known in zip((gain, offset, *deviations), told):
        each[among] = known
    return Channels(gain, offset), *deviations


def of_one_state(rows: Rows, prior: Prior) -> int:
    """How many of the last rows may be of one state of the sheet, whatever that is: those among which
    reciprocity holds."""
    whole = len(rows.grounded)

    def holds(count: int) -> bool:
        part = rows.part(slice(whole - count, None))
        return _fitted(part, prior, _ROUNDS)[1].misfit[0] < _TORN

    if whole <= _PAIRS or holds(whole):
        return whole
    least, most = _PAIRS, whole - 1
    while least < most:
        count = (least + most + 1) // 2
        least, most = (count, most) if holds(count) else (least, count - 1)
    return least


def _fitted(rows: Rows, prior: Prior, steps: int) -> tuple[np.ndarray, Gains]:
    """Electrodes that are grounded, which alone have equations; their gains and offsets, and how far
    reciprocity is violated, of rows alone."""
    among, at = np.unique(rows.grounded, return_inverse=True)
    frame = np.full((len(among),) * 2, np.nan)
    frame[at] = np.where(rows.weights > 0, rows.readings, np.nan)[:, among]
    noise = float(np.median(rows.weights[rows.weights > 0])) ** -0.5
    gain, offset, gain_deviation, offset_deviation = (
        each[among] for each in (prior.gain, prior.offset, *prior.deviations[:2])
    )
    expected = (gain, gain_deviation), (offset, offset_deviation)
    return among, fit_gains(frame[None], 1.0, noise, *expected, steps)
