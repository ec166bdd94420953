"""Readings in the measurement order of pyEIT and of EIDORS.

Both list, stimulation after stimulation, what is measured at one electrode after the other, without
those that carry the current unless `meas_current` asks for them; a stimulation is here a grounded
electrode. With `rotate_meas` the list begins at that electrode, otherwise at the first one. pyEIT
(`build_meas_pattern_std`) has frames as vectors one below the other, EIDORS (`mk_stim_patterns`) as
columns. Differences of neighbours are V[k+1] - V[k] in pyEIT and V[k] - V[k+1] in EIDORS.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

ORDERS = ("pyeit", "eidors")
_CLOSED = 0.05  # differences around the ring add up to nothing: to less than this part of them


def in_order(
    values: np.ndarray, grounded: np.ndarray, electrodes: int, order: str, rotated: bool = False
) -> tuple[np.ndarray, str]:
    """(N, L, E) readings, NaN where none was taken, and a line that says how they were read.

    Parameters
    ----------
    grounded : (L,) electrode of each row; electrodes : E
    order : of `ORDERS`; rotated : `rotate_meas` of both
    """
    if order not in ORDERS:
        raise InputError(f"order: {checks.show(order)} is none of {', '.join(ORDERS)}")
    rows = len(grounded)
    each = next((n for n in (electrodes - 1, electrodes) if _fits(values, rows * n)), 0)
    if not each:
        raise InputError(_wrong_size(values, rows, electrodes))
    frames = _frames(values, rows * each, each, order).reshape(-1, rows, each)
    readings = np.full((len(frames), rows, electrodes), np.nan)
    told = f"in the order of {order}, {'from the grounded one on' if rotated else 'from the first one on'}"
    differences = each == electrodes and _are_differences(frames)
    for row, ground in enumerate(grounded):
        electrode = (np.arange(electrodes) + (ground if rotated else 0)) % electrodes
        if each < electrodes:
            electrode = electrode[electrode != ground]
        readings[:, row, electrode] = frames[:, row]
        if differences:
            steps = readings[:, row] if order == "pyeit" else -readings[:, row]
            around = (np.arange(electrodes) + ground) % electrodes
            readings[:, row, around] = np.cumsum(np.roll(steps[:, around], 1, axis=1), axis=1)
            readings[:, row] -= readings[:, row, ground, None]
    if differences:
        return readings, f"differences of neighbours, {told}"
    return readings, f"{each} readings a row, {told}"


def _fits(values: np.ndarray, size: int) -> bool:
    """Whether frames of so many numbers fill one end of the shape."""
    ends = np.cumprod(values.shape), np.cumprod(values.shape[::-1])
    return any(size in end for end in ends)


def _frames(values: np.ndarray, size: int, each: int, order: str) -> np.ndarray:
    """Numbers of one frame of `size` after the other, each row of `each` after row."""
    if order == "eidors":
        across = values.shape[0] not in (size, each)
    else:
        across = values.shape[-1] in (size, each)
    return values.reshape(-1, order="C" if across else "F")


def _are_differences(frames: np.ndarray) -> bool:
    """Whether rows (N, L, E) add up to nothing: potentials are all above that of the ground."""
    known = np.where(np.isfinite(frames), frames, 0.0)
    total = np.abs(known).sum()
    return bool(total > 0 and np.abs(known.sum(axis=2)).sum() < _CLOSED * total)


def _wrong_size(values: np.ndarray, rows: int, electrodes: int) -> str:
    shape = " x ".join(map(str, values.shape))
    text = f"order: {shape} numbers are no frames of {rows} rows x {electrodes - 1} or {electrodes} readings"
    for fewer in (2, 3, 4):
        if electrodes > fewer and _fits(values, rows * (electrodes - fewer)):
            return (
                f"{text}, but of {electrodes - fewer}: differences without those at electrodes that carry "
                "current leave open how far all are above the ground, and currents between pairs are another "
                "sensor; measure each electrode against the grounded one (EIDORS: '{mono}'), or all "
                "differences (meas_current)"
            )
    return text
