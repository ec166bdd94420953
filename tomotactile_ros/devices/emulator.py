"""The sensor as a program: speaks docs/protocol.md on a pseudo-terminal or a TCP port.

`EmulatedDevice` is the firmware (bytes in, bytes out, no I/O), a port of `ports` the cable, and
`Emulator` joins them in a loop that never sleeps longer than to the next row.
"""

from __future__ import annotations

import argparse
import signal
import sys
import threading
import time
from collections.abc import Callable

import numpy as np

from tomotactile_ros.devices import protocol
from tomotactile_ros.devices.ports import PtyPort, TcpPort, port_maker
from tomotactile_ros.errors import InputError
from tomotactile_ros.layout import load_layout
from tomotactile_ros.scene import load_scene
from tomotactile_ros.simulation import Simulator

MAX_RATE = 1000.0

Source = Callable[[float, int], np.ndarray]
"""(time since START in s, sequence) -> voltages (L, E) in V, NaN where there is no reading."""


class EmulatedDevice:
    """Firmware of a scanning sensor; electrode l is grounded in row l.

    Parameters
    ----------
    source : callable
        Voltages (L, E) of the frame that starts at a time.  The same array again means the same
        readings, which saves converting them.
    electrodes, rows : int
    rate, max_rate : float
        Frames/s at power-up, and the fastest.
    adc_bits, range : int, float
        The converter: counts of range / 2**bits volts, clipped.
    drive_voltage : float, V
    haste : float
        How many times faster than told it scans (a fault).
    clock : callable
        Device time, s.
    """

    def __init__(
        self,
        source: Source,
        electrodes: int,
        rows: int | None = None,
        *,
        rate: float = 15.625,
        max_rate: float = MAX_RATE,
        adc_bits: int = 12,
        range: float = 3.3,
        drive_voltage: float = 3.3,
        name: str = "emulator",
        serial: str = "0",
        haste: float = 1.0,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.electrodes, self.rows = electrodes, rows or electrodes
        self.rate, self.max_rate = rate, max_rate
        self.streaming = False
        self.sequence, self._row = 0, 0
        self._source, self._clock = source, clock
        self._name, self._serial = name, serial
        self._bits, self._range, self._drive = adc_bits, range, drive_voltage
        self._haste = haste
        self._parser = protocol.Parser()
        self._voltages: np.ndarray | None = None
        self._readings: list[bytes] = []
        self._rate_changed = False

    def receive(self, data: bytes, now: float) -> bytes:
        """Carry out the commands in `data`; return the answers. `now` as for `rows_due`."""
        return b"".join(self._answer(packet, now) for packet in self._parser.feed(data))

    def next_due(self) -> float | None:
        """When the current frame is complete, s; None while stopped."""
        return self._start + self._period if self.streaming else None

    def rows_due(self, now: float) -> bytes:
        """Packets of the rows whose last sample was taken by `now` (s, steady clock)."""
        packets = []
        while self.streaming:
            done = min(self.rows, int((now - self._start) / self._period * self.rows + 1e-6))
            packets += [self._row_packet(row, now) for row in range(self._row, done)]
            self._row = max(done, self._row)
            if self._row < self.rows:
                break
            self._next_frame(now)
        return b"".join(packets)

    def _start_scan(self, now: float) -> None:
        self.sequence += self._row > 0
        self._started = self._start = now
        self._row = 0
        self._begin_rate()

    def _begin_rate(self) -> None:
        self._period = 1.0 / (self.rate * self._haste)
        self._first, self._number = self._start, 0

    def _next_frame(self, now: float) -> None:
        behind = int((now - self._start) / self._period) - 1
        skipped = behind if behind * self._period > 1.0 else 0
        self._number += 1 + skipped
        self.sequence += 1 + skipped
        self._start, self._row = self._first + self._number * self._period, 0
        if self._rate_changed:
            self._rate_changed = False
            self._begin_rate()

    def _row_packet(self, row: int, now: float) -> bytes:
        if row == 0:
            self._sample(now)
        row_end = round(1e6 * (row + 1) * self._period / self.rows)
        packet = protocol.Row(
            self.electrodes,
            row,
            self.rows,
            self.sequence & 0xFFFFFFFF,
            row_end,
            self._frame_time,
            self._range / 2**self._bits,
            self._drive,
            row,
            self._readings[row],
        )
        return protocol.encode(packet)

    def _sample(self, now: float) -> None:
        self._frame_time = max(0, round(1e6 * (self._clock() - (now - self._start))))
        voltages = self._source(self._start - self._started, self.sequence)
        if voltages is self._voltages:
            return
        largest = min(2**self._bits - 1, protocol.NO_READING - 1)
        counts = np.round(np.nan_to_num(voltages) / (self._range / 2**self._bits))
        counts = np.where(np.isnan(voltages), protocol.NO_READING, np.clip(counts, 0, largest))
        self._readings = [protocol.pack_counts(row) for row in counts.astype(np.uint16)]
        self._voltages = voltages

    def _answer(self, packet: protocol.Packet, now: float) -> bytes:
        if isinstance(packet, protocol.SetRate):
            return self._set_rate(packet)
        if not isinstance(packet, protocol.Command):
            return b""
        if packet.type == protocol.IDENTIFY:
            return protocol.encode(self._identity(packet.tag))
        if packet.type == protocol.START and not self.streaming:
            self.streaming = True
            self._start_scan(now)
            return b"\0" + self._ack(packet.tag, packet.type)
        if packet.type == protocol.STOP:
            self.streaming = False
        return self._ack(packet.tag, packet.type)

    def _identity(self, tag: int) -> protocol.Identity:
        return protocol.Identity(
            tag, self.electrodes, self.rows, self._bits, self._range, self.rate, 0, self.max_rate,
            self._name, "1.0.0", self._serial,
        )  # fmt: skip

    def _set_rate(self, packet: protocol.SetRate) -> bytes:
        if not 0.0 < packet.rate <= self.max_rate:
            text = f"{packet.rate:g} frames/s asked for, at most {self.max_rate:g} possible"
            return protocol.encode(
                protocol.Error(packet.tag, protocol.SET_RATE, protocol.BAD_VALUE, text)
            )
        self._rate_changed = self._rate_changed or packet.rate != self.rate
        self.rate = packet.rate
        return self._ack(packet.tag, protocol.SET_RATE)

    def _ack(self, tag: int, command: int) -> bytes:
        return protocol.encode(protocol.Ack(tag, command, self.streaming, self.rate))


class Emulator:
    """Runs a device on a port, in the caller's thread (`run`) or in one of its own (`plug`).

    Parameters
    ----------
    device : EmulatedDevice
    make_port : callable
        Makes the port, each time the plug goes in.
    mangle : callable
        What the line does to the device's packets, for fault tests: bytes -> bytes.
    """

    TICK = 0.001
    IDLE = 0.05
    BUFFER = 1 << 19  # of a microcontroller with half a megabyte to spare

    def __init__(
        self,
        device: EmulatedDevice,
        make_port: Callable[[], PtyPort | TcpPort],
        mangle: Callable[[bytes], bytes] = bytes,
    ) -> None:
        self.device = device
        self.dropped = 0
        self.path = ""
        self._make_port, self._mangle = make_port, mangle
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def plug(self) -> str:
        """Plug in and run in a thread; return the path or URL for the host."""
        self._stop.clear()
        port = self._make_port()
        self.path = port.path
        self._thread = threading.Thread(target=self._serve, args=(port,), daemon=True)
        self._thread.start()
        return self.path

    def unplug(self) -> None:
        """Pull the plug and stop; a device on battery: sequence and time go on at the next plug."""
        self._stop.set()
        self._thread.join()

    def run(self, announce: Callable[[str], None]) -> None:
        """Plug in, `announce` the path and serve until an exception such as Ctrl-C."""
        port = self._make_port()
        announce(port.path)
        self._serve(port)

    def _serve(self, port: PtyPort | TcpPort) -> None:
        pending = bytearray()
        try:
            while not self._stop.is_set():
                if port.wait(self._idle_time(), sending=bool(pending)):
                    answer = self.device.receive(port.receive(), time.monotonic())
                    pending += self._mangle(answer)
                rows = self.device.rows_due(time.monotonic())
                if len(pending) < self.BUFFER:
                    pending += self._mangle(rows)
                elif rows:
                    self.dropped += 1
                if pending:
                    del pending[: port.send(bytes(pending))]
        finally:
            port.close()

    def _idle_time(self) -> float:
        due = self.device.next_due()
        if due is None:
            return self.IDLE
        return max(0.0, min(self.TICK, due - time.monotonic()))


def idle_source(electrodes: int) -> Source:
    """A sheet that nothing touches: all readings 0 V."""
    voltages = np.zeros((electrodes, electrodes))
    np.fill_diagonal(voltages, np.nan)
    return lambda time, sequence: voltages


def _parse(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        prog="emulator", description="A sensor without hardware, behind the real wire protocol."
    )
    parser.add_argument("--layout", default="equal-8x8", help="path or name of a layout")
    parser.add_argument("--scene", help="path or name of a scene; without it nothing touches")
    parser.add_argument("--rate", type=float, default=15.625, help="frames/s at power-up")
    parser.add_argument(
        "--port", default="pty", help="pty, pty:LINK, tcp:PORT or tcp:HOST:PORT (default: pty)"
    )
    return parser.parse_args(argv)


def _make_device(arguments: argparse.Namespace) -> EmulatedDevice:
    layout = load_layout(arguments.layout)
    if not 0.0 < arguments.rate <= MAX_RATE:
        raise InputError(f"rate: {arguments.rate:g}, expected up to {MAX_RATE:g} frames/s")
    if arguments.scene is None:
        return EmulatedDevice(
            idle_source(layout.electrodes), layout.electrodes, rate=arguments.rate
        )
    scene = load_scene(arguments.scene)
    simulator = Simulator(layout, scene)
    simulator.row_period = 1.0 / (arguments.rate * layout.electrodes)
    return EmulatedDevice(
        simulator.frame,
        layout.electrodes,
        rate=arguments.rate,
        adc_bits=scene.adc.bits if scene.adc else 16,
        range=scene.adc.range if scene.adc else scene.drive_voltage,
        drive_voltage=scene.drive_voltage,
    )


def _interrupt(signum: int, frame: object) -> None:
    raise KeyboardInterrupt


def main(argv: list[str] | None = None) -> int:
    """Run the emulator until it is interrupted; returns the exit status."""
    arguments = _parse(argv)
    signal.signal(signal.SIGTERM, _interrupt)
    try:
        emulator = Emulator(_make_device(arguments), port_maker(arguments.port))
        emulator.run(lambda path: print(path, flush=True))
    except InputError as error:
        print(error, file=sys.stderr)
        return 2
    except OSError as error:
        print(f"port: {arguments.port}: {error.strerror or error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 0
    return 0


if __name__ == "__main__":
    sys.exit(main())
