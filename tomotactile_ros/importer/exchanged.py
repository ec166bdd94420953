"""Whether rows of square frames are grounded electrodes, or the electrodes that were read.

With Z the impedances between electrodes and the driving layer, readings are v_ln = V0 (1 - Z_ln /
Z_ll), and the row sums of Y = Z^-1 are >= 0: no current flows back into the driving layer. So

    sum_l y_l v_ln = 1 for all n,      y_l = Z_ll sum_n Y_ln / c >= 0

with c > 0, whatever V0 is. In exchanged frames it is y_l = sum_n Y_ln Z_nn / c, which has both signs
unless all Z_nn are about the same: where electrodes lie around a sheet, exchanged frames are those of
a mirrored contact, and nothing tells. The best y >= 0 leaves a misfit, to be compared.
"""

from __future__ import annotations

import numpy as np
from scipy.optimize import nnls

_FRAMES = 5  # the strongest, which are looked at
_GAINS = 0.02  # rms, by which the channels of a device usually differ
_FLAT = 0.1  # of the usual spread of an electrode's readings, below which it is stuck or cut off
# median misfit in parts of what noise and gains make it, 0.7 for pure noise. Simulated on five layouts,
# one to three contacts, also with dead, stuck, weak and swapped channels, offsets of 10 mV and gains
# off by 5 %: of 7,800 frames none was decided wrongly; of grids some 90 % are decided
_FITS, _CONTRADICTS = 1.0, 2.0


def look_exchanged(frames: np.ndarray, noise: float, idle: float) -> bool | None:
    """Whether rows are the electrodes that were read; None where the readings do not tell.

    Parameters
    ----------
    frames : (N, E, E) V, row e of electrode e; the diagonal does not matter. Those with NaN elsewhere
        tell nothing, unless electrodes are missing as a whole
    noise : of a reading, V rms
    idle : mean reading, V, below which nothing touches
    """
    strength = np.nan_to_num(frames).mean(axis=(1, 2))
    strongest = [_usable(frames[n], idle) for n in np.argsort(strength)[-_FRAMES:]]
    both = [(_misfit(w, noise), _misfit(w.T, noise)) for w in strongest if len(w)]
    if not both:
        return None
    as_given, turned = np.median(both, axis=0)
    if min(as_given, turned) > _FITS or max(as_given, turned) < _CONTRADICTS:
        return None
    return bool(turned < as_given)


def _usable(frame: np.ndarray, idle: float) -> np.ndarray:
    """(n, n) V, readings of electrodes that work, 0 on the diagonal; empty where they tell nothing."""
    valid = np.isfinite(frame)
    np.fill_diagonal(valid, False)
    read = valid.any(axis=0) & valid.any(axis=1)
    block = _block(frame, read)
    if len(block) < 3 or not np.isfinite(block).all():
        return np.empty((0, 0))
    off = ~np.eye(len(block), dtype=bool)
    if block[off].mean() < idle:
        return np.empty((0, 0))
    spreads = [each[off].reshape(len(block), -1).std(axis=1) for each in (block, block.T)]
    spread = np.minimum(*spreads)
    return _block(block, spread > _FLAT * np.median(spread))


def _block(frame: np.ndarray, chosen: np.ndarray) -> np.ndarray:
    block = frame[np.ix_(chosen, chosen)]
    np.fill_diagonal(block, 0.0)
    return block


def _misfit(readings: np.ndarray, noise: float) -> float:
    """Median over n of |sum_l y_l v_ln - 1| for the best y >= 0, in parts of what is expected."""
    ones = np.ones(len(readings))
    try:
        y, _ = nnls(readings.T, ones, maxiter=30 * len(ones))
    except RuntimeError:  # no convergence
        return np.inf
    return float(np.median(np.abs(y @ readings - 1)) / np.hypot(noise * np.linalg.norm(y), _GAINS))
