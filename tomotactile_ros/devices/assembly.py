"""Joins the rows of the wire protocol to frames; decides what is whole, lost, repeated or late.

Rows belong together when count, rows, sequence and frame_time agree (docs/protocol.md, section
3).  Nothing else is ever joined, so that lost packets, restarts and repetitions can cost frames but
never make a wrong one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomotactile_ros.devices.protocol import NO_READING, Row, unpack_counts

_RECENT = 16
_BLOCK = 16  # rows converted at a time: one by one costs more, all at the end takes longer then


@dataclass(frozen=True, eq=False)
class RowsOfFrame:
    """A frame in device time; `frame_time` and `last_sample` in µs, voltages (L, E) in V.

    `row_period` (µs) is the median time from the end of one row to the end of the next, so that a
    row that was late or a counter that slipped does not move it; 0 where no row tells.
    """

    voltages: np.ndarray
    grounded: np.ndarray
    sequence: int
    frame_time: int
    last_sample: int
    drive_voltage: float
    missing: int
    row_period: float


@dataclass
class AssemblyCounters:
    """What was lost on the way to frames."""

    packets_lost: int = 0
    frames_incomplete: int = 0
    frames_lost: int = 0
    rows_ignored: int = 0


class FrameAssembler:
    """Collects the rows of one frame at a time.

    Parameters
    ----------
    electrodes, rows : int
        Shape of the frames; rows of another shape are ignored.
    partial : bool
        Whether incomplete frames are returned too, with NaN in the missing rows.
    counters : AssemblyCounters
        Where to count on, for a device that was connected before.
    """

    def __init__(
        self,
        electrodes: int,
        rows: int,
        partial: bool = False,
        counters: AssemblyCounters | None = None,
    ) -> None:
        self.counters = counters or AssemblyCounters()
        self._shape = (rows, electrodes)
        self._partial = partial
        self._grounded = np.full(rows, -1)
        self._key: tuple[int, int] | None = None
        self._finished: tuple[int, int] | None = None

    def feed(self, row: Row) -> list[RowsOfFrame]:
        """Take in one row; return the frames that it finishes: none, one or (partial) two."""
        key = (row.sequence, row.frame_time)
        if (row.rows, row.count) != self._shape or self._is_old(key):
            self.counters.rows_ignored += 1
            return []
        done = [] if key == self._key else self._next(key)
        if self._received[row.row] or self._contradicts(row):
            self.counters.rows_ignored += 1
            return done
        self._received[row.row] = True
        self._grounded[row.row] = row.grounded
        self._block.append(row)
        self._missing -= 1
        if self._missing == 0:
            done.append(self._frame())
            self._finish()
        elif len(self._block) == _BLOCK:
            self._convert()
        return done

    def _contradicts(self, row: Row) -> bool:
        """Whether another row grounds this electrode, or this row another one in other frames."""
        known = self._grounded[row.row]
        return known != row.grounded and (known >= 0 or row.grounded in self._grounded)

    def abandon(self) -> None:
        """Forget the frame under way: the device has stopped, which is no loss."""
        if self._key is not None:
            self._finish()

    def _is_old(self, key: tuple[int, int]) -> bool:
        last = self._key or self._finished
        if last is None or key == self._key:
            return False
        behind = (last[0] - key[0]) & 0xFFFFFFFF
        return key == self._finished or (behind <= _RECENT and key[1] <= last[1])

    def _next(self, key: tuple[int, int]) -> list[RowsOfFrame]:
        done = []
        if self._key is not None:
            self.counters.frames_incomplete += 1
            self.counters.packets_lost += self._missing
            if self._partial and (self._grounded >= 0).all():
                done.append(self._frame())
            self._finish()
        if self._finished is not None:
            gap = (key[0] - self._finished[0] - 1) & 0xFFFFFFFF
            if gap < 1 << 16:
                self.counters.frames_lost += gap
                self.counters.packets_lost += gap * self._shape[0]
        self._begin(key)
        return done

    def _begin(self, key: tuple[int, int]) -> None:
        self._key = key
        self._voltages = np.full(self._shape, np.nan, dtype=np.float32)
        self._received = [False] * self._shape[0]
        self._missing = self._shape[0]
        self._block: list[Row] = []
        self._ends = np.full(self._shape[0], -1)
        self._drive_voltage = 0.0

    def _convert(self) -> None:
        """Make voltages of the rows that wait; few are left to do when the last one comes."""
        rows, self._block = self._block, []
        counts = unpack_counts(b"".join(row.readings for row in rows)).reshape(len(rows), -1)
        voltages = counts * np.array([row.scale for row in rows], dtype=np.float32)[:, None]
        voltages[counts == NO_READING] = np.nan
        voltages[np.arange(len(rows)), [row.grounded for row in rows]] = np.nan
        self._voltages[[row.row for row in rows]] = voltages
        self._ends[[row.row for row in rows]] = [row.row_end for row in rows]
        self._drive_voltage = rows[-1].drive_voltage

    def _finish(self) -> None:
        self._finished, self._key = self._key, None

    def _frame(self) -> RowsOfFrame:
        if self._block:
            self._convert()
        sequence, frame_time = self._key
        return RowsOfFrame(
            self._voltages,
            self._grounded.astype(np.uint16),
            sequence,
            frame_time,
            frame_time + int(self._ends.max()),
            self._drive_voltage,
            self._missing,
            row_period(self._ends),
        )


def row_period(ends: np.ndarray) -> float:
    """Median distance of the ends (L,) of rows, -1 for missing ones; the first begins at 0."""
    known = np.flatnonzero(ends >= 0)
    distances = np.diff(ends[known], prepend=0) / np.diff(known, prepend=-1)
    return max(0.0, float(np.median(distances)))
