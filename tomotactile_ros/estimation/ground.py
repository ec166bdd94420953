"""Whether readings show that an electrode is grounded at all.

Where they do not, the electronics are broken; a contact with an absurd force would explain them.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

NO_GROUND = (
    "the readings do not depend on which electrode is grounded: the converter stands still, inputs are "
    "open, nothing is grounded, or what presses drives the whole sheet to the drive voltage"
)
_LEAST_READINGS = 8  # valid ones, below which symmetry may make all readings the same
# mean of readings below which nothing is said of what they depend on: of the drive voltage, of noise
_PRESSED, _CLEAR = 0.01, 20.0
# of the mean reading: what the grounded electrode changes at least; and what noise may hide of it,
# half of what the widest contact leaves, times what is missing to the drive voltage
_CHANGES, _HIDDEN = 0.005, 0.2
_NOISES = 3.0


def no_ground_is_seen(rows: np.ndarray, drive_voltage: float, noise: float) -> bool:
    """Whether readings say nothing of which electrode was grounded, though something drives them.

    A grounded electrode lowers what is read beside it: also under a contact that covers the whole
    sheet the readings of a channel differ from row to row, by 48 % of their mean under a weak one,
    15 % where the mean is 79 % of the drive voltage, 3 % where it is 98 %, and by nothing
    only where everything is at the drive voltage. Those of a converter that stands still, of open
    inputs or of a switch that grounds nothing do not, and a contact with an absurd force would
    explain them.

    Parameters
    ----------
    rows : (L, E) V, NaN where there is no reading
    drive_voltage : V
    noise : of a reading, V rms
    """
    valid = ~np.isnan(rows)
    number = np.count_nonzero(valid)
    if number < _LEAST_READINGS:
        return False
    filled = np.where(valid, rows, 0.0)
    mean = filled.sum() / number
    if mean < max(_PRESSED * drive_voltage, _CLEAR * noise):
        return False
    usual = mean
    if len(rows) > 2:  # of fewer rows only whether all readings are the same
        usual = filled.sum(axis=0) / np.maximum(np.count_nonzero(valid, axis=0), 1)
    changes = np.sqrt((np.where(valid, rows - usual, 0.0) ** 2).sum() / number)
    hidden = _HIDDEN * max(1.0 - mean / drive_voltage, 0.0) * mean
    return bool(changes < max(_CHANGES * mean, min(_NOISES * noise, hidden)))


@dataclass
class GroundWatch:
    """The same of rows that come one by one: at once where all readings of a row are the same, after
    as many rows as there are electrodes where those of each channel are."""

    unseen: bool = False
    _rows: list[np.ndarray] = field(default_factory=list)
    _block: bool = False

    def take(self, row: np.ndarray, drive_voltage: float, noise: float) -> None:
        """Take in a row (E,), V, NaN where there is no reading; arguments as above."""
        self._rows.append(row)
        if len(self._rows) >= len(row):
            self._block = no_ground_is_seen(np.array(self._rows), drive_voltage, noise)
            self._rows = []
        self.unseen = self._block or no_ground_is_seen(row[None], drive_voltage, noise)
