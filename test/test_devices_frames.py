"""Frames from rows, host time from device time, dead channels: no line needed."""

import itertools

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tomotactile_ros.devices import protocol, time_source
from tomotactile_ros.devices.assembly import FrameAssembler, RunAssembler, row_period
from tomotactile_ros.devices.clock import DeviceClock
from tomotactile_ros.devices.health import DeadChannels, Health

E = 4


def row(index: int, sequence: int, time: int | None = None, **changes) -> protocol.Row:
    """Row `index` of frame `sequence`; its readings tell both."""
    counts = 100 * (sequence % 100) + 10 * index + np.arange(E)
    made = protocol.Row(
        E, index, E, sequence, 10 * (index + 1), 1000 * sequence if time is None else time,
        0.5, 3.0, index, protocol.pack_counts(counts),
    )  # fmt: skip
    return made._replace(**changes)


def expected(sequence: int) -> np.ndarray:
    """Voltages of that frame."""
    counts = 100 * (sequence % 100) + 10 * np.arange(E)[:, None] + np.arange(E)
    voltages = 0.5 * counts.astype(np.float32)
    np.fill_diagonal(voltages, np.nan)
    return voltages


def feed(assembler, rows) -> list:
    """All frames or runs that come of `rows`."""
    return [made for r in rows for made in assembler.feed(r)]


@pytest.mark.parametrize("rows", [E, 40])
def test_rows_under_another_drive_voltage_are_brought_to_that_of_the_frame(rows):
    """All that is read is proportional to what drives the sheet."""
    drives = 3.0 * (1.0 - 0.4 * (np.arange(rows) % 3 == 2))
    counts = 100 + np.arange(rows)[:, None] + np.arange(rows)
    sent = [
        protocol.Row(
            rows, i, rows, 1, i, 1, 0.5, drives[i], i,
            protocol.pack_counts(np.round(counts[i] * drives[i] / 3.0)),
        )
        for i in range(rows)
    ]  # fmt: skip
    (frame,) = feed(FrameAssembler(rows, rows), sent)
    wanted = 0.5 * counts.astype(np.float32)
    np.fill_diagonal(wanted, np.nan)
    assert frame.drive_voltage == 3.0
    assert np.allclose(frame.voltages, wanted, atol=0.5, equal_nan=True)
    assert np.isclose(frame.drive_span, 1.2)
    for run in feed(RunAssembler(5), sent):
        share = run.drive_voltage / 3.0
        assert np.allclose(run.voltages, share * wanted[run.grounded], atol=0.5, equal_nan=True)


def test_a_late_row_or_a_lost_one_does_not_move_the_row_period():
    ends = 250 * np.arange(1, 9)
    assert row_period(ends) == 250
    ends[3] += 180
    assert row_period(ends) == 250
    ends[[0, 5]] = -1
    assert row_period(ends) == 250
    assert row_period(np.array([700])) == 700
    assert row_period(ends[::-1]) == 0.0  # a counter that runs backwards tells nothing


@given(st.sets(st.tuples(st.integers(0, 9), st.integers(0, E - 1))))
def test_lost_packets_are_counted_and_never_make_a_wrong_frame(lost):
    assembler = FrameAssembler(E, E)
    sent = [(s, i) for s in range(10) for i in range(E)]
    fence = [row(i, s) for s in (10,) for i in range(E)]
    frames = feed(assembler, [row(i, s) for s, i in sent if (s, i) not in lost] + fence)
    whole = [s for s in range(10) if all((s, i) not in lost for i in range(E))]
    assert [f.sequence for f in frames] == [*whole, 10]
    for frame in frames:
        assert np.array_equal(frame.voltages, expected(frame.sequence), equal_nan=True)
    first = min(s for s, i in [*sent, (10, 0)] if (s, i) not in lost)
    assert assembler.counters.packets_lost == sum(s >= first for s, _ in lost)


@given(st.sets(st.integers(0, 39), max_size=39))
def test_of_many_rows_each_is_where_it_belongs_whichever_are_lost(lost):
    assembler = FrameAssembler(40, 40, partial=True)
    counts = np.arange(1600).reshape(40, 40)
    first, second, third = (
        [
            protocol.Row(40, i, 40, s, i, s, 0.5 + s, 3.0, i, protocol.pack_counts(counts[i]))
            for i in range(40)
        ]
        for s in range(3)
    )
    arrived = [r for r in second if r.row not in lost]
    _, frame, *_ = feed(assembler, first + arrived + third)
    voltages = 1.5 * counts.astype(np.float32)
    np.fill_diagonal(voltages, np.nan)
    voltages[sorted(lost)] = np.nan
    assert np.array_equal(frame.voltages, voltages, equal_nan=True)
    missing = np.isnan(frame.voltages).all(axis=1).sum()
    assert (missing, frame.last_sample) == (len(lost), 1 + arrived[-1].row)


