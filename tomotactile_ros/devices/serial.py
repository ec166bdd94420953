"""The real sensor: the host's side of docs/protocol.md over a serial line, with recovery.

connect -> identify -> set the rate, start -> stream, and from the beginning after every fault.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import asdict, replace

from tomotactile_ros.devices import protocol
from tomotactile_ros.devices.assembly import AssemblyCounters, FrameAssembler, RowsOfFrame
from tomotactile_ros.devices.base import Frame, Status, ThreadedDevice, unix_time
from tomotactile_ros.devices.clock import DeviceClock
from tomotactile_ros.devices.conversation import ANSWER_TIME, Conversation, check_identity
from tomotactile_ros.devices.line import Line, LineFault, open_line

FIRST_RETRY, LAST_RETRY = 0.05, 0.5
SILENCE, SILENT_FRAMES = 1.0, 3.0
RATE_TOLERANCE = 1.5


def retry_delays(first: float = FIRST_RETRY, last: float = LAST_RETRY):
    """Yield the waits between attempts to connect, s: doubled each time, never above `last`."""
    delay = first
    while True:
        yield delay
        delay = min(2.0 * delay, last)


class SerialDevice(ThreadedDevice):
    """Frames from hardware that speaks the wire protocol.

    Parameters
    ----------
    port : str
        See `tomotactile_ros.devices.line.find_port`.
    electrodes : int
        Electrodes of the layout; a device with another number is refused.
    baud : int
        Bit rate, for ports that have one.
    rate : float
        Wanted frames/s; 0 leaves the device's own rate.
    partial_frames : bool
        Deliver incomplete frames with NaN rows, instead of dropping them.
    opener : callable
        How a port is opened; for tests.
    """

    def __init__(
        self,
        port: str,
        electrodes: int,
        *,
        baud: int = 2_000_000,
        rate: float = 0.0,
        partial_frames: bool = False,
        opener: Callable[[str, int], Line] = open_line,
    ) -> None:
        super().__init__(rate)
        self.identity: protocol.Identity | None = None
        self._port, self._baud, self._electrodes = port, baud, electrodes
        self._partial = partial_frames
        self._opener = opener
        self._reset()

    def _reset(self) -> None:
        self._parser = protocol.Parser()
        self._lost = AssemblyCounters()
        self._clock = DeviceClock()
        self._connections = 0
        self._low_latency = False
        self._found = ""
        self._device_rate = 0.0
        self._note = ""

    def open(self, on_frame: Callable[[Frame], None]) -> None:
        """Start; returns at once, the port is opened by the thread."""
        if self._thread is None:
            self._reset()
        super().open(on_frame)

    def status(self) -> Status:
        """As for every device; while streaming the message tells a wrong rate or a refused wish."""
        status = super().status()
        if status.state != "streaming":
            return status
        seen, due = status.counters["rate_seen"], self._device_rate
        hurry = ""
        if 0 < RATE_TOLERANCE * due < seen:
            hurry = f"sends {seen:.4g} frames/s instead of {due:.4g}"
        return replace(status, message=_joined(status.message, self._note, hurry))

    def _counters(self) -> dict[str, float]:
        counted = {**asdict(self._parser.counters), **asdict(self._lost)}
        return {
            **{name: float(number) for name, number in counted.items()},
            "rate_device": self._device_rate,
            "reconnects": float(max(0, self._connections - 1)),
            "clock_jumps": float(self._clock.jumps),
            "clock_drift_ppm": 1e6 * self._clock.drift,
            "low_latency": float(self._low_latency),
        }

    def _run(self) -> None:
        delays = retry_delays()
        while not self._stop.is_set():
            connections = self._connections
            try:
                self._one_connection()
            except LineFault as fault:
                self._report(fault)
            if self._connections > connections:
                delays = retry_delays()
            if not self._stop.is_set():
                self._stop.wait(next(delays))

    def _one_connection(self) -> None:
        line = self._open_line()
        if line is None:
            return
        try:
            self._low_latency, self._found = line.low_latency, line.name
            if self._state[0] in ("closed", "disconnected"):
                self._set_state("identifying", f"asking {self._port} for its identity")
            talk = Conversation(line, self._parser, self._stop)
            while not self._stop.is_set():
                identity = talk.identify(self._report)
                if identity is not None:
                    self._accept(identity)
                    self._stream(talk)
        finally:
            line.close()

    def _open_line(self) -> Line | None:
        """Open the port; None if closed in the meantime: the network may take seconds to fail."""
        opening: Future[Line] = Future()

        def attempt() -> None:
            try:
                opening.set_result(self._opener(self._port, self._baud))
            except Exception as error:  # noqa: BLE001 - raised by `result`
                opening.set_exception(error)
            self._changed.set()

        threading.Thread(target=attempt, daemon=True).start()
        while not opening.done() and not self._stop.is_set():
            self._changed.wait()
            self._changed.clear()
        if self._stop.is_set():
            opening.add_done_callback(lambda it: it.exception() or it.result().close())
            return None
        return opening.result()

    def _report(self, fault: LineFault) -> None:
        self._set_state(fault.state, str(fault))

    def _accept(self, identity: protocol.Identity) -> None:
        check_identity(identity, self._electrodes, self._found)
        self.identity = identity
        self._agree_on_rate(identity.rate)
        self._assembler = FrameAssembler(
            identity.electrodes, identity.rows, self._partial, self._lost
        )
        self._clock = self._clock.successor()
        self._connections += 1

    def _stream(self, talk: Conversation) -> None:
        """Take in packets until the line falls silent (returns) or is lost (raises).

        A frame that was under way is not waited for: it may be one of a very low rate.
        """
        talk.command(protocol.STOP)
        self._apply_settings(talk)
        counters = self._parser.counters
        bytes_then = counters.bytes
        while not self._stop.is_set():
            if self._changed.is_set():
                self._apply_settings(talk)
            elif self._unanswered and time.monotonic() - self._told > ANSWER_TIME:
                self._tell_settings(talk)
            packets, arrival = talk.listen(0.1), talk.arrival
            for packet in packets:
                self._take(packet, arrival)
            if packets:
                self._heard, bytes_then = arrival, counters.bytes
                self._report_rows_without_frames(arrival)
            elif arrival - self._heard > self._patience() and (self._started or self._unanswered):
                self._report_silence(counters.bytes - bytes_then)
                return
        talk.command(protocol.STOP)

    def _patience(self) -> float:
        return max(SILENCE, SILENT_FRAMES / self._device_rate)

    def _report_silence(self, garbage: int) -> None:
        if garbage:
            self._set_state("garbled", f"port: {garbage} bytes from {self._port}, no valid packet")
        else:
            self._set_state("silent", _joined(f"port: {self._port} sends nothing", self._note))

    def _report_rows_without_frames(self, now: float) -> None:
        if not self._started or now - self._framed <= self._patience():
            return
        lost = self._assembler.counters
        self._set_state(
            "garbled",
            f"port: packets from {self._port} but no complete frame ({lost.packets_lost} packets "
            f"lost, {lost.rows_ignored} that fit no frame); check the line or set partial_frames",
        )

    def _apply_settings(self, talk: Conversation) -> None:
        self._changed.clear()
        self._note = ""
        self._heard = self._framed = time.monotonic()
        self._started = self._streaming
        self._tell_settings(talk)
        if not self._started:
            self._set_state("stopped", f"{self._describe()}; stopped on request")

    def _tell_settings(self, talk: Conversation) -> None:
        """Send the settings; again, as long as one of them is without an answer."""
        self._told = time.monotonic()
        self._unanswered = {talk.set_rate(self._rate)} if self._rate > 0 else set()
        self._unanswered.add(talk.command(protocol.START if self._started else protocol.STOP))

    def _agree_on_rate(self, rate: float) -> None:
        if rate != self._device_rate:
            self._device_rate = rate
            self.health.forget_rate()

    def _describe(self) -> str:
        i = self.identity
        return f"{i.name} {i.serial} (firmware {i.firmware}) on {self._found}"

    def _take(self, packet: protocol.Packet, arrival: float) -> None:
        if isinstance(packet, protocol.Row):
            for rows in self._assembler.feed(packet):
                if self._started:
                    self._publish(rows, arrival, len(packet.readings))
        elif isinstance(packet, protocol.Ack):
            self._unanswered.discard(packet.tag)
            self._agree_on_rate(packet.rate)
            if not packet.streaming:
                self._assembler.abandon()
        elif isinstance(packet, protocol.Error):
            self._unanswered.discard(packet.tag)
            self._note = f"device: {packet}"

    def _publish(self, rows: RowsOfFrame, arrival: float, row_bytes: int) -> None:
        line_rate = self.identity.line_rate
        on_the_line = 10.0 * (row_bytes + 40) / line_rate if line_rate else 0.0
        self._clock.update(1e-6 * rows.last_sample, arrival - on_the_line)
        stamp = unix_time(self._clock.stamp(1e-6 * rows.frame_time))
        self._framed = arrival
        if self._state[0] != "streaming":
            self._set_state("streaming", self._describe())
        frame = Frame(
            rows.voltages,
            rows.grounded,
            rows.sequence,
            stamp,
            rows.drive_voltage,
            self._clock.duration(1e-6 * rows.row_period),
        )
        self._deliver(frame, self._clock.to_host(1e-6 * rows.last_sample))
        self._clock.fit()


def _joined(*remarks: str) -> str:
    return "; ".join(filter(None, remarks))
