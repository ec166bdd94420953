"""The real sensor: the host's side of docs/protocol.md over a serial line, with recovery.

connect -> identify -> set the rate, start -> stream, and from the beginning after every fault.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import asdict, replace

from tomotactile_ros.devices import protocol
from tomotactile_ros.devices.assembly import (
    AssemblyCounters,
    FrameAssembler,
    RowsOfFrame,
    RunAssembler,
)
from tomotactile_ros.devices.base import Frame
from tomotactile_ros.devices.capture import Capture
from tomotactile_ros.devices.clock import DeviceClock
from tomotactile_ros.devices.conversation import ANSWER_TIME, Conversation, check_identity
from tomotactile_ros.devices.delay import RoundTrips
from tomotactile_ros.devices.doubts import Doubts
from tomotactile_ros.devices.health import Trouble
from tomotactile_ros.devices.line import Line, LineFault, open_line
from tomotactile_ros.devices.line_device import SILENCE, SILENT_FRAMES, LineDevice
from tomotactile_ros.devices.world import Settings, World
from tomotactile_ros.support.checks import plain

RATE_TOLERANCE = 1.5
LATE_PERIOD, LATE_BUT_USED = 2.0, 60.0
EMPTYING_TIME = 60.0
KEEP_ALIVE_PERIOD, KEEP_ALIVE_TIMEOUT = 1.0, 5.0
LEAST_STEP = 1e-6  # s from one stamp of rows to the next
NOBODY = protocol.Identity(0, 0, 0, 0, 0.0, 0.0, 0, 0.0, "nobody", "", "")


class SerialDevice(LineDevice):
    """Frames from hardware that speaks the wire protocol.

    Parameters
    ----------
    port : str
        See `tomotactile_ros.devices.line.find_port`.
    electrodes : int
        Electrodes of the layout; a device with another number is refused.
    baud, rate, partial_frames, address, capture
        As of `tomotactile_ros.devices.DeviceSettings`. Missing rows are NaN; on a bus the device is
        asked for frames one by one.
    opener : callable
        How a port is opened; for tests.

    Attributes
    ----------
    identity : protocol.Identity
        What the device has told of itself; `NOBODY` before that.
    temperature : (float, float) or None
        Temperature of the sheet (°C) that the device told last, and when (Unix time, s).
    """

    def __init__(
        self,
        port: str,
        electrodes: int,
        *,
        baud: int = 2_000_000,
        rate: float = 0.0,
        partial_frames: bool = False,
        address: int = protocol.NO_ADDRESS,
        capture: str = "",
        opener: Callable[[str, int], Line] = open_line,
    ) -> None:
        super().__init__(port, electrodes, baud, rate, opener)
        self._partial, self._address = partial_frames, address
        self._capture_path = capture
        self._reset()

    def _reset(self) -> None:
        self.temperature: tuple[float, float] | None = None
        self._parser = protocol.Parser()
        self._lost = AssemblyCounters()
        self._doubts = Doubts()
        self._clock = DeviceClock()
        self._connections = self._restarts = self._others = self._dropped = 0
        self._low_latency = False
        self._found = ""
        self._device_rate = 0.0
        self._note, self._faulty, self._scan_note = "", False, ""
        self._answers_ignored = 0
        self._stale_at = self._row_stamp = self._told = -math.inf
        self.identity = NOBODY

    def open(
        self,
        on_frame: Callable[[Frame], None],
        on_rows: Callable[[Frame], None] | None = None,
    ) -> None:
        """Start; returns at once, the port is opened by the thread.

        Raises
        ------
        InputError
            The file to capture to cannot be made.
        """
        if self._thread is None:
            self._reset()
            if self._capture_path:
                header = self._header(on_rows is not None)
                self._world = Capture(self._capture_path, header, self._world)
        super().open(on_frame, on_rows)

    def close(self) -> None:
        """Stop the thread and join it; harmless when closed already."""
        super().close()
        if isinstance(self._world, Capture):
            self._world.close()
            self._world = self._world.world

    def _header(self, rows: bool) -> dict:
        """What has to be known, beside the bytes, to live a capture again."""
        return {
            "port": self._port,
            "electrodes": self._electrodes,
            "baud": self._baud,
            "partial_frames": self._partial,
            "address": self._address,
            "max_age": self.max_age if math.isfinite(self.max_age) else 0.0,
            "run_length": self.run_length if rows else 0,
            "usual_order": list(self.usual_order),
        }

    def relive(
        self,
        world: World,
        on_frame: Callable[[Frame], None],
        on_rows: Callable[[Frame], None] | None = None,
    ) -> None:
        """Do in another world, in the caller's thread, what was done in the one of a capture."""
        self._reset()
        self._on_frame, self._on_rows, self._world = on_frame, on_rows, world
        self._run()

    def _troubles(self) -> list[Trouble]:
        """As of every device; also a refused wish, a fault of the device, a wrong rate."""
        found = super()._troubles() + self._doubts.troubles()
        if self._note:
            found.append(Trouble("device", self._faulty, self._note, which=self._note))
        if self._scan_note:
            found.append(Trouble("scan", False, self._scan_note))
        if isinstance(self._world, Capture) and self._world.trouble:
            found.append(Trouble("capture", False, self._world.trouble))
        seen = self.health.counters()["rate_seen"]
        if 0 < RATE_TOLERANCE * self._device_rate < seen:
            text = f"sends {plain(seen, 4)} frames/s instead of {plain(self._device_rate, 4)}"
            found.append(Trouble("rate", False, text))
        return found

    def _rate_due(self) -> float:
        return self._device_rate

    def _counters(self) -> dict[str, float]:
        counted = {**asdict(self._parser.counters), **asdict(self._lost)}
        return {
            **{name: float(number) for name, number in counted.items()},
            "rate_device": self._device_rate,
            "answers_ignored": float(self._answers_ignored),
            "reconnects": float(max(0, self._connections - 1)),
            "device_restarts": float(self._restarts),
            "packets_dropped": float(self._dropped),
            "packets_of_others": float(self._others),
            "temperature": self.temperature[0] if self.temperature else math.nan,
            "clock_jumps": float(self._clock.jumps),
            "clock_drift_ppm": 1e6 * self._clock.drift,
            "low_latency": float(self._low_latency),
        }

    def _understood(self) -> int:
        return self._connections

    def _talk(self, line: Line) -> None:
        self._low_latency, self._found = line.low_latency, line.name
        if self._state[0] in ("closed", "disconnected"):
            self._set_state("identifying", f"asking {self._port} for its identity")
        talk = Conversation(line, self._parser, self._world, self._address)
        while not self._stopped():
            identity = talk.identify(self._report)
            if identity is not None:
                self._accept(identity)
                self._stream(talk)

    def _accept(self, identity: protocol.Identity) -> None:
        check_identity(identity, self._electrodes, self._found)
        if self._connections and identity.boot != self.identity.boot:
            self._restarts += 1
        self.identity = identity
        self._agree_on_rate(identity.rate)
        self._assembler = FrameAssembler(
            identity.electrodes, identity.rows, self._partial, self._lost
        )
        self._runs = RunAssembler(self.run_length)
        self._clock = self._clock.successor()
        self._connections += 1
        self._doubts.begin(again=self._connections > 1)

    def _stream(self, talk: Conversation) -> None:
        """Take in packets until the line falls silent (returns) or is lost (raises).

        A frame that was under way is not waited for: it may be one of a very low rate.
        """
        self._empty(talk)
        self._anchored = self._restarted = False
        self._apply_settings(talk)
        self._trips = RoundTrips()
        self._alive = self._told + ANSWER_TIME - KEEP_ALIVE_PERIOD
        counters = self._parser.counters
        bytes_then = counters.bytes
        while not self._stopped():
            self._speak(talk)
            packets, arrival = talk.listen(0.1), talk.arrival
            heard = False
            for packet in packets:
                heard = self._take(packet, talk) or heard
            self._others += talk.others
            talk.others = 0
            if self._restarted:
                return
            if heard:
                self._heard, bytes_then = arrival, counters.bytes
                self._report_rows_without_frames(arrival)
            elif arrival - self._heard > self._patience(talk):
                self._report_silence(counters.bytes - bytes_then)
                return
            if self._trips.wait:
                self._doubts.waited(self._trips.hidden)
            if self._trips.wait or self._is_behind(arrival):
                self._empty(talk)
                return
        talk.command(protocol.STOP)

    def _speak(self, talk: Conversation) -> None:
        """Send what is due: new settings, those without an answer yet, a sign of life."""
        if self._world.changed():
            self._change_settings(talk)
        elif self._wanted and talk.arrival - self._told > ANSWER_TIME:
            self._tell_settings(talk)
        elif self._address and self._started:
            if talk.arrival - max(self._heard, self._told) > self._frame_patience():
                self._ask_frame(talk)  # the end of one was lost
        elif talk.arrival - self._alive > KEEP_ALIVE_PERIOD and (talk.version > 1 or self._started):
            self._alive = talk.arrival
            kind = protocol.KEEP_ALIVE if talk.version > 1 else protocol.IDENTIFY
            self._trips.ask(talk.command(kind), talk.arrival)

    def _empty(self, talk: Conversation) -> None:
        """Stop the device, and throw away what is still on the way: it would be taken for new.

        An answer comes behind what was sent before it. A device that is silent may have none;
        `LineFault` where it goes on sending all the same.
        """
        tags: set[int] = set()
        now = begin = heard = self._now()
        told = -math.inf
        while not self._stopped():
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
            now = talk.arrival

    def _is_behind(self, now: float) -> bool:
        """Whether the line should be emptied: late for long, by too much or for very long.

        An empty line has no delay. Where the device's clock has jumped, that is put right, too.
        """
        since = self._clock.late_since
        if since is None:
            return False
        stale = now - self._stale_at < 0.5 * LATE_PERIOD
        return now - since > (LATE_PERIOD if stale else LATE_BUT_USED)

    def _patience(self, talk: Conversation) -> float:
        """How long the device may say nothing, s."""
        if self._started or self._wanted:
            return self._row_patience()
        return KEEP_ALIVE_TIMEOUT if talk.version > 1 and not self._address else math.inf

    def _row_patience(self) -> float:
        return max(SILENCE, SILENT_FRAMES / self._device_rate)

    def _frame_patience(self) -> float:
        """How long a device that was asked for one frame may take, s."""
        return ANSWER_TIME + 2.0 / self._device_rate

    def _report_silence(self, garbage: int) -> None:
        if garbage:
            self._set_state("garbled", f"port: {garbage} bytes from {self._port}, no valid packet")
        else:
            self._set_state("silent", _joined(f"port: {self._port} sends nothing", self._note))

    def _report_rows_without_frames(self, now: float) -> None:
        if not self._started or now - self._framed <= self._row_patience():
            return
        lost = self._assembler.counters
        self._set_state(
            "garbled",
            f"port: packets from {self._port} but no complete frame ({lost.packets_lost} packets "
            f"lost, {lost.rows_ignored} that fit no frame); check the line or set partial_frames",
        )

    def _apply_settings(self, talk: Conversation, settings: Settings | None = None) -> None:
        settings = self._settings = settings or self._world.settings()
        self._note, self._faulty = "", False
        self._order = settings.scan
        if not settings.scan and self.identity.max_scan >= len(self.usual_order):
            self._order = self.usual_order
        self._heard = self._framed = self._now()
        self._started = settings.streaming
        self._asked: dict[int, int] = {}  # tag -> command
        self._wanted = [protocol.SET_SCAN] if self._can_scan(settings.scan) else []
        if settings.rate > 0:
            self._wanted.append(protocol.SET_RATE)
        self._wanted.append(protocol.START if self._started else protocol.STOP)
        self._tell_settings(talk)
        if not self._started:
            self._set_state("stopped", f"{self._describe()}; stopped on request")

    def _change_settings(self, talk: Conversation) -> None:
        """Take up new settings; another order of as many rows while frames flow disturbs nothing
        else, so that it can be told in every frame."""
        before = self._settings
        settings = self._world.settings()
        alike = replace(settings, scan=before.scan) == before
        flowing = self._started and not self._address and self.identity.max_scan > 0
        if not (alike and flowing and len(settings.scan) == len(self._order)):
            self._apply_settings(talk, settings)
            return
        self._settings, self._order = settings, settings.scan
        if protocol.SET_SCAN not in self._wanted:
            self._wanted.insert(0, protocol.SET_SCAN)
        self._told = self._now()
        self._asked[self._tell(talk, protocol.SET_SCAN)] = protocol.SET_SCAN

    def _can_scan(self, order: tuple[int, ...]) -> bool:
        """Whether to command an order: also the device's own, after whoever was there before."""
        longest = self.identity.max_scan
        self._scan_note = ""
        if len(order) > longest:
            limit = f"at most {longest} rows" if longest else "its own order only"
            self._scan_note = f"scan: of {len(order)} rows, the device takes {limit}"
        return longest > 0 and not self._scan_note

    def _ask_frame(self, talk: Conversation) -> None:
        """Ask a device on a bus for one frame, with what else has no answer yet."""
        if protocol.START not in self._wanted:
            self._wanted.append(protocol.START)
        self._tell_settings(talk)

    def _tell_settings(self, talk: Conversation) -> None:
        """Send the settings that have no answer yet."""
        self._told = self._now()
        for kind in self._wanted:
            self._asked[self._tell(talk, kind)] = kind

    def _tell(self, talk: Conversation, kind: int) -> int:
        if kind == protocol.SET_RATE:
            return talk.set_rate(self._settings.rate)
        if kind == protocol.SET_SCAN:
            tag = talk.set_scan(self._order)
            if self._order:
                self._assembler.expect_order(tag, self._order)
            return tag
        if kind == protocol.START:
            if self._address:
                return talk.start(frames=1)
            return talk.start(timeout=KEEP_ALIVE_TIMEOUT)
        return talk.command(kind)

    def _agree_on_rate(self, rate: float) -> None:
        self._doubts.rate_is(rate)
        if rate != self._device_rate:
            self._device_rate = rate
            self.health.forget_rate()

    def _describe(self) -> str:
        i = self.identity
        return f"{i.name} {i.serial} (firmware {i.firmware}) on {self._found}"

    def _take(self, packet: protocol.Packet, talk: Conversation) -> bool:
        """Take in a packet; whether it is a sign of life of what was asked for."""
        if isinstance(packet, protocol.Row):
            self._take_row(packet, talk)
        elif isinstance(packet, protocol.Ack):
            if self._is_answered(packet):
                self._take_ack(packet)
        elif isinstance(packet, protocol.Error) and (not packet.tag or self._is_answered(packet)):
            self._note = f"device: {packet}"
            self._faulty = self._faulty or not packet.tag
        elif isinstance(packet, (protocol.Status, protocol.Identity)):
            period = 1.0 / self._device_rate
            self._trips.answer(packet.tag, talk.arrival, self._clock.late, period)
            if isinstance(packet, protocol.Status):
                self._take_status(packet, talk.arrival)
            return not self._started
        return True

    def _take_row(self, row: protocol.Row, talk: Conversation) -> None:
        arrival = talk.arrival
        if row.version != talk.version or not self._doubts.may_end(row.row_end):
            self._lost.rows_ignored += 1
            return
        if not self._anchored:  # the first row has waited for no other
            self._anchored = True
            self._clock.update(
                1e-6 * (row.frame_time + row.row_end),
                arrival - self._time_on_line(len(row.readings)),
            )
        lost = self._lost.frames_incomplete + self._lost.frames_lost
        done = self._assembler.feed(row)
        self.health.frames_lost(self._lost.frames_incomplete + self._lost.frames_lost - lost)
        if self._on_rows and self._assembler.accepted:
            for run in self._runs.feed(row):
                if self._started:
                    self._publish_rows(run)
        for rows in done:
            if self._started:
                self._publish(rows, arrival, len(row.readings))
        if self._address and self._started and row.row == row.rows - 1:
            self._ask_frame(talk)

    def _take_ack(self, ack: protocol.Ack) -> None:
        self._agree_on_rate(ack.rate)
        if not ack.streaming:
            self._assembler.abandon()
        if ack.version == 1:
            return
        if ack.command == protocol.START:
            self._assembler.expect_first(ack.sequence)
        elif ack.command == protocol.SET_SCAN and not self._order:
            self._assembler.own_rows = ack.rows

    def _take_status(self, status: protocol.Status, arrival: float) -> None:
        if not math.isnan(status.temperature):
            self.temperature = status.temperature, self._world.unix_time(arrival)
        self._dropped = status.dropped
        self._restarted = status.boot != self.identity.boot
        if self._started and not status.streaming and protocol.START not in self._wanted:
            self._wanted.append(protocol.START)
            self._told = -math.inf

    def _is_answered(self, answer: protocol.Ack | protocol.Error) -> bool:
        """Note the answer to a command; False, and counted, where nothing like it was asked.

        A repeated command is answered by the answer to any of its repetitions.
        """
        if self._trips.asked(answer.tag):  # a device that refuses a sign of life is not in trouble
            return False
        if self._asked.get(answer.tag) != answer.command:
            self._answers_ignored += 1
            return False
        self._asked = {tag: kind for tag, kind in self._asked.items() if kind != answer.command}
        if answer.command in self._wanted:
            self._wanted.remove(answer.command)
        return True

    def _publish(self, rows: RowsOfFrame, arrival: float, row_bytes: int) -> None:
        jumps = self._clock.jumps
        self._clock.update(1e-6 * rows.last_sample, arrival - self._time_on_line(row_bytes))
        self._doubts.frame(rows, jumped=self._clock.jumps > jumps)
        stamp = self._world.unix_time(self._clock.stamp(1e-6 * rows.frame_time))
        self._framed = arrival
        if self._state[0] != "streaming":
            self._set_state("streaming", self._describe())
        self._deliver(self._frame(rows, stamp), self._clock.to_host(1e-6 * rows.last_sample))
        self._clock.fit()

    def _publish_rows(self, run: RowsOfFrame) -> None:
        stamp = max(self._clock.to_host(1e-6 * run.frame_time), self._row_stamp + LEAST_STEP)
        self._row_stamp = stamp
        rows = self._frame(run, self._world.unix_time(stamp))
        self._deliver_rows(rows, self._clock.to_host(1e-6 * run.last_sample))

    def _frame(self, rows: RowsOfFrame, stamp: float) -> Frame:
        return Frame(
            rows.voltages,
            rows.grounded,
            rows.sequence,
            stamp,
            rows.drive_voltage,
            self._clock.duration(1e-6 * rows.row_period),
        )

    def _time_on_line(self, row_bytes: int) -> float:
        line_rate = self.identity.line_rate
        return 10.0 * (row_bytes + 40) / line_rate if line_rate else 0.0


def _joined(*remarks: str) -> str:
    return "; ".join(filter(None, remarks))
