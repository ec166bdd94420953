"""A sensor for fault tests, written from docs/protocol.md alone; it shares no line with the package.

    python3 benchmark/sensor.py --port pty:LINK|tcp:PORT [--electrodes 64] [--rate 15.625] [--buffer BYTES]
        [--throttle BYTES_PER_S] [--fault NAME] [--amount P] [--seed N]
    python3 benchmark/sensor.py --list

Speaks version 1 of the protocol. Every reading is a hash of sequence, row and electrode (`readings`), so
that whoever knows the hash sees any wrong value. `--buffer` is what it keeps for a slow line before it
drops whole packets, `--throttle` how fast the line is. `--fault` is one of `--list`: what the line does to
the bytes, or what a broken device says in packets that are whole. `--amount` is its probability for each
packet (for `restart` the seconds in between).

Prints the port, then `from SEQUENCE MICROSECONDS RATE` when frames begin (monotonic clock), so that the
age of each can be told, and at its end, with SIGTERM, what it has made and dropped.
"""

from __future__ import annotations

import argparse
import functools
import os
import select
import signal
import socket
import struct
import time
import tty
import zlib
from math import inf, isnan, nan
from random import Random

import numpy as np

FASTEST, SLOWEST = 4000.0, 0.001  # frames/s
SCALE, DRIVE = 3.3 / 4096, 3.3  # V per count, V
NONE = 0xFFFF  # no valid reading
ROW = struct.Struct("<BBHHHIIQffH")
FIELDS = (
    *("type", "version", "count", "row", "rows", "sequence"),
    *("row_end", "time", "scale", "drive", "grounded"),
)
random = Random()


@functools.cache
def _places(electrodes: int) -> np.ndarray:
    row, electrode = np.indices((electrodes, electrodes), dtype=np.uint32) + np.uint32(1)
    return row * np.uint32(0x85EBCA77) ^ electrode * np.uint32(0xC2B2AE3D)


def readings(sequence: int, electrodes: int) -> np.ndarray:
    """Counts (E, E) of 12 bits of a frame, below 4000."""
    h = _places(electrodes) ^ np.uint32(sequence * 0x9E3779B1 & 0xFFFFFFFF)
    h ^= h >> np.uint32(15)
    h *= np.uint32(0x2C1B3C6D)
    h ^= h >> np.uint32(12)
    h *= np.uint32(0x297A2D39)
    h ^= h >> np.uint32(15)
    h %= np.uint32(4000)
    return h


# -- what a bad line makes of a packet on its way ------------------------------------------------


def _flip(wire: bytearray) -> None:
    wire[random.randrange(len(wire))] ^= 1 << random.randrange(8)


def _overwrite(wire: bytearray, byte) -> None:
    first = random.randrange(len(wire))
    for i in range(first, min(first + random.randint(1, 16), len(wire))):
        wire[i] = byte()


LINE = {
    "none": lambda wire: None,
    "flip": _flip,
    "burst": lambda wire: _overwrite(wire, lambda: random.randrange(256)),
    "zeros": lambda wire: _overwrite(wire, lambda: 0),
    "drop-byte": lambda wire: wire.pop(random.randrange(len(wire))),
    "insert-byte": lambda wire: wire.insert(random.randrange(len(wire)), random.randrange(256)),
    "cut": lambda wire: wire.__delitem__(slice(random.randrange(len(wire)), None)),
    "lose": lambda wire: wire.clear(),
    "double": lambda wire: wire.extend(bytes(wire)),
    "noise": lambda wire: wire.extend(random.randbytes(random.randint(1, 9000))),
    "swap": lambda wire: None,  # it comes behind the next one: `Line.send`
    "merge": lambda wire: wire.pop(),  # two packets become one
}

# -- what a broken device says in a packet that is whole, in the place of what it would say ------

