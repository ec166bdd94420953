"""The serial device against the emulated sensor, on real pseudo-terminals and TCP, with its faults."""

import errno
import os
import re
import select
import socket
import threading
import time
from types import SimpleNamespace
from unittest.mock import Mock

import numpy as np
import pytest
import serial
from devices_support import E, Watch, connected, counted, plugged, sensor, watched
from serial import rfc2217

from tomotactile_ros.cli import main
from tomotactile_ros.devices import (
    DeviceSettings,
    cobs,
    conversation,
    emulator,
    line,
    make_device,
    protocol,
)
from tomotactile_ros.devices.firmware import EmulatedDevice, idle_source
from tomotactile_ros.devices.serial import SerialDevice
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.support.errors import InputError


class Unmodem(serial.Serial):
    """A pseudo-terminal has no modem lines; a server of ports asks for them."""

    cts = dsr = ri = cd = False

    def _update_dtr_state(self) -> None:
        pass

    _update_rts_state = _update_dtr_state


class PortServer(threading.Thread):
    """A serial port on the network by RFC 2217, as a terminal server or `ser2net` offers it."""

    def __init__(self, path: str) -> None:
        super().__init__(daemon=True)
        self._serial, self._stop_it = Unmodem(path, timeout=0), threading.Event()
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = "rfc2217://{}:{}".format(*self._server.getsockname())
        self.start()

    def write(self, data: bytes) -> None:
        """What the telnet side of the port wants to tell its client."""
        self._peer.sendall(data)

    def close(self) -> None:
        self._stop_it.set()
        self.join()

    def run(self) -> None:
        with self._server, self._serial:
            self._peer = self._server.accept()[0]
            telnet = rfc2217.PortManager(self._serial, self)
            with self._peer:
                while not self._stop_it.is_set():
                    ready = select.select([self._peer, self._serial], [], [], 0.05)[0]
                    if self._peer in ready:
                        self._serial.write(b"".join(telnet.filter(self._peer.recv(4096))))
                    if self._serial in ready and self._serial.in_waiting:
                        self.write(b"".join(telnet.escape(self._serial.read(4096))))


@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of pyserial, about its own thread
def test_frames_arrive_from_a_port_on_the_network():
    with plugged(sensor()) as port:
        server = PortServer(port.path)
        with watched(SerialDevice(server.url, E, baud=115200)) as watch:
            watch.wait_for_frames(20)
            server.close()
            watch.wait_for(lambda s: s.state == "disconnected")
            message = watch.device.status().message
        assert "\n" not in message


class HardOfHearing(EmulatedDevice):
    """A device that keeps what it hears, and does not obey all of it."""

    deaf_for = 0
    heard = b""

    def receive(self, data, now):
        self.heard += data
        if self.deaf_for > 0:
            self.deaf_for -= 1
            return b""
        return super().receive(data, now)


def test_commands_lost_on_the_line_are_sent_again():
    device = HardOfHearing(counted, E, rate=100.0)
    with connected(device) as (_, watch):
        for deaf_for in (1, 3):
            watch.wait_for_frames(1)
            device.deaf_for = deaf_for
            watch.device.set_streaming(False)
            watch.wait_for(lambda s: s.state == "stopped")
            watch.wait_for(lambda s: not device.streaming)
            device.deaf_for = deaf_for
            watch.device.set_rate(50.0 * deaf_for)
            watch.wait_for(lambda s, rate=50.0 * deaf_for: s.counters["rate_device"] == rate)
            device.deaf_for = deaf_for
            watch.device.set_streaming(True)
            watch.wait_for(lambda s: s.state == "streaming")


def test_a_board_that_restarts_when_its_port_is_opened_has_time_to_boot(monkeypatch):
    board = HardOfHearing(counted, E, rate=100.0)

    def opener(path, baud):
        board.deaf_for = conversation.ATTEMPTS + 3
        return line.open_line(path, baud)

    monkeypatch.setattr(conversation, "ANSWER_TIME", 0.05)
    with connected(board, opener=opener) as (_, watch):
        watch.wait_for(lambda s: s.state == "silent")
        watch.wait_for_frames(3)


