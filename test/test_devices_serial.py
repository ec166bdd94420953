"""The serial device against the emulated sensor, on real pseudo-terminals and TCP, with its faults.

Every wait is for an event; PATIENCE is only how long a broken program may take to fail.
"""

import errno
import os
import select
import socket
import threading
import time

import numpy as np
import pytest
import serial
from devices_support import PATIENCE, E, Watch, connected, counted, plugged, sensor, watched
from serial import rfc2217

from tomotactile_ros.devices import (
    DeviceSettings,
    conversation,
    emulator,
    line,
    make_device,
    protocol,
)
from tomotactile_ros.devices.serial import SerialDevice
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.support.errors import InputError


@pytest.mark.parametrize("make_port", [emulator.PtyPort, emulator.TcpPort], ids=["pty", "tcp"])
def test_frames_arrive_whole_in_order_and_stamped(make_port):
    with connected(make_port=make_port) as (_, watch):
        watch.wait_for_frames(50)
        watch.wait_for(lambda s: s.state == "streaming" and "skin" in s.message)
        status = watch.device.status()
    assert status.counters["crc_errors"] == status.counters["malformed"] == 0
    frame = watch.frames[-1]
    assert np.array_equal(np.isnan(frame.voltages), np.eye(E, dtype=bool))
    assert frame.grounded.tolist() == list(range(E))
    assert frame.drive_voltage == pytest.approx(3.3)
    assert frame.row_period == pytest.approx(1 / (100.0 * E), rel=3e-3)  # whole µs, clock drift


class Unmodem(serial.Serial):
    """A pseudo-terminal has no modem lines; a server of ports asks for them."""

    cts = dsr = ri = cd = False

    def _update_dtr_state(self) -> None:
        pass

    _update_rts_state = _update_dtr_state


class PortServer:
    """A serial port on the network by RFC 2217, as a terminal server or `ser2net` offers it."""

    def __init__(self, path: str) -> None:
        self._serial = Unmodem(path, timeout=0)
        self._server = socket.create_server(("127.0.0.1", 0))
        self.url = "rfc2217://{}:{}".format(*self._server.getsockname())
        self._stop = threading.Event()
        self._thread = threading.Thread(target=self._serve, daemon=True)
        self._thread.start()

    def write(self, data: bytes) -> None:
        """What the telnet side of the port wants to tell its client."""
        self._peer.sendall(data)

    def close(self) -> None:
        """Hang up."""
        self._stop.set()
        self._thread.join()

    def _serve(self) -> None:
        self._peer = self._server.accept()[0]
        telnet = rfc2217.PortManager(self._serial, self)
        while not self._stop.is_set():
            ready = select.select([self._peer, self._serial], [], [], 0.05)[0]
            if self._peer in ready:
                self._serial.write(b"".join(telnet.filter(self._peer.recv(4096))))
            if self._serial in ready and self._serial.in_waiting:
                self._peer.sendall(b"".join(telnet.escape(self._serial.read(4096))))
        for end in (self._peer, self._server, self._serial):
            end.close()


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
            adapters = [Found(port.path, 0x2341, 0x10, "X1")]
            watch.wait_for(lambda s, port=port: s.state == "streaming" and port.path in s.message)
            watch.wait_for_frames(1)
            first.unplug()


def test_rate_stop_and_start_at_run_time():
    with connected(rate=50.0) as (port, watch):
        watch.wait_for(lambda s: s.counters["rate_device"] == 50.0)
        watch.device.set_rate(200.0)
        watch.wait_for(lambda s: s.counters["rate_device"] == 200.0)
        assert port.device.rate == 200.0
        watch.device.set_streaming(False)
        watch.wait_for(lambda s: s.state == "stopped" and not port.device.streaming)
        watch.device.set_streaming(True)
        watch.wait_for(lambda s: s.state == "streaming")
        watch.wait_for_frames(5)
        assert watch.device.status().counters["frames_incomplete"] == 0


