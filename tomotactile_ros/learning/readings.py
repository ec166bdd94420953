"""Readings as the learning takes them: rows for the estimator, what is clipped, whether the sheet
is untouched."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.special import log_ndtr

from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.screening import at_lowest

_EVEN = 1.2  # variance over the rows in parts of the noise's, up to which nothing touches
_FLOOR = 1e-4  # V, standard deviation: hum and drift of what is averaged
# deviations expected of offsets (50 mV): beyond, in most channels, what reads the same in all rows
# is no untouched sheet: nothing is grounded, or the converter is at its end
_FAR_OFF = 10.0
_GRID = 801  # values of an offset
_WIDTH = 6.0  # standard deviations that they span


def rows_of(
    operator: SheetOperator, voltages, grounded, drive: float, noise: float, unused=None
) -> Rows:
    """`Rows` of one frame (L, E), V, grounded electrodes (L,); `unused` (L, E) readings that are
    left out.

    The grounded electrode's own reading is one like all others (its potential is the drop over its
    resistance); where it was not taken it is NaN.
    """
    voltages, grounded = np.asarray(voltages, float), np.asarray(grounded, int)
    valid = np.isfinite(voltages)
    if unused is not None:
        valid &= ~unused
    used = operator.used
    at = operator.position[grounded]
    readings = np.where(valid, voltages, 0.0)[:, used] / drive
    weights = valid[:, used] / (noise / drive) ** 2
    kept = (at >= 0) & (weights > 0).any(axis=1)
    return Rows(readings[kept], weights[kept], at[kept])


def square(voltages: np.ndarray, grounded: np.ndarray, unused: np.ndarray) -> np.ndarray:
    """(E, E) V, row l the mean of the rows with electrode l grounded; NaN: not read, or
    `unused`."""
    kept = np.isfinite(voltages) & ~unused
    count = np.zeros((voltages.shape[1],) * 2)
    total = np.zeros_like(count)
    np.add.at(count, np.asarray(grounded, int), kept)
    np.add.at(total, np.asarray(grounded, int), np.where(kept, voltages, 0.0))
    return np.where(count > 0, total / np.maximum(count, 1), np.nan)


def is_untouched(voltages: np.ndarray, grounded: np.ndarray, noise: float) -> bool:
    """Whether the readings (L, E), V, of each electrode are the same in all rows, as offsets are.

    A touch drives the sheet, and which electrode is grounded then makes a difference.
    """
    valid, count, mean = _means(voltages, grounded)
    left = np.where(valid, voltages - mean, 0.0)
    degrees = np.maximum(count - 1, 0).sum()
    return bool(degrees and (left**2).sum() < _EVEN * degrees * noise**2)


def are_offsets(voltages: np.ndarray, grounded: np.ndarray, mean, deviation) -> bool:
    """Whether the readings (L, E), V, of an untouched sheet are those of channels whose offsets are
    expected to be `mean` +- `deviation` (E,), V: most of them near it."""
    _, count, own = _means(voltages, grounded)
    far = np.abs(own - mean)[count > 0] > _FAR_OFF * deviation[count > 0]
    return bool(2 * np.count_nonzero(far) <= len(far))


def _means(voltages, grounded):
    """What was read of electrodes that are not grounded (L, E), how often (E,), and means (E,), V."""
    valid = np.isfinite(voltages)
    valid[np.arange(len(grounded)), grounded] = False
    count = valid.sum(axis=0)
    return valid, count, np.where(valid, voltages, 0.0).sum(axis=0) / np.maximum(count, 1)


@dataclass(frozen=True)
class Offsets:
    """What untouched readings say of the offsets, V, beside what was expected: of each channel its
    information (E,), V^-2, and that times the mean (E,), to be added to those of the prior."""

    information: np.ndarray
    pull: np.ndarray
    ended: np.ndarray  # channels that only read the lower end of the range


def offsets(frames: np.ndarray, grounded, noise: float, mean: np.ndarray, deviation) -> Offsets:
    """Offsets from untouched frames (F, L, E), V, where `mean` +- `deviation` (E,), V, was
    expected.

    A reading at 0 V, the end of the range, says that offset and noise were below half a step: those
    of a channel are censored (Tobin 1958), and mean and variance of the exact posterior stand for
    it.
    """
    valid = np.isfinite(frames)
    valid[:, np.arange(len(grounded)), grounded] = False
    low = at_lowest(np.where(valid, frames, np.nan)) & valid
    above = valid & ~low
    count, ends = above.sum(axis=(0, 1)), low.sum(axis=(0, 1))
    positive = frames[above & (frames > 0)]
    step = positive.min() / 2 if low.any() and positive.size else 0.0
    own = np.where(above, frames, 0.0).sum(axis=(0, 1)) / np.maximum(count, 1)
    variance = noise**2 / np.maximum(count, 1) + _FLOOR**2
    information = np.where(count > 0, 1 / variance, 0.0)
    pull = information * own
    for channel in np.flatnonzero(ends):
        m, s = mean[channel], deviation[channel]
        grid = m + s * np.linspace(-_WIDTH, _WIDTH, _GRID)
        log = -(((grid - m) / s) ** 2) / 2 + ends[channel] * log_ndtr((step - grid) / noise)
        if count[channel]:
            log -= (grid - own[channel]) ** 2 / (2 * noise**2 / count[channel])
        weight = np.exp(log - log.max())
        weight /= weight.sum()
        centre = weight @ grid
        spread = weight @ (grid - centre) ** 2 + _FLOOR**2
        information[channel] = max(1 / spread - 1 / s**2, 0.0)
        pull[channel] = centre * (information[channel] + 1 / s**2) - m / s**2
    return Offsets(information, pull, (count == 0) & (ends > 0))
