"""The wire protocol of docs/protocol.md: bytes <-> packets, without any input or output.

A packet is `type, version, fields, CRC-32`, COBS-encoded and ended by a zero byte.  `encode` makes
the bytes of a packet, `Parser` finds the packets in a stream of bytes, whatever else is in there.
Fields that a version does not have keep the default of their class.
"""

from __future__ import annotations

import math
import struct
import zlib
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from tomotactile_ros.devices import cobs
from tomotactile_ros.devices.messages import *  # all of its names are names of the protocol

MAX_WIRE = MAX_PACKET + MAX_PACKET // 254 + 1
ALSO_VERSION_2 = "v2"  # behind the strings of an IDENTITY of version 1

_CRC_RESIDUE = 0x2144DF1C  # CRC-32 of any message followed by its own CRC-32
_MAX_SCALE = 1e6  # V per count; far above it, readings would not be finite


class Malformed(ValueError):
    """A packet whose checksum is right but whose content is not."""


class Command(NamedTuple):
    """IDENTIFY, START of version 1, STOP or KEEP_ALIVE, host to device; the answer repeats
    `tag`."""

    type: int
    tag: int
    version: int = 1
    address: int = NO_ADDRESS


class Start(NamedTuple):
    """START of version 2, host to device.

    The device stops by itself behind `frames` frames, and when it has heard nothing for `timeout`
    ms; 0 of either: it does not.
    """

    tag: int
    timeout: int = 0
    frames: int = 0
    version: int = 2
    address: int = NO_ADDRESS


class SetRate(NamedTuple):
    """SET_RATE, host to device: `rate` in frames/s."""

    tag: int
    rate: float
    version: int = 1
    address: int = NO_ADDRESS


class SetScan(NamedTuple):
    """SET_SCAN, host to device: electrodes to ground, row after row; none: the device's own
    order."""

    tag: int
    order: tuple[int, ...]
    version: int = 2
    address: int = NO_ADDRESS

    @property
    def count(self) -> int:  # type: ignore[override] # hides the one of tuples
        """Rows of a frame, 0 for as many as the device likes."""
        return len(self.order)


class Row(NamedTuple):
    """ROW, device to host: the readings of one ground condition.

    `readings` are the bytes on the wire, see `unpack_counts`; a reading r means (r - `zero`) *
    `scale` volts.  Times in µs: `frame_time` is the device time of the frame's start, `row_end` the
    row's last sample after that.  `scan` is the tag of the SET_SCAN whose order it follows.
    """

    count: int  # type: ignore[assignment] # hides the one of tuples
    row: int
    rows: int
    sequence: int
    row_end: int
    frame_time: int
    scale: float
    drive_voltage: float
    grounded: int
    readings: bytes
    scan: int = OWN_ORDER
    zero: int = 0
    version: int = 1
    address: int = NO_ADDRESS


class Identity(NamedTuple):
    """IDENTITY, device to host: the answer to IDENTIFY.

    `range` is the voltage of a full-scale reading and `lowest` that of the reading 0 (V), rates are
    in frames/s (`max_rate` of version 1) and rows/s (`max_row_rate` of version 2), `line_rate` in
    bit/s (0 if the line has none, as with native USB).
    """

    tag: int
    electrodes: int
    rows: int
    adc_bits: int
    range: float
    rate: float
    line_rate: int
    max_rate: float
    name: str
    firmware: str
    serial: str
    also: str = ""
    version: int = 1
    address: int = NO_ADDRESS
    max_scan: int = 0
    boot: int = 0
    lowest: float = 0.0
    max_row_rate: float = 0.0


class Ack(NamedTuple):
    """ACK, device to host: `command` was carried out; streaming or not and the rate in effect.

    In version 2 also the number of the next frame that begins, and its rows.
    """

    tag: int
    command: int
    streaming: bool
    rate: float
    version: int = 1
    address: int = NO_ADDRESS
    sequence: int = 0
    rows: int = 0


class Error(NamedTuple):
    """ERROR, device to host: `command` was refused, or a fault without a command (tag 0)."""

    tag: int
    command: int
    code: int
    message: str
    version: int = 1
    address: int = NO_ADDRESS

    def __str__(self) -> str:
        return self.message or f"error {self.code}"


class Status(NamedTuple):
    """STATUS, device to host: the answer to KEEP_ALIVE.

    `temperature` in °C or NaN, `time` in µs since power-up; `dropped` counts ROW packets,
    `sequence` is that of the next frame that begins.
    """

    tag: int
    streaming: bool
    boot: int
    temperature: float
    time: int
    dropped: int
    sequence: int
    version: int = 2
    address: int = NO_ADDRESS