def test_a_device_of_version_1_never_sees_a_byte_of_version_2():
    device = HardOfHearing(counted, E, rate=100.0, versions=[1])
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
    kinds = [protocol.type_of(packet) for packet in packets]
    begin = [protocol.IDENTIFY, protocol.STOP, protocol.SET_RATE, protocol.START]
    assert kinds[:4] == begin and kinds[-1] == protocol.STOP
    assert {packet.version for packet in packets} == {1}


@pytest.mark.parametrize(
    ("versions", "said", "spoken"),
    [([1, 2], None, 2), ([2], None, 2), ([1], "\x02v3", 1), ([1], "\x02v2", 1), ([1], "later", 1)],
    ids=["both", "only 2", "another word", "lies", "junk behind the strings"],
)
def test_host_and_device_agree_on_a_version(versions, said, spoken, monkeypatch):
    monkeypatch.setattr(conversation, "ANSWER_TIME", 0.05)

    def says(packet):
        wire = protocol.encode(packet)
        if said is None or not isinstance(packet, protocol.Identity):
            return wire
        return protocol.frame(cobs.decode(wire[:-1])[:-4] + said.encode())

    def mangle(data: bytes) -> bytes:
        return b"\0" + b"".join(map(says, protocol.Parser().feed(data)))

    with connected(sensor(versions=versions), mangle=mangle) as (_, watch):
        watch.wait_for_frames(3)
        assert watch.device.identity.version == spoken
        assert watch.device.status().counters["rows_ignored"] == 0


def test_a_commanded_order_arrives_and_changes_while_it_streams():
    device = sensor(max_scan=8)
    device.receive(protocol.encode(protocol.SetScan(0x1234, (2, 1))), 100.0)  # of somebody else
    with connected(device, rate=200.0) as (_, watch):
        watch.wait_for_frames(3)
        assert {len(frame.grounded) for frame in watch.frames} == {E}
        for order in ((5, 0, 5, 2), (1,), ()):
            watch.device.set_scan(order)
            wanted = list(order) or list(range(E))
            watch.wait_for(lambda s, w=wanted: watch.frames[-1].grounded.tolist() == w)
            watch.wait_for_frames(5)
            frame = watch.frames[-1]
            assert frame.voltages.shape == (len(wanted), E)
            assert frame.drive_voltage == pytest.approx(3.3)
            assert frame.row_period == pytest.approx(1 / (200.0 * len(wanted)), rel=3e-3)
        watch.device.set_scan(9 * [1])
        watch.wait_for(lambda s: "at most 8 rows" in s.message)
        with pytest.raises(InputError, match=f"scan: electrode {E} does not exist"):
            watch.device.set_scan((E,))
        status = watch.device.status()
    assert status.counters["rows_ignored"] == 0
    assert status.counters["frames_lost"] == 0


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

    zeros = protocol.pack_counts(np.zeros(E))
    other = protocol.Row(E, 0, 2, 1, 100, 10_000, 0.5, 3.0, 0, zeros, 9, 1000, 2, address=3)
    device = HardOfHearing(counted, E, rate=200.0, address=7)
    beside = protocol.encode(other)
    with connected(device, mangle=lambda data: data + beside, address=7) as (port, watch):
        watch.wait_for_frames(20)
        assert watch.device.status().counters["packets_of_others"] > 10
        assert watch.device.status().counters["frames_incomplete"] == 0
        port._mangle = mangle
        watch.wait_for_frames(20)
    starts = [p for p in protocol.Parser().feed(device.heard) if isinstance(p, protocol.Start)]
    assert len(starts) > 40
    assert {(start.frames, start.address) for start in starts} == {(1, 7)}


class Faulty(EmulatedDevice):
    """Answers a command with an error, `command`; tells a fault behind its rows, `beside`."""

    command = beside = None

    def _answer(self, packet, now):
        if protocol.type_of(packet) != self.command:
            return super()._answer(packet, now)
        fault = protocol.Error(packet.tag, self.command, protocol.HARDWARE_FAULT, "no ADC")
        return protocol.encode(fault)

    def rows_due(self, now):
        rows = super().rows_due(now)
        return rows + (protocol.encode(self.beside) if self.beside and rows else b"")