class HardOfHearing(emulator.EmulatedDevice):
    """A device that does not get all that it is told."""

    deaf_for = 0

    def receive(self, data, now):
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


@pytest.mark.parametrize("command", [protocol.IDENTIFY, protocol.START])
def test_a_device_that_says_what_is_wrong_with_it_is_quoted(command):
    class Broken(emulator.EmulatedDevice):
        def _answer(self, packet, now):
            if protocol.type_of(packet) != command:
                return super()._answer(packet, now)
            fault = protocol.Error(packet.tag, command, protocol.HARDWARE_FAULT, "no ADC")
            return protocol.encode(fault)

    state = "refused" if command == protocol.IDENTIFY else "silent"
    with connected(Broken(counted, E)) as (_, watch):
        watch.wait_for(lambda s: s.state == state and "no ADC" in s.message)


def test_a_rate_that_the_device_refuses_is_told_and_frames_go_on():
    with connected(sensor(max_rate=150.0), rate=1000.0) as (_, watch):
        watch.wait_for(lambda s: s.state == "streaming" and "at most 150" in s.message)


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
        assert watch.device.status().counters["reconnects"] >= 100


def test_the_emulator_says_what_it_is_and_programs_read_the_port_alone(capsys, monkeypatch):
    monkeypatch.setattr(emulator.Emulator, "run", lambda self, announce: announce("/tmp/skin"))
    assert emulator.main(["--protocol", "text-mV"]) == 0
    said = capsys.readouterr()
    assert said.out == "/tmp/skin\n" and said.err.count("\n") == 1
    assert "watch --layout equal-8x8 --port /tmp/skin --protocol text-mV" in said.err


def test_the_emulator_says_in_one_line_what_it_cannot_do(capsys):
    assert emulator.main(["--port", "usb", "--ros-args", "-r", "__node:=sensor"]) == 2
    assert emulator.main(["--layout", "no-such-layout"]) == 2
    assert emulator.main(["--port", "pty:/no/such/folder/port"]) == 2
    with pytest.raises(SystemExit, match="2"):
        emulator.main(["--speed", "9"])
    lines = capsys.readouterr().err.splitlines()
    assert len(lines) == 4
    assert all(line.startswith("emulator: ") for line in lines)
    assert "tcp:HOST:PORT" in lines[0]
    assert "no-such-layout" in lines[1]
    assert "--speed" in lines[3]


def test_a_board_that_restarts_when_its_port_is_opened_has_time_to_boot(monkeypatch):
    class Board(emulator.EmulatedDevice):
        deaf = 0

        def receive(self, data, now):
            self.deaf -= 1
            return b"" if self.deaf >= 0 else super().receive(data, now)

    board = Board(counted, E, rate=100.0)

    def opener(path, baud):
        board.deaf = conversation.ATTEMPTS + 3
        return line.open_line(path, baud)

    monkeypatch.setattr(conversation, "ANSWER_TIME", 0.05)
    with connected(board, opener=opener) as (_, watch):
        watch.wait_for(lambda s: s.state == "silent")
        watch.wait_for_frames(3)


def test_a_device_that_falls_silent_and_comes_back():
    with connected() as (port, watch):
        watch.wait_for_frames(3)
        port._mangle = lambda data: b""
        watch.wait_for(lambda s: s.state == "silent")
        port._mangle = bytes
        watch.wait_for_frames(3)
        watch.wait_for(lambda s: s.state == "streaming")


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


def test_a_device_ten_times_too_fast_is_told():
    with connected(sensor(rate=25.0, haste=10.0), rate=25.0) as (_, watch):
        watch.wait_for(lambda s: s.state == "streaming" and "instead of 25" in s.message)


def test_rows_of_before_the_start_are_not_taken_for_new(monkeypatch):
    """A device that was left streaming: seconds of rows wait on the line when the host comes."""
    with plugged(sensor()) as port:
        port.device.streaming = True
        port.device._start_scan(time.monotonic() - 3.0)
        with watched(SerialDevice(port.path, E)) as watch:
            watch.wait_for_frames(20)
        assert watch.frames[0].sequence >= 300


