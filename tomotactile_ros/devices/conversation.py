"""The host's side of the conversation in docs/protocol.md: commands and their answers.

Sections 2 and 4: which version is spoken follows from the answer to IDENTIFY.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import asdict

from tomotactile_ros.devices import protocol
from tomotactile_ros.devices.line import Line, LineFault
from tomotactile_ros.devices.text import READ_AS, is_text
from tomotactile_ros.devices.world import World

ANSWER_TIME = 0.3
ATTEMPTS, LAST_ATTEMPT = 5, 15
VERSION_ATTEMPTS = 3

_TOLD_BY = 1024  # bytes: lines of text are shorter


class Conversation:
    """Speaks with the device on one line; `arrival` is when it was last read (s, by `world.now`).

    Parameters
    ----------
    line : Line
        Open.
    parser : protocol.Parser
        Its counters go on from line to line.
    world : World
    address : int
        Of the device, on a bus; packets of others are left out, and counted in `others`.

    Attributes
    ----------
    version : int
        Of the protocol; known after `identify`.
    """

    def __init__(
        self,
        line: Line,
        parser: protocol.Parser,
        world: World,
        address: int = protocol.NO_ADDRESS,
    ) -> None:
        self.line, self.parser, self.address = line, parser, address
        self.arrival = 0.0
        self.version = 1
        self.others = 0
        self._world = world
        self._data = b""  # that came last
        self._tag = world.first_tag()

    def listen(self, timeout: float) -> list[protocol.Packet]:
        """Packets that have come, waiting up to `timeout` s for the first byte."""
        data, self.arrival = self._world.read(self.line, timeout)
        self._data = (self._data + data)[-_TOLD_BY:]
        packets = self.parser.feed(data)
        mine = [packet for packet in packets if packet.address == self.address]
        self.others += len(packets) - len(mine)
        return mine

    def command(self, kind: int) -> int:
        """Send IDENTIFY, STOP, KEEP_ALIVE or a START without end; return the tag of its answer."""
        return self._send(protocol.Command(kind, self._next_tag()))

    def start(self, timeout: float = 0.0, frames: int = 0) -> int:
        """Send START; in version 2 with the time in s and the number of frames until it ends."""
        if self.version == 1:
            return self.command(protocol.START)
        return self._send(protocol.Start(self._next_tag(), round(1e3 * timeout), frames))

    def set_rate(self, rate: float) -> int:
        """Ask for `rate` frames/s; return the tag of the answer."""
        return self._send(protocol.SetRate(self._next_tag(), rate))

    def set_scan(self, order: tuple[int, ...]) -> int:
        """Ask for an order of the scan, none for the device's own; return the tag of the answer."""
        return self._send(protocol.SetScan(self._next_tag(), order))

    def identify(self, report: Callable[[LineFault], None]) -> protocol.Identity | None:
        """Ask who is there until there is an answer; None if closed in the meantime.

        After `ATTEMPTS` without answer, what is wrong goes to `report`; after `LAST_ATTEMPT` it is
        raised, and the line should be opened anew.
        """
        self.parser.reset()
        before = asdict(self.parser.counters)
        self._world.write(self.line, b"\0")
        self.version = 1 if self.address == protocol.NO_ADDRESS else 2
        asked: set[int] = set()
        for attempt in range(1, LAST_ATTEMPT + 1):
            identity = self._ask_once(asked)
            if self._world.stopped():
                return identity
            if identity is not None:
                return self._newer(identity) if identity.also else identity
            if attempt >= ATTEMPTS:
                fault = self._why_no_identity(before)
                report(fault)
        raise fault

    def _newer(self, identity: protocol.Identity) -> protocol.Identity:
        """Ask a device that speaks version 2, too, in that version; else go on in version 1."""
        self.version = 2
        for _ in range(VERSION_ATTEMPTS):
            try:
                newer = self._ask_once(set())
            except LineFault as fault:
                if fault.state != "refused":
                    raise
                break
            if newer is not None:
                return newer
        self.version = 1
        return identity

    def _ask_once(self, asked: set[int]) -> protocol.Identity | None:
        asked.add(self.command(protocol.IDENTIFY))
        now = self._world.now()
        deadline = now + ANSWER_TIME
        while not self._world.stopped() and now < deadline:
            for packet in self.listen(min(deadline - now, 0.1)):
                if isinstance(packet, protocol.Identity) and packet.tag in asked:
                    self.version = packet.version
                    return packet
                if isinstance(packet, protocol.Error) and packet.tag in asked:
                    if packet.version > self.version:
                        self.version = packet.version  # it speaks no older one
                        return None
                    raise LineFault("refused", f"port: device on {self.line.name}: {packet}")
            now = self.arrival
        return None

    def _why_no_identity(self, before: dict[str, int]) -> LineFault:
        port = self.line.name
        since = {name: n - before[name] for name, n in asdict(self.parser.counters).items()}
        if since["packets"]:
            return LineFault("refused", f"port: {port} sends packets but does not answer IDENTIFY")
        if since["malformed"]:
            return LineFault("refused", f"port: {port}: {self.parser.last_complaint}")
        if since["bytes"] and is_text(self._data):
            return LineFault("garbled", f"port: {port} prints text; {READ_AS}")
        if since["bytes"]:
            return LineFault(
                "garbled",
                f"port: {since['bytes']} bytes from {port} at {self.line.baud} bit/s and no valid "
                "packet; wrong baud rate or another kind of device",
            )
        return LineFault(
            "silent", f"port: {port} is open but nothing answers; is the sensor powered?"
        )

    def _next_tag(self) -> int:
        self._tag = self._tag % 0xFFFF + 1
        return self._tag

    def _send(self, packet: protocol.FromHost) -> int:
        packet = packet._replace(version=self.version, address=self.address)
        self._world.write(self.line, protocol.encode(packet))
        return packet.tag


def check_identity(identity: protocol.Identity, electrodes: int, port: str) -> None:
    """Raise `LineFault` where the device cannot serve a layout of so many electrodes."""
    if identity.version == 1 and identity.rows > identity.electrodes:
        raise LineFault(
            "refused",
            f"port: {identity.name} on {port} announces {identity.rows} ground conditions for "
            f"{identity.electrodes} electrodes; at most one each is possible",
        )
    if identity.electrodes != electrodes:
        raise LineFault(
            "refused",
            f"port: {identity.name} on {port} has {identity.electrodes} electrodes, the layout "
            f"{electrodes}; choose the layout that fits the sensor",
        )