ROWS = {
    "row-index": lambda row: {"row": row["count"]},
    "sequence-jumps": lambda row: {"sequence": row["sequence"] + random.randrange(1000)},
    "sequence-falls": lambda row: {"sequence": ~row["sequence"] & 0xFFFFFFFF},
    "sequence-stands": lambda row: {"sequence": 5},
    "time-falls": lambda row: {"time": 10**12 - row["time"]},
    "time-stands": lambda row: {"time": 10**6},
    "time-jumps": lambda row: {"time": row["time"] + 3600 * 10**6 * (row["sequence"] % 2)},
    "time-random": lambda row: {"time": random.getrandbits(64)},
    "row-end-huge": lambda row: {"row_end": 0xFFFFFFFF},
    "row-end-zero": lambda row: {"row_end": 0},
    "scale-nan": lambda row: {"scale": nan},
    "scale-huge": lambda row: {"scale": 1e30},
    "scale-zero": lambda row: {"scale": 0.0},
    "scale-ten-times": lambda row: {"scale": 10 * SCALE},
    "scale-negative": lambda row: {"scale": -SCALE},
    "drive-nan": lambda row: {"drive": nan},
    "drive-negative": lambda row: {"drive": -DRIVE},
    "drive-zero": lambda row: {"drive": 0.0},
    "grounded-beyond": lambda row: {"grounded": row["count"]},
    "grounded-other": lambda row: {"grounded": (row["row"] + 1) % row["count"]},
    "grounded-twice": lambda row: {"grounded": 0},
    "grounded-changes": lambda row: {"grounded": (row["row"] + row["sequence"]) % row["count"]},
    "type-unknown": lambda row: {"type": 0x5A},
    "count-less": lambda row: {"count": row["count"] - 1},
    "version-nine": lambda row: {"version": 9},
    "rows-less": lambda row: {"rows": row["rows"] - 1},
    "readings-none": lambda row: {"readings": row["readings"] * 0 + NONE},
    "readings-same": lambda row: {"readings": row["readings"] * 0 + 2000},
    "dead-channel": lambda row: {
        "readings": np.where(np.arange(row["count"]) == 3, 7, row["readings"])
    },
    "row-long": lambda row: {"readings": np.append(row["readings"], 0)},
    "row-short": lambda row: {"readings": row["readings"][:-1]},
}
IDENTITY = {
    "identity-no-electrodes": {"electrodes": 0},
    "identity-more-rows": {"more_rows": 1},
    "identity-range": {"range": -DRIVE},
    "identity-rate": {"rate": nan},
    "identity-escape": {"name": b"\033[2J\033]0;owned\007\n[INFO] all is well"},
    "identity-short": {},
}
ANSWERS = (  # and what nobody asked for
    *("error-unasked", "ack-unasked", "stop-unasked", "haste", "stop-deaf"),
    *("ack-never", "ack-tag", "ack-command", "ack-rate"),
)
FAULTS = (*LINE, *ROWS, *ANSWERS, *IDENTITY, "restart", "restart-streaming")


def stuffed(data: bytes) -> bytearray:
    """A packet as it is on the line: COBS, and the delimiter."""
    parts = []
    for run in data.split(b"\0"):
        while len(run) >= 254:
            parts += [b"\xff", run[:254]]
            run = run[254:]
        parts += [bytes((len(run) + 1,)), run]
    return bytearray(b"".join(parts) + b"\0")


def unstuffed(run: bytes) -> bytes:
    """A packet between two delimiters; nothing where that is none."""
    out, at = bytearray(), 0
    while at < len(run):
        code = run[at]
        if at + code > len(run):
            return b""
        out += run[at + 1 : at + code]
        at += code
        if at < len(run) and code < 255:
            out.append(0)
    return bytes(out)


def micros() -> int:
    return time.monotonic_ns() // 1000


