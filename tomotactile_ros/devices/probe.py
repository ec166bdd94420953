"""A line to a device whose manners are to be tried: commands out, packets and their times in."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import TypeVar

from tomotactile_ros.devices import protocol
from tomotactile_ros.devices.line import Line

PAUSE = 0.3  # s in which an answer, or its absence, is waited for
QUIET = 0.15  # s without a row: it has stopped
Answer = TypeVar("Answer", protocol.Identity, protocol.Ack, protocol.Error, protocol.Status)


@dataclass(frozen=True)
class Heard:
    """A packet and when it had come, s."""

    packet: protocol.Packet
    time: float


class Broken(Exception):
    """A device does not keep a rule; the text says what it does instead."""


class Untried(Exception):
    """A rule cannot be tried with this device; the text says why."""


class Probe:
    """Talks with a device, and keeps all that it says.

    Parameters
    ----------
    line : Line
        Open.
    address : int
        Of the device, on a bus.
    now : callable
        The time, s.

    Attributes
    ----------
    version : int
        In which commands are sent.
    heard : list of Heard
        Packets since the last `forget`.
    bytes : bytearray
        All bytes since then.
    slowest : float
        Longest time that an answer took, s.
    """

    def __init__(
        self,
        line: Line,
        address: int = protocol.NO_ADDRESS,
        now: Callable[[], float] = time.monotonic,
    ) -> None:
        self.version, self.address = 1, address
        self.heard: list[Heard] = []
        self.bytes = bytearray()
        self.slowest = 0.0
        self.now = now
        self._line = line
        self.parser = protocol.Parser()
        self._tag = 0x0100

    def forget(self) -> None:
        """Begin a new account of what is heard."""
        self.heard, self.bytes = [], bytearray()

    def next_tag(self) -> int:
        """A tag that was not used yet."""
        self._tag = self._tag % 0xFFFF + 1
        return self._tag

    def listen(self, seconds: float, until: Callable[[], object] | None = None) -> None:
        """Take in what comes, for some time or until a condition holds."""
        end = self.now() + seconds
        while (left := end - self.now()) > 0 and not (until and until()):
            data = self._line.read(min(left, 0.02))
            now = self.now()
            self.bytes += data
            self.heard += [Heard(packet, now) for packet in self.parser.feed(data)]

    def be_quiet(self) -> None:
        """Stop the device, and wait until nothing comes any more."""
        for _ in range(5):
            tag = self.send(protocol.Command(protocol.STOP, 0))
            self.answer(tag)
            self.forget()
            self.listen(QUIET)
            if not self.rows():
                self.forget()
                return
        raise Broken("STOP does not stop it")

    def send(self, packet: protocol.FromHost | bytes, address: int | None = None) -> int:
        """Send a command in the probe's version, with a new tag; or the content of a packet.

        Returns the tag.
        """
        if isinstance(packet, bytes):
            self._line.write(protocol.frame(packet))
            return int.from_bytes(packet[2:4], "little")
        tag = packet.tag or self.next_tag()
        address = self.address if address is None else address
        packet = packet._replace(tag=tag, version=self.version, address=address)
        self._line.write(protocol.encode(packet))
        return tag

    def head(
        self, kind: int, version: int | None = None, tag: int | None = None, rows: int = 0
    ) -> bytes:
        """How a command begins, by default in the probe's version and with a new tag; `rows` of SET_SCAN."""
        version = self.version if version is None else version
        tag = self.next_tag() if tag is None else tag
        start = bytes([kind, version]) + tag.to_bytes(2, "little")
        return start + (bytes([rows, 0, self.address, 0]) if version > 1 else b"")

    def write(self, data: bytes) -> None:
        """Send bytes as they are."""
        self._line.write(data)

    def answer(self, tag: int, seconds: float = PAUSE) -> protocol.Packet | None:
        """What answers a tag, None if nothing does in time."""
        begin = self.now()
        self.listen(seconds, lambda: self.answers(tag))
        found = self.answers(tag)
        if not found:
            return None
        self.slowest = max(self.slowest, found[0].time - begin)
        return found[0].packet

    def answers(self, tag: int) -> list[Heard]:
        """Packets that are no rows and carry the tag."""
        return [
            h for h in self.heard if not isinstance(h.packet, protocol.Row) and h.packet.tag == tag
        ]

    def ask(self, packet: protocol.FromHost | bytes, kind: type[Answer]) -> Answer:
        """Send a command; return its answer, which must be of that kind."""
        tag = self.send(packet)
        found = self.answer(tag)
        name = name_of(packet[0] if isinstance(packet, bytes) else protocol.type_of(packet))
        if found is None:
            raise Broken(f"no answer to {name} within {PAUSE:g} s")
        if not isinstance(found, kind):
            said = f" ({found})" if isinstance(found, protocol.Error) else ""
            given = name_of(protocol.type_of(found))
            raise Broken(f"{name} is answered with {given}{said}, not {kind.__name__.upper()}")
        return found

    def start(self, timeout: int = 0, frames: int = 0) -> protocol.Ack:
        """Send START of the probe's version; return the ACK."""
        if self.version == 1:
            return self.ask(protocol.Command(protocol.START, 0), protocol.Ack)
        return self.ask(protocol.Start(0, timeout, frames), protocol.Ack)

    def rows(self) -> list[protocol.Row]:
        """The rows that were heard."""
        return [h.packet for h in self.heard if isinstance(h.packet, protocol.Row)]

    def wait_for_rows(self, count: int, seconds: float) -> list[protocol.Row]:
        """The rows heard, once there are so many."""
        self.listen(seconds, lambda: len(self.rows()) >= count)
        rows = self.rows()
        if len(rows) < count:
            raise Broken(f"{len(rows)} rows within {seconds:.3g} s, {count} were due")
        return rows


def name_of(kind: int) -> str:
    """Name of a type of packets."""
    names = (
        "IDENTIFY", "START", "STOP", "SET_RATE", "SET_SCAN", "KEEP_ALIVE", "ROW", "IDENTITY", "ACK",
        "ERROR", "STATUS",
    )  # fmt: skip
    return {getattr(protocol, name): name for name in names}.get(kind, f"type 0x{kind:02x}")
