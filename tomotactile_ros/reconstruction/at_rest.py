"""The readings of a sensor while nothing touches it, or why frames do not show them.

A tare is taken off all that follows, and a contact in it with it: nothing would be seen of what
presses on, and of later contacts something false. The readings themselves tell the two apart. At
rest they are offsets of channels, hundredths of a volt; a contact that has the drive voltage lifts
all electrodes that float, 8 mN on a sheet of 10 kOhm a median of 0.02 V, 0.1 N one of 0.2 V.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomotactile_ros.support.errors import InputError

ASKED, REFUSED = 0.01, 0.1  # of the drive voltage: median readings that look like a load
MOVED = 0.01  # of the drive voltage: so far may a frame's mean reading go from the others


@dataclass(frozen=True)
class Rest:
    """Frames at rest.

    mean : (L, E) V, NaN where nothing valid was read
    median : of its readings, without their signs, V
    noise : rms of the readings around it, V
    doubt : why they may not be at rest after all; empty if they look like it
    """

    mean: np.ndarray
    median: float
    noise: float
    doubt: str


def at_rest(frames, drive_voltage: float) -> Rest:
    """The mean of frames that nothing touches.

    Parameters
    ----------
    frames : (N, L, E) V, the same rows in each; NaN where there is no valid reading
    drive_voltage : V

    Raises InputError where nothing valid was read, something moves or something presses.
    """
    stack = np.asarray(frames, float)
    valid = np.isfinite(stack)
    counts = np.count_nonzero(valid, axis=0)
    if not counts.any():
        raise InputError("no valid reading")
    mean = np.where(valid, stack, 0.0).sum(axis=0) / np.maximum(counts, 1)
    left = np.where(valid, stack - mean, 0.0)
    moved = np.abs(left.sum(axis=(1, 2)) / np.maximum(np.count_nonzero(valid, axis=(1, 2)), 1))
    if moved.max() > MOVED * drive_voltage:
        raise InputError(
            f"readings change by {moved.max():.3f} V on average: something moves "
            "on the sheet; take your hands off and tare again"
        )
    mean[counts == 0] = np.nan
    median = float(np.nanmedian(np.abs(mean)))
    if median > REFUSED * drive_voltage:
        raise InputError(
            f"median reading {median:.3f} V: something presses on the sheet; "
            "take it off and tare again"
        )
    doubt = ""
    if median > ASKED * drive_voltage:
        doubt = (
            f"{median:.3f} V is much for a sheet that nothing touches: whatever "
            "presses on it now is subtracted from all that follows"
        )
    noise = np.sqrt((left**2).sum() / max(valid.sum() - np.count_nonzero(counts), 1))
    return Rest(mean, median, float(noise), doubt)
