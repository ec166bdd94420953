"""Tries whether a device keeps the rules of docs/protocol.md, one after the other.

Each check is a function with the rule as its docstring. It returns a remark, or nothing, where the
rule is kept; it raises `Broken`, or `Untried` where the device cannot be asked.  What a host cannot
see is not tried: whether a device drops whole packets when the line is slow, clocks over hours.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from tomotactile_ros.devices import protocol
from tomotactile_ros.devices.line import Line, LineFault
from tomotactile_ros.devices.probe import PAUSE, Broken, Probe, Untried, name_of
from tomotactile_ros.devices.text import READ_AS, is_text
from tomotactile_ros.support.checks import plain

ANSWER_TIME = 0.1
CLOCK_PPM = 1000.0
ROWS_PER_SECOND = 1000.0  # that are asked for, where the device can
SLACK = 1.0  # s that a line may keep things back
CLOCK_TIME = 2.0

KEPT, BROKEN, UNTRIED = "kept", "BROKEN", "not tried"


@dataclass(frozen=True)
class Verdict:
    """What came of a check: the rule, the version it was tried in, `KEPT` or another, why."""

    version: int
    rule: str
    result: str
    remark: str


class Trial(Probe):
    """A device under trial; `identity` is what it said of itself."""

    identity: protocol.Identity

    @property
    def length(self) -> int:
        """Rows of a frame in the device's own order."""
        return self.identity.rows

    @property
    def fastest(self) -> float:
        """Fastest rate in the device's own order, frames/s."""
        i = self.identity
        return i.max_row_rate / i.rows if i.version > 1 else i.max_rate

    def patience(self, frames: float) -> float:
        """How long so many frames may take at the rate of the trial, s."""
        return SLACK + 1.5 * frames / self.rate

    def prepare(self) -> None:
        """A stopped device in its own order, at a rate at which the trial takes seconds."""
        self.be_quiet()
        if self.version > 1 and self.identity.max_scan:
            self.ask(protocol.SetScan(0, ()), protocol.Ack)
        wish = min(self.fastest, max(ROWS_PER_SECOND / self.length, 10.0))
        self.rate = self.ask(protocol.SetRate(0, wish), protocol.Ack).rate
        self.forget()

    def frames(self, count: int) -> list[list[protocol.Row]]:
        """Start, and return so many whole frames and what else has come."""
        self.start()
        return by_frame(self.wait_for_rows(count * self.length, self.patience(count + 1)))


def by_frame(rows: list[protocol.Row]) -> list[list[protocol.Row]]:
    """Rows that follow one another with one sequence number, together."""
    frames: list[list[protocol.Row]] = []
    for row in rows:
        if not frames or frames[-1][-1].sequence != row.sequence:
            frames.append([])
        frames[-1].append(row)
    return frames


def identity_is_told(trial: Trial) -> str:
    """IDENTIFY is answered with an IDENTITY that makes sense (section 3)"""
    i = trial.identity
    if i.version == 1 and not 1 <= i.rows <= i.electrodes:
        raise Broken(f"{i.rows} rows of {i.electrodes} electrodes")
    if i.electrodes < 2:
        raise Broken(f"{i.electrodes} electrodes")
    if not 1 <= i.adc_bits <= 32:
        raise Broken(f"a converter of {i.adc_bits} bits")
    if not i.rate <= trial.fastest * (1 + 1e-6):
        raise Broken(f"{i.rate:g} frames/s are more than its fastest rate, {trial.fastest:g}")
    if i.version > 1 and i.address != trial.address:
        raise Broken(f"address {i.address}, not {trial.address}, which was asked")
    return f"{i.name} {i.serial}, firmware {i.firmware}, {i.electrodes} electrodes"