FRAME = [row(i, 5) for i in range(E)]
AGAIN = [row(i, 6) for i in range(E)]
WRAPS = [row(i, s, time=t) for s, t in ((0xFFFFFFFF, 1000), (0, 2000)) for i in range(E)]
ORDERS = {
    "repeated and late": ([*FRAME[:2], FRAME[1], row(3, 4), *FRAME[2:], *FRAME], [5], 2 + E, 0),
    "misfitting": (
        [*FRAME, AGAIN[0]._replace(count=5, readings=bytes(10)), row(0, 6, rows=3)], [5], 2, 0,
    ),
    "grounded twice": ([AGAIN[0], row(1, 6, grounded=0), *AGAIN[2:]], [], 1, 0),
    "by another row": (
        [*FRAME, row(0, 6, grounded=1), row(1, 6, grounded=0), *AGAIN[2:]], [5], 2, 0,
    ),
    "of before and after a restart": (
        [*FRAME[:2], *(row(i, 5, time=50_000) for i in (2, 3))], [], 0, 1,
    ),
    "a restart": ([row(i, s) for s in (50_000, 0, 1) for i in range(E)], [50_000, 0, 1], 0, 0),
    "the sequence wraps": (WRAPS, [0xFFFFFFFF, 0], 0, 0),
}  # fmt: skip


@pytest.mark.parametrize("name", ORDERS)
def test_rows_make_no_frame_that_they_are_not_of(name):
    rows, sequences, ignored, incomplete = ORDERS[name]
    assembler = FrameAssembler(E, E)
    frames = feed(assembler, rows)
    assert [frame.sequence for frame in frames] == sequences
    assert all(frame.grounded.tolist() == list(range(E)) for frame in frames)
    counters = assembler.counters
    assert (counters.rows_ignored, counters.frames_incomplete) == (ignored, incomplete)
    assert counters.frames_lost == 0 and (incomplete or ignored or not counters.packets_lost)


ORDER = (3, 0, 3)


def ordered(index: int, order=ORDER, sequence: int = 1, scan: int = 9, **changes) -> protocol.Row:
    """A row of an order, with a zero of 1000 counts; its readings tell row and sequence."""
    counts = 1000 + 100 * sequence + 10 * index + np.arange(E)
    made = protocol.Row(
        E, index, len(order), sequence, 100 * (index + 1), 10_000 * sequence, 0.5, 3.0,
        order[index], protocol.pack_counts(counts), scan, 1000, 2,
    )  # fmt: skip
    return made._replace(**changes)


def test_rows_of_another_order_than_they_say_or_of_an_unknown_one_are_ignored():
    assembler = FrameAssembler(E, E)
    assembler.expect_order(9, ORDER)
    for wrong in ({"grounded": 2}, {"scan": 8}, {"rows": 4}, {"scan": 0}):
        assert assembler.feed(ordered(0, **wrong)) == [] and not assembler.accepted
    assembler.expect_order(10, (1, 2, 0))
    mixed = [ordered(0), ordered(1, (1, 2, 0), scan=10), ordered(1), ordered(2)]
    (frame,) = feed(assembler, mixed)
    assert frame.grounded.tolist() == list(ORDER)
    assert assembler.counters.rows_ignored == 5


def test_runs_hold_rows_that_follow_one_another_and_when_they_were_taken():
    order = (3, 0, 2, 1, 2, 0, 3)
    sent = [(s, i) for s in (1, 2) for i in range(7) if (s, i) not in ((2, 1), (2, 5))]
    done = feed(RunAssembler(3), [ordered(i, order, s) for s, i in sent])
    groups = [[3, 0, 2], [1, 2, 0], [3], [3], [2, 1, 2], [3]]
    assert [run.grounded.tolist() for run in done] == groups
    begins = [10_000, 10_300, 10_600, 20_000, 20_200, 20_600]
    assert [run.frame_time for run in done] == begins
    for run, begin in zip(done, begins):
        assert run.row_period == 100.0
        assert run.last_sample == begin + 100 * len(run.grounded)
        assert run.voltages.shape == (len(run.grounded), E)
    assert done[1].voltages[0, 0] == 0.5 * (100 + 30)


def arrivals(device: np.ndarray, drift: float, seed: int = 0) -> np.ndarray:
    """Host times: a drifting clock, delays of 0.2 ms and more, every tenth up to 30 ms late."""
    random = np.random.default_rng(seed)
    delay = 2e-4 + random.exponential(3e-4, device.size)
    delay += np.where(random.random(device.size) < 0.1, random.uniform(0, 0.03, device.size), 0.0)
    return 1000.0 + device / (1.0 + drift) + delay


