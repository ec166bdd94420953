"""firmware/: on this computer with sanitizers, and on emulated boards where QEMU is installed.

Every wait is for an event; PATIENCE is only how long a broken program may take to fail.
"""

import contextlib
import fcntl
import os
import re
import select
import socket
import subprocess
import time
from pathlib import Path

import board_support
import numpy as np
import pytest
from devices_support import PATIENCE, collect, opened

from tomotactile_ros.devices import emulator, protocol
from tomotactile_ros.devices.protocol import Command, SetRate, SetScan, Start
from tomotactile_ros.devices.serial import SerialDevice
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.scene import Scene

ROOT = Path(__file__).resolve().parent.parent
E = 6
SCALE = 3.3 / 4096


ARM = ("make", "arm-none-eabi-gcc")


def needs(absent: str):
    return pytest.mark.skipif(bool(absent), reason=absent)


needs_compiler = needs(board_support.missing(("cc", "make")))
needs_arm = needs(board_support.missing(ARM))
needs_qemu = needs(board_support.missing())
needs_rp2040 = needs(board_support.missing_rp2040())


@pytest.fixture(scope="module")
def program(tmp_path_factory):
    """The board that is this computer, with address and undefined-behaviour sanitizers."""
    return board_support.build(tmp_path_factory.mktemp("firmware"), "computer")


