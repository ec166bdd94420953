"""The wire protocol of docs/protocol.md: bytes <-> packets, without any input or output.

A packet is `type, version, fields, CRC-32`, COBS-encoded and ended by a zero byte.  `encode` makes
the bytes of a packet, `Parser` finds the packets in a stream of bytes, whatever else is in there.
"""

from __future__ import annotations

import math
import struct
import zlib
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from tomotactile_ros.devices import cobs

VERSION = 1
MAX_PACKET = 4096
MAX_WIRE = MAX_PACKET + MAX_PACKET // 254 + 1
NO_READING = 0xFFFF

IDENTIFY, START, STOP, SET_RATE = 0x01, 0x02, 0x03, 0x04
ROW, IDENTITY, ACK, ERROR = 0x10, 0x11, 0x12, 0x13

UNKNOWN_COMMAND, BAD_VALUE, UNSUPPORTED_VERSION, HARDWARE_FAULT = 1, 2, 3, 4

_CRC_RESIDUE = 0x2144DF1C  # CRC-32 of any message followed by its own CRC-32
_MAX_SCALE = 1e6  # V per count; far above it, readings would not be finite
_COMMAND = struct.Struct("<BBH")
_SET_RATE = struct.Struct("<BBHf")
_ROW = struct.Struct("<BBHHHIIQffH")
_IDENTITY = struct.Struct("<BBHHHBxffIf")
_ACK = struct.Struct("<BBHBBf")
_ERROR = struct.Struct("<BBHBB")


class Malformed(ValueError):
    """A packet whose checksum is right but whose content is not."""


class Command(NamedTuple):
    """IDENTIFY, START or STOP, host to device; the answer repeats `tag`."""

    type: int
    tag: int


class SetRate(NamedTuple):
    """SET_RATE, host to device: `rate` in frames/s."""

    tag: int
    rate: float


class Row(NamedTuple):
    """ROW, device to host: the readings of one ground condition.

    `readings` are the bytes on the wire, see `unpack_counts`.  Times in µs: `frame_time` is the
    device time of the frame's start, `row_end` the row's last sample after that.
    """

    count: int
    row: int
    rows: int
    sequence: int
    row_end: int
    frame_time: int
    scale: float
    drive_voltage: float
    grounded: int
    readings: bytes