class Line:
    """Bytes from and to one host at a time, over a pseudo-terminal or TCP."""

    def __init__(self, port: str, options: argparse.Namespace) -> None:
        self._options, self._waiting, self._held = options, bytearray(), b""
        self._allowed, self._flushed = 0.0, micros()
        self._server, self._host, self._heard = None, None, b""
        kind, _, name = port.partition(":")
        if kind == "tcp":
            self._server = socket.create_server(("127.0.0.1", int(name)))
            print(f"socket://127.0.0.1:{self._server.getsockname()[1]}", flush=True)
            return
        self._host, slave = os.openpty()  # whose other end stays open: hosts come and go
        tty.setraw(slave)
        os.set_blocking(self._host, False)
        there = os.ttyname(slave)
        if name:
            if os.path.lexists(name):
                os.unlink(name)
            os.symlink(there, name)
        print(name or there, flush=True)

    def clear(self) -> None:
        self._waiting.clear()

    def put(self, data: bytes) -> None:
        self._waiting += data[: max(self._options.buffer - len(self._waiting), 0)]

    def send(self, packet: bytes) -> bool:
        """Whether there was room for it, after what the line does to it."""
        wire = stuffed(packet + zlib.crc32(packet).to_bytes(4, "little"))
        fault = self._options.fault
        if self._held:
            wire, self._held = wire + self._held, b""
        elif fault in LINE and random.random() < self._options.amount:
            if fault == "swap":
                self._held = bytes(wire)
                wire.clear()
            LINE[fault](wire)
        fits = len(self._waiting) + len(wire) <= self._options.buffer
        if fits:
            self._waiting += wire
        return fits

    def flush(self) -> None:
        """Hand on what a line of this speed takes by now."""
        if self._host is None:
            self._waiting.clear()
            return
        most, throttle = 65536, self._options.throttle
        if throttle:
            now = micros()
            self._allowed += throttle * 1e-6 * (now - self._flushed)
            self._allowed, self._flushed = min(self._allowed, 0.01 * throttle), now
            most = int(self._allowed)
        if not (most and self._waiting):
            return
        try:
            sent = os.write(self._host, self._waiting[:most])
        except BlockingIOError:
            return
        except OSError:
            self._leave()
            return
        del self._waiting[:sent]
        self._allowed -= sent

    def wait(self, busy: bool) -> list[bytes]:
        """Packets that a host has sent, after a while or as soon as something comes."""
        want_out = bool(self._waiting) and not self._options.throttle and self._host is not None
        both = [each for each in (self._host, self._server) if each is not None]
        timeout = 0.001 if busy or self._waiting else 0.05
        there, _, _ = select.select(both, [self._host] if want_out else [], [], timeout)
        if self._server in there:
            host, _ = self._server.accept()
            if self._host is None:
                host.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                host.setblocking(False)
                self._host = host.detach()
            else:
                host.close()
        if self._host not in there:
            return []
        try:
            data = os.read(self._host, 4096)
        except BlockingIOError:
            return []
        except OSError:
            data = b""
        if not data:
            self._leave()
        *runs, self._heard = (self._heard + data).split(b"\0")
        self._heard = self._heard[-64:]  # no command is longer
        packets = (unstuffed(run) for run in runs if len(run) <= 64)
        return [
            packet[:-4]
            for packet in packets
            if len(packet) >= 8 and zlib.crc32(packet[:-4]).to_bytes(4, "little") == packet[-4:]
        ]

    def _leave(self) -> None:
        """The host is gone; over TCP another one may come."""
        if self._server is not None:
            os.close(self._host)
            self._host = None
            self._waiting.clear()


