"""Joins the rows of the wire protocol to frames; decides what is whole, lost, repeated or late.

Rows belong together when count, rows, sequence, frame_time and scan agree (docs/protocol.md,
sections 3 and 4).  Nothing else is ever joined, so that lost packets, restarts and repetitions can
cost frames but never make a wrong one.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tomotactile_ros.devices.protocol import NO_READING, OWN_ORDER, Row, unpack_counts

_RECENT = 16
_ORDERS = 64  # commanded orders that are remembered
_HIGHEST = 1e30  # V, of readings that were brought to another drive voltage
_BLOCK = 16  # rows converted at a time: one by one costs more, all at the end takes longer then


@dataclass(frozen=True, eq=False)
class RowsOfFrame:
    """A frame, or rows of one, in device time; begin and last sample in µs, voltages (L, E) in V.

    `frame_time` is when the first of the rows began. `row_period` (µs) is the median time from the
    end of one row to the end of the next, so that a row that was late or a counter that slipped
    does not move it; 0 where no row tells.  `drive_voltage` is that of the first row, and what was
    read under another one is told in proportion; `drive_span` (V) is from the lowest to the highest.
    """

    voltages: np.ndarray
    grounded: np.ndarray
    sequence: int
    frame_time: int
    last_sample: int
    drive_voltage: float
    row_period: float
    drive_span: float = 0.0


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
        Shape of the frames in the device's own order; rows of another shape are ignored.
    partial : bool
        Whether incomplete frames are returned too, with NaN in the missing rows.
    counters : AssemblyCounters
        Where to count on, for a device that was connected before.

    Attributes
    ----------
    own_rows : int
        As `rows`; may change when the device says so.
    accepted : bool
        Whether the row that was fed last is one of a frame, and not ignored.
    """

    def __init__(
        self,
        electrodes: int,
        rows: int,
        partial: bool = False,
        counters: AssemblyCounters | None = None,
    ) -> None:
        self.counters = counters or AssemblyCounters()
        self.own_rows = rows
        self.accepted = False
        self._electrodes = electrodes
        self._partial = partial
        self._orders: dict[int, np.ndarray] = {}
        self._learned: np.ndarray | None = (
            None  # electrodes that the own order grounds, -1: unknown
        )
        self._key: tuple[int, int, int] | None = None
        self._finished: tuple[int, int, int] | None = None
        self._first: int | None = None

    def expect_order(self, scan: int, order: Sequence[int]) -> None:
        """Rows of this scan ground these electrodes."""
        self._orders[scan] = np.array(order)
        if len(self._orders) > _ORDERS:
            del self._orders[next(iter(self._orders))]

    def expect_first(self, sequence: int) -> None:
        """The stream begins with this frame; those before the first that comes are lost."""
        if self._key is None:
            self._first = sequence

    def feed(self, row: Row) -> list[RowsOfFrame]:
        """Take in one row; return the frames that it finishes: none, one or (partial) two."""
        key = (row.sequence, row.frame_time, row.scan)
        self.accepted = False
        if not self._fits(row) or self._is_old(key):
            self.counters.rows_ignored += 1
            return []
        done = [] if key == self._key else self._next(key)
        if self._received[row.row] or self._contradicts(row):
            self.counters.rows_ignored += 1
            return done
        self.accepted = True
        self._received[row.row] = True
        self._grounded[row.row] = row.grounded
        self._block.append(row)
        self._missing -= 1
        if self._missing == 0:
            done.append(self._frame(key))
            self._finish()
        elif len(self._block) == _BLOCK:
            self._convert()
        return done

    def _fits(self, row: Row) -> bool:
        """Whether count and rows are those of the scan that the row names."""
        if row.scan == OWN_ORDER:
            rows = self.own_rows
        elif row.scan in self._orders:
            rows = len(self._orders[row.scan])
        else:
            return False
        return (row.rows, row.count) == (rows, self._electrodes)

    def _contradicts(self, row: Row) -> bool:
        """Whether the row grounds another electrode than commanded, or than in other frames.

        In a device's own order, no electrode is grounded by two rows, either.
        """
        known = self._grounded[row.row]
        if row.scan != OWN_ORDER:
            return known != row.grounded
        return known != row.grounded and (known >= 0 or row.grounded in self._grounded)

    def abandon(self) -> None:
        """Forget the frame under way: the device has stopped, which is no loss."""
        if self._key is not None:
            self._finish()

    def _is_old(self, key: tuple[int, int, int]) -> bool:
        last = self._key or self._finished
        if last is None or key == self._key:
            return False
        behind = (last[0] - key[0]) & 0xFFFFFFFF
        return key == self._finished or (behind <= _RECENT and key[1] <= last[1])

    def _next(self, key: tuple[int, int, int]) -> list[RowsOfFrame]:
        done = []
        if self._key is not None:
            self.counters.frames_incomplete += 1
            self.counters.packets_lost += self._missing
            if self._partial and (self._grounded >= 0).all():
                done.append(self._frame(self._key))
            self._finish()
        self._begin(key)
        expected = self._first
        if self._finished is not None:
            expected = (self._finished[0] + 1) & 0xFFFFFFFF
        if expected is not None:
            gap = (key[0] - expected) & 0xFFFFFFFF
            if gap < 1 << 16:
                self.counters.frames_lost += gap
                self.counters.packets_lost += gap * len(self._received)
        return done

    def _begin(self, key: tuple[int, int, int]) -> None:
        self._key = key
        if key[2] == OWN_ORDER:
            if self._learned is None or len(self._learned) != self.own_rows:
                self._learned = np.full(self.own_rows, -1)
            self._grounded = self._learned
        else:
            self._grounded = self._orders[key[2]]
        rows = len(self._grounded)
        self._voltages = np.full((rows, self._electrodes), np.nan, dtype=np.float32)
        self._received = [False] * rows
        self._missing = rows
        self._block: list[Row] = []
        self._ends = np.full(rows, -1)
        self._drives: list[float] = []

    def _convert(self) -> None:
        """Make voltages of the rows that wait; few are left to do when the last one comes."""
        rows, self._block = self._block, []
        places = [row.row for row in rows]
        self._drives += [row.drive_voltage for row in rows]
        self._voltages[places] = voltages_of(rows, self._drives[0])
        self._ends[places] = [row.row_end for row in rows]

    def _finish(self) -> None:
        self._finished, self._key = self._key, None

    def _frame(self, key: tuple[int, int, int]) -> RowsOfFrame:
        if self._block:
            self._convert()
        sequence, frame_time, _ = key
        return RowsOfFrame(
            self._voltages,
            self._grounded.astype(np.uint16),
            sequence,
            frame_time,
            frame_time + int(self._ends.max()),
            self._drives[0],
            row_period(self._ends),
            max(self._drives) - min(self._drives),
        )


