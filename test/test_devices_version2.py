"""Version 2 of the wire protocol: device and host, alone and together."""

import math
import time

import numpy as np
import pytest
from devices_support import E, connected, counted, sensor

from tomotactile_ros.devices import protocol
from tomotactile_ros.devices.assembly import FrameAssembler, RunAssembler
from tomotactile_ros.devices.emulator import EmulatedDevice
from tomotactile_ros.support.errors import InputError


def row(index: int, order: tuple[int, ...], sequence: int = 1, scan: int = 9, **changes):
    """A row of an order; its readings tell row and sequence."""
    counts = 1000 + 100 * sequence + 10 * index + np.arange(E)
    made = protocol.Row(
        E, index, len(order), sequence, 100 * (index + 1), 10_000 * sequence, 0.5, 3.0,
        order[index], protocol.pack_counts(counts), scan, 1000, 2,
    )  # fmt: skip
    return made._replace(**changes)


def test_rows_of_an_order_become_a_frame_with_negative_and_own_readings():
    order = (3, 0, 3)
    assembler = FrameAssembler(E, E)
    assembler.expect_order(9, order)
    low = protocol.pack_counts([998, 1000, protocol.NO_READING, 1002, 0, 65534])
    (frame,) = [
        frame
        for each in (row(0, order, readings=low), row(1, order), row(2, order))
        for frame in assembler.feed(each)
    ]
    assert frame.grounded.tolist() == [3, 0, 3]
    assert frame.voltages[0].tolist()[:2] == [-1.0, 0.0]
    assert math.isnan(frame.voltages[0, 2])
    assert frame.voltages[0].tolist()[3:] == [1.0, -500.0, 32267.0]
    assert frame.voltages[2].tolist() == (0.5 * (120 + np.arange(E))).tolist()


def test_rows_of_another_order_than_they_say_or_of_an_unknown_one_are_ignored():
    order = (3, 0, 3)
    assembler = FrameAssembler(E, E)
    assembler.expect_order(9, order)
    for wrong in (
        row(0, order, grounded=2),
        row(0, order, scan=8),
        row(0, order, rows=4),
        row(0, order, scan=0),
    ):
        assert assembler.feed(wrong) == [] and not assembler.accepted
    assert assembler.counters.rows_ignored == 4
    assembler.expect_order(10, (1, 2, 4))
    mixed = [row(0, order), row(1, (1, 2, 4), scan=10), row(1, order), row(2, order)]
    (frame,) = [frame for each in mixed for frame in assembler.feed(each)]
    assert frame.grounded.tolist() == list(order)
    assert assembler.counters.rows_ignored == 5


def test_runs_hold_rows_that_follow_one_another_and_when_they_were_taken():
    order = (3, 0, 5, 1, 2, 4, 3)
    runs = RunAssembler(3)
    sent = [row(i, order, s) for s in (1, 2) for i in range(7) if (s, i) not in ((2, 1), (2, 5))]
    done = [run for each in sent for run in runs.feed(each)]
    assert [run.grounded.tolist() for run in done] == [
        [3, 0, 5], [1, 2, 4], [3],
        [3], [5, 1, 2], [3],
    ]  # fmt: skip
    begins = [10_000, 10_300, 10_600, 20_000, 20_200, 20_600]
    assert [run.frame_time for run in done] == begins
    assert [run.row_period for run in done] == [100.0] * 6
    assert [run.last_sample for run in done] == [
        begin + 100 * len(run.grounded) for begin, run in zip(begins, done)
    ]
    for run in done:
        assert run.voltages.shape == (len(run.grounded), E)
    assert done[1].voltages[0, 0] == 0.5 * (100 + 30)


class Listening(EmulatedDevice):
    """Keeps what it hears."""

    def __init__(self, *args, **settings) -> None:
        super().__init__(*args, **settings)
        self.heard = b""

    def receive(self, data, now):
        self.heard += data
        return super().receive(data, now)


def test_a_device_of_version_1_never_sees_a_byte_of_version_2():
    device = Listening(counted, E, rate=100.0, versions=[1])
    with connected(device, rate=50.0) as (_, watch):
        watch.wait_for_frames(5)
        watch.device.set_scan((1, 2))
        watch.wait_for(lambda s: any(trouble.name == "scan" for trouble in s.troubles))
        assert "its own order only" in watch.device.status().message
        watch.wait_for_frames(5)
        watch.device.set_streaming(False)
        watch.wait_for(lambda s: s.state == "stopped")
    packets = protocol.Parser().feed(device.heard)
    assert b"".join(map(protocol.encode, packets)) == device.heard.lstrip(b"\0")
    kinds = [(type(packet), protocol.type_of(packet)) for packet in packets]
    commands = protocol.Command
    assert kinds[:2] == [(commands, protocol.IDENTIFY), (commands, protocol.STOP)]
    assert kinds[2:4] == [(protocol.SetRate, protocol.SET_RATE), (commands, protocol.START)]
    assert kinds[-1] == (commands, protocol.STOP)
    assert {packet.version for packet in packets} == {1}


