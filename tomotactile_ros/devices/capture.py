"""Raw capture: all that a serial device learns from outside, in a file, and the way back.

The format is that of docs/hardware.md.  Kinds of records: O, a port was opened; F, it could not be, or
was lost; G, the number behind which tags begin; R, bytes read; W, bytes written; S, settings; N, the
clock; U, the Unix time of a moment; Q, the end.  The device decides from what the file holds
alone (devices/world.py): living it again gives the same frames, to the bit.
"""

from __future__ import annotations

import json
import os
import struct
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import IO

from tomotactile_ros.devices.line import Line, LineFault
from tomotactile_ros.devices.world import Settings, World
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import open_regular

FORMAT = b"tomotactile-raw/1\n"
MAX_BYTES = 16_000_000_000
_RECORD = struct.Struct("<cdI")
_LONGEST_HEADER = 1 << 20  # an order of 65535 rows fits
_LONGEST_RECORD = 1 << 20
_FLUSH_PERIOD = 1.0  # s


class Capture(World):
    """A world that writes down what it says; never the reason that a device stops.

    Parameters
    ----------
    path : path
        Of the file. One that is there already is never touched: a number is put behind the name.
    header : dict
        Settings of the device.
    world : World
        What is written down.

    Attributes
    ----------
    trouble : str
        Why nothing is written any more; empty while it is.

    Raises
    ------
    InputError
        The file cannot be made.
    """

    def __init__(self, path: str | os.PathLike, header: dict, world: World) -> None:
        self.world = world
        self.trouble = ""
        self._stopped = False
        self._flushed = 0.0
        self._file, self.path = _create(path)
        self._size = 0
        self._put(FORMAT + json.dumps(header).encode() + b"\n")

    def close(self) -> None:
        """End the file."""
        try:
            self._file.close()
        except OSError as error:
            self._give_up(error)

    def now(self) -> float:
        """As of `World`, and so are all below."""
        now = self.world.now()
        self._record(b"N", time=now)
        return now

    def unix_time(self, monotonic: float) -> float:
        stamp = self.world.unix_time(monotonic)
        self._record(b"U", time=stamp)
        return stamp

    def first_tag(self) -> int:
        tag = self.world.first_tag()
        self._record(b"G", json.dumps(tag).encode())
        return tag

    def stopped(self) -> bool:
        if not self._stopped and self.world.stopped():
            self._stopped = True
            self._record(b"Q")
        return self._stopped

    def changed(self) -> bool:
        return self.world.changed()

    def settings(self) -> Settings:
        settings = self.world.settings()
        self._record(b"S", json.dumps(asdict(settings)).encode())
        return settings

    def wait(self, seconds: float) -> None:
        self.world.wait(seconds)

    def open(self, port: str, baud: int) -> Line | None:
        line = self._watched(lambda: self.world.open(port, baud))
        if line is not None:
            said = {"name": line.name, "baud": line.baud, "low_latency": line.low_latency}
            self._record(b"O", json.dumps(said).encode())
        return line

    def read(self, line: Line, timeout: float) -> tuple[bytes, float]:
        data, arrival = self._watched(lambda: self.world.read(line, timeout))
        self._record(b"R", data, arrival)
        if arrival - self._flushed > _FLUSH_PERIOD:
            self._flushed = arrival
            self._flush()
        return data, arrival

    def write(self, line: Line, data: bytes) -> None:
        self._watched(lambda: self.world.write(line, data))
        self._record(b"W", data)

    def _watched(self, act: Callable):
        try:
            return act()
        except LineFault as fault:
            said = {"state": fault.state, "message": str(fault)}
            self._record(b"F", json.dumps(said).encode())
            raise

    def _record(self, kind: bytes, content: bytes = b"", time: float = 0.0) -> None:
        self._put(_RECORD.pack(kind, time, len(content)) + content)

    def _put(self, data: bytes) -> None:
        if self.trouble:
            return
        self._size += len(data)
        if self._size > MAX_BYTES:
            self.trouble = (
                f"capture: {self.path} has {MAX_BYTES / 1e9:g} GB: the rest is not captured"
            )
            self._flush()
            return
        try:
            self._file.write(data)
        except (OSError, ValueError) as error:
            self._give_up(error)

    def _flush(self) -> None:
        try:
            self._file.flush()
        except (OSError, ValueError) as error:
            self._give_up(error)

    def _give_up(self, error: Exception) -> None:
        reason = getattr(error, "strerror", None) or error
        self.trouble = f"capture: {self.path} ends here, the rest is not captured: {reason}"


class EndOfCapture(Exception):
    """Nothing is left of a capture."""