class Talk:
    """A host on the program's pipes that hears every packet."""

    def __init__(self, program: Path, address: int = 0) -> None:
        self._process = subprocess.Popen(
            [program, str(address)], stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        self.parser = protocol.Parser()
        self.heard: list[protocol.Packet] = []
        self._at = 0

    def send(self, data: bytes) -> None:
        self._process.stdin.write(data)
        self._process.stdin.flush()

    def narrow(self) -> None:
        """Make the line from the device as small as can be."""
        fcntl.fcntl(self._process.stdout, fcntl.F_SETPIPE_SZ, 4096)

    def read(self, most: int = 65536) -> None:
        """Hear what comes next; waits for it."""
        ready = select.select([self._process.stdout], [], [], PATIENCE)[0]
        data = os.read(self._process.stdout.fileno(), most) if ready else b""
        assert data, f"nothing comes; the last was {self.heard[-1:]}"
        self.heard += self.parser.feed(data)

    def until(self, condition) -> protocol.Packet:
        """The next packet that fits; those in front of it count as heard."""
        deadline = time.monotonic() + PATIENCE
        while True:
            while self._at < len(self.heard):
                self._at += 1
                if condition(self.heard[self._at - 1]):
                    return self.heard[self._at - 1]
            assert time.monotonic() < deadline, "not heard"
            self.read()

    def answer(self, tag: int) -> protocol.Packet:
        """What carries this tag, and is no row."""
        return self.until(lambda p: not isinstance(p, protocol.Row) and p.tag == tag)

    def ask(self, packet: protocol.Packet) -> protocol.Packet:
        self.send(protocol.encode(packet))
        return self.answer(packet.tag)

    def rows(self, number: int) -> list[protocol.Row]:
        return [self.until(lambda p: isinstance(p, protocol.Row)) for _ in range(number)]

    def close(self) -> None:
        """End it; the sanitizers must have had nothing to say."""
        self._process.stdin.close()
        self._process.stdout.close()
        assert self._process.wait(PATIENCE) == 0


@contextlib.contextmanager
def talking(program: Path, address: int = 0):
    talk = Talk(program, address)
    try:
        yield talk
    finally:
        talk.close()
    counters = talk.parser.counters
    assert (counters.crc_errors, counters.framing_errors, counters.malformed) == (0, 0, 0)


def counts(row: protocol.Row) -> list[int]:
    return protocol.unpack_counts(row.readings).tolist()


def sent(row: int) -> list[int]:
    """What boards/computer reads while this electrode is grounded."""
    return [100 * row + electrode for electrode in range(E)]


@needs_compiler
def test_the_firmware_speaks_with_the_driver(program):
    port = emulator.PtyPort()
    os.set_blocking(port._master, True)
    firmware = subprocess.Popen([program], stdin=port._master, stdout=port._master)
    device = SerialDevice(port.path, E, rate=150.0)
    watch = opened(device)
    watch.wait_for_frames(20)
    watch.wait_for(lambda s: s.counters["rate_device"] == 150.0)
    device.set_rate(1000.0)
    watch.wait_for(lambda s: "device: no value" in s.message)
    device.set_streaming(False)
    watch.wait_for(lambda s: s.state == "stopped")
    for wanted, told in ((1e-6, 1e-3), (50.0, 50.0)):
        device.set_rate(wanted)
        watch.wait_for(lambda s, told=told: s.counters["rate_device"] == pytest.approx(told))
    device.set_streaming(True)
    watch.wait_for_frames(5)
    device.set_scan((4, 0, 4, 2))
    watch.wait_for(lambda s: watch.frames[-1].grounded.tolist() == [4, 0, 4, 2])
    watch.wait_for(lambda s: s.counters["temperature"] == 21.5)
    counters = device.status().counters
    device.close()
    firmware.kill()
    firmware.wait()
    port.close()
    for fault in ("crc_errors", "framing_errors", "malformed"):  # a busy host may lose rows
        assert counters[fault] == 0
    assert (device.identity.name, device.identity.version) == ("example", 2)
    expected = np.array([sent(row) for row in range(E)]) * SCALE
    for frame in watch.frames:
        assert np.allclose(frame.voltages, expected[frame.grounded], atol=1e-6)
    assert (np.diff([f.sequence for f in watch.frames]) > 0).all()


@needs_compiler
def test_a_host_of_version_1_is_served_as_ever(program):
    with talking(program) as talk:
        identity = talk.ask(Command(protocol.IDENTIFY, 1))
        assert (identity.electrodes, identity.rows, identity.also) == (E, E, "v2")
        talk.ask(SetScan(2, (3, 3)))
        assert talk.ask(SetRate(3, 100.0)).rate == 100.0
        assert talk.ask(Command(protocol.START, 4)).streaming
        for row in talk.rows(2 * E):
            assert (row.version, row.rows, row.grounded) == (1, E, row.row)
            expected = sent(row.row)
            expected[row.row] = protocol.NO_READING
            assert counts(row) == expected
        refused = talk.ask(SetScan(5, (0, 1)))
        assert refused.code == protocol.BAD_VALUE
        assert not talk.ask(Command(protocol.STOP, 6)).streaming


@needs_compiler
def test_a_number_of_frames_and_orders_that_are_none(program):
    with talking(program) as talk:
        own = talk.ask(Command(protocol.IDENTIFY, 1, version=2))
        told = talk.ask(SetScan(7, (4, 0, 4, 2)))
        assert told.rate * told.rows == pytest.approx(own.rate * own.rows)
        begun = talk.ask(Start(8, frames=2))
        rows = talk.rows(8)
        assert {row.sequence - begun.sequence for row in rows} == {0, 1}
        assert (np.diff([row.row_end for row in rows[:4]]) > 0).all()
        status = talk.ask(Command(protocol.KEEP_ALIVE, 9, version=2))
        assert (status.streaming, status.sequence) == (False, begun.sequence + 2)
        assert (status.boot, status.temperature) == (own.boot, 21.5)
        assert talk.ask(SetScan(10, ())).rows == E
        for tag, order in ((11, (0, E)), (0, (0,)), (12, (0,) * (own.max_scan + 1))):
            assert talk.ask(SetScan(tag, order)).code == protocol.BAD_VALUE


@needs_compiler
def test_a_device_stops_when_its_host_has_vanished(program):
    with talking(program) as talk:
        talk.ask(SetRate(1, 200.0, version=2))
        talk.ask(Start(2, timeout=50))
        talk.rows(3)
        while True:  # rows end by themselves; to ask would be a sign of life
            before = len(talk.heard)
            time.sleep(0.1)
            talk.send(protocol.encode(Command(protocol.KEEP_ALIVE, 3, version=2)))
            if not talk.answer(3).streaming:
                break
            assert len(talk.heard) > before


@needs_compiler
def test_addresses_on_a_bus(program):
    with talking(program, address=7) as talk:
        talk.send(protocol.encode(Command(protocol.IDENTIFY, 1)))
        for tag, address in ((2, 0), (3, 8), (4, 255), (5, 7)):
            talk.send(protocol.encode(Command(protocol.IDENTIFY, tag, 2, address)))
        assert talk.answer(5).address == 7
        assert len(talk.heard) == 1


WRONG = {
    "a byte behind IDENTIFY": (bytes([1, 1, 9, 0, 0]), protocol.BAD_VALUE),
    "a byte behind START of version 2": (bytes([2, 2, 9, 0]) + bytes(9), protocol.BAD_VALUE),
    "a byte behind SET_RATE": (bytes([4, 1, 9, 0, 0, 0, 0x7A, 0x41, 0]), protocol.BAD_VALUE),
    "a rate cut short": (bytes([4, 1, 9, 0, 0, 0, 0x7A]), protocol.BAD_VALUE),
    "too few electrodes": (bytes([5, 2, 9, 0, 3, 0, 0, 0, 1, 0, 2, 0]), protocol.BAD_VALUE),
    "too many electrodes": (bytes([5, 2, 9, 0, 1, 0, 0, 0, 1, 0, 2, 0]), protocol.BAD_VALUE),
    "a command of version 2 cut short": (bytes([1, 2, 9, 0]), protocol.BAD_VALUE),
    "an unknown command": (bytes([0x77, 1, 9, 0]), protocol.UNKNOWN_COMMAND),
    "version 3": (bytes([1, 3, 9, 0]), protocol.UNSUPPORTED_VERSION),
}


@needs_compiler
def test_commands_that_are_none_are_refused(program):
    with talking(program) as talk:
        for name, (body, code) in WRONG.items():
            talk.send(protocol.frame(body))
            assert getattr(talk.answer(9), "code", None) == code, name


@needs_compiler
def test_a_slow_line_costs_whole_frames_and_answers_still_come(program):
    with talking(program) as talk:
        talk.narrow()
        talk.ask(SetRate(1, 200.0, version=2))
        talk.ask(Start(2))
        dropped, deadline = 0, time.monotonic() + PATIENCE
        while dropped < 50 and time.monotonic() < deadline:
            talk.send(protocol.encode(Command(protocol.KEEP_ALIVE, 3, version=2)))
            talk.read(512)
            time.sleep(0.02)  # 25 kB/s, a third of what it makes
            told = [p.dropped for p in talk.heard if isinstance(p, protocol.Status)]
            dropped = max(told, default=0)
        assert dropped >= 50
        talk.ask(Command(protocol.STOP, 4, version=2))
        rows = {}
        for packet in talk.heard:
            if isinstance(packet, protocol.Row):
                rows.setdefault(packet.sequence, []).append(packet.row)
        cut = [found for found in list(rows.values())[:-1] if len(found) < E]
        assert all(found == list(range(len(found))) for found in rows.values())
        assert len(cut) < 0.5 * len(rows)


@needs_compiler
def test_random_bytes_do_no_harm(tmp_path):
    image = board_support.build(tmp_path, "fuzz")
    done = subprocess.run([image, "2e6"], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr[-2000:]
    figures = [int(n) for n in re.findall(r"\d+", done.stdout)]
    assert figures[0] >= 2e6 and figures[2] > 2e3


@needs_qemu
def test_every_reading_of_the_emulated_board_is_right(tmp_path):
    table, zero = board_support.random_table(8, 16), 20000  # many readings are below 0 V
    board_support.write_table(tmp_path, table.tolist(), 16, zero=zero)
    image = board_support.build(tmp_path)
    with board_support.running(image, boot=41) as port:
        device = SerialDevice(port, 8, rate=125.0)
        watch = opened(device)
        watch.wait_for_frames(100)
        watch.wait_for(lambda s: s.counters["temperature"] == 23.5)
        counters = device.status().counters
        device.close()
    assert device.identity.boot == 42
    assert counters["crc_errors"] + counters["framing_errors"] + counters["malformed"] == 0
    for frame in watch.frames:
        expected = (table[frame.sequence % len(table)] - float(zero)) * board_support.SCALE
        assert np.allclose(frame.voltages, expected, atol=0.1 * board_support.SCALE)


@needs_qemu
def test_a_touch_on_the_emulated_board_is_found(tmp_path):
    """The whole way: sheet as a table, firmware, line, driver's device, reconstruction."""
    scene = tmp_path / "scene.yaml"
    contact = Contact("disc", center=(0.03, -0.02), radius=0.006, pressure=2e4)
    Scene("touch", 3.3, (contact,), ContactLaw(1e-6, 1.0)).save(scene)
    table = board_support.simulated_table("equal-4x4", str(scene))
    board_support.write_table(tmp_path, table, 12)
    with board_support.running(board_support.build(tmp_path)) as port:
        frame = collect(SerialDevice(port, 16, rate=20.0), 2)[-1]
    pipeline = Pipeline(load_layout("equal-4x4"), Settings(profile="balanced"))
    voltages = np.where(np.eye(16, dtype=bool), np.nan, frame.voltages)
    result = pipeline.process(voltages, frame.grounded, frame.drive_voltage)
    (contact,) = result.contacts
    assert np.hypot(contact.x - 0.03, contact.y + 0.02) < 0.003


@needs_arm
@pytest.mark.parametrize("target", ["qemu.elf", "stm32f4.elf", "rp2040.elf"])
def test_images_divide_no_64_bits_and_allocate_nothing(tmp_path, target):
    image = board_support.build(tmp_path, target)
    listed = subprocess.run(
        ["arm-none-eabi-nm", image], capture_output=True, text=True, check=True
    ).stdout
    names = {line.split()[-1] for line in listed.splitlines()}
    assert "tt_scan_tick" in names
    assert not names & {"malloc", "free", "_malloc_r", "_sbrk"}
    assert not [name for name in names if re.search(r"ldivmod|[du]i?div.*64|__[u]?divdi3", name)]


@needs(board_support.missing(("avr-gcc",)))
def test_the_library_compiles_where_an_int_has_16_bits(tmp_path):
    command = ["avr-gcc", "-mmcu=atmega2560", "-std=c99", "-Wall", "-Wextra", "-Wconversion"]
    command += ["-Wsign-conversion", "-Werror", "-Os", "-DTT_MAX_ELECTRODES=16", "-c"]
    for source in sorted((ROOT / "firmware").glob("tt_*.c")):
        subprocess.run([*command, str(source)], cwd=tmp_path, check=True)


def first_rows(port: int, number: int) -> tuple[protocol.Identity, list[protocol.Packet]]:
    """Identity and all packets up to that many rows of a board at a TCP port; none is damaged."""
    parser, heard = protocol.Parser(), []
    with socket.create_connection(("127.0.0.1", port), PATIENCE) as line:
        while not heard:  # it does not listen before it has started
            line.sendall(b"\0" + protocol.encode(Command(protocol.IDENTIFY, 1, version=2)))
            if select.select([line], [], [], 0.5)[0]:
                heard += parser.feed(line.recv(4096))
        line.sendall(protocol.encode(Start(2)))
        while sum(isinstance(packet, protocol.Row) for packet in heard) < number:
            heard += parser.feed(line.recv(4096))
    assert parser.counters.crc_errors + parser.counters.framing_errors == 0
    return heard[0], heard


@needs_rp2040
def test_the_board_with_usb_speaks_in_the_emulator(tmp_path):
    """From boot2 over clocks, converter and pins to descriptors and bytes of the USB controller."""
    with board_support.running_rp2040(board_support.build(tmp_path, "rp2040.uf2")) as told:
        identity, heard = first_rows(told["port"], 66)
    assert (identity.name, identity.electrodes, identity.max_scan) == ("rp2040", 64, 64)
    assert told["device"][8:12] == [0x09, 0x12, 0x01, 0x00]  # vendor and product
    assert bytes(told["product"][2:]).decode("utf-16-le") == "rp2040"
    assert told["configuration"] == [1]
    assert told["coding"] == [0, 0xC2, 1, 0, 0, 0, 8]  # as was set
    rows = [packet for packet in heard if isinstance(packet, protocol.Row)]
    for number, row in enumerate(rows):
        assert (row.sequence, row.row, row.grounded) == (*divmod(number, 64), number % 64)
        expected = (61 * row.grounded + 7 * np.arange(64) + 5) % 4096  # rp2040_board.cjs
        assert counts(row) == expected.tolist()
    ends = [row.row_end for row in rows[:64]]
    assert np.diff(ends).min() > 900  # 3 + 63 + 1 ticks of 14 µs


@needs_qemu
def test_the_board_to_be_bought_speaks_in_the_emulator(tmp_path):
    """QEMU's STM32F405 has its time, its converter (each conversion 7 more) and its line."""
    image = board_support.build(tmp_path, "stm32f4.elf", BOARDFLAGS="-DEMULATED")
    with board_support.running(image, "-serial", "null", machine="netduinoplus2") as port:
        identity, heard = first_rows(int(port.rpartition(":")[2]), 2)
    assert (identity.name, identity.electrodes, identity.max_scan) == ("stm32f4", 64, 64)
    (fault,) = [packet for packet in heard if isinstance(packet, protocol.Error)]
    assert (fault.tag, fault.code) == (0, protocol.HARDWARE_FAULT)  # QEMU gives it no clock
    rows = [packet for packet in heard if isinstance(packet, protocol.Row)]
    for number, row in enumerate(rows):
        assert (row.row, row.grounded, row.sequence) == (number, number, 0)
        assert set(np.diff(counts(row)) % 4096) == {7}
