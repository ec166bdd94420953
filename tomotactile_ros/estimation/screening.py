"""Channels that no model explains: nothing read, a reading that never changes, a switch that never
closes.

Only what a row or a column shows by itself is judged here; what contradicts the others shows in the
misfit of the fit.
"""

from __future__ import annotations

import numpy as np

# why channels are left out
STUCK, OPEN = "its reading never changes", "it is never grounded: its switch or wire is open"
_STUCK = 6.0  # standard deviations of the noise that a stuck channel spans at the most
_ALIVE = 10.0  # times as much spans a channel that sees a touch
# of the channels in use: with more that give no readings or never change the frame is withheld:
# electrodes lie too far apart. Of 20 frames of two contacts on 8 x 8, 2 had one more than 10 mm off
# with 14 channels left, 3 with 12, 5 with 10, 7 with 8
_MOST_BAD = 0.5
# channels: with fewer left, also with exactly half that tell nothing: of 20 frames of two contacts
# on 4 x 4, 3 had one more than 10 mm off with 8 channels left
_ENOUGH = 9
# V: a channel that reads more than that, always the same, while nothing drives the others is stuck:
# offsets are a few mV
_RAISED = 0.02
# of the drive voltage: mean reading of an electrode under a conductor, whose channel has a gain; and the median of
# all: a conductor on an electrode drives the others but for the one that is grounded, and half way between two
# electrodes is half the voltage
AT_DRIVE, _ALL_RAISED = 0.9, 0.25
_REPEATED = 8  # readings of one and the same highest value that only an end of the range gives
_ABOVE = 3.0  # times as many as have the value below
# of the drive voltage: how far below it the highest code of a converter of 6 to 14 bits is that has it as
# its reference, and how exactly; a float32 tells the codes of more bits no better from their neighbours
_TOP_CODES, _SAME_CODE = 0.5 ** np.arange(6, 15), 2e-3
# of the largest share of the drive voltage that is typically left at an electrode in a row
_OPEN = 0.25


def dead_channels(valid: np.ndarray) -> np.ndarray:
    """(E,) channels with less than half of their readings; valid (L, E), the grounded electrode's
    own entries counted as read."""
    return np.count_nonzero(valid, axis=0) < len(valid) / 2


def stuck_channels(readings: np.ndarray, valid: np.ndarray, noise: float) -> np.ndarray:
    """(E,) channels whose readings (L, E), V, stay the same while most others change, or far from 0
    while nothing drives the others: contacts raise the readings of all electrodes."""
    if len(readings) < 4:
        return np.zeros(readings.shape[1], bool)
    low, high = _range(readings, valid)
    span, level = high - low, np.abs(high + low) / 2
    changing, still = np.median(span) > _ALIVE * _STUCK * noise, span < _STUCK * noise
    idle = np.median(level) < _ALIVE * noise
    stuck = still & idle & (level > max(_RAISED, _ALIVE * noise))
    for n in np.flatnonzero(still & ~stuck) if changing else ():
        # in the rows in which it was read itself: a touch may begin in another
        low, high = _range(readings[valid[:, n]], valid[valid[:, n]])
        stuck[n] = np.median(high - low) > _ALIVE * _STUCK * noise
    return stuck


def driven_channels(readings: np.ndarray, valid: np.ndarray, drive_voltage: float) -> np.ndarray:
    """(E,) channels that read what electrodes under a conductor do, which is at the drive voltage, V; their
    wires may be broken there."""
    level = np.where(valid, readings, 0.0).sum(axis=0) / np.maximum(valid.sum(axis=0), 1)
    raised = bool(np.median(level) > _ALL_RAISED * drive_voltage)
    return (level > AT_DRIVE * drive_voltage) & raised


