"""The firmware of a simulated sensor: the device's side of docs/protocol.md, without input or
output.

Bytes of the host go in, bytes for the host come out, and time is told from outside.
"""

from __future__ import annotations

import math
import random
from collections.abc import Callable, Sequence

import numpy as np

from tomotactile_ros.devices import protocol

MIN_RATE, MAX_RATE = 0.001, 1000.0
MAX_SCAN = 1024

Source = Callable[[float, int, np.ndarray], np.ndarray]
"""(time since START in s, sequence, electrodes to ground (L,)) -> voltages (L, E) in V, NaN where
there is no reading."""


class EmulatedDevice:
    """Firmware of a scanning sensor; its own order grounds electrode l in row l.

    Parameters
    ----------
    source : callable
        Voltages (L, E) of the frame that starts at a time.  The same array again means the same
        readings, which saves converting them.
    electrodes, rows : int
    rate, max_rate : float
        Frames/s at power-up, and the fastest, both of the device's own order.
    adc_bits, range, lowest : int, float, float
        The converter: 2**bits counts from `lowest` to `range` volts, clipped.
    drive_voltage : float, V
    haste : float
        How many times faster than told it scans (a fault).
    clock : callable
        Device time at a time as of `rows_due`, s.
    versions : sequence of int
        Of the protocol, that it speaks.
    address : int
        On a bus; 0 for a line of its own.
    max_scan : int
        Longest order that it takes; 0: none.
    own_reading : bool
        Whether version 2 tells what the grounded electrode reads itself.

    Attributes
    ----------
    temperature : float
        That it reports, °C; NaN for none.
    dropped : int
        ROW packets that the line did not take, to be counted by whoever drops them.
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
        lowest: float = 0.0,
        drive_voltage: float = 3.3,
        name: str = "emulator",
        serial: str = "0",
        haste: float = 1.0,
        clock: Callable[[float], float] = float,
        versions: Sequence[int] = protocol.VERSIONS,
        address: int = protocol.NO_ADDRESS,
        max_scan: int = MAX_SCAN,
        own_reading: bool = False,
    ) -> None:
        self.electrodes = electrodes
        self.rate, self.max_rate = rate, max_rate
        self.streaming = False
        self.sequence, self._row = 0, 0
        self.temperature, self.dropped = math.nan, 0
        self._own_order = np.arange(rows or electrodes)
        self.order, self._scan = self._own_order, protocol.OWN_ORDER
        self._next_order, self._next_scan = self.order, self._scan
        self._source, self._clock = source, clock
        self._name, self._serial = name, serial
        self._bits, self._range, self._drive = adc_bits, range, drive_voltage
        self._step = (range - lowest) / 2**adc_bits
        self._zero = round(-lowest / self._step)
        self._haste = haste
        self._versions, self._version = tuple(versions), min(versions)
        self._address, self._max_scan, self._own_reading = address, max_scan, own_reading
        self._boot = random.randrange(1 << 32)
        self._heard, self._timeout, self._frames_left = 0.0, 0.0, 0
        self._answers: list[bytes] = []
        self._parser = protocol.Parser(self._refuse)
        self._sampled: tuple | None = None
        self._readings: list[bytes] = []
        self._changed = False

    @property
    def rows(self) -> int:
        """Rows of the frame under way."""
        return len(self.order)

    @property
    def row_period(self) -> float:
        """Time from one row of the frame under way to the next, s."""
        return self._period / self.rows

    def receive(self, data: bytes, now: float) -> bytes:
        """Carry out the commands in `data`; return the answers. `now` as for `rows_due`."""
        self._answers = []
        for packet in self._parser.feed(data):
            if not self._is_for_me(packet.version, packet.address):
                continue
            self._heard = now
            answer = self._answer(packet, now)
            if packet.address != protocol.ALL_ADDRESSES:
                self._answers.append(answer)
        return b"".join(self._answers)

    def next_due(self) -> float | None:
        """When the current frame is complete, s; None while stopped."""
        return self._start + self._period if self.streaming else None

    def rows_due(self, now: float) -> bytes:
        """Packets of the rows whose last sample was taken by `now` (s, steady clock)."""
        packets = []
        if self._timeout and now - self._heard > self._timeout:
            self.streaming = False
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
        self._begin_settings()

    def _begin_settings(self) -> None:
        """What was commanded holds from the frame that begins now."""
        self._changed = False
        self.order, self._scan = self._next_order, self._next_scan
        self._period = 1.0 / (self.rate * self._haste)
        self._first, self._number = self._start, 0

    def _next_frame(self, now: float) -> None:
        behind = int((now - self._start) / self._period) - 1
        skipped = behind if behind * self._period > 1.0 else 0
        self._number += 1 + skipped
        self.sequence += 1 + skipped
        self._start, self._row = self._first + self._number * self._period, 0
        if self._changed:
            self._begin_settings()
        if self._frames_left:
            self._frames_left -= 1
            self.streaming = self._frames_left > 0

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
            self._step,
            self._drive,
            int(self.order[row]),
            self._readings[row],
            version=self._version,
        )
        if self._version > 1:
            packet = packet._replace(scan=self._scan, zero=self._zero, address=self._address)
        return protocol.encode(packet)

    def _sample(self) -> None:
        self._frame_time = max(0, round(1e6 * self._clock(self._start)))
        voltages = self._source(self._start - self._started, self.sequence, self.order)
        sampled = voltages, self._version, self._scan
        if self._sampled and voltages is self._sampled[0] and sampled[1:] == self._sampled[1:]:
            return
        largest = min(2**self._bits - 1, protocol.HIGHEST_READING)
        counts = np.round(np.nan_to_num(voltages) / self._step) + self._zero
        counts = np.clip(counts, 0, largest)
        if self._version == 1:
            counts = np.maximum(counts - self._zero, 0)
        counts = np.where(np.isnan(voltages), protocol.NO_READING, counts).astype(np.uint16)
        if self._version == 1 or not self._own_reading:
            counts[np.arange(self.rows), self.order] = protocol.NO_READING
        self._readings = [protocol.pack_counts(row) for row in counts]
        self._sampled = sampled

    def _is_for_me(self, version: int, address: int) -> bool:
        if version != 2:
            return self._address == protocol.NO_ADDRESS
        return address in (self._address, protocol.ALL_ADDRESSES)

    def _answer(self, packet: protocol.Packet, now: float) -> bytes:
        if not isinstance(packet, protocol.FromHost):
            return b""
        kind = protocol.type_of(packet)
        if packet.version not in self._versions:
            return self._error(packet.tag, kind, protocol.UNSUPPORTED_VERSION)
        if isinstance(packet, protocol.SetRate):
            return self._set_rate(packet)
        if isinstance(packet, protocol.SetScan):
            return self._set_scan(packet)
        if kind == protocol.IDENTIFY:
            return protocol.encode(self._identity(packet))
        if kind == protocol.KEEP_ALIVE:
            return protocol.encode(self._status(packet.tag, now))
        if kind == protocol.START:
            return self._start_stream(packet, now)
        self.streaming = False
        return self._ack(packet, kind)

    def _start_stream(self, packet: protocol.Command | protocol.Start, now: float) -> bytes:
        self._timeout, self._frames_left = 0.0, 0
        if isinstance(packet, protocol.Start):
            self._timeout, self._frames_left = 1e-3 * packet.timeout, packet.frames
        if self.streaming and packet.version == self._version:
            return self._ack(packet, protocol.START)
        if packet.version == 1 and self._next_scan != protocol.OWN_ORDER:
            self._take_order(self._own_order, protocol.OWN_ORDER)
        self._version = packet.version
        self.streaming = False  # until there are rows of the new version
        self._start_scan(now)
        ack = self._ack(packet, protocol.START, streaming=True)
        self.streaming = True
        return b"\0" + ack

    def _set_rate(self, packet: protocol.SetRate) -> bytes:
        fastest = self.max_rate * len(self._own_order) / len(self._next_order)
        if not 0.0 < packet.rate <= fastest * (1.0 + 1e-6):
            text = f"{packet.rate:g} frames/s asked for, at most {fastest:g} possible"
            return self._error(packet.tag, protocol.SET_RATE, protocol.BAD_VALUE, text, packet)
        rate = max(packet.rate, MIN_RATE)
        self._changed = self._changed or rate != self.rate
        self.rate = rate
        return self._ack(packet, protocol.SET_RATE)

    def _set_scan(self, packet: protocol.SetScan) -> bytes:
        wrong = [electrode for electrode in packet.order if electrode >= self.electrodes]
        text = ""
        if packet.tag == 0:
            text = "the tag of SET_SCAN must not be 0"
        elif packet.count > self._max_scan:
            text = f"an order of {packet.count} rows, at most {self._max_scan} possible"
        elif wrong:
            text = f"electrode {wrong[0]} does not exist, there are {self.electrodes}"
        if text:
            return self._error(packet.tag, protocol.SET_SCAN, protocol.BAD_VALUE, text, packet)
        if packet.order:
            self._take_order(np.array(packet.order), packet.tag)
        else:
            self._take_order(self._own_order, protocol.OWN_ORDER)
        return self._ack(packet, protocol.SET_SCAN)

    def _take_order(self, order: np.ndarray, scan: int) -> None:
        """From the next frame on; the time from row to row stays."""
        self.rate *= len(self._next_order) / len(order)
        self._next_order, self._next_scan = order, scan
        self._changed = True

    def _refuse(self, packet: bytes) -> None:
        """Answer what is no command: of another version, of an unknown type or a wrong length."""
        if len(packet) < 4 or packet[0] >= protocol.ROW:
            return
        kind, version, tag = packet[0], packet[1], int.from_bytes(packet[2:4], "little")
        address = packet[6] if version > 1 and len(packet) > 6 else protocol.NO_ADDRESS
        if not self._is_for_me(version, address) or address == protocol.ALL_ADDRESSES:
            return
        code = protocol.UNKNOWN_COMMAND
        if version not in self._versions:
            code = protocol.UNSUPPORTED_VERSION
        elif (kind, version) in protocol.HEADS:
            code = protocol.BAD_VALUE
        known = version if version in self._versions else None
        self._answers.append(self._error(tag, kind, code, version=known))

    def _identity(self, packet: protocol.FromHost) -> protocol.Identity:
        identity = protocol.Identity(
            packet.tag, self.electrodes, len(self._next_order), self._bits, self._range, self.rate,
            0, self.max_rate, self._name, "1.0.0", self._serial,
        )  # fmt: skip
        if packet.version == 1:
            also = protocol.ALSO_VERSION_2 if 2 in self._versions else ""
            own = len(self._own_order)
            rate = self.rate * len(self._next_order) / own
            return identity._replace(also=also, rows=own, rate=rate)
        return identity._replace(
            version=2,
            address=self._address,
            max_scan=self._max_scan,
            boot=self._boot,
            lowest=-self._zero * self._step,
            max_row_rate=self.max_rate * len(self._own_order),
        )

    def _status(self, tag: int, now: float) -> protocol.Status:
        return protocol.Status(
            tag,
            self.streaming,
            self._boot,
            self.temperature,
            max(0, round(1e6 * self._clock(now))),
            self.dropped & 0xFFFFFFFF,
            self._next_sequence(),
            address=self._address,
        )

    def _next_sequence(self) -> int:
        """Number of the next frame that begins."""
        begun = self.streaming or self._row > 0
        return (self.sequence + begun) & 0xFFFFFFFF

    def _ack(self, packet: protocol.FromHost, command: int, streaming: bool | None = None) -> bytes:
        streaming = self.streaming if streaming is None else streaming
        ack = protocol.Ack(packet.tag, command, streaming, self.rate)
        if packet.version > 1:
            ack = ack._replace(
                version=2,
                address=self._address,
                sequence=self._next_sequence(),
                rows=len(self._next_order),
            )
        return protocol.encode(ack)

    def _error(
        self,
        tag: int,
        command: int,
        code: int,
        text: str = "",
        packet: protocol.Packet | None = None,
        version: int | None = None,
    ) -> bytes:
        version = packet.version if packet else version or min(self._versions)
        address = self._address if version > 1 else protocol.NO_ADDRESS
        return protocol.encode(protocol.Error(tag, command, code, text, version, address))


def idle_source(electrodes: int) -> Source:
    """A sheet that nothing touches: all readings 0 V."""
    kept: dict[bytes, np.ndarray] = {}

    def source(time: float, sequence: int, order: np.ndarray) -> np.ndarray:
        key = order.tobytes()
        if key not in kept:
            kept.clear()
            kept[key] = np.zeros((len(order), electrodes))
        return kept[key]

    return source
