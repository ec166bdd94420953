"""Frames as they come in: checked against the layout, put in order, compared with the noise."""

from __future__ import annotations

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

LARGEST_VOLTAGE = 1e3  # V; beyond, a reading is no reading
_LEAST_READINGS = 8  # valid ones that a frame needs to be more than idle


def ordered(layout: Layout, voltages, grounded) -> np.ndarray:
    """(E, E) float64 frame with row l for ground condition l, V; NaN where nothing valid was read.

    Parameters
    ----------
    voltages : (L, E) V, NaN where there is no valid reading
    grounded : (L,) grounded electrode of each row, each at most once, in any order

    Raises InputError where the frame does not fit the layout.
    """
    electrodes = layout.electrodes
    voltages, grounded = np.asarray(voltages), np.asarray(grounded)
    if voltages.ndim != 2 or voltages.shape[1] != electrodes or voltages.dtype.kind not in "fiu":
        raise InputError(
            f"voltages: {voltages.dtype} of shape {voltages.shape} does not fit {layout.name}, "
            f"numbers of shape (rows, {electrodes}) are needed"
        )
    if grounded.shape != (len(voltages),) or grounded.dtype.kind not in "iu":
        raise InputError(
            f"grounded: shape {grounded.shape} does not fit, the number of an electrode is needed "
            f"for each of the {len(voltages)} rows"
        )
    grounded = grounded.astype(np.intp)
    if len(grounded) and not (0 <= grounded.min() and grounded.max() < electrodes):
        raise InputError(f"grounded: the electrodes of {layout.name} are 0 to {electrodes - 1}")
    frame = np.full((electrodes, electrodes), np.nan)
    frame[grounded] = voltages
    if np.bincount(grounded, minlength=1).max() > 1:
        raise InputError(f"grounded: electrode {np.bincount(grounded).argmax()} is named twice")
    np.copyto(frame, np.nan, where=np.abs(frame) > LARGEST_VOLTAGE)
    frame.ravel()[:: electrodes + 1] = np.nan
    return frame


def ordered_row(layout: Layout, voltages, grounded: int) -> np.ndarray:
    """(E,) float64 readings of one row, V; NaN where nothing valid was read. As `ordered`, for who
    has no time for a frame of it."""
    row = np.array(voltages, float) if np.asarray(voltages).dtype.kind in "fiu" else None
    if row is None or row.shape != (layout.electrodes,) or not 0 <= grounded < len(row):
        return ordered(layout, np.atleast_2d(voltages), np.atleast_1d(grounded))[grounded]
    row[grounded] = np.nan
    row[np.abs(row) > LARGEST_VOLTAGE] = np.nan
    return row


def check_drive_voltage(value) -> float:
    """The drive voltage, V, positive and finite."""
    value = checks.positive(value, "drive_voltage", "voltage in V")
    if not 1e-6 <= value <= LARGEST_VOLTAGE:
        raise InputError(f"drive_voltage: {value:g} V is not from 1e-06 V to {LARGEST_VOLTAGE:g} V")
    return value


def is_idle(frame: np.ndarray, missing: np.ndarray, bad: np.ndarray, limit: float) -> bool:
    """Whether nothing touches: the median over electrodes of the mean reading is below `limit`, V.

    Contacts raise all readings but the grounded electrode's, a broken channel only its own.

    Parameters
    ----------
    frame : (E, E) V; missing : (E, E) bool, where there is no reading
    bad : (E,) bool, channels that are left out
    """
    counts = len(frame) - np.count_nonzero(missing, axis=0)
    counts[bad] = 0
    if counts.sum() < _LEAST_READINGS:
        return True
    sums = np.where(missing, 0.0, frame).sum(axis=0)
    read = counts > 0
    means = np.sort(sums[read] / counts[read])
    return bool(means[len(means) // 2] < limit)
