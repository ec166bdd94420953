"""Joins the rows of the wire protocol to frames; decides what is whole, lost, repeated or late.

Rows belong together when count, rows, sequence and frame_time agree (docs/protocol.md, section
3).  Nothing else is ever joined, so that lost packets, restarts and repetitions can cost frames but
never make a wrong one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomotactile_ros.devices.protocol import NO_READING, Row

_RECENT = 16


@dataclass(frozen=True, eq=False)
class RowsOfFrame:
    """A frame in device time; `frame_time` and `last_sample` in µs, voltages (L, E) in V."""

    voltages: np.ndarray
    grounded: np.ndarray
    sequence: int
    frame_time: int
    last_sample: int
    drive_voltage: float
    missing: int


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
        self._shape = (electrodes, rows)
        self._partial = partial
        self._grounded: list[int | None] = [None] * rows
        self._key: tuple[int, int] | None = None
        self._rows: list[Row | None] = [None] * rows
        self._missing = rows
        self._finished: tuple[int, int] | None = None

    def feed(self, row: Row) -> list[RowsOfFrame]:
        """Take in one row; return the frames that it finishes: none, one or (partial) two."""
        key = (row.sequence, row.frame_time)
        if (row.count, row.rows) != self._shape or self._is_old(key):
            self.counters.rows_ignored += 1
            return []
        done = [] if key == self._key else self._next(key)
        if self._rows[row.row] is not None:
            self.counters.rows_ignored += 1
            return done
        self._rows[row.row] = row
        self._grounded[row.row] = row.grounded
        self._missing -= 1
        if self._missing == 0:
            done.append(self._frame())
            self._finish()
        return done

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
            if self._partial and None not in self._grounded:
                done.append(self._frame())
            self._finish()
        if self._finished is not None:
            gap = (key[0] - self._finished[0] - 1) & 0xFFFFFFFF
            if gap < 1 << 16:
                self.counters.frames_lost += gap
                self.counters.packets_lost += gap * self._shape[1]
        self._key = key
        return done

    def _finish(self) -> None:
        self._finished, self._key = self._key, None
        self._rows = [None] * self._shape[1]
        self._missing = self._shape[1]

    def _frame(self) -> RowsOfFrame:
        electrodes, rows = self._shape
        received = [row for row in self._rows if row is not None]
        empty = b"\0" * (2 * electrodes)
        wire = b"".join(empty if row is None else row.readings for row in self._rows)
        counts = np.bitwise_not(np.frombuffer(wire, dtype="<u2")).reshape(rows, electrodes)
        scale = [0.0 if row is None else row.scale for row in self._rows]
        voltages = counts * np.array(scale, dtype=np.float32)[:, None]
        voltages[counts == NO_READING] = np.nan
        grounded = np.array(self._grounded, dtype=np.uint16)
        voltages[np.arange(rows), grounded] = np.nan
        return RowsOfFrame(
            voltages,
            grounded,
            received[0].sequence,
            received[0].frame_time,
            received[0].frame_time + max(row.row_end for row in received),
            received[0].drive_voltage,
            rows - len(received),
        )
