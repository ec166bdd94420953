"""The host's side of the conversation in docs/protocol.md, section 2: commands and their answers."""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable
from dataclasses import asdict

from tomotactile_ros.devices import protocol
from tomotactile_ros.devices.line import Line, LineFault

ANSWER_TIME = 0.3
ATTEMPTS, LAST_ATTEMPT = 5, 15


class Conversation:
    """Speaks with the device on one line; `arrival` is when it was last read (s, monotonic).

    Parameters
    ----------
    line : Line
        Open.
    parser : protocol.Parser
        Its counters go on from line to line.
    closing : threading.Event
        Ends all waiting.
    """

    def __init__(self, line: Line, parser: protocol.Parser, closing: threading.Event) -> None:
        self.line, self.parser = line, parser
        self.arrival = 0.0
        self._closing = closing
        self._tag = random.randrange(0xFFFF)  # answers to whoever asked before must not fit

    def listen(self, timeout: float) -> list[protocol.Packet]:
        """Packets that have come, waiting up to `timeout` s for the first byte."""
        data = self.line.read(timeout)
        self.arrival = time.monotonic()
        return self.parser.feed(data)

    def command(self, kind: int) -> int:
        """Send IDENTIFY, START or STOP; return the tag of its answer."""
        return self._send(protocol.Command(kind, self._next_tag()))

    def set_rate(self, rate: float) -> int:
        """Ask for `rate` frames/s; return the tag of the answer."""
        return self._send(protocol.SetRate(self._next_tag(), rate))

    def identify(self, report: Callable[[LineFault], None]) -> protocol.Identity | None:
        """Ask who is there until there is an answer; None if closed in the meantime.

        After `ATTEMPTS` without answer, what is wrong goes to `report`; after `LAST_ATTEMPT` it is
        raised, and the line should be opened anew.
        """
        self.parser.reset()
        before = asdict(self.parser.counters)
        self.line.write(b"\0")
        asked: set[int] = set()
        for attempt in range(1, LAST_ATTEMPT + 1):
            identity = self._ask_once(asked)
            if identity is not None or self._closing.is_set():
                return identity
            if attempt >= ATTEMPTS:
                fault = self._why_no_identity(before)
                report(fault)
        raise fault

    def _ask_once(self, asked: set[int]) -> protocol.Identity | None:
        asked.add(self.command(protocol.IDENTIFY))
        deadline = time.monotonic() + ANSWER_TIME
        while not self._closing.is_set() and (left := deadline - time.monotonic()) > 0:
            for packet in self.listen(min(left, 0.1)):
                if isinstance(packet, protocol.Identity) and packet.tag in asked:
                    return packet
                if isinstance(packet, protocol.Error) and packet.tag in asked:
                    raise LineFault("refused", f"port: device on {self.line.name}: {packet}")
        return None

    def _why_no_identity(self, before: dict[str, int]) -> LineFault:
        port = self.line.name
        since = {name: n - before[name] for name, n in asdict(self.parser.counters).items()}
        if since["packets"]:
            return LineFault("refused", f"port: {port} sends packets but does not answer IDENTIFY")
        if since["malformed"]:
            return LineFault("refused", f"port: {port}: {self.parser.last_complaint}")
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

    def _send(self, packet: protocol.Command | protocol.SetRate) -> int:
        self.line.write(protocol.encode(packet))
        return packet.tag


def check_identity(identity: protocol.Identity, electrodes: int, port: str) -> None:
    """Raise `LineFault` where the device cannot serve a layout of so many electrodes."""
    if identity.rows > identity.electrodes:
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
