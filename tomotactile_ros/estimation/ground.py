"""Whether readings show that an electrode is grounded at all, and nothing else that lifts whole rows.

Where they do not, the electronics are broken or disturbed; a contact with an absurd force, or in a
wrong place, would explain them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import lru_cache

import numpy as np

NO_GROUND = (
    "the readings do not depend on which electrode is grounded: the converter stands still, inputs are "
    "open, nothing is grounded, or what presses drives the whole sheet to the drive voltage"
)
ALIKE = (
    "the readings of a row are nearly the same, and differ from row to row whatever is grounded: "
    "something disturbs all of them (hum, the supply), or nothing is grounded"
)
DISTURBED = (
    "rows differ as only negative resistances to ground could make them: something disturbs all "
    "readings of a row (hum, the supply)"
)
OR_MANY = ", or more things touch than can be told apart"
UNLIKE = (
    "rows agree with each other, but no contacts explain them on a sheet like that of the layout: is it torn, or cut "
    "otherwise (`tomotactile learn` finds out), or do more things touch it than can be told apart?"
)
OR_HUM = " Something that disturbs all readings of a row alike (hum, the supply) looks the same."
_LEAST_READINGS = 8  # valid ones, below which symmetry may make all readings the same
# mean of readings below which nothing is said of what they depend on: of the drive voltage, of noise
_PRESSED, _CLEAR = 0.01, 20.0
# of the mean reading: what the grounded electrode changes at least; and what noise may hide of it,
# half of what the widest contact leaves, times what is missing to the drive voltage
_CHANGES, _HIDDEN = 0.005, 0.2
_NOISES = 3.0  # noises: what noise may hide
# What the nearest electrodes read less than the others, in parts of how rows differ: 0.38 and more
# under one or two contacts on the sheets of config/layouts, 0.2 on 3 x 3 electrodes. It is to be
# known to a twentieth.
_LOWERED, _KNOWN_TO = 0.1, 0.05
_NEAREST = 4  # electrodes that are beside the grounded one
_UNDER_ONE = 2  # electrodes, grounded in turn, that one conductor may lie on
_ROUNDS = 8  # of taking means off, where some readings are missing
_PLAIN = 10.0  # times the noise: rows that differ by more are judged before anything is fitted
_FEWEST = 12  # electrodes: of fewer, too many are near each other


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
    read = rows[valid]
    if len(read) < _LEAST_READINGS:
        return False
    mean = float(np.add.reduce(read)) / len(read)
    if mean < max(_PRESSED * drive_voltage, _CLEAR * noise):
        return False
    away = read - mean
    if len(rows) > 2:  # of fewer rows only whether all readings are the same
        sums = np.where(valid, rows, 0.0).sum(axis=0)
        away = (rows - sums / np.maximum(np.count_nonzero(valid, axis=0), 1))[valid]
    changes = math.sqrt(float(away @ away) / len(read))
    hidden = _HIDDEN * max(1.0 - mean / drive_voltage, 0.0) * mean
    return bool(changes < max(_CHANGES * mean, min(_NOISES * noise, hidden)))


def rows_are_alike(
    rows: np.ndarray, grounded: np.ndarray, places: np.ndarray, noise: float
) -> bool:
    """Whether rows differ by something common to all their readings, whatever was grounded.

    In readings v_ln the mean of all, that of row l and that of channel n are taken off. What is left
    shows the grounded electrode, -i Z_ln for a current i: those beside it read less. Rows that a
    contact makes differ show it; rows that a disturbance of all channels makes differ do not.

    Parameters
    ----------
    rows : (L, n) V, NaN where there is no reading
    grounded : (L, 2) where the grounded electrode of each row is, m
    places : (n, 2) where the electrodes of the channels are, m
    noise : V rms, of a reading; rows that differ by less are not judged
    """
    valid = ~np.isnan(rows)
    number = np.count_nonzero(valid)
    if len(places) < _FEWEST or number < rows.size / 2 or len(rows) < len(places):
        return False
    of_rows, left = _without_means(np.where(valid, rows, 0.0), valid)
    seen = valid.any(axis=1)
    differ = float(np.std(of_rows[seen]))
    lifted = np.abs(of_rows[seen])
    # a few rows alone, as of a touch that has just begun, may all lie near a contact
    few = lifted.sum() ** 2 < 0.5 * len(lifted) * (lifted**2).sum()
    if differ < noise or few:
        return False
    near, far = (valid & each for each in _near_and_far(grounded.tobytes(), places.tobytes()))
    counts = max(int(np.count_nonzero(near)), 1), max(int(np.count_nonzero(far)), 1)
    lowered = left[far].sum() / counts[1] - left[near].sum() / counts[0]
    scatter = np.sqrt((left**2).sum() / number * (1 / counts[0] + 1 / counts[1]))
    return bool(scatter < _KNOWN_TO * differ and lowered < _LOWERED * differ)


@lru_cache(maxsize=8)
def _near_and_far(grounded: bytes, places: bytes) -> tuple[np.ndarray, np.ndarray]:
    """(L, n) each: which of `places` (n, 2) are the nearest to those of the electrodes `grounded` (L, 2),
    and which of the others are not the same; both as bytes of float64."""
    at, to = (np.frombuffer(each).reshape(-1, 2).T for each in (grounded, places))
    apart = np.hypot(*(np.subtract.outer(a, b) for a, b in zip(at, to)))
    apart[apart == 0] = np.inf
    near = apart <= 1.001 * np.partition(apart, _NEAREST - 1)[:, [_NEAREST - 1]]
    return near, ~near & np.isfinite(apart)


def _without_means(rows: np.ndarray, valid: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(L,) part of each row, and (L, n) rows without it and without that of each channel."""
    read = valid.astype(float)
    in_row, in_channel = (np.maximum(read.sum(axis=axis), 1) for axis in (1, 0))
    by_row, by_channel = (np.where(valid, rows, 0.0).sum(axis=axis) for axis in (1, 0))
    of_rows, of_channels = np.zeros(len(rows)), np.zeros(rows.shape[1])
    for _ in range(_ROUNDS):
        of_rows = (by_row - read @ of_channels) / in_row
        of_channels = (by_channel - of_rows @ read) / in_channel
    return of_rows, np.where(valid, rows - of_rows[:, None] - of_channels, 0.0)