FromHost = Command | Start | SetRate | SetScan
Packet = FromHost | Row | Identity | Ack | Error | Status
_TYPES: dict[type, int] = {
    Start: START, SetRate: SET_RATE, SetScan: SET_SCAN, Row: ROW, Identity: IDENTITY, Ack: ACK,
    Error: ERROR, Status: STATUS,
}  # fmt: skip


def type_of(packet: Packet) -> int:
    """The type that a packet has on the wire."""
    return packet.type if isinstance(packet, Command) else _TYPES[type(packet)]


def pack_counts(counts: np.ndarray) -> bytes:
    """Wire form of readings (uint16 counts): complemented, little endian."""
    return np.bitwise_not(np.asarray(counts, dtype="<u2")).tobytes()


def unpack_counts(readings: bytes) -> np.ndarray:
    """Counts (uint16) of readings in wire form; `NO_READING` marks an invalid one."""
    return np.bitwise_not(np.frombuffer(readings, dtype="<u2"))


def encode(packet: Packet) -> bytes:
    """Bytes of `packet` on the wire, with checksum, framing and the closing zero."""
    key = type_of(packet), packet.version
    fields = [getattr(packet, name) if name else 0 for name in FIELDS[key]]
    return frame(HEADS[key].pack(*key, *fields) + _TAILS.get(key[0], _nothing)(packet))


def frame(body: bytes) -> bytes:
    """Add checksum, COBS and the delimiter to the bytes of a packet from `type` on."""
    return cobs.encode(body + zlib.crc32(body).to_bytes(4, "little")) + b"\0"


def decode(packet: bytes) -> Packet:
    """Turn the bytes of a packet without framing and checksum into a packet; else `Malformed`."""
    if len(packet) < 2:
        raise Malformed("shorter than type and version")
    kind, version = packet[0], packet[1]
    if version not in VERSIONS:
        expected = " or ".join(map(str, VERSIONS))
        raise Malformed(f"protocol version {version}, expected {expected}")
    if (kind, version) not in HEADS:
        raise Malformed(f"unknown packet type 0x{kind:02x}")
    head, names = HEADS[kind, version], FIELDS[kind, version]
    try:
        values = head.unpack_from(packet) if kind in _TAILS else head.unpack(packet)
        fields = {name: value for name, value in zip(names, values[2:]) if name}
        fields["version"] = version
        if kind in _DECODE:
            return _DECODE[kind](fields, packet[head.size :])
        if kind == START and version > 1:
            return Start(**fields)
        return SetRate(**fields) if kind == SET_RATE else Command(kind, **fields)
    except (struct.error, UnicodeDecodeError, IndexError) as error:
        raise Malformed(f"packet of type 0x{kind:02x}: {error}") from None


def _nothing(packet: Packet) -> bytes:
    return b""


def _string(text: str) -> bytes:
    data = text.encode()[:255]
    return bytes([len(data)]) + data


def _strings(p: Identity) -> bytes:
    also = [p.also] if p.also and p.version == 1 else []
    return b"".join(map(_string, [p.name, p.firmware, p.serial, *also]))


_TAILS: dict[int, Callable[[Any], bytes]] = {
    SET_SCAN: lambda p: np.asarray(p.order, "<u2").tobytes(),
    ROW: lambda p: p.readings,
    IDENTITY: _strings,
    ERROR: lambda p: p.message.encode(),
}


def _decode_set_scan(fields: dict, order: bytes) -> SetScan:
    count = fields.pop("count")
    if len(order) != 2 * count:
        raise Malformed(f"an order with {len(order)} bytes for {count} rows")
    return SetScan(order=tuple(np.frombuffer(order, "<u2").tolist()), **fields)


def _decode_row(fields: dict, readings: bytes) -> Row:
    row = Row(readings=readings, **fields)
    if len(row.readings) != 2 * row.count:
        raise Malformed(f"row with {len(row.readings)} bytes for {row.count} readings")
    if row.row >= row.rows or row.grounded >= row.count:
        raise Malformed("row or grounded electrode out of range")
    if not (0.0 < row.scale <= _MAX_SCALE and 0.0 <= row.drive_voltage < math.inf):
        raise Malformed("scale or drive voltage out of range")
    return row