@pytest.mark.parametrize("drift", [0.0, 3e-5, -3e-5, 5e-4, -5e-4])
def test_the_clock_is_mapped_to_the_shortest_delay_whatever_the_drift(drift):
    clock, device = DeviceClock(), np.arange(0.0, 60.0, 0.016)
    for d, h in zip(device, arrivals(device, drift), strict=True):
        clock.update(d, h)
        clock.fit()
    truth = 1000.0 + device[-1] / (1.0 + drift) + 2e-4
    assert abs(clock.to_host(device[-1]) - truth) < 2e-4
    assert abs(clock.drift - drift) < 1e-5
    assert clock.jumps == 0


@pytest.mark.parametrize("catching_up", [0.3, 6.0])
def test_a_backlog_of_ten_seconds_does_not_move_the_clock(catching_up):
    """The host stands still at 3 s, goes on at 13 s and takes that long to read what has come."""
    clock, device = DeviceClock(), np.arange(0.0, 25.0, 0.016)
    host = 1000.0 + device + 2e-4
    backlog = (device > 3.0) & (device < 13.0 + catching_up)
    host[backlog] = np.linspace(1013.0, 1013.0 + catching_up, backlog.sum())
    for d, h in zip(device, host, strict=True):
        clock.update(d, h)
        clock.fit()
    assert clock.jumps == 0
    assert abs(clock.to_host(25.0) - 1025.0002) < 2e-4


@given(st.lists(st.sampled_from([0.004, 0.5, 3.0, -2.0, -0.1, 100.0, -1e4]), max_size=60))
def test_stamps_increase_and_never_lie_in_the_future_whatever_the_device_clock_does(steps):
    clock, device, host, last = DeviceClock(), 1e5, 50.0, -np.inf
    for step in steps:
        device, host = device + step, host + 0.004
        clock.update(device, host)
        clock.fit()
        stamp = clock.stamp(device - 0.003)
        assert stamp > last
        assert stamp <= host + 1e-4
        last = stamp


@pytest.mark.parametrize("jump", [10.0, -10.0, 0.2])
def test_a_jump_of_the_device_clock_is_noticed_at_once(jump):
    clock = DeviceClock()
    for k in range(100):
        clock.update(0.01 * k, 0.01 * k + 5.0)
    clock.update(1.0 + jump, 6.0)
    assert clock.jumps == 1
    assert clock.to_host(1.0 + jump) == pytest.approx(6.0)


@pytest.mark.parametrize("held_up_at", range(6))
def test_unix_time_is_right_wherever_the_process_is_held_up(monkeypatch, held_up_at):
    reads = itertools.count()
    passed = [0.0]

    def read(offset: float) -> float:
        passed[0] += 0.1 if next(reads) == held_up_at else 1e-6
        return passed[0] + offset

    monkeypatch.setattr(time_source.time, "monotonic", lambda: read(50.0))
    monkeypatch.setattr(time_source.time, "time", lambda: read(1e9))
    assert time_source.unix_time(7.0) == pytest.approx(1e9 - 43.0, rel=0, abs=2e-5)


def test_dead_channels_are_told_from_idle_ones():
    random, channels = np.random.default_rng(0), DeadChannels(window=10)
    for _ in range(10):
        channels.update(random.normal(0, 1e-3, (8, 8)), 3.3)
    assert channels.dead == ()
    for _ in range(10):
        voltages = random.uniform(0.0, 1.0, (8, 8))
        voltages[:, 2] = 3.05  # covered by a conductor, and read 8 % low
        voltages[:, 3] = 2.5
        voltages[:, 5] = random.normal(0.0, 1e-3, 8)
        voltages[:, 6] = np.nan
        channels.update(voltages, 3.3)
    assert channels.dead == (3, 5, 6)
    for _ in range(10):
        channels.update(random.normal(0, 1e-3, (8, 8)), 3.3)
    assert channels.dead == (3, 5)


def test_a_rate_that_is_not_reached_is_told():
    now = [1000.0]
    watched = Health(lambda: now[0])

    def deliver(seconds, rate):
        for _ in range(round(seconds * rate)):
            now[0] += 1 / rate
            watched.frame_delivered(np.zeros((E, E)), 3.3, now[0])
        return [(trouble.name, trouble.serious) for trouble in watched.troubles(10.0)]

    assert deliver(1.0, 5.0) == []  # too early to say
    assert deliver(3.0, 5.0) == [("rate", False)]
    assert watched.troubles(10.0)[0].text == "5 frames/s arrive, 10 are wanted"
    assert watched.troubles(5.0) == watched.troubles() == []
    watched.forget_rate()  # another one is wanted from now on
    assert deliver(20.0, 10.0) == []
