"""`tomotactile conform`: devices that keep the protocol, and one that breaks each rule."""

import itertools

import numpy as np
import pytest
from devices_support import E, counted, plugged, sensor

from tomotactile_ros.cli import main
from tomotactile_ros.devices import conformance, protocol
from tomotactile_ros.devices.conformance import BROKEN, KEPT, UNTRIED, Broken, check
from tomotactile_ros.devices.emulator import EmulatedDevice, TcpPort


class Instant:
    """A line to a device on which time passes only while somebody reads."""

    def __init__(self, device: EmulatedDevice, mangle=bytes) -> None:
        self.time = 50.0
        self._device, self._mangle = device, mangle
        self._waiting = b""

    def now(self) -> float:
        return self.time

    def read(self, timeout: float) -> bytes:
        data, self._waiting = self._waiting, b""
        if not data:
            self.time += min(timeout, 0.001)
            data = self._mangle(self._device.rows_due(self.time))
        return data

    def write(self, data: bytes) -> None:
        self._waiting += self._mangle(self._device.rows_due(self.time))
        self._waiting += self._mangle(self._device.receive(data, self.time))


def verdicts(device: EmulatedDevice, address: int = 0, mangle=bytes) -> list:
    line = Instant(device, mangle)
    return list(check(line, address, line.now))


def broken(device: EmulatedDevice, mangle=bytes) -> list[str]:
    """The rules that a device breaks, with the remarks."""
    return [f"{v.rule}: {v.remark}" for v in verdicts(device, mangle=mangle) if v.result == BROKEN]


@pytest.mark.parametrize(
    ("settings", "address", "versions", "untried"),
    [
        ({}, 0, {1, 2}, 0),
        ({"versions": [1]}, 0, {1}, 0),
        ({"versions": [2], "own_reading": True, "lowest": -3.3}, 0, {2}, 0),
        ({"address": 7}, 7, {2}, 0),
        ({"rows": 3, "max_scan": 2}, 0, {1, 2}, 0),
        ({"versions": [2], "max_scan": 0}, 0, {2}, 2),
    ],
)
def test_the_emulator_keeps_every_rule_that_can_be_tried(settings, address, versions, untried):
    found = verdicts(sensor(**settings), address)
    assert {v.version for v in found} == versions
    left = [v for v in found if v.result != KEPT]
    assert len(left) == untried
    assert all(v.result == UNTRIED and "SET_SCAN" in v.rule for v in left)
    assert len(found) >= (18 if versions == {1} else 27)


def test_nobody_and_noise_are_told_apart():
    for mangle, words in (
        (lambda data: b"", "nothing answers"),
        (lambda data: b"noise" if data else b"", "no valid packet"),
        (lambda data: b"0\t612\t655\t701\r\n", "it prints text.*--protocol text-V"),
        (lambda data: protocol.encode(protocol.Ack(0, 1, False, 1.0)), "no answer to IDENTIFY"),
    ):
        with pytest.raises(Broken, match=words):
            verdicts(sensor(), mangle=mangle)


def changed(kind: int, change):
    """A line that changes packets of a type: `change` returns what takes a packet's place."""

    def mangle(data: bytes) -> bytes:
        zeros = b"\0" if data.startswith(b"\0") else b""
        packets = [
            change(packet) if protocol.type_of(packet) == kind else packet
            for packet in protocol.Parser().feed(data)
        ]
        return zeros + b"".join(protocol.encode(p) for p in packets if p is not None)

    return mangle


def row(**fields):
    """A line that changes these fields of rows."""

    def change(row):
        return row._replace(**{name: made(row) for name, made in fields.items()})

    return changed(protocol.ROW, change)


def every(count: int):
    """True every so many times."""
    calls = itertools.count(1)
    return lambda: next(calls) % count == 0


def too_high(row) -> bytes:
    """Readings with one that the converter does not have."""
    counts = protocol.unpack_counts(row.readings).copy()
    counts[row.grounded - 1] = 5000
    return protocol.pack_counts(counts)


def losing(count: int):
    """A change that loses every so manyth packet."""
    due = every(count)
    return lambda packet: None if due() else packet


def damaging(count: int):
    """A line that damages some packets."""
    due = every(count)
    return lambda data: data[:-9] + b"\0" if data and due() else data