def test_answers_to_nothing_that_was_asked_change_nothing():
    """An ACK with another tag, or to another command: neither the rate nor the frame is touched."""

    class Talkative(emulator.EmulatedDevice):
        def rows_due(self, now):
            rows = super().rows_due(now)
            false = protocol.Ack(0x7777, protocol.SET_RATE, False, 1.0)
            return rows + (protocol.encode(false) if rows else b"")

    with connected(Talkative(counted, E, rate=100.0)) as (_, watch):
        watch.wait_for_frames(30)
        counters = watch.device.status().counters
        assert counters["answers_ignored"] > 10
        assert counters["rate_device"] == 100.0
        assert counters["frames_incomplete"] <= 1  # one at the stop with which it began


def troubles(status):
    return {trouble.name: trouble for trouble in status.troubles}


def test_a_device_that_reports_a_fault_is_in_trouble():
    class Hot(emulator.EmulatedDevice):
        def _next_frame(self, now):
            super()._next_frame(now)
            self.hot = True

        def rows_due(self, now):
            rows = super().rows_due(now)
            fault = protocol.Error(0, 0, protocol.HARDWARE_FAULT, "too \x1b[2J hot")
            return rows + (protocol.encode(fault) if getattr(self, "hot", False) and rows else b"")

    with connected(Hot(counted, E, rate=100.0)) as (_, watch):
        watch.wait_for(lambda s: "device" in troubles(s))
        status = watch.device.status()
    assert troubles(status)["device"].serious
    assert "hot" in status.message and status.message.isprintable()


def test_lost_frames_and_readings_above_the_drive_voltage_are_troubles():
    high = sensor(drive_voltage=1.0)
    with connected(high) as (port, watch):
        watch.wait_for(lambda s: "above drive" in troubles(s))
        assert "loss" not in troubles(watch.device.status())
        port._mangle = losing(0.02)
        watch.wait_for(lambda s: "loss" in troubles(s) and not troubles(s)["loss"].serious)
        port._mangle = losing(0.4)
        watch.wait_for(lambda s: "loss" in troubles(s) and troubles(s)["loss"].serious)
        assert "% of the frames are lost" in watch.device.status().message


def losing(share: float, seed: int = 0):
    """Line that loses that share of the packets."""
    random = np.random.default_rng(seed)

    def mangle(data: bytes) -> bytes:
        packets = data.split(b"\0")
        return b"".join(p + b"\0" for p in packets if p and random.random() >= share)

    return mangle


def test_half_of_the_packets_lost_is_told_and_no_wrong_frame_comes():
    with connected(mangle=losing(0.5)) as (port, watch):
        watch.wait_for(lambda s: s.counters["packets_lost"] > 300)
        port._mangle = losing(0.99)
        watch.wait_for(lambda s: s.state in ("garbled", "silent"))
        port._mangle = bytes
        watch.wait_for(lambda s: s.state == "streaming")
        watch.wait_for_frames(3)


def test_a_port_that_does_not_exist(tmp_path):
    with watched(SerialDevice(str(tmp_path / "none"), E)) as watch:
        watch.wait_for(lambda s: s.state == "disconnected" and "does not exist" in s.message)