def faulty(**faults):
    device = Faulty(counted, E, rate=100.0)
    vars(device).update(faults)
    return device


def noise(data: bytes) -> bytes:
    """A pseudo-terminal has no baud rate: what a wrong one makes of the bytes."""
    count = len(data) // 2 + 100
    return np.random.default_rng(count).integers(0, 256, count, dtype=np.uint8).tobytes()


def of_version_3(data: bytes) -> bytes:
    return protocol.frame(bytes([0x11, 3, 0, 0])) if data else b""


BIG = EmulatedDevice(idle_source(9), 9, name="big skin")
TEXT = b"0\t612\t655\t701\r\n"
FAULTS = {
    "baud rate": ({"mangle": noise, "baud": 9600}, "garbled", "wrong baud rate"),
    "text": ({"mangle": lambda data: TEXT}, "garbled", "prints text; "),
    "version 3": ({"mangle": of_version_3}, "refused", "version 3"),
    "electrodes": ({"simulated": BIG}, "refused", "big skin.*9 electrodes.*layout 6"),
    "IDENTIFY": ({"simulated": faulty(command=protocol.IDENTIFY)}, "refused", "no ADC"),
    "START": ({"simulated": faulty(command=protocol.START)}, "silent", "no ADC"),
    "rate": ({"simulated": sensor(max_rate=150.0), "rate": 1e3}, "streaming", "at most 150"),
    "haste": ({"simulated": sensor(rate=25.0, haste=10.0), "rate": 25.0}, "streaming", "of 25"),
}


@pytest.mark.parametrize("name", FAULTS)
def test_what_is_wrong_with_a_device_or_its_line_is_told_until_it_is_mended(name):
    settings, state, words = FAULTS[name]
    with connected(**settings) as (port, watch):
        watch.wait_for(lambda s: s.state == state and re.search(words, s.message))
        assert state == "streaming" or watch.frames == []
        port._mangle, port.device = bytes, sensor()
        watch.wait_for(lambda s: s.state == "streaming")
        watch.wait_for_frames(3)


def test_close_stops_the_device_and_it_can_be_opened_again():
    with plugged(sensor()) as port:
        device = SerialDevice(port.path, E)
        for _ in range(3):
            with watched(device) as watch:
                watch.wait_for_frames(3)
            probe = Watch(device)
            probe.wait_for(lambda s: not port.device.streaming)
            assert len(watch.frames) == device.status().counters["frames"]


def test_a_receiver_that_raises_does_not_end_the_stream():
    with plugged(sensor()) as port:
        device = SerialDevice(port.path, E)
        device.open(lambda frame: 1 / 0)
        watch = Watch(device)
        watch.wait_for(lambda s: s.counters["callback_errors"] >= 3 and s.state == "streaming")
        (trouble,) = (t for t in device.status().troubles if t.name == "receiver")
        assert trouble.serious and "ZeroDivisionError: division by zero" in trouble.text
        device.close()


def test_unplug_and_replug_a_hundred_times(tmp_path):
    link = str(tmp_path / "port")
    with connected(make_port=lambda: emulator.PtyPort(link)) as (port, watch):
        watch.wait_for_frames(1)
        for cycle in range(100):
            port.unplug()
            if cycle % 10 == 0:
                watch.wait_for(lambda s: s.state == "disconnected")
            port.plug()
            watch.wait_for(lambda s, n=cycle: s.counters["reconnects"] > n)
            watch.wait_for_frames(1)


def test_the_emulator_says_what_it_is_and_programs_read_the_port_alone(capsys, monkeypatch):
    monkeypatch.setattr(emulator.Emulator, "run", lambda self, announce: announce("/tmp/skin"))
    assert main(["emulate", "--protocol", "text-mV"]) == 0
    said = capsys.readouterr()
    assert said.out == "/tmp/skin\n" and said.err.count("\n") == 1
    assert "watch --layout equal-8x8 --port /tmp/skin --protocol text-mV" in said.err


