"""The firmware of a simulated sensor: the device's side of docs/protocol.md, without input or output.

Bytes of the host go in, bytes for the host come out, and time is told from outside.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tomotactile_ros.devices import protocol

MIN_RATE, MAX_RATE = 0.001, 1000.0

Source = Callable[[float, int], np.ndarray]
"""(time since START in s, sequence) -> voltages (L, E) in V, NaN where there is no reading."""


class EmulatedDevice:
    """Firmware of a scanning sensor; electrode l is grounded in row l.

    Parameters
    ----------
    source : callable
        Voltages (L, E) of the frame that starts at a time.  The same array again means the same
        readings, which saves converting them.
    electrodes, rows : int
    rate, max_rate : float
        Frames/s at power-up, and the fastest.
    adc_bits, range : int, float
        The converter: counts of range / 2**bits volts, clipped.
    drive_voltage : float, V
    haste : float
        How many times faster than told it scans (a fault).
    clock : callable
        Device time at a time as of `rows_due`, s.
    """

    def __init__(
        self,
        source: Source,
        electrodes: int,
        rows: int | None = None,
        *,
        rate: float = 15.625,
        max_rate: float = MAX_RATE,
        adc_bits: int = 12,
        range: float = 3.3,
        drive_voltage: float = 3.3,
        name: str = "emulator",
        serial: str = "0",
        haste: float = 1.0,
        clock: Callable[[float], float] = float,
    ) -> None:
        self.electrodes, self.rows = electrodes, rows or electrodes
        self.rate, self.max_rate = rate, max_rate
        self.streaming = False
        self.sequence, self._row = 0, 0
        self._source, self._clock = source, clock
        self._name, self._serial = name, serial
        self._bits, self._range, self._drive = adc_bits, range, drive_voltage
        self._haste = haste
        self._parser = protocol.Parser()
        self._voltages: np.ndarray | None = None
        self._readings: list[bytes] = []
        self._rate_changed = False

    @property
    def row_period(self) -> float:
        """Time from one row of the frame under way to the next, s."""
        return self._period / self.rows

    def receive(self, data: bytes, now: float) -> bytes:
        """Carry out the commands in `data`; return the answers. `now` as for `rows_due`."""
        return b"".join(self._answer(packet, now) for packet in self._parser.feed(data))

    def next_due(self) -> float | None:
        """When the current frame is complete, s; None while stopped."""
        return self._start + self._period if self.streaming else None

    def rows_due(self, now: float) -> bytes:
        """Packets of the rows whose last sample was taken by `now` (s, steady clock)."""
        packets = []
        while self.streaming:
            done = min(self.rows, int((now - self._start) / self._period * self.rows + 1e-6))
            packets += [self._row_packet(row) for row in range(self._row, done)]
            self._row = max(done, self._row)
            if self._row < self.rows:
                break
            self._next_frame(now)
        return b"".join(packets)

    def _start_scan(self, now: float) -> None:
        self.sequence += self._row > 0
        self._started = self._start = now
        self._row = 0
        self._begin_rate()

    def _begin_rate(self) -> None:
        self._period = 1.0 / (self.rate * self._haste)
        self._first, self._number = self._start, 0

    def _next_frame(self, now: float) -> None:
        behind = int((now - self._start) / self._period) - 1
        skipped = behind if behind * self._period > 1.0 else 0
        self._number += 1 + skipped
        self.sequence += 1 + skipped
        self._start, self._row = self._first + self._number * self._period, 0
        if self._rate_changed:
            self._rate_changed = False
            self._begin_rate()

    def _row_packet(self, row: int) -> bytes:
        if row == 0:
            self._sample()
        row_end = round(1e6 * (row + 1) * self._period / self.rows)
        packet = protocol.Row(
            self.electrodes,
            row,
            self.rows,
            self.sequence & 0xFFFFFFFF,
            row_end,
            self._frame_time,
            self._range / 2**self._bits,
            self._drive,
            row,
            self._readings[row],
        )
        return protocol.encode(packet)

    def _sample(self) -> None:
        self._frame_time = max(0, round(1e6 * self._clock(self._start)))
        voltages = self._source(self._start - self._started, self.sequence)
        if voltages is self._voltages:
            return
        largest = min(2**self._bits - 1, protocol.NO_READING - 1)
        counts = np.round(np.nan_to_num(voltages) / (self._range / 2**self._bits))
        counts = np.where(np.isnan(voltages), protocol.NO_READING, np.clip(counts, 0, largest))
        self._readings = [protocol.pack_counts(row) for row in counts.astype(np.uint16)]
        self._voltages = voltages

    def _answer(self, packet: protocol.Packet, now: float) -> bytes:
        if isinstance(packet, protocol.SetRate):
            return self._set_rate(packet)
        if not isinstance(packet, protocol.Command):
            return b""
        if packet.type == protocol.IDENTIFY:
            return protocol.encode(self._identity(packet.tag))
        if packet.type == protocol.START and not self.streaming:
            self.streaming = True
            self._start_scan(now)
            return b"\0" + self._ack(packet.tag, packet.type)
        if packet.type == protocol.STOP:
            self.streaming = False
        return self._ack(packet.tag, packet.type)

    def _identity(self, tag: int) -> protocol.Identity:
        return protocol.Identity(
            tag, self.electrodes, self.rows, self._bits, self._range, self.rate, 0, self.max_rate,
            self._name, "1.0.0", self._serial,
        )  # fmt: skip

    def _set_rate(self, packet: protocol.SetRate) -> bytes:
        if not 0.0 < packet.rate <= self.max_rate:
            text = f"{packet.rate:g} frames/s asked for, at most {self.max_rate:g} possible"
            return protocol.encode(
                protocol.Error(packet.tag, protocol.SET_RATE, protocol.BAD_VALUE, text)
            )
        rate = max(packet.rate, MIN_RATE)
        self._rate_changed = self._rate_changed or rate != self.rate
        self.rate = rate
        return self._ack(packet.tag, protocol.SET_RATE)

    def _ack(self, tag: int, command: int) -> bytes:
        return protocol.encode(protocol.Ack(tag, command, self.streaming, self.rate))


def idle_source(electrodes: int) -> Source:
    """A sheet that nothing touches: all readings 0 V."""
    voltages = np.zeros((electrodes, electrodes))
    np.fill_diagonal(voltages, np.nan)
    return lambda time, sequence: voltages