def stop_is_obeyed(trial: Trial) -> None:
    """STOP is answered with ACK, and the stream ends behind the row under way (section 2)"""
    trial.frames(1)
    ack = trial.ask(protocol.Command(protocol.STOP, 0), protocol.Ack)
    if ack.streaming:
        raise Broken("the ACK to STOP says that the device still streams")
    at = [h.packet for h in trial.heard].index(ack)
    trial.listen(max(PAUSE, 2.5 / (trial.rate * trial.length)))
    after = [h for h in trial.heard[at + 1 :] if isinstance(h.packet, protocol.Row)]
    if len(after) > (trial.version == 1):
        raise Broken(f"{len(after)} rows after the ACK to STOP")


def a_delimiter_comes_first(trial: Trial) -> None:
    """A delimiter is sent before the first packet behind START (section 1)"""
    trial.start()
    if trial.bytes[:1] != b"\0":
        raise Broken(f"the first byte after START is 0x{trial.bytes[0]:02x}")


def frames_are_whole(trial: Trial) -> str:
    """Frames begin with row 0, rows rise, all carry one count, rows and frame_time (section 3)"""
    frames = trial.frames(4)
    if frames[0][0].row != 0:
        raise Broken(f"the first row after START is {frames[0][0].row}")
    for frame in frames:
        if len({(row.count, row.rows, row.frame_time, row.scan) for row in frame}) > 1:
            raise Broken(f"rows of frame {frame[0].sequence} differ in what they share")
        if frame[0].count != trial.identity.electrodes or frame[0].rows != trial.length:
            raise Broken(
                f"{frame[0].rows} rows of {frame[0].count} readings, IDENTITY says {trial.length} of "
                f"{trial.identity.electrodes}"
            )
        indices = [row.row for row in frame]
        if indices != sorted(set(indices)):
            raise Broken(f"rows of frame {frame[0].sequence} come in the order {indices}")
    whole = [frame for frame in frames[:-1] if len(frame) == trial.length]
    if len(whole) < len(frames) - 1:
        raise Broken(f"{len(frames) - 1 - len(whole)} of {len(frames) - 1} frames lack rows")
    return f"{len(frames)} frames"


def sequence_counts(trial: Trial) -> None:
    """The sequence number rises by 1, also from one stream to the next (section 3)"""
    first = trial.frames(3)
    numbers = [frame[0].sequence for frame in first]
    trial.be_quiet()
    second = trial.frames(2)
    numbers += [frame[0].sequence for frame in second]
    steps = [(b - a) & 0xFFFFFFFF for a, b in pairwise(numbers)]
    gap = len(first) - 1  # the frame at the stop may be the last, or one may have begun behind it
    if any(step != 1 for i, step in enumerate(steps) if i != gap) or steps[gap] not in (1, 2):
        raise Broken(f"frames are numbered {numbers}")


def ground_conditions_stay(trial: Trial) -> None:
    """A row grounds the same electrode in every frame, and no two rows the same (section 3)"""
    orders = {tuple(row.grounded for row in frame) for frame in trial.frames(3)[:3]}
    if len(orders) > 1:
        raise Broken("frames ground different electrodes")
    (order,) = orders
    if len(set(order)) < len(order):
        raise Broken("an electrode is grounded twice in a frame")


def times_make_sense(trial: Trial) -> str:
    """Device time never jumps, row_end rises, its rate is right to 1000 ppm (section 3)"""
    trial.frames(1)
    trial.listen(CLOCK_TIME)
    for frame in by_frame(trial.rows()):
        ends = [row.row_end for row in frame]
        if any(a >= b for a, b in pairwise(ends)):
            raise Broken(f"row_end of frame {frame[0].sequence}: {ends[:8]} µs")
    frames = [f for f in by_frame(trial.rows()) if len(f) == trial.length]
    for before, after in pairwise(frames):
        step = after[0].frame_time - before[0].frame_time
        apart = (after[0].sequence - before[0].sequence) & 0xFFFFFFFF
        if step < before[-1].row_end - 2 and apart == 1:
            raise Broken(
                f"a frame begins {step} µs after the begin of one that takes {before[-1].row_end} µs"
            )
    times = [
        (1e-6 * (h.packet.frame_time + h.packet.row_end), h.time)
        for h in trial.heard
        if isinstance(h.packet, protocol.Row)
    ]
    ppm, doubt = _drift(*np.array(times).T)
    if abs(ppm) > CLOCK_PPM + doubt:
        raise Broken(f"device time is off by {ppm:.0f} ± {doubt:.0f} ppm")
    if doubt > CLOCK_PPM:
        raise Untried(f"the delays of the line leave {doubt:.0f} ppm of doubt")
    return f"{ppm:.0f} ± {doubt:.0f} ppm"