def ground_is_doubtful(
    rows: np.ndarray, grounded: np.ndarray, places: np.ndarray, drive_voltage: float, noise: float
) -> str:
    """Why a frame plainly does not show what was grounded; empty where it does, and where rows differ
    by so little that it matters only to contacts that are found there. Arguments as above."""
    if no_ground_is_seen(rows, drive_voltage, noise):
        return NO_GROUND
    return ALIKE if rows_are_alike(rows, grounded, places, _PLAIN * noise) else ""


@dataclass
class GroundWatch:
    """The same of rows that come one by one: where all readings of a few in turn are the same, after as many
    rows as there are electrodes where those of each channel are, or those of each row.

    doubt : why nothing is to be told of these rows; empty where something is
    unseen : rows in turn up to the last whose readings are all the same: a conductor on the electrode that is
        grounded keeps the sheet at its voltage
    alike : whether contacts are not to be told, by `rows_are_alike`
    """

    doubt: str = ""
    unseen: int = 0
    alike: bool = False
    _rows: list[np.ndarray] = field(default_factory=list)
    _grounded: list[np.ndarray] = field(default_factory=list)
    _block: str = ""

    def take(
        self,
        row: np.ndarray,
        grounded: np.ndarray,
        places: np.ndarray,
        drive_voltage: float,
        noise: float,
    ) -> None:
        """Take in a row (n,), V, NaN where there is no reading, its electrode grounded at (2,);
        the rest as above."""
        self._rows.append(row)
        self._grounded.append(grounded)
        if len(self._rows) >= len(row):
            rows, at = np.array(self._rows), np.array(self._grounded)
            self._block = ground_is_doubtful(rows, at, places, drive_voltage, noise)
            self.alike = rows_are_alike(rows, at, places, noise)
            self._rows, self._grounded = [], []
        unseen = no_ground_is_seen(row[None], drive_voltage, noise)
        self.unseen = self.unseen + 1 if unseen else 0
        self.doubt = self._block or (NO_GROUND if self.unseen > _UNDER_ONE else "")