class RunAssembler:
    """Collects runs of at most `length` rows that follow one another within a frame.

    A run ends early with its frame, and before a row that does not follow: each of its rows was
    taken one row period behind the one before.
    """

    def __init__(self, length: int) -> None:
        self._length = length
        self._run: list[Row] = []
        self._begin = 0  # of the run, µs after frame_time
        self._last: Row | None = None
        self._period = 0  # of the last row, µs

    def feed(self, row: Row) -> list[RowsOfFrame]:
        """Take in a row that the frame's assembler accepted; return runs that are finished."""
        done = []
        last = self._last if self._last and self._follows(self._last, row) else None
        if self._run and last is None:
            done.append(self._finish())
        if not self._run:
            begin = last.row_end if last else row.row_end - self._period
            self._begin = max(0, begin) if row.row else 0
        before = self._run[-1].row_end if self._run else self._begin
        self._period = max(0, row.row_end - before)
        self._run.append(row)
        self._last = row
        if len(self._run) == self._length or row.row == row.rows - 1:
            done.append(self._finish())
        return done

    @staticmethod
    def _follows(last: Row, row: Row) -> bool:
        before = last.sequence, last.frame_time, last.scan, last.row + 1
        return before == (row.sequence, row.frame_time, row.scan, row.row)

    def _finish(self) -> RowsOfFrame:
        rows, self._run = self._run, []
        ends = np.array([row.row_end for row in rows])
        last, drive_voltage = rows[-1], rows[0].drive_voltage
        return RowsOfFrame(
            voltages_of(rows, drive_voltage),
            np.array([row.grounded for row in rows], np.uint16),
            last.sequence,
            last.frame_time + self._begin,
            last.frame_time + int(ends.max()),
            drive_voltage,
            row_period(np.maximum(ends - self._begin, 0)),
        )


def voltages_of(rows: Sequence[Row], drive_voltage: float) -> np.ndarray:
    """(L, E) float32 voltages of rows of one scan under one drive voltage, V; NaN: no valid reading.

    All that is read is proportional to what drives the sheet, and a supply may sag from row to row.
    Version 1 has no reading of the grounded electrode itself, whatever stands in its place.
    """
    counts = unpack_counts(b"".join(row.readings for row in rows)).reshape(len(rows), -1)
    scales = np.array([row.scale for row in rows], dtype=np.float32)[:, None]
    if any(row.zero for row in rows):
        zeros = np.array([row.zero for row in rows], dtype=np.float32)[:, None]
        voltages = (counts - zeros) * scales
    else:
        voltages = counts * scales
    drives = np.array([row.drive_voltage for row in rows])[:, None]
    if drive_voltage > 0 and (drives != drive_voltage).any():
        factors = np.divide(drive_voltage, drives, out=np.ones_like(drives), where=drives > 0)
        brought = voltages * factors
        brought[np.abs(brought) > _HIGHEST] = np.nan
        voltages = brought.astype(np.float32)
    voltages[counts == NO_READING] = np.nan
    if rows[0].version == 1:
        voltages[np.arange(len(rows)), [row.grounded for row in rows]] = np.nan
    return voltages


def row_period(ends: np.ndarray) -> float:
    """Median distance of the ends (L,) of rows, -1 for missing ones; the first begins at 0."""
    known = np.flatnonzero(ends >= 0)
    distances = np.diff(ends[known], prepend=0) / np.diff(known, prepend=-1)
    return max(0.0, float(np.median(distances)))