def _drift(device: np.ndarray, host: np.ndarray) -> tuple[float, float]:
    """How much faster the device's clock runs, ppm, and how sure that is: least delays of parts."""
    delay = host - device
    parts = np.array_split(np.arange(len(delay)), 8)
    least = [part[np.argmin(delay[part])] for part in parts if len(part)]
    x, y = host[least] - host[0], delay[least] - delay[0]
    slope, offset = np.polyfit(x, y, 1)
    doubt = 4 * np.std(y - slope * x - offset) / max(np.ptp(x), 1e-9)
    return -1e6 * slope, 1e6 * doubt + 100.0


def the_rate_is_kept(trial: Trial) -> str:
    """Frames come at the rate that the ACK tells (section 3)"""
    frames = trial.frames(4)
    step = np.median([b[0].frame_time - a[0].frame_time for a, b in pairwise(frames)])
    found = 1e6 / step if step > 0 else math.inf
    if abs(found / trial.rate - 1) > 0.01:
        raise Broken(f"{plain(found, 4)} frames/s, the device announced {plain(trial.rate, 4)}")
    return f"{plain(found, 4)} frames/s"


def readings_make_sense(trial: Trial) -> str:
    """Readings are counts of the converter, the scale fits its range (section 3)"""
    i = trial.identity
    rows = [row for frame in trial.frames(2) for row in frame]
    most = min(2**i.adc_bits - 1, protocol.HIGHEST_READING)
    for row in rows:
        counts = protocol.unpack_counts(row.readings)
        valid = counts[counts != protocol.NO_READING]
        if valid.size and valid.max() > most:
            raise Broken(f"a reading of {valid.max()} of {i.adc_bits} bits")
    span = rows[0].scale * 2 ** min(i.adc_bits, 16)
    if not 0.99 < span / (i.range - i.lowest) < 1.01:
        raise Broken(
            f"scale x 2^bits is {plain(span, 4)} V, the range {plain(i.range - i.lowest, 4)} V"
        )
    own = {
        int(protocol.unpack_counts(row.readings)[row.grounded]) == protocol.NO_READING
        for row in rows
    }
    if trial.version == 1 and own != {True}:
        raise Broken("the grounded electrode has a reading in version 1")
    return (
        "without a reading of the grounded electrode"
        if own == {True}
        else "with a reading of the grounded electrode"
    )


