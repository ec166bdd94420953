"""What a device says of its frames and cannot be so, though every packet is whole.

Times and numbers are checked against one another and against the agreed rate. A row whose time is
impossible is refused: it would move the stamps. For the rest there is a trouble, with its level.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.devices.assembly import RowsOfFrame
from tomotactile_ros.devices.health import Recent, Trouble
from tomotactile_ros.support.checks import plain

FRAMES, MORE = 3.0, 1.0  # a row ends within so many frames and so many s behind its frame's begin
OFTEN = 0.1  # of the frames
VARIES = 0.1  # of the drive voltage: readings are brought to one, which lifts offsets with them
TOO_OFTEN = 5  # beginnings anew within 10 s


class Doubts:
    """Looks at rows and frames of one device; its troubles are those of the last 10 s."""

    def __init__(self) -> None:
        self._recent = Recent()
        self._delay = 0.0  # s, of the last of those
        self._rates = (1.0, 1.0)
        self._last: RowsOfFrame | None = None

    def begin(self, again: bool) -> None:
        """The device has told who it is, for the first time or `again`."""
        self._last = None
        self._recent.add(anew=again)

    def waited(self, seconds: float) -> None:
        """Rows have waited so long on the line, and their times did not tell."""
        self._delay = seconds
        self._recent.add(waited=1)

    def rate_is(self, rate: float) -> None:
        """The device has told its rate, frames/s; a frame of the one before may be under way."""
        if rate != self._rates[1]:
            self._rates = self._rates[1], rate

    def may_end(self, row_end: int) -> bool:
        """Whether a row can end so many µs behind its frame's begin."""
        return 1e-6 * row_end <= FRAMES / min(self._rates) + MORE

    def frame(self, rows: RowsOfFrame, jumped: bool) -> None:
        """Take in a frame; `jumped`: the device's clock has."""
        last, self._last = self._last, rows
        timeless = rows.row_period == 0 and len(rows.grounded) > 1
        stands = False
        if last is not None and rows.frame_time > last.frame_time and not jumped:
            stands = not 0 < (rows.sequence - last.sequence) & 0xFFFFFFFF < 1 << 31
        varies = rows.drive_span > VARIES * rows.drive_voltage
        mistaken = rows_are_mistaken(rows.voltages, rows.grounded)
        self._recent.add(
            frames=1,
            stands=stands,
            timeless=timeless,
            mistaken=mistaken,
            anew=jumped,
            varies=varies,
        )

    def troubles(self) -> list[Trouble]:
        """What is to be said."""
        recent = self._recent.sums()
        often, found = OFTEN * recent["frames"], []
        if stands := recent["stands"]:
            text = f"{stands:.0f} frames have no higher number than the one before, but a later time: the device counts wrong"
            found.append(Trouble("sequence", stands > often, text))
        if recent["timeless"] > often:
            text = "the device tells no times of rows: stamps are late by up to a frame"
            found.append(Trouble("times", False, text))
        if recent["mistaken"] > often:
            text = (
                "in each row the reading that is missing is not that of the electrode called grounded: the "
                "device numbers rows or grounded electrodes wrong"
            )
            found.append(Trouble("rows", True, text))
        if recent["varies"] > often:
            text = (
                f"the drive voltage changes by more than {100 * VARIES:.0f} % within frames: the device's "
                "supply sags, or what it tells of it is wrong"
            )
            found.append(Trouble("drive", False, text))
        if anew := recent["anew"]:
            text = f"the device restarted or the line was interrupted {anew:.0f} times within 10 s"
            found.append(Trouble("anew", anew >= TOO_OFTEN, text))
        if recent["waited"]:
            text = (
                f"frames had waited {plain(self._delay, 2)} s on the line, unseen by their times, and were thrown "
                "away: the line is a little slower than the sensor (lower its rate), or its clock is fast"
            )
            found.append(Trouble("delay", False, text))
        return found


def rows_are_mistaken(voltages: np.ndarray, grounded: np.ndarray) -> bool:
    """Whether each row (L, E) lacks one reading beside the grounded electrode's, each another one.

    A device that does not read the grounded electrode (version 1) shows thereby which one it is.
    """
    number = len(grounded)
    lacking = np.isnan(voltages)
    if number < 3 or np.count_nonzero(lacking) != 2 * number:
        return False
    lacking[np.arange(number), grounded] = False
    return bool((lacking.sum(axis=1) == 1).all() and (lacking.sum(axis=0) <= 1).all())
