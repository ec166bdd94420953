"""The real sensor: the host's side of docs/protocol.md over a serial line, with recovery.

connect -> identify -> set the rate, start -> stream, and from the beginning after every fault.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import asdict

from tomotactile_ros.devices import protocol
from tomotactile_ros.devices.assembly import AssemblyCounters, FrameAssembler, RowsOfFrame
from tomotactile_ros.devices.base import Frame, ThreadedDevice, unix_time
from tomotactile_ros.devices.clock import DeviceClock
from tomotactile_ros.devices.conversation import ANSWER_TIME, Conversation, check_identity
from tomotactile_ros.devices.health import Trouble
from tomotactile_ros.devices.line import Line, LineFault, open_line

FIRST_RETRY, LAST_RETRY = 0.05, 0.5
SILENCE, SILENT_FRAMES = 1.0, 3.0
RATE_TOLERANCE = 1.5
LATE_PERIOD, LATE_BUT_USED = 2.0, 60.0
EMPTYING_TIME = 60.0


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
        self._note, self._faulty = "", False
        self._answers_ignored = 0

    def open(self, on_frame: Callable[[Frame], None]) -> None:
        """Start; returns at once, the port is opened by the thread."""
        if self._thread is None:
            self._reset()
        super().open(on_frame)

    def _troubles(self) -> list[Trouble]:
        """As of every device; also a refused wish, a fault of the device, a wrong rate."""
        found = super()._troubles()
        if self._note:
            found.append(Trouble("device", self._faulty, self._note))
        seen = self.health.counters()["rate_seen"]
        if 0 < RATE_TOLERANCE * self._device_rate < seen:
            text = f"sends {seen:.4g} frames/s instead of {self._device_rate:.4g}"
            found.append(Trouble("rate", False, text))
        return found

    def _counters(self) -> dict[str, float]:
        counted = {**asdict(self._parser.counters), **asdict(self._lost)}
        return {
            **{name: float(number) for name, number in counted.items()},
            "rate_device": self._device_rate,
            "answers_ignored": float(self._answers_ignored),
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
        self._empty(talk)
        self._anchored = False
        self._apply_settings(talk)
        counters = self._parser.counters
        bytes_then = counters.bytes
        while not self._stop.is_set():
            if self._changed.is_set():
                self._apply_settings(talk)
            elif self._wanted and time.monotonic() - self._told > ANSWER_TIME:
                self._tell_settings(talk)
            packets, arrival = talk.listen(0.1), talk.arrival
            for packet in packets:
                self._take(packet, arrival)
            if packets:
                self._heard, bytes_then = arrival, counters.bytes
                self._report_rows_without_frames(arrival)
            elif arrival - self._heard > self._patience() and (self._started or self._wanted):
                self._report_silence(counters.bytes - bytes_then)
                return
            if self._is_behind(arrival):
                self._empty(talk)
                return
        talk.command(protocol.STOP)

    def _empty(self, talk: Conversation) -> None:
        """Stop the device, and throw away what is still on the way: it would be taken for new.

        An answer comes behind what was sent before it. A device that is silent may have none;
        `LineFault` where it goes on sending all the same.
        """
        tags: set[int] = set()
        begin = heard = time.monotonic()
        told = -math.inf
        while not self._stop.is_set():
            now = time.monotonic()
            if now - heard > SILENCE:
                return
            if now - begin > EMPTYING_TIME:
                raise LineFault("refused", f"port: {self._found} sends and does not answer STOP")
            if now - told > ANSWER_TIME:
                tags.add(talk.command(protocol.STOP))
                told = now
            for packet in talk.listen(0.1):
                if isinstance(packet, (protocol.Ack, protocol.Error)) and packet.tag in tags:
                    return
                heard = talk.arrival

    def _is_behind(self, now: float) -> bool:
        """Whether the line should be emptied: late for long, by too much or for very long.

        An empty line has no delay. Where the device's clock has jumped, that is put right, too.
        """
        since = self._clock.late_since
        if since is None:
            return False
        stale = self.health.stale_within(0.5 * LATE_PERIOD)
        return now - since > (LATE_PERIOD if stale else LATE_BUT_USED)

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
        self._note, self._faulty = "", False
        self._heard = self._framed = time.monotonic()
        self._started = self._streaming
        self._asked: dict[int, int] = {}  # tag -> command
        self._wanted = [protocol.SET_RATE] if self._rate > 0 else []
        self._wanted.append(protocol.START if self._started else protocol.STOP)
        self._tell_settings(talk)
        if not self._started:
            self._set_state("stopped", f"{self._describe()}; stopped on request")

    def _tell_settings(self, talk: Conversation) -> None:
        """Send the settings that have no answer yet."""
        self._told = time.monotonic()
        for kind in self._wanted:
            rate = kind == protocol.SET_RATE
            self._asked[talk.set_rate(self._rate) if rate else talk.command(kind)] = kind

    def _agree_on_rate(self, rate: float) -> None:
        if rate != self._device_rate:
            self._device_rate = rate
            self.health.forget_rate()

    def _describe(self) -> str:
        i = self.identity
        return f"{i.name} {i.serial} (firmware {i.firmware}) on {self._found}"

    def _take(self, packet: protocol.Packet, arrival: float) -> None:
        if isinstance(packet, protocol.Row):
            if not self._anchored:  # the first row has waited for no other
                self._anchored = True
                self._clock.update(
                    1e-6 * (packet.frame_time + packet.row_end),
                    arrival - self._time_on_line(len(packet.readings)),
                )
            lost = self._lost.frames_incomplete + self._lost.frames_lost
            done = self._assembler.feed(packet)
            self.health.frames_lost(self._lost.frames_incomplete + self._lost.frames_lost - lost)
            for rows in done:
                if self._started:
                    self._publish(rows, arrival, len(packet.readings))
        elif isinstance(packet, protocol.Ack):
            if self._is_answered(packet):
                self._agree_on_rate(packet.rate)
                if not packet.streaming:
                    self._assembler.abandon()
        elif isinstance(packet, protocol.Error) and (not packet.tag or self._is_answered(packet)):
            self._note = f"device: {packet}"
            self._faulty = self._faulty or not packet.tag

    def _is_answered(self, answer: protocol.Ack | protocol.Error) -> bool:
        """Note the answer to a command; False, and counted, where nothing like it was asked.

        A repeated command is answered by the answer to any of its repetitions.
        """
        if self._asked.get(answer.tag) != answer.command:
            self._answers_ignored += 1
            return False
        self._asked = {tag: kind for tag, kind in self._asked.items() if kind != answer.command}
        self._wanted.remove(answer.command)
        return True

    def _publish(self, rows: RowsOfFrame, arrival: float, row_bytes: int) -> None:
        self._clock.update(1e-6 * rows.last_sample, arrival - self._time_on_line(row_bytes))
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

    def _time_on_line(self, row_bytes: int) -> float:
        line_rate = self.identity.line_rate
        return 10.0 * (row_bytes + 40) / line_rate if line_rate else 0.0


def _joined(*remarks: str) -> str:
    return "; ".join(filter(None, remarks))