def _range(readings: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(E,) lowest and highest of readings (L, E), V; 0 where there are none."""
    read = valid.any(axis=0)
    low = np.where(valid, readings, np.inf).min(axis=0, initial=np.inf)
    high = np.where(valid, readings, -np.inf).max(axis=0, initial=-np.inf)
    return np.where(read, low, 0.0), np.where(read, high, 0.0)


def too_many_are_bad(bad: int, of: int) -> str:
    """Why nothing is told where `bad` channels `of` those in use tell nothing; empty where enough are
    left."""
    if bad < _MOST_BAD * of or (bad == _MOST_BAD * of and of - bad >= _ENOUGH):
        return ""
    return (
        f"{bad} of {of} channels give no readings or never change (wires, connectors, multiplexers?): the "
        "others alone cannot tell contacts from each other"
    )


def without_channels(rows: np.ndarray, grounded: np.ndarray, bad: np.ndarray) -> np.ndarray:
    """Rows (L, E), V, with electrodes `grounded` (L,) as if the channels `bad` (E,) bool were not there:
    NaN, not read."""
    out = np.array(rows, float)
    out[:, bad] = np.nan
    out[bad[grounded]] = np.nan
    return out


def open_grounds(left: np.ndarray, valid: np.ndarray, noise: float) -> np.ndarray:
    """(L,) rows in which nothing seems to be grounded: all electrodes are at the drive voltage.

    left (L, E) drive voltage minus reading, in parts of the drive voltage, as `noise` is.
    """
    counts = np.maximum(np.count_nonzero(valid, axis=1), 1)
    largest = np.where(valid, left, 0.0).max(axis=1)
    typical = np.median(largest)
    touched = np.median(np.where(valid, left, 0.0).sum(axis=1) / counts) < 1 - _ALIVE * noise
    read = valid.any(axis=1)  # of a row without a reading nothing is known
    return read & (largest < _OPEN * typical) & touched & (largest < _ALIVE * noise)


def latest_state(left: np.ndarray, valid: np.ndarray, noise: float) -> int:
    """Number of the first row from which on the sheet is touched all the time, or untouched all the
    time.

    left (L, E) drive voltage minus reading, in parts of the drive voltage, as `noise` is.
        Untouched, nothing drives the
    sheet, and all that is read is offsets.
    """
    counts = np.maximum(np.count_nonzero(valid, axis=1), 1)
    mean = np.where(valid, np.abs(1 - left), 0.0).sum(axis=1) / counts
    touched = mean > _ALIVE * noise
    changes = np.flatnonzero(touched[1:] != touched[:-1])
    return int(changes[-1]) + 1 if len(changes) else 0


def clipped(voltages: np.ndarray, drive_voltage: float) -> np.ndarray:
    """Which of the voltages (..., L, E), V, are at an end of the converter's range.

    The lower end is 0 V where nothing is negative. The upper one is the highest value if it is far
    more frequent than the next one, as noise would spread it, or the highest code of a converter whose
    reference is the drive voltage.
    """
    valid = voltages[np.isfinite(voltages)]
    out = np.zeros(voltages.shape, bool)
    if not valid.size:
        return out
    out |= at_lowest(voltages)
    highest = valid.max()
    ended = is_top_code(highest, drive_voltage) or is_end(valid, highest)
    if valid.min() < highest and highest > 0 and ended:
        out |= voltages == highest
    return out


def at_lowest(voltages: np.ndarray) -> np.ndarray:
    """Which of the voltages (..., L, E), V, are 0 V, where that is the lower end of the converter's range."""
    return (voltages == 0.0) & bool(np.nanmin(voltages, initial=np.inf) == 0.0)


def is_top_code(reading: float, drive_voltage: float) -> bool:
    """Whether a reading, V, is the highest that a converter gives whose reference is the drive voltage: one
    alone tells, which no other readings of a frame do."""
    below = 1 - reading / drive_voltage
    return bool(np.abs(below / _TOP_CODES - 1).min() < _SAME_CODE)


def is_end(readings: np.ndarray, highest: float) -> bool:
    """Whether the highest of some readings, V, is that of the converter."""
    count = np.count_nonzero(readings == highest)
    if count < _REPEATED:
        return False
    lower = readings[readings < highest]
    below = np.count_nonzero(lower == lower.max()) if lower.size else 0
    return bool(count >= _ABOVE * below)