class Device:
    """The electronics: what is scanned, and what is answered."""

    def __init__(self, line: Line, options: argparse.Namespace) -> None:
        self.line, self.fault, self.amount = line, options.fault, options.amount
        self.electrodes, self.rate = options.electrodes, options.rate
        self.made = self.rows = self.dropped = 0
        self._rate = self.rate  # of the frame under way; `rate` holds from the next one on
        self._haste = 3.0 if self.fault == "haste" else 1.0
        self.streaming, self._row, self._sequence = False, 0, 0
        self._power_up = self._restarted = micros()
        self._due = float(self._power_up)  # when the frame began
        self._announce = False  # say when the frame begins, for whoever measures its age

    def hit(self) -> bool:
        return random.random() < self.amount

    # -- rows --

    def begin_frame(self) -> None:
        if self._rate != self.rate or self._announce:
            print(
                f"from {self._sequence} {self._due:.0f} {self.rate * self._haste:.9g}", flush=True
            )
        self._announce, self._rate, self._row = False, self.rate, 0
        counts = readings(self._sequence, self.electrodes)
        np.fill_diagonal(counts, NONE)
        self._counts = counts

    def _end_of(self, row: int) -> float:
        """µs from the begin of the frame to the end of a row."""
        return 1e6 * (row + 1) / (self._rate * self._haste * self.electrodes)

    def scan(self) -> None:
        """Rows whose time has come; a computer that was away for more than a second leaves some out."""
        now = micros()
        while self.streaming and now >= self._due + self._end_of(self._row):
            self._send_row()
            self._row += 1
            if self._row < self.electrodes:
                continue
            lasts = self._end_of(self.electrodes - 1)
            behind = int((now - self._due - lasts) // lasts) if now - self._due - lasts > 1e6 else 0
            self._due += (1 + behind) * lasts
            self._sequence += 1 + behind
            self._announce = behind > 0
            self.made += 1
            self.begin_frame()

    def _send_row(self) -> None:
        row = {
            "type": 0x10, "version": 1, "count": self.electrodes, "row": self._row,
            "rows": self.electrodes, "sequence": self._sequence,
            "row_end": int(self._end_of(self._row) * self._haste),
            "time": int(self._due) - self._power_up, "scale": SCALE, "drive": DRIVE,
            "grounded": self._row, "readings": self._counts[self._row],
        }  # fmt: skip
        if self.fault in ROWS and self.hit():
            row |= ROWS[self.fault](row)
        words = (NONE - row["readings"]).astype("<u2").tobytes()
        self.rows += 1
        if not self.line.send(ROW.pack(*(row[key] for key in FIELDS)) + words):
            self.dropped += 1
            return
        if self.fault.endswith("-unasked") and self.hit():
            if self.fault == "error-unasked":
                self._error(0, 0, 4, b"sheet torn")
            elif self.fault == "ack-unasked":
                self._ack(random.randrange(65536), 3)
            else:
                self.streaming = False

    # -- answers --

    def _answer(self, kind: int, tag: int, layout: str = "", *values, text: bytes = b"") -> None:
        self.line.send(struct.pack(f"<BBH{layout}", kind, 1, tag & 0xFFFF, *values) + text)

    def _identify(self, tag: int) -> None:
        count = self.electrodes
        said = {
            "electrodes": count, "more_rows": 0, "range": DRIVE, "rate": self.rate, "name": b"hash"
        } | IDENTITY.get(self.fault, {})  # fmt: skip
        rows = count + said["more_rows"]
        words = [bytes((len(each),)) + each for each in (said["name"], b"1.0", b"C0")]
        text = b"".join(words)[: -4 if self.fault == "identity-short" else None]
        numbers = said["electrodes"], rows, 12, 0, said["range"], said["rate"], 0, FASTEST
        self._answer(0x11, tag, "HHBBffIf", *numbers, text=text)

    def _ack(self, tag: int, command: int) -> None:
        if self.fault == "ack-never" and command != 1:
            return
        tag += 7 * (self.fault == "ack-tag")
        command += 0x10 * (self.fault == "ack-command")
        rate = inf if self.fault == "ack-rate" else self.rate
        self._answer(0x12, tag, "BBf", command, self.streaming, rate)

    def _error(self, tag: int, command: int, code: int, words: bytes) -> None:
        self._answer(0x13, tag, "BB", command, code, text=words)

    def obey(self, packet: bytes) -> None:
        kind, version, tag = struct.unpack_from("<BBH", packet)
        lengths = {1: 4, 2: 4, 3: 4, 4: 8}
        if version != 1:
            self._error(tag, kind, 3, b"version 1 only")
        elif lengths.get(kind) != len(packet):
            self._error(tag, kind, 2 if kind in lengths else 1, b"what?")
        elif kind == 1:
            self._identify(tag)
        elif kind == 4:
            (wish,) = struct.unpack_from("<f", packet, 4)
            if isnan(wish) or not 0 < wish <= FASTEST:
                self._error(tag, kind, 2, b"rate")
            else:
                self.rate = max(wish, SLOWEST)
                self._ack(tag, kind)
        else:
            if kind == 3:
                self.streaming = self.fault == "stop-deaf"
            elif not self.streaming:
                self._start()
            self._ack(tag, kind)

    def _start(self) -> None:
        self.line.put(b"\0")
        self._sequence += self._row > 0
        self.streaming, self._announce, self._due = True, True, float(micros())
        self.begin_frame()

    def restart(self) -> None:
        """Where that is the fault, and its time has come."""
        if not self.fault.startswith("restart") or micros() - self._restarted <= self.amount * 1e6:
            return
        self._power_up = self._restarted = micros()
        self._sequence, self._due = 0, float(self._power_up)
        self.streaming = self.fault == "restart-streaming" and self.streaming
        self.line.clear()
        self.begin_frame()
        print("restarted", flush=True)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--port", default="pty:", help="pty:LINK or tcp:PORT")
    parser.add_argument("--electrodes", type=int, default=64)
    parser.add_argument("--rate", type=float, default=15.625, help="frames/s")
    parser.add_argument("--buffer", type=int, default=1 << 19, help="bytes")
    parser.add_argument(
        "--throttle", type=float, default=0.0, help="bytes/s; 0: as fast as it goes"
    )
    parser.add_argument("--fault", choices=FAULTS, default="none", metavar="NAME")
    parser.add_argument("--amount", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--list", action="store_true", help="of faults")
    options = parser.parse_args()
    if options.list:
        print(*FAULTS, sep="\n")
        return
    over = []
    for number in (signal.SIGTERM, signal.SIGINT):
        signal.signal(number, lambda *_: over.append(True))
    random.seed(options.seed)
    line = Line(options.port, options)
    device = Device(line, options)
    while not over:
        for packet in line.wait(device.streaming):
            device.obey(packet)
        device.restart()
        device.scan()
        line.flush()
    print(f"frames {device.made}, rows {device.rows}, dropped {device.dropped}", flush=True)


if __name__ == "__main__":
    main()