class Identity(NamedTuple):
    """IDENTITY, device to host: the answer to IDENTIFY.

    `range` is the voltage of a full-scale reading (V), rates in frames/s, `line_rate` in bit/s (0
    if the line has none, as with native USB).
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


class Ack(NamedTuple):
    """ACK, device to host: `command` was carried out; streaming or not and the rate in effect."""

    tag: int
    command: int
    streaming: bool
    rate: float


class Error(NamedTuple):
    """ERROR, device to host: `command` was refused, or a fault without a command (tag 0)."""

    tag: int
    command: int
    code: int
    message: str

    def __str__(self) -> str:
        return self.message or f"error {self.code}"


Packet = Command | SetRate | Row | Identity | Ack | Error


def pack_counts(counts: np.ndarray) -> bytes:
    """Wire form of readings (uint16 counts): complemented, little endian."""
    return np.bitwise_not(np.asarray(counts, dtype="<u2")).tobytes()


def unpack_counts(readings: bytes) -> np.ndarray:
    """Counts (uint16) of readings in wire form; `NO_READING` marks an invalid one."""
    return np.bitwise_not(np.frombuffer(readings, dtype="<u2"))


def encode(packet: Packet) -> bytes:
    """Bytes of `packet` on the wire, with checksum, framing and the closing zero."""
    return frame(_BODY[type(packet)](packet))


def frame(body: bytes) -> bytes:
    """Add checksum, COBS and the delimiter to the bytes of a packet from `type` on."""
    return cobs.encode(body + zlib.crc32(body).to_bytes(4, "little")) + b"\0"


def decode(packet: bytes) -> Packet:
    """Turn the bytes of a packet without framing and checksum into a packet; else `Malformed`."""
    if len(packet) < 2:
        raise Malformed("shorter than type and version")
    kind, version = packet[0], packet[1]
    if version != VERSION:
        raise Malformed(f"protocol version {version}, expected {VERSION}")
    try:
        return _DECODE[kind](packet)
    except KeyError:
        raise Malformed(f"unknown packet type 0x{kind:02x}") from None
    except (struct.error, UnicodeDecodeError, IndexError) as error:
        raise Malformed(f"packet of type 0x{kind:02x}: {error}") from None


def _string(text: str) -> bytes:
    data = text.encode()[:255]
    return bytes([len(data)]) + data


def _identity_body(p: Identity) -> bytes:
    head = _IDENTITY.pack(
        IDENTITY, VERSION, p.tag, p.electrodes, p.rows, p.adc_bits, p.range, p.rate, p.line_rate,
        p.max_rate,
    )  # fmt: skip
    return head + _string(p.name) + _string(p.firmware) + _string(p.serial)


_BODY = {
    Command: lambda p: _COMMAND.pack(p.type, VERSION, p.tag),
    SetRate: lambda p: _SET_RATE.pack(SET_RATE, VERSION, p.tag, p.rate),
    Row: lambda p: _ROW.pack(ROW, VERSION, *p[:-1]) + p.readings,
    Identity: _identity_body,
    Ack: lambda p: _ACK.pack(ACK, VERSION, p.tag, p.command, p.streaming, p.rate),
    Error: lambda p: _ERROR.pack(ERROR, VERSION, p.tag, p.command, p.code) + p.message.encode(),
}


def _decode_command(data: bytes) -> Command:
    kind, _, tag = _COMMAND.unpack(data)
    return Command(kind, tag)


def _decode_set_rate(data: bytes) -> SetRate:
    _, _, tag, rate = _SET_RATE.unpack(data)
    return SetRate(tag, rate)


def _decode_row(data: bytes) -> Row:
    fields = _ROW.unpack_from(data)
    row = Row(*fields[2:], data[_ROW.size :])
    if len(row.readings) != 2 * row.count:
        raise Malformed(f"row with {len(row.readings)} bytes for {row.count} readings")
    if row.row >= row.rows or row.grounded >= row.count:
        raise Malformed("row or grounded electrode out of range")
    if not (0.0 < row.scale <= _MAX_SCALE and 0.0 <= row.drive_voltage < math.inf):
        raise Malformed("scale or drive voltage out of range")
    return row


def _decode_identity(data: bytes) -> Identity:
    fields = _IDENTITY.unpack_from(data)
    strings, position = [], _IDENTITY.size
    for _ in range(3):
        end = position + 1 + data[position]
        if end > len(data):
            raise Malformed("identity ends within a string")
        strings.append(_text(data[position + 1 : end]))
        position = end
    identity = Identity(*fields[2:], *strings)
    if not (identity.electrodes > 0 and identity.rows > 0 and 0.0 < identity.range < math.inf):
        raise Malformed("identity without electrodes, rows or range")
    _check_rate(identity.rate)
    return identity


def _decode_ack(data: bytes) -> Ack:
    _, _, tag, command, streaming, rate = _ACK.unpack(data)
    _check_rate(rate)
    return Ack(tag, command, bool(streaming), rate)


def _decode_error(data: bytes) -> Error:
    _, _, tag, command, code = _ERROR.unpack_from(data)
    return Error(tag, command, code, _text(data[_ERROR.size :]))


def _text(data: bytes) -> str:
    """What is fit for one line of a log: everything else becomes a question mark."""
    return "".join(c if c.isprintable() else "?" for c in data.decode())


def _check_rate(rate: float) -> None:
    if not 0.0 < rate < math.inf:
        raise Malformed(f"{rate:g} is no rate")


_DECODE = {
    IDENTIFY: _decode_command,
    START: _decode_command,
    STOP: _decode_command,
    SET_RATE: _decode_set_rate,
    ROW: _decode_row,
    IDENTITY: _decode_identity,
    ACK: _decode_ack,
    ERROR: _decode_error,
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
    """

    def __init__(self) -> None:
        self.counters = LineCounters()
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
        packets = []
        for chunk in chunks:
            if self._overlong:
                self._overlong = False
                continue
            packet = self._packet(chunk) if chunk else None
            if packet is not None:
                packets.append(packet)
        if len(rest) > MAX_WIRE:
            if not self._overlong:
                self._out_of_step("framing_errors", "no delimiter within the longest packet")
            self._overlong, rest = True, b""
        self._rest = rest
        return packets

    def _packet(self, chunk: bytes) -> Packet | None:
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
            return self._out_of_step("malformed", str(error))
        self.counters.packets += 1
        if not self._in_step:
            self._in_step = True
            self.counters.resynchronisations += 1
        return packet

    def _out_of_step(self, counter: str, complaint: str) -> None:
        setattr(self.counters, counter, getattr(self.counters, counter) + 1)
        self.last_complaint = complaint
        self._in_step = False