def _decode_identity(fields: dict, data: bytes) -> Identity:
    strings, position = [], 0
    for _ in range(3):
        end = position + 1 + data[position]
        if end > len(data):
            raise Malformed("identity ends within a string")
        strings.append(_text(data[position + 1 : end]))
        position = end
    names = dict(zip(("name", "firmware", "serial"), strings))
    if fields["version"] == 1:
        fields["also"] = ALSO_VERSION_2 if data[position:] == _string(ALSO_VERSION_2) else ""
    identity = Identity(**{"max_rate": 0.0, **names, **fields})
    if not (identity.electrodes > 0 and identity.rows > 0 and 0.0 < identity.range < math.inf):
        raise Malformed("identity without electrodes, rows or range")
    if not -math.inf < identity.lowest <= 0.0:
        raise Malformed(f"identity whose lowest voltage is {identity.lowest:g} V")
    _check_rate(identity.rate)
    if identity.version > 1:
        _check_rate(identity.max_row_rate)
    return identity


def _decode_ack(fields: dict, _: bytes) -> Ack:
    _check_rate(fields["rate"])
    fields["streaming"] = bool(fields["streaming"])
    return Ack(**fields)


def _decode_error(fields: dict, message: bytes) -> Error:
    return Error(message=_text(message), **fields)


def _decode_status(fields: dict, _: bytes) -> Status:
    fields["streaming"] = bool(fields["streaming"])
    if math.isinf(fields["temperature"]):
        raise Malformed(f"a temperature of {fields['temperature']:g} °C")
    return Status(**fields)


def _text(data: bytes) -> str:
    """What is fit for one line of a log: everything else becomes a question mark."""
    return "".join(c if c.isprintable() else "?" for c in data.decode())


def _check_rate(rate: float) -> None:
    if not 0.0 < rate < math.inf:
        raise Malformed(f"{rate:g} is no rate")


# of those that are no mere command: from the fields of fixed size, and what is behind them
_DECODE: dict[int, Callable[[dict, bytes], Packet]] = {
    SET_SCAN: _decode_set_scan,
    ROW: _decode_row,
    IDENTITY: _decode_identity,
    ACK: _decode_ack,
    ERROR: _decode_error,
    STATUS: _decode_status,
}


@dataclass
class LineCounters:
    """What a parser has seen since it was made."""

    bytes: int = 0
    packets: int = 0
    crc_errors: int = 0
    framing_errors: int = 0
    malformed: int = 0
    resynchronisations: int = 0


class Parser:
    """Finds packets in a stream of bytes.

    Keeps at most `MAX_WIRE` bytes between calls, raises for no input, and returns nothing whose
    checksum, version or content is wrong.  After damage, the packet behind the next delimiter is
    found again.

    Parameters
    ----------
    on_malformed : callable
        Gets the bytes, from the type on, of a packet whose checksum is right but whose content is
        not: a device answers it with ERROR.
    """

    def __init__(self, on_malformed: Callable[[bytes], None] | None = None) -> None:
        self.counters = LineCounters()
        self._on_malformed = on_malformed
        self.last_complaint = ""
        self._rest = b""
        self._overlong = False
        self._in_step = True

    @property
    def pending(self) -> int:
        """Bytes kept until the packet they belong to is complete."""
        return len(self._rest)

    def reset(self) -> None:
        """Forget the packet under way, as on a new connection; the counters go on."""
        self._rest, self._overlong = b"", False

    def feed(self, data: bytes) -> list[Packet]:
        """Take in `data`, return the packets that are complete now, in order."""
        self.counters.bytes += len(data)
        *chunks, rest = (self._rest + data).split(b"\0") if self._rest else data.split(b"\0")
        packets: list[Packet] = []
        for chunk in chunks:
            if self._overlong:
                self._overlong = False
                continue
            if chunk:
                packets += self._packet(chunk)
        if len(rest) > MAX_WIRE:
            if not self._overlong:
                self._out_of_step("framing_errors", "no delimiter within the longest packet")
            self._overlong, rest = True, b""
        self._rest = rest
        return packets

    def _packet(self, chunk: bytes) -> list[Packet]:
        """The packet of a chunk, or none."""
        if len(chunk) > MAX_WIRE:
            return self._out_of_step("framing_errors", "packet too long")
        data = cobs.decode(chunk)
        if data is None:
            return self._out_of_step("framing_errors", "COBS code points beyond the packet")
        if zlib.crc32(data) != _CRC_RESIDUE:
            return self._out_of_step("crc_errors", "wrong checksum")
        try:
            packet = decode(data[:-4])
        except Malformed as error:
            if self._on_malformed is not None:
                self._on_malformed(data[:-4])
            return self._out_of_step("malformed", str(error))
        self.counters.packets += 1
        if not self._in_step:
            self._in_step = True
            self.counters.resynchronisations += 1
        return [packet]

    def _out_of_step(self, counter: str, complaint: str) -> list[Packet]:
        setattr(self.counters, counter, getattr(self.counters, counter) + 1)
        self.last_complaint = complaint
        self._in_step = False
        return []