def start_twice_changes_nothing(trial: Trial) -> None:
    """START while streaming is answered with ACK and begins no new frame (section 2)"""
    trial.start()
    trial.wait_for_rows(trial.length + trial.length // 2, trial.patience(2))
    trial.start()
    trial.wait_for_rows(4 * trial.length, trial.patience(5))
    lengths = [len(frame) for frame in by_frame(trial.rows())[:-1]]
    if set(lengths) != {trial.length}:
        raise Broken(f"frames of {lengths} rows")


def answers_come_in_time(trial: Trial) -> str:
    """Commands are answered within 0.1 s, also while it streams (section 2)"""
    times = []
    trial.frames(1)
    for _ in range(10):
        trial.slowest = 0.0
        trial.ask(protocol.Command(protocol.IDENTIFY, 0), protocol.Identity)
        times.append(trial.slowest)
    if sorted(times)[-2] > ANSWER_TIME:  # one may be the host's fault
        raise Broken(f"up to {1e3 * max(times):.0f} ms")
    return f"up to {1e3 * max(times):.0f} ms"


def a_rate_is_set(trial: Trial) -> str:
    """SET_RATE holds from the next frame on, the one under way ends at the old rate (section 3)"""
    trial.frames(1)
    ack = trial.ask(protocol.SetRate(0, 0.5 * trial.rate), protocol.Ack)
    if not ack.rate < 0.9 * trial.rate:
        raise Broken(f"asked for half the rate, the ACK says {ack.rate:g} frames/s")
    count = len(trial.rows()) + 4 * trial.length
    trial.wait_for_rows(count, trial.patience(12))
    frames = by_frame(trial.rows())
    times = [b[0].frame_time - a[0].frame_time for a, b in pairwise(frames)]
    wanted = [1e6 / trial.rate, 1e6 / ack.rate]
    odd = [t for t in times if min(abs(t / w - 1) for w in wanted) > 0.02]
    if odd:
        raise Broken(f"a frame of {odd[0]} µs; periods are {wanted[0]:.0f} and {wanted[1]:.0f} µs")
    return f"{ack.rate:g} frames/s"


def impossible_rates_are_refused(trial: Trial) -> None:
    """SET_RATE above the fastest rate, of 0, below 0 or of NaN is refused: bad value (section 3)"""
    for rate in (1.5 * trial.fastest, 0.0, -1.0, math.nan):
        error = trial.ask(protocol.SetRate(0, rate), protocol.Error)
        if error.code != protocol.BAD_VALUE:
            raise Broken(f"{rate:g} frames/s give ERROR {error.code}")


def unknown_commands_are_refused(trial: Trial) -> None:
    """An unknown command is answered with ERROR, unknown command (section 1)"""
    error = trial.ask(trial.head(0x0E), protocol.Error)
    if (error.command, error.code) != (0x0E, protocol.UNKNOWN_COMMAND):
        raise Broken(f"ERROR {error.code} to command 0x{error.command:02x}")


def unknown_versions_are_refused(trial: Trial) -> None:
    """A command of an unknown version is answered with ERROR, unsupported version (section 3), but on a bus"""
    content = trial.head(protocol.STOP, 0x7F)
    if trial.address != protocol.NO_ADDRESS:  # where such a packet has its address nobody knows
        if (answer := trial.answer(trial.send(content))) is not None:
            raise Broken(f"answered with {name_of(protocol.type_of(answer))} at an address")
        return
    error = trial.ask(content, protocol.Error)
    if (error.command, error.code) != (protocol.STOP, protocol.UNSUPPORTED_VERSION):
        raise Broken(f"ERROR {error.code} to command 0x{error.command:02x}")


def wrong_lengths_are_refused(trial: Trial) -> str:
    """A command of the wrong length is refused (bad value); in version 1 thrown away or refused"""
    content, remark = trial.head(protocol.SET_RATE), ""
    for wrong in (content + bytes(3), content + b"\0\0\0\x3f\0"):
        trial.forget()
        answer = trial.answer(trial.send(wrong))
        if answer is None and trial.version == 1:
            remark = "thrown away"
        elif not isinstance(answer, protocol.Error):
            said = "nothing" if answer is None else name_of(protocol.type_of(answer))
            raise Broken(f"SET_RATE of {len(wrong)} bytes is answered with {said}, not ERROR")
    return remark


def damage_does_no_harm(trial: Trial) -> None:
    """What is damaged, too long or empty is thrown away, and the next command is heard (section
    1)"""
    tag = trial.next_tag()
    command: protocol.FromHost = protocol.Command(protocol.START, tag)
    if trial.version > 1:
        command = protocol.Start(tag, address=trial.address)
    wire = bytearray(protocol.encode(command))
    wire[-2] ^= 0x10  # of the checksum
    for noise in (bytes(wire), b"\0\0\0", b"\x55" * 6000 + b"\0", b"\xff\x01\0", wire[3:]):
        trial.write(bytes(noise))
    trial.listen(PAUSE)
    if trial.rows():
        raise Broken("a START with a wrong checksum is obeyed")
    trial.ask(protocol.Command(protocol.STOP, 0), protocol.Ack)


def acks_tell_the_next_frame(trial: Trial) -> None:
    """The ACK to START comes before the first ROW and tells its sequence number (section 4)"""
    ack = trial.start()
    heard = [type(h.packet) for h in trial.heard]
    if protocol.Row in heard[: heard.index(protocol.Ack)]:
        raise Broken("a ROW comes before the ACK to START")
    first = trial.wait_for_rows(1, trial.patience(1))[0]
    if (ack.sequence, ack.rows) != (first.sequence, first.rows):
        raise Broken(
            f"the ACK announces frame {ack.sequence} of {ack.rows} rows, then comes {first.sequence} of "
            f"{first.rows}"
        )


def an_order_is_followed(trial: Trial) -> str:
    """SET_SCAN holds from the frame on that its ACK tells, in any order, with repeats (section
    4)"""
    i = trial.identity
    if not i.max_scan:
        raise Untried("the device has a fixed order (max_scan 0)")
    order = [i.electrodes - 1, 0, i.electrodes - 1, *range(1, i.electrodes)][: i.max_scan]
    trial.frames(1)
    ack = trial.ask(protocol.SetScan(0, tuple(order)), protocol.Ack)
    trial.wait_for_rows(len(trial.rows()) + trial.length + 2 * len(order), trial.patience(5))
    for row in trial.rows():
        new = (row.sequence - ack.sequence) & 0xFFFFFFFF < 1 << 31
        if new != (row.scan == ack.tag) or row.rows != (len(order) if new else trial.length):
            raise Broken(f"frame {row.sequence} has scan {row.scan} and {row.rows} rows")
        if new and row.grounded != order[row.row]:
            raise Broken(f"row {row.row} grounds {row.grounded}, not {order[row.row]}")
    if ack.rows != len(order):
        raise Broken(f"the ACK announces {ack.rows} rows, the order has {len(order)}")
    told = trial.rate * trial.length / len(order)
    if abs(ack.rate / told - 1) > 0.02 and ack.rate * len(order) < 0.98 * i.max_row_rate:
        raise Broken(f"{ack.rate:g} frames/s; at the same time per row it would be {told:g}")
    return f"{len(order)} rows, {plain(ack.rate, 4)} frames/s"


def the_own_order_comes_back(trial: Trial) -> None:
    """SET_SCAN without rows gives the device's own order back, told as scan 0 (section 4)"""
    if not trial.identity.max_scan:
        raise Untried("the device has a fixed order (max_scan 0)")
    trial.ask(protocol.SetScan(0, (1, 0)), protocol.Ack)
    ack = trial.ask(protocol.SetScan(0, ()), protocol.Ack)
    frames = trial.frames(2)
    if {row.scan for frame in frames for row in frame} != {protocol.OWN_ORDER}:
        raise Broken("rows of the own order carry another scan than 0")
    if ack.rows != len(frames[0]):
        raise Broken(f"the ACK announces {ack.rows} rows, {len(frames[0])} come")


def impossible_orders_are_refused(trial: Trial) -> None:
    """SET_SCAN of a missing electrode, too long, of tag 0 or cut short is refused (section 4)"""
    i = trial.identity
    wrong: dict[str, protocol.SetScan | bytes] = {
        "an electrode that does not exist": protocol.SetScan(0, (i.electrodes,)),
        "an order that is too long": protocol.SetScan(0, (0,) * (i.max_scan + 1)),
    }
    wrong["the tag 0"] = trial.head(protocol.SET_SCAN, tag=0, rows=1) + bytes(2)
    wrong["an order that is cut short"] = trial.head(protocol.SET_SCAN, rows=1) + bytes(1)
    for what, packet in wrong.items():
        trial.forget()
        try:
            error = trial.ask(packet, protocol.Error)
        except Broken as broken:
            raise Broken(f"{what}: {broken}") from None
        if error.code != protocol.BAD_VALUE:
            raise Broken(f"{what}: ERROR {error.code}")


def signs_of_life_are_answered(trial: Trial) -> str:
    """KEEP_ALIVE is answered with STATUS, which agrees with IDENTITY and time (section 4)"""
    trial.start()
    first = trial.ask(protocol.Command(protocol.KEEP_ALIVE, 0), protocol.Status)
    begin = trial.now()
    trial.listen(0.5)
    second = trial.ask(protocol.Command(protocol.KEEP_ALIVE, 0), protocol.Status)
    passed = 1e-6 * (second.time - first.time)
    if first.boot != trial.identity.boot:
        raise Broken(f"boot id {first.boot:08x}, IDENTITY says {trial.identity.boot:08x}")
    if not first.streaming:
        raise Broken("STATUS says that it does not stream")
    if abs(passed - (trial.now() - begin)) > 0.2:
        raise Broken(f"{plain(passed)} s of device time pass in {plain(trial.now() - begin)} s")
    if math.isnan(second.temperature):
        return "no temperature"
    return f"{second.temperature:.1f} °C"


def it_stops_without_a_host(trial: Trial) -> None:
    """The device stops when it has heard nothing for the timeout of START (section 4)"""
    trial.start(timeout=400)
    for _ in range(4):
        trial.listen(0.2)
        trial.send(protocol.Command(protocol.KEEP_ALIVE, 0))
    trial.forget()
    trial.wait_for_rows(1, trial.patience(1))
    trial.listen(0.4 + SLACK)
    trial.forget()
    trial.listen(0.5)
    if trial.rows():
        raise Broken("it still streams 1.4 s after the last command, with a timeout of 0.4 s")
    status = trial.ask(protocol.Command(protocol.KEEP_ALIVE, 0), protocol.Status)
    if status.streaming:
        raise Broken("STATUS says that it streams")


def it_sends_so_many_frames(trial: Trial) -> None:
    """The device stops behind the number of frames that START tells (section 4)"""
    trial.start(frames=2)
    trial.wait_for_rows(2 * trial.length, trial.patience(3))
    trial.listen(max(PAUSE, 1.5 / trial.rate))
    count = len(trial.rows())
    if count != 2 * trial.length:
        raise Broken(f"{count} rows of {trial.length} a frame for 2 frames")


def it_knows_its_address(trial: Trial) -> None:
    """Commands to another address are ignored; those to all are obeyed, not answered (section 4)"""
    other = 1 if trial.address != 1 else 2
    tag = trial.send(protocol.Command(protocol.IDENTIFY, 0), address=other)
    if trial.answer(tag) is not None:
        raise Broken(f"it has address {trial.address} and answers {other}")
    trial.frames(1)
    tag = trial.send(protocol.Command(protocol.STOP, 0), address=protocol.ALL_ADDRESSES)
    if trial.answer(tag) is not None:
        raise Broken("it answers a command to all")
    trial.forget()
    trial.listen(max(PAUSE, 1.5 / trial.rate))
    if trial.rows():
        raise Broken("it does not obey a STOP to all")


def reserved_fields_are_ignored(trial: Trial) -> None:
    """Fields that are sent as 0 are ignored when received (section 4)"""
    tag = trial.next_tag()
    content = bytes([protocol.STOP, 2]) + tag.to_bytes(2, "little")
    trial.ask(content + bytes([0x12, 0x34, trial.address, 0x56]), protocol.Ack)


BOTH: tuple[Callable[[Trial], str | None], ...] = (
    identity_is_told,
    stop_is_obeyed,
    a_delimiter_comes_first,
    frames_are_whole,
    sequence_counts,
    ground_conditions_stay,
    times_make_sense,
    the_rate_is_kept,
    readings_make_sense,
    start_twice_changes_nothing,
    answers_come_in_time,
    a_rate_is_set,
    impossible_rates_are_refused,
    unknown_commands_are_refused,
    unknown_versions_are_refused,
    wrong_lengths_are_refused,
    damage_does_no_harm,
)
NEWER: tuple[Callable[[Trial], str | None], ...] = (
    acks_tell_the_next_frame,
    an_order_is_followed,
    the_own_order_comes_back,
    impossible_orders_are_refused,
    signs_of_life_are_answered,
    it_stops_without_a_host,
    it_sends_so_many_frames,
    it_knows_its_address,
    reserved_fields_are_ignored,
)


def versions_of(probe: Probe) -> dict[int, protocol.Identity]:
    """The versions that a device speaks, and how it identifies itself in each."""
    found: dict[int, protocol.Identity] = {}
    for version in protocol.VERSIONS:
        if version == 1 and probe.address != protocol.NO_ADDRESS:
            continue
        probe.version = version
        for _ in range(5):
            tag = probe.send(protocol.Command(protocol.IDENTIFY, 0))
            answer = probe.answer(tag)
            if isinstance(answer, protocol.Identity):
                found[version] = answer
            if answer is not None:
                break
    return found


def check(
    line: Line,
    address: int = protocol.NO_ADDRESS,
    now: Callable[[], float] = time.monotonic,
) -> Iterator[Verdict]:
    """Try a device in every version that it speaks, rule by rule; `now` tells the time in s.

    Raises
    ------
    LineFault
        The line is lost.
    Broken
        Nothing on it speaks the protocol.
    """
    trial = Trial(line, address, now)
    trial.write(b"\0")
    identities = versions_of(trial)
    if not identities:
        raise Broken(_nobody(trial))
    if len(identities) == 2:
        said = identities[1].also == protocol.ALSO_VERSION_2
        rule = "A device of both versions says so in its IDENTITY of version 1 (section 4)"
        yield Verdict(1, rule, KEPT if said else BROKEN, "" if said else "the string v2 is missing")
    for version, identity in identities.items():
        trial.identity = identity
        trial.version = version
        for tried in BOTH + (NEWER if version > 1 else ()):
            yield _verdict(trial, tried)
        counters = trial.parser.counters
        wrong = counters.crc_errors + counters.framing_errors + counters.malformed
        rule = "All packets have the right checksum and content (sections 1 and 3)"
        yield Verdict(version, rule, BROKEN if wrong else KEPT, f"{wrong} wrong" if wrong else "")
    with suppress(Broken):
        trial.be_quiet()


def _verdict(trial: Trial, tried: Callable[[Trial], str | None]) -> Verdict:
    rule = " ".join((tried.__doc__ or "").split())
    result, remark = KEPT, ""
    try:
        trial.prepare()
        if trial.version > 1:
            command = protocol.Command(protocol.IDENTIFY, 0)
            trial.identity = trial.ask(command, protocol.Identity)
            trial.forget()
        remark = tried(trial) or ""
    except Broken as broken:
        result, remark = BROKEN, str(broken)
    except Untried as untried:
        result, remark = UNTRIED, str(untried)
    return Verdict(trial.version, rule, result, remark)


def _nobody(probe: Probe) -> str:
    counters = probe.parser.counters
    if not counters.bytes:
        return "nothing answers IDENTIFY"
    if counters.packets:
        return "packets come, but no answer to IDENTIFY"
    if is_text(probe.bytes):
        return f"it prints text, and only binary packets have rules to try; {READ_AS}"
    return f"{counters.bytes} bytes come and no valid packet (wrong baud rate?)"


__all__ = ["BROKEN", "KEPT", "UNTRIED", "Broken", "LineFault", "Verdict", "check"]