@pytest.mark.parametrize("version", protocol.VERSIONS)
def test_a_device_that_forgets_to_stream_is_started_again(version):
    """A device of version 2 says so itself; that of version 1 has fallen silent, though it still
    answers."""
    with connected(sensor(versions=(version,))) as (port, watch):
        watch.wait_for_frames(3)
        port.device.streaming = False
        watch.wait_for(lambda status: port.device.streaming)
        watch.wait_for_frames(3)
        assert version > 1 or watch.device.status().counters["reconnects"] >= 1


def test_rows_of_before_the_start_are_not_taken_for_new():
    """A device that was left streaming: seconds of rows wait on the line when the host comes."""
    with plugged(sensor()) as port:
        port.device.streaming = True
        port.device._start_scan(time.monotonic() - 3.0)
        with watched(SerialDevice(port.path, E)) as watch:
            watch.wait_for_frames(20)
        assert watch.frames[0].sequence >= 300


def test_answers_to_nothing_that_was_asked_change_nothing():
    """An ACK with another tag, or to another command: neither the rate nor the frame is touched."""
    false = protocol.Ack(0x7777, protocol.SET_RATE, False, 1.0)
    with connected(faulty(beside=false)) as (_, watch):
        watch.wait_for_frames(30)
        counters = watch.device.status().counters
        assert counters["answers_ignored"] > 10
        assert counters["rate_device"] == 100.0
        assert counters["frames_incomplete"] <= 1  # one at the stop with which it began


def troubles(status):
    return {trouble.name: trouble.serious for trouble in status.troubles}


def test_a_device_that_reports_a_fault_is_in_trouble():
    fault = protocol.Error(0, 0, protocol.HARDWARE_FAULT, "too \x1b[2J hot")
    with connected(faulty(beside=fault)) as (_, watch):
        watch.wait_for(lambda s: troubles(s).get("device"))
        message = watch.device.status().message
    assert "hot" in message and message.isprintable()


def losing(share: float, seed: int = 0):
    """Line that loses that share of the packets."""
    random = np.random.default_rng(seed)

    def mangle(data: bytes) -> bytes:
        packets = data.split(b"\0")
        return b"".join(p + b"\0" for p in packets if p and random.random() >= share)

    return mangle


def test_lost_packets_and_readings_above_the_drive_voltage_are_told_and_no_wrong_frame_comes():
    with connected(sensor(drive_voltage=1.0)) as (port, watch):
        watch.wait_for(lambda s: "above drive" in troubles(s))
        assert "loss" not in troubles(watch.device.status())
        port._mangle = losing(0.02)
        watch.wait_for(lambda s: not troubles(s).get("loss", True))
        port._mangle = losing(0.5)
        watch.wait_for(lambda s: troubles(s).get("loss") and s.counters["packets_lost"] > 300)
        assert "% of the frames are lost" in watch.device.status().message
        port._mangle = losing(0.99)
        watch.wait_for(lambda s: s.state in ("garbled", "silent"))
        port._mangle = bytes
        watch.wait_for(lambda s: s.state == "streaming")
        watch.wait_for_frames(3)


def test_a_second_host_on_the_network_does_not_disturb_the_first():
    with connected(make_port=emulator.TcpPort) as (port, first):
        first.wait_for_frames(1)
        with watched(SerialDevice(port.path, E)) as second:
            second.wait_for(lambda s: "connection lost" in s.message)
            first.wait_for_frames(10)
            assert second.frames == []
            first.device.close()
            second.wait_for_frames(1)


def test_a_port_in_use_is_told():
    with plugged(sensor()) as port:
        other = serial.Serial(port.path, exclusive=True)
        with watched(SerialDevice(port.path, E)) as watch:
            watch.wait_for(lambda s: s.state == "disconnected" and "in use" in s.message)
            other.close()
            watch.wait_for_frames(1)


def found(device, vid, pid, serial_number):
    """What pyserial tells of a plugged-in adapter."""
    return SimpleNamespace(device=device, vid=vid, pid=pid, serial_number=serial_number)