@pytest.mark.parametrize(
    ("versions", "said", "spoken"),
    [([1, 2], None, 2), ([2], None, 2), ([1], "\x02v3", 1), ([1], "\x02v2", 1), ([1], "later", 1)],
    ids=["both", "only 2", "another word", "lies", "junk behind the strings"],
)
def test_host_and_device_agree_on_a_version(versions, said, spoken, monkeypatch):
    monkeypatch.setattr("tomotactile_ros.devices.conversation.ANSWER_TIME", 0.05)

    def mangle(data: bytes) -> bytes:
        if said is None:
            return data
        packets = protocol.Parser().feed(data)
        return b"\0" + b"".join(
            protocol.frame(_body(packet) + said.encode())
            if isinstance(packet, protocol.Identity)
            else protocol.encode(packet)
            for packet in packets
        )

    with connected(sensor(versions=versions), mangle=mangle) as (_, watch):
        watch.wait_for_frames(3)
        assert watch.device.identity.version == spoken
        assert watch.device.status().counters["rows_ignored"] == 0


def _body(packet: protocol.Packet) -> bytes:
    from tomotactile_ros.devices import cobs

    return cobs.decode(protocol.encode(packet)[:-1])[:-4]


def test_a_commanded_order_arrives_and_changes_while_it_streams():
    with connected(sensor(max_scan=8), rate=200.0) as (_, watch):
        watch.wait_for_frames(3)
        for order in ((5, 0, 5, 2), (1,), ()):
            watch.device.set_scan(order)
            wanted = list(order) or list(range(E))
            watch.wait_for(lambda s, w=wanted: watch.frames[-1].grounded.tolist() == w)
            watch.wait_for_frames(5)
            frame = watch.frames[-1]
            assert frame.voltages.shape == (len(wanted), E)
            assert frame.row_period == pytest.approx(1 / (200.0 * len(wanted)), rel=3e-3)
        watch.device.set_scan(9 * [1])
        watch.wait_for(lambda s: "at most 8 rows" in s.message)
        with pytest.raises(InputError, match=f"scan: electrode {E} does not exist"):
            watch.device.set_scan((E,))
        status = watch.device.status()
    assert status.counters["rows_ignored"] == 0
    assert status.counters["frames_lost"] == 0


def test_an_order_that_somebody_else_commanded_does_not_stay():
    device = sensor()
    device.receive(protocol.encode(protocol.SetScan(0x1234, (2, 1))), 100.0)
    with connected(device) as (_, watch):
        watch.wait_for_frames(3)
        assert {len(frame.grounded) for frame in watch.frames} == {E}


def test_temperature_losses_and_restarts_of_the_device_are_told():
    device = sensor()
    device.temperature = 36.5
    with connected(device) as (_, watch):
        watch.wait_for(lambda s: s.counters["temperature"] == 36.5)
        told, when = watch.device.temperature
        assert told == 36.5 and 0.0 <= time.time() - when < 30.0
        device.dropped = 12
        watch.wait_for(lambda s: s.counters["packets_dropped"] == 12)
        assert watch.device.status().counters["device_restarts"] == 0
        device._boot ^= 1
        watch.wait_for(lambda s: s.counters["device_restarts"] == 1)
        watch.wait_for_frames(3)


def test_a_device_on_a_bus_is_asked_for_frames_one_by_one():
    lost = [0]

    def mangle(data: bytes) -> bytes:
        lost[0] += data.count(0)
        return data if lost[0] % 97 > 3 else b""

    other = protocol.encode(
        row(0, (0, 1), address=3)._replace(readings=protocol.pack_counts(np.zeros(E)))
    )
    device = Listening(counted, E, rate=200.0, address=7)
    with connected(device, mangle=lambda data: data + other, address=7) as (port, watch):
        watch.wait_for_frames(20)
        assert watch.device.status().counters["packets_of_others"] > 10
        assert watch.device.status().counters["frames_incomplete"] == 0
        port._mangle = mangle
        watch.wait_for_frames(20)
    starts = [p for p in protocol.Parser().feed(device.heard) if isinstance(p, protocol.Start)]
    assert len(starts) > 40
    assert {(start.frames, start.address) for start in starts} == {(1, 7)}
