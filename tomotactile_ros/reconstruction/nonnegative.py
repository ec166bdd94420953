"""Non-negative image: conductances cannot be below zero, and that alone makes the image sharp.

    min over c >= 0 of  sum_i ((A c - d)_i / sigma_i)^2

with the data d and the operator A of `local`. Each datum counts by its own error: currents into
electrodes are nearly free of errors of the sheet, couplings carry a part of Y0 that stands for an
uneven sheet. Currents alone leave open how far a contact reaches: they give its centre. Couplings
are largest for a current fed in midway between electrodes and least for one spread out to them, and
a constant added to their data makes contacts as compact as the currents allow where couplings are
too uncertain to tell. Solutions are sparse, a few pixels to a contact; active sets find them from
those of the last frame. Only pixels where the linear image of the same frame is above a fraction of
its maximum take part: contacts that jump are not followed late.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.optimize import nnls

from tomotactile_ros.grid import Grid
from tomotactile_ros.reconstruction.active_set import Memory, minimise
from tomotactile_ros.reconstruction.admittance import AdmittanceMeter, Grounded
from tomotactile_ros.reconstruction.local import LocalImage

_SUPPORT = 0.04  # of the linear image's maximum
_TYPICAL = 3.5  # conductance of a pixel, per its width in spacings, times the sheet resistance
_LEAST_SPREAD = 0.6  # pixels
_MOST = 400  # pixels that take part
_CURRENT_ERROR = 0.001  # in parts of all contacts: size and place of electrodes
_OWN_ERROR = 0.01  # in parts of the electrode's own current
_COUPLING_ERROR = 0.1  # of Y0: an uneven sheet
_COMPACT = 0.3  # of Y0, added to couplings


def support(linear: np.ndarray) -> np.ndarray:
    """(n,) pixels of the linear image (K,) that take part."""
    active = np.flatnonzero(linear > _SUPPORT * linear.max())
    if len(active) > _MOST:
        active = np.sort(active[np.argpartition(-linear[active], _MOST)[:_MOST]])
    return active


def weighted_data(
    local: LocalImage, measured: Grounded, compact: float = _COMPACT
) -> tuple[np.ndarray, np.ndarray]:
    """(D,) data and (D,) 1 / sigma; couplings are left out where noise hides them."""
    error = current_error(local.meter, measured)
    if measured.couplings is None:
        return measured.currents, 1 / error
    model_error = _COUPLING_ERROR * local.meter.untouched
    coupling_error = np.hypot(measured.noise, model_error)
    # what is added has the same weight against the currents, whatever the noise
    added = compact * local.meter.untouched * (coupling_error / model_error) ** 2
    data = np.append(measured.currents, measured.couplings - added)
    return data, 1 / np.append(error, coupling_error)


def current_error(meter: AdmittanceMeter, measured: Grounded) -> np.ndarray:
    """(n,) how far the currents can be trusted, S."""
    currents = measured.currents
    noise = measured.noise**2 * float(currents.dot(currents)) / meter.amplification
    model = _CURRENT_ERROR * measured.total + _OWN_ERROR * np.abs(currents)
    return np.sqrt(model**2 + noise)


def solve_nonnegative(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """x >= 0 that minimises |matrix x - right|, from scratch; the best so far where the steps run
    out."""
    if not matrix.size:  # scipy frees memory twice there, which ends the process
        return np.zeros(matrix.shape[1])
    try:
        return nnls(matrix, right)[0]
    except RuntimeError:
        return np.maximum(np.linalg.lstsq(matrix, right, rcond=None)[0], 0.0)


def nonnegative_image(
    local: LocalImage,
    measured: Grounded,
    linear: np.ndarray,
    even: bool = False,
    memory: Memory | None = None,
) -> np.ndarray:
    """(K,) effective conductance c of each pixel, S, from the linear image of the same frame.

    Parameters
    ----------
    even : add a small weight on c^2, for contacts that are wide: they would break into spots
    memory : of the last frame; updated
    """
    out = np.zeros(len(linear))
    active = support(linear)
    if not len(active):
        return out
    data, weight = weighted_data(local, measured)
    matrix = local.forward[: len(data), active] * weight[:, None]
    right = data * weight
    memory = memory or Memory()
    start = memory.recall(active)
    if start is None and not even:
        out[active], memory.steps = solve_nonnegative(matrix, right), 0
    else:
        gram = matrix.T @ matrix
        if even:
            gram.ravel()[:: len(gram) + 1] += typical_pixel(local) ** -2
        if start is None:
            start = np.maximum(linear[active] - linear.max() / 2, 0.0)
        out[active], memory.steps = minimise(gram, matrix.T @ right, start, blocks=even)
    memory.values = out
    return out


def typical_pixel(local: LocalImage) -> float:
    """Conductance of a pixel, S, that costs as much as an error of one standard deviation."""
    return _TYPICAL * np.sqrt(local.grid.cell_area) / local.spacing / local.resistance


def spread(values: np.ndarray, grid: Grid, width: float) -> np.ndarray:
    """(K,) `values` (K,) smoothed by a Gaussian of standard deviation `width`, m; keeps the sum."""
    sigma = np.maximum(width / np.array(grid.cell_size[::-1]), _LEAST_SPREAD)
    image = gaussian_filter(grid.fill(values, outside=0.0), sigma, mode="constant")
    image = grid.gather(image)
    total = image.sum()
    return image * (values.sum() / total) if total > 0 else image