def test_the_wrong_baud_rate():
    """A pseudo-terminal has no baud rate: what a wrong one makes of the bytes is emulated."""
    random = np.random.default_rng(0)

    def garbage(data: bytes) -> bytes:
        return random.integers(0, 256, len(data) // 2 + 100, dtype=np.uint8).tobytes()

    with connected(mangle=garbage, baud=9600) as (_, watch):
        watch.wait_for(lambda s: s.state == "garbled" and "wrong baud rate" in s.message)
        assert watch.frames == []


def test_a_device_that_prints_text():
    with connected(mangle=lambda data: b"0\t612\t655\t701\r\n") as (_, watch):
        watch.wait_for(lambda s: s.state == "garbled" and "prints text; " in s.message)
        assert watch.frames == []


def test_the_wrong_number_of_electrodes_and_then_the_right_device(tmp_path):
    link = str(tmp_path / "port")
    wrong = emulator.EmulatedDevice(emulator.idle_source(9), 9, name="big skin")
    with watched(SerialDevice(link, E)) as watch:
        with plugged(wrong, lambda: emulator.PtyPort(link)):
            watch.wait_for(lambda s: s.state == "refused")
            message = watch.device.status().message
        assert "big skin" in message and "9 electrodes" in message and "layout 6" in message
        assert watch.frames == []
        with plugged(sensor(), lambda: emulator.PtyPort(link)):
            watch.wait_for_frames(3)


def test_a_device_of_another_protocol_version_is_refused():
    def version_3(data: bytes) -> bytes:
        return b"".join(protocol.frame(bytes([0x11, 3, 0, 0])) for _ in range(bool(data)))

    with connected(mangle=version_3) as (_, watch):
        watch.wait_for(lambda s: s.state == "refused" and "version 3" in s.message)


@pytest.mark.parametrize("jump", [3600.0, -3600.0])
def test_a_device_clock_that_jumps(jump):
    offset = [1e5]
    device = sensor(clock=lambda now: now + offset[0])
    with connected(device) as (_, watch):
        watch.wait_for_frames(10)
        before = watch.device.status().counters["clock_jumps"]
        offset[0] += jump
        watch.wait_for(lambda s: s.counters["clock_jumps"] > before)
        watch.wait_for_frames(20)
    ages = [time.time() - frame.stamp for frame in watch.frames]
    assert max(ages) < 2 * PATIENCE


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


class Found:
    """What pyserial tells of a plugged-in adapter."""

    def __init__(self, device, vid, pid, serial_number):
        self.device, self.vid, self.pid = device, vid, pid
        self.serial_number = serial_number


def test_ports_are_found_by_usb_id_pattern_and_name(monkeypatch, tmp_path):
    adapters = [Found("/dev/a", 0x2341, 0x10, "X1"), Found("/dev/b", 0x2341, 0x10, "X2")]
    monkeypatch.setattr(
        line.list_ports, "comports", lambda: [*adapters, Found("/dev/c", 1, 2, None)]
    )
    assert line.find_port("usb:0001:0002") == "/dev/c"
    assert line.find_port("usb:2341:0010:X2") == "/dev/b"
    (tmp_path / "skin-1").symlink_to("/dev/null")
    (tmp_path / "skin-2").touch()  # no device
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
        (f"{tmp_path}/skin-2", "refused", "no device under /dev"),
    ):
        with pytest.raises(line.LineFault, match=words) as raised:
            line.find_port(port)
        assert raised.value.state == state


@pytest.mark.parametrize(
    "scheme", ["spy", "SPY", "loop", "alt", "hwgrep", "cp2110", "file", "http"]
)
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


def test_a_port_outside_of_dev_is_not_opened(tmp_path, monkeypatch):
    monkeypatch.setattr(line.serial, "serial_for_url", None)
    file, fifo = tmp_path / "file", tmp_path / "fifo"
    file.touch()
    os.mkfifo(fifo)
    (tmp_path / "link").symlink_to(file)
    for path in (file, fifo, tmp_path, tmp_path / "link", "/dev/../etc/passwd", "/dev/shm"):
        with pytest.raises(line.LineFault, match="no device under /dev"):
            line.open_line(str(path), 9600)


def test_errors_of_the_system_become_one_clear_line(monkeypatch):
    def fails(code):
        def opened(*args, **kwargs):
            raise serial.SerialException(code, f"could not open port: {os.strerror(code)}")

        monkeypatch.setattr(line.serial, "serial_for_url", opened)
        with pytest.raises(line.LineFault) as raised:
            line.open_line("/dev/x", 9600)
        return str(raised.value)

    assert "no permission" in fails(errno.EACCES)
    assert "does not exist" in fails(errno.ENOENT)
    assert "in use" in fails(errno.EBUSY)
    assert "\n" not in fails(errno.EIO)