def test_a_port_is_found_by_its_usb_id_and_again_under_another_name(monkeypatch):
    adapters = None

    def comports():
        if adapters is None:
            raise TypeError("gone while asked about")
        return adapters

    monkeypatch.setattr(line.list_ports, "comports", comports)
    with (
        plugged(sensor()) as first,
        plugged(sensor()) as second,
        watched(SerialDevice("usb:2341:0010", E)) as watch,
    ):
        watch.wait_for(lambda s: s.state == "disconnected" and "gone while" in s.message)
        adapters = []
        watch.wait_for(lambda s: s.state == "disconnected" and "plugged in" in s.message)
        for port in (first, second):
            adapters = [found(port.path, 0x2341, 0x10, "X1")]
            watch.wait_for(lambda s, port=port: s.state == "streaming" and port.path in s.message)
            watch.wait_for_frames(1)
            first.unplug()


def test_ports_are_found_by_usb_id_pattern_and_name(monkeypatch, tmp_path):
    adapters = [found("/dev/a", 0x2341, 0x10, "X1"), found("/dev/b", 0x2341, 0x10, "X2")]
    adapters.append(found("/dev/c", 1, 2, None))
    monkeypatch.setattr(line.list_ports, "comports", lambda: adapters)
    assert line.find_port("usb:0001:0002") == "/dev/c"
    assert line.find_port("usb:2341:0010:X2") == "/dev/b"
    (tmp_path / "skin-1").symlink_to("/dev/null")
    (tmp_path / "skin-2").touch()  # no device
    (tmp_path / "link").symlink_to(tmp_path / "skin-2")
    os.mkfifo(tmp_path / "fifo")
    places = [tmp_path / "fifo", tmp_path, tmp_path / "link", "/dev/../etc/passwd", "/dev/shm"]
    assert line.find_port(f"{tmp_path}/skin-*") == f"{tmp_path}/skin-1"
    assert line.find_port("ttyUSB0") == "/dev/ttyUSB0"
    assert line.find_port("rfc2217://host:1") == "rfc2217://host:1"
    for port, state, words in (
        ("usb:2341:0010", "refused", "/dev/a, /dev/b"),
        ("usb:9999:0010", "disconnected", "plugged in"),
        ("usb:hello", "refused", "VID:PID"),
        ("socket://far.away", "refused", "socket://HOST:PORT"),
        ("rfc2217://far.away:70000", "refused", "rfc2217://HOST:PORT"),
        (f"{tmp_path}/no-*", "disconnected", "plugged in"),
        *((str(place), "refused", "no device under /dev") for place in places),
    ):
        with pytest.raises(line.LineFault, match=words) as raised:
            line.open_line(port, 9600)
        assert raised.value.state == state


SCHEMES = ["spy", "SPY", "loop", "alt", "hwgrep", "cp2110", "file", "http"]


@pytest.mark.parametrize("scheme", SCHEMES)
def test_a_port_never_makes_pyserial_do_anything_else(tmp_path, monkeypatch, scheme):
    precious = tmp_path / "precious"
    precious.write_text("as it was")
    monkeypatch.setattr(line.serial, "serial_for_url", None)  # would end in another message
    for port in (f"{scheme}:///dev/ttyS0?file={precious}", f"{scheme}://?logging=debug"):
        with pytest.raises(line.LineFault, match="none of /dev") as raised:
            line.open_line(port, 9600)
        assert raised.value.state == "refused"
        with pytest.raises(InputError, match="none of /dev"):
            make_device(DeviceSettings(load_layout("equal-4x4"), "serial", port=port))
    for url in ("socket://h:1?logging=debug", "rfc2217://h:1/?logging=debug", "socket://u@h:1/x"):
        with pytest.raises(line.LineFault, match="without options"):
            line.open_line(url, 9600)
    assert precious.read_text() == "as it was"


def test_errors_of_the_system_become_one_clear_line(monkeypatch):
    for code, words in ((errno.EACCES, "no permission"), (errno.EIO, ".")):
        error = serial.SerialException(code, f"could not open port: {os.strerror(code)}")
        monkeypatch.setattr(line.serial, "serial_for_url", Mock(side_effect=error))
        with pytest.raises(line.LineFault, match=words) as raised:
            line.open_line("/dev/x", 9600)
        assert "\n" not in str(raised.value)