LINES = {
    "A delimiter is sent": lambda data: data.lstrip(b"\0"),
    "Frames begin with row 0": changed(protocol.ROW, losing(5)),
    "The sequence number rises": row(sequence=lambda row: 2 * row.sequence),
    "A row grounds the same": row(grounded=lambda row: (row.row + row.sequence) % E),
    "Device time never jumps": row(row_end=lambda row: row.row_end - row.row_end % 7000),
    "1000 ppm": row(frame_time=lambda row: round(1.02 * row.frame_time)),
    "Readings are counts": row(readings=too_high),
    "the scale fits its range": row(scale=lambda row: 0.1),
    "Frames come at the rate": changed(protocol.ACK, lambda a: a._replace(rate=2 * a.rate)),
    "ACK to START comes before": changed(
        protocol.ACK, lambda ack: ack._replace(sequence=ack.sequence + 1)
    ),
    "agrees with IDENTITY": changed(protocol.STATUS, lambda s: s._replace(boot=s.boot ^ 1)),
    "have the right checksum": damaging(40),
    "says so in its IDENTITY": changed(protocol.IDENTITY, lambda i: i._replace(also="")),
    "that makes sense": changed(
        protocol.IDENTITY, lambda i: i._replace(rate=1e6, max_rate=10.0, max_row_rate=60.0)
    ),
}


def try_only(monkeypatch, rules: list[str]) -> None:
    """Try the checks of these rules, or a few where none is meant."""
    for name in ("BOTH", "NEWER"):
        checks = getattr(conformance, name)
        wanted = [c for c in checks if any(r in " ".join(c.__doc__.split()) for r in rules)]
        monkeypatch.setattr(conformance, name, tuple(wanted) or checks[3:5])


@pytest.mark.parametrize("rule", LINES)
def test_a_device_that_says_something_wrong_is_found(rule, monkeypatch):
    try_only(monkeypatch, [rule])
    assert any(rule in told for told in broken(sensor(), LINES[rule]))


class Slow(EmulatedDevice):
    """Answers with its next rows, a fifth of a second late."""

    _late = b""

    def receive(self, data, now):
        self._late += super().receive(data, now)
        self._due = now + 0.2
        return b""

    def rows_due(self, now):
        late = b""
        if self._late and now > self._due:
            late, self._late = self._late, b""
        return late + super().rows_due(now)


class Generous(EmulatedDevice):
    """Says yes to every rate, and to all addresses; knows no ERROR."""

    def _set_rate(self, packet):
        return self._ack(packet, protocol.SET_RATE)

    def _error(self, *args, **settings):
        return b""

    def _is_for_me(self, version, address):
        return True


class Sticky(EmulatedDevice):
    """Forgets nothing: orders, timeouts, numbers of frames."""

    def _set_scan(self, packet):
        if packet.order:
            self._take_order(np.array(packet.order) % self.electrodes, packet.tag)
        return self._ack(packet, protocol.SET_SCAN)

    def _start_stream(self, packet, now):
        newer = packet.version > 1
        return super()._start_stream(packet._replace(timeout=0, frames=0) if newer else packet, now)


class Elsewhere(EmulatedDevice):
    """Grounds electrodes in rising order, whatever it is told."""

    def _set_scan(self, packet):
        return super()._set_scan(packet._replace(order=tuple(sorted(packet.order))))


MANNERS = {
    Slow: ["within 0.1 s"],
    Generous: [
        "SET_RATE above the fastest",
        "unknown command",
        "unsupported version",
        "of the wrong length is refused",
        "Commands to another address",
    ],
    Sticky: [
        "without rows gives",
        "SET_SCAN of a missing electrode",
        "when it has heard nothing",
        "behind the number of frames",
    ],
    Elsewhere: ["SET_SCAN holds from"],
}


@pytest.mark.parametrize("kind", MANNERS)
def test_a_device_with_bad_manners_is_found(kind, monkeypatch):
    try_only(monkeypatch, MANNERS[kind])
    told = broken(kind(counted, E, rate=100.0))
    assert not any("(tag=" in each for each in told), told  # a packet as Python prints it
    for rule in MANNERS[kind]:
        assert any(rule in each for each in told), told


def test_the_command_says_what_is_kept_and_broken(capsys, monkeypatch):
    try_only(monkeypatch, ["that makes sense", "A delimiter"])
    with plugged(sensor(versions=[1]), TcpPort) as port:
        assert main(["conform", port.path]) == 0
        said = capsys.readouterr().out
        assert said.startswith("version 1\n  kept       IDENTIFY")
        assert said.splitlines()[-1] == "3 kept"
        port._mangle = lambda data: data.lstrip(b"\0")
        assert main(["conform", port.path]) == 1
        assert "  BROKEN     A delimiter is sent before" in capsys.readouterr().out
    assert main(["conform", port.path]) == 2
    assert "cannot be opened" in capsys.readouterr().err