class Relived(World):
    """The world of a capture; asked for anything else than it was then, it raises InputError."""

    def __init__(self, path: str | os.PathLike) -> None:
        self._path = path
        self._records = _records(path)
        self.header = _header(path, next(self._records).content)
        self._next: _Record | None = next(self._records, None)
        self._stopped = False

    def now(self) -> float:
        """As of `World`, and so are all below."""
        return self._take(b"N").time

    def unix_time(self, monotonic: float) -> float:
        return self._take(b"U").time

    def first_tag(self) -> int:
        return int(self._json(self._take(b"G")))

    def stopped(self) -> bool:
        if not self._stopped and (self._next is None or self._next.kind == b"Q"):
            self._stopped = True
            self._next = next(self._records, None)
        return self._stopped

    def changed(self) -> bool:
        return self._next is not None and self._next.kind == b"S"

    def settings(self) -> Settings:
        said = self._json(self._take(b"S"))
        return Settings(said["rate"], said["streaming"], tuple(said["scan"]))

    def wait(self, seconds: float) -> None:
        pass

    def open(self, port: str, baud: int) -> RelivedLine | None:
        if self._next is not None and self._next.kind == b"Q":
            return None
        return RelivedLine(**self._json(self._take(b"O")))

    def read(self, line: Line, timeout: float) -> tuple[bytes, float]:
        record = self._take(b"R")
        return record.content, record.time

    def write(self, line: Line, data: bytes) -> None:
        if self._take(b"W").content != data:
            raise self._mismatch("wrote other bytes")

    def _take(self, kind: bytes) -> _Record:
        record = self._next
        if record is None:
            raise EndOfCapture
        if record.kind not in (kind, b"F"):
            raise self._mismatch(
                f"did {record.kind.decode(errors='replace')!r}, now {kind.decode()!r}"
            )
        self._next = next(self._records, None)
        if record.kind == b"F":
            said = self._json(record)
            raise LineFault(said["state"], said["message"])
        return record

    def _json(self, record: _Record):
        try:
            return json.loads(record.content)
        except (ValueError, RecursionError):
            raise InputError(f"{self._path}: record at byte {record.at}: is no JSON") from None

    def _mismatch(self, what: str) -> InputError:
        at = self._next.at if self._next else "the end"
        return InputError(
            f"{self._path}: at byte {at} the device {what}: captured by another version?"
        )


@dataclass
class RelivedLine(Line):
    """What a device knows of the line of a capture."""

    name: str
    baud: int
    low_latency: bool

    def close(self) -> None:
        """Nothing is open."""


@dataclass(frozen=True)
class _Record:
    kind: bytes
    time: float
    content: bytes
    at: int


def _create(path: str | os.PathLike) -> tuple[IO[bytes], Path]:
    """A new file of this name, or with a number behind it where there is one."""
    path = Path(path)
    flags = os.O_WRONLY | os.O_CREAT | os.O_EXCL | getattr(os, "O_NOFOLLOW", 0)
    for number in range(1, 10_000):
        name = path if number == 1 else path.with_stem(f"{path.stem}-{number}")
        try:
            return os.fdopen(os.open(name, flags, 0o666), "wb", 1 << 16), name
        except FileExistsError:
            continue
        except (OSError, ValueError) as error:
            reason = getattr(error, "strerror", None) or error
            raise InputError(f"capture: {name}: cannot be made: {reason}") from None
    raise InputError(f"capture: {path} and 9998 more are there already")


def _records(path: str | os.PathLike) -> Iterator[_Record]:
    """The header, as a record of the kind H, and the records up to the first that is cut."""
    try:
        with os.fdopen(open_regular(path, MAX_BYTES), "rb") as file:
            if file.readline(len(FORMAT)) != FORMAT:
                raise InputError(f"{path}: is no raw capture")
            header = file.readline(_LONGEST_HEADER)
            yield _Record(b"H", 0.0, header, len(FORMAT))
            at = len(FORMAT) + len(header)
            while len(head := file.read(_RECORD.size)) == _RECORD.size:
                kind, time, length = _RECORD.unpack(head)
                if length > _LONGEST_RECORD:
                    raise InputError(
                        f"{path}: record at byte {at}: {length} bytes, longer than any record"
                    )
                content = file.read(length)
                if len(content) < length:
                    return
                yield _Record(kind, time, content, at)
                at += _RECORD.size + length
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None


def _header(path: str | os.PathLike, line: bytes) -> dict:
    try:
        header = json.loads(line)
    except (ValueError, RecursionError):
        raise InputError(f"{path}: line 2: is no JSON") from None
    if not isinstance(header, dict):
        raise InputError(f"{path}: line 2: is no mapping of settings")
    return header
