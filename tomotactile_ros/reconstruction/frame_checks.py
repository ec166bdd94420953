"""Frames as they come in: checked against the layout, put in order, compared with the noise."""

from __future__ import annotations

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

LARGEST_VOLTAGE = 1e3  # V; beyond, a reading is no reading
# V rms, in parts of the drive voltage: the converter cuts off what noise adds beyond its range, and
# what is left is not noise around what is true
MOST_NOISE = 0.2
# times the noise: mean readings of a row that is plainly of an untouched sheet, or of a touched one
_UNTOUCHED, _TOUCHED = 3.0, 30.0
_CHANGES = 4  # from one to the other: a touch that begins and ends, and one row on its electrode
_STILL = 6.0  # times the noise, that a channel spans which never changes; ten times as much does
_MOVING = 2, 0.05  # channels, and share of them, that a touch is taken from and not broken wires
_ABOVE = 1.1  # times the drive voltage, that no reading of a sheet is: gains are a few % off
_FAR_ABOVE = 10.0  # times the drive voltage: no other drive voltage, readings are in another unit
_LEAST_READINGS = 8  # valid ones that a frame needs to be more than idle


def rows_of(layout: Layout, voltages, grounded) -> np.ndarray:
    """(L, E) float64 rows in their order, V; NaN where nothing valid was read.

    Parameters
    ----------
    voltages : (L, E) V, NaN where there is no valid reading
    grounded : (L,) grounded electrode of each row, any of them in any order, maybe more than once

    Raises InputError where they do not fit the layout.
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
    if len(grounded) and not (0 <= grounded.min() and grounded.max() < electrodes):
        raise InputError(f"grounded: the electrodes of {layout.name} are 0 to {electrodes - 1}")
    rows = np.array(voltages, float)
    np.copyto(rows, np.nan, where=np.abs(rows) > LARGEST_VOLTAGE)
    rows[np.arange(len(rows)), grounded.astype(np.intp)] = np.nan
    return rows


def ordered(layout: Layout, voltages, grounded) -> np.ndarray:
    """(E, E) float64 frame with row l for ground condition l, V; NaN where nothing valid was read.

    As `rows_of`, and each electrode is grounded at most once, or an InputError says which is not.
    """
    rows, grounded = rows_of(layout, voltages, grounded), np.asarray(grounded).astype(np.intp)
    if np.bincount(grounded, minlength=1).max() > 1:
        raise InputError(f"grounded: electrode {np.bincount(grounded).argmax()} is named twice")
    frame = np.full((layout.electrodes, layout.electrodes), np.nan)
    frame[grounded] = rows
    return frame


def alternates(rows: np.ndarray, noise: float) -> bool:
    """Whether rows (L, E), V, show a touch and none in turn, more often than a touch comes and goes
    within a frame: some of them were not read, and what they say is 0 V.

    A row is that of an untouched sheet, too, where all that presses lies on the grounded electrode.
    """
    read = ~np.isnan(rows)
    counts = np.count_nonzero(read, axis=1)
    means = np.where(read, np.abs(rows), 0.0).sum(axis=1) / np.maximum(counts, 1)
    clear = (counts > 0) & ((means < _UNTOUCHED * noise) | (means > _TOUCHED * noise))
    touched = means[clear] > _TOUCHED * noise
    return bool(np.count_nonzero(touched[1:] != touched[:-1]) > _CHANGES)


def standing_still(rows: np.ndarray, noise: float) -> int:
    """How many channels of rows (L, E), V, never change though others are raised and do, where that
    is more than half of them; otherwise 0.

    Every channel sees a touch, by about as much as the others, so that these tell nothing, and whether
    something touches is not to be judged by them.
    """
    read = ~np.isnan(rows)
    counts = np.count_nonzero(read, axis=0)
    highest = np.where(read, rows, -np.inf).max(axis=0, initial=-np.inf)
    span = highest - np.where(read, rows, np.inf).min(axis=0, initial=np.inf)
    raised = np.where(read, rows, 0.0).sum(axis=0) > 10.0 * noise * np.maximum(counts, 1)
    seen = counts > 2
    still = int(np.count_nonzero(seen & (span < _STILL * noise)))
    moving = np.count_nonzero(seen & raised & (span > 10.0 * _STILL * noise))
    enough = max(_MOVING[0], _MOVING[1] * rows.shape[1])
    return still if moving >= enough and still > np.count_nonzero(seen) / 2 else 0


def last_of_each(voltages, grounded) -> tuple[np.ndarray, np.ndarray]:
    """Of rows that ground the same electrode the last one, in the order of rows."""
    voltages, grounded = np.asarray(voltages), np.asarray(grounded)
    if voltages.ndim != 2 or grounded.shape != (len(voltages),):
        return voltages, grounded  # whoever reads them says what is wrong
    _, last = np.unique(grounded[::-1], return_index=True)
    kept = np.sort(len(grounded) - 1 - last)
    return (voltages, grounded) if len(kept) == len(grounded) else (voltages[kept], grounded[kept])


def ordered_row(layout: Layout, voltages, grounded: int) -> np.ndarray:
    """(E,) float64 readings of one row, V; NaN where nothing valid was read. As `ordered`, for who
    has no time for a frame of it."""
    row = np.array(voltages, float) if np.asarray(voltages).dtype.kind in "fiu" else None
    if row is None or row.shape != (layout.electrodes,) or not 0 <= grounded < len(row):
        return ordered(layout, np.atleast_2d(voltages), np.atleast_1d(grounded))[grounded]
    row[grounded] = np.nan
    row[np.abs(row) > LARGEST_VOLTAGE] = np.nan
    return row


def check_drive_voltage(value, noise: float) -> float:
    """The drive voltage, V, positive, finite, and so much that readings with `noise`, V rms, can tell
    something."""
    value = checks.positive(value, "drive_voltage", "voltage in V")
    if not 1e-6 <= value <= LARGEST_VOLTAGE:
        raise InputError(f"drive_voltage: {value:g} V is not from 1e-06 V to {LARGEST_VOLTAGE:g} V")
    if noise > MOST_NOISE * value:
        raise InputError(
            f"noise: {noise:g} V is not from 0 V to {MOST_NOISE * value:g} V, "
            f"{100 * MOST_NOISE:g} % of the drive voltage {value:g} V: readings could not tell a touch"
        )
    return value


def above_drive(voltages, drive_voltage: float) -> str:
    """That readings (L, E), V, of several channels are above the drive voltage, V, as none on a sheet is; empty
    where they are not."""
    highest = np.nanmax(np.asarray(voltages, float), axis=0, initial=-np.inf)
    if np.count_nonzero(highest > _ABOVE * drive_voltage) < 2:
        return ""
    far = highest.max() > _FAR_ABOVE * drive_voltage
    return (
        f"readings up to {highest.max():.4g} V are above the drive voltage {drive_voltage:g} V: "
        + (
            "are they in mV, or counts of a converter (protocol)?"
            if far
            else "is that the right one?"
        )
    )


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
