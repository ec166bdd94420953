"""The sensor as a program: speaks docs/protocol.md on a pseudo-terminal or a TCP port.

`firmware` is the device (`printer` one that prints text), a port of `ports` the cable, and `Emulator` joins them in a loop that
never sleeps longer than to the end of the frame.
"""

from __future__ import annotations

import argparse
import math
import sys
import threading
import time
from collections.abc import Callable

import numpy as np

from tomotactile_ros.devices.firmware import MAX_RATE, MIN_RATE, EmulatedDevice, idle_source
from tomotactile_ros.devices.ports import PtyPort, TcpPort, port_maker
from tomotactile_ros.devices.printer import PrintingDevice
from tomotactile_ros.devices.protocol import ALL_ADDRESSES, VERSIONS
from tomotactile_ros.devices.text import FORMATS, volts_per_unit
from tomotactile_ros.frame import DEFAULT_DRIVE
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.errors import InputError

VERSION_NAMES = tuple(map(str, VERSIONS))


class Emulator:
    """Runs a device on a port, in the caller's thread (`run`) or in one of its own (`plug`).

    Parameters
    ----------
    device : EmulatedDevice or PrintingDevice
    make_port : callable
        Makes the port, each time the plug goes in.
    mangle : callable
        What the line does to the device's packets, for fault tests: bytes -> bytes.
    """

    TICK = 0.001
    IDLE = 0.05
    BUFFER = 1 << 19  # of a microcontroller with half a megabyte to spare
    PIECE = 1 << 16

    def __init__(
        self,
        device: EmulatedDevice | PrintingDevice,
        make_port: Callable[[], PtyPort | TcpPort],
        mangle: Callable[[bytes], bytes] = bytes,
    ) -> None:
        self.device = device
        if isinstance(device, PrintingDevice):
            self.BUFFER = 1  # what nobody reads is lost, and not read later
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
        if self._thread is not None:
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
                else:
                    self.device.dropped += rows.count(0)
                if pending:
                    del pending[: port.send(bytes(pending[: self.PIECE]))]
        finally:
            port.close()

    def _idle_time(self) -> float:
        due = self.device.next_due()
        if due is None:
            return self.IDLE
        return max(0.0, min(self.TICK, due - time.monotonic()))


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the emulator."""
    parser.add_argument("--layout", default="equal-8x8", help="path or name of a layout")
    parser.add_argument("--scene", help="path or name of a scene; without it nothing touches")
    parser.add_argument("--rate", type=float, default=15.625, help="frames/s at power-up")
    parser.add_argument(
        "--protocol",
        nargs="+",
        choices=(*VERSION_NAMES, *FORMATS),
        default=list(VERSION_NAMES),
        help="versions of the binary protocol that it speaks (default: all), or text that it prints",
    )
    parser.add_argument("--address", type=int, default=0, help="on a bus, 1 to 254 (default: none)")
    parser.add_argument("--temperature", type=float, default=math.nan, help="that it reports, °C")
    parser.add_argument(
        "--port", default="pty", help="pty, pty:LINK, tcp:PORT or tcp:HOST:PORT (default: pty)"
    )


def _make_device(arguments: argparse.Namespace) -> EmulatedDevice | PrintingDevice:
    layout = load_layout(arguments.layout)
    if not MIN_RATE <= arguments.rate <= MAX_RATE:
        raise InputError(
            f"rate: {arguments.rate:g}, expected {MIN_RATE:g} to {MAX_RATE:g} frames/s"
        )
    if not 0 <= arguments.address < ALL_ADDRESSES:
        raise InputError(f"address: {arguments.address}, expected 0 (none) to 254")
    text = [name for name in arguments.protocol if name in FORMATS]
    if text:
        if len(arguments.protocol) > 1 or arguments.address:
            raise InputError(
                f"protocol: {text[0]} cannot be combined with another protocol or an address"
            )
        return _printing(layout, arguments.scene, text[0], arguments.rate)
    settings = {
        "rate": arguments.rate,
        "versions": [int(name) for name in arguments.protocol],
        "address": arguments.address,
    }
    device = _simulated(layout, arguments.scene, settings)
    device.temperature = arguments.temperature
    return device


def _simulated(layout: Layout, scene_name: str | None, settings: dict) -> EmulatedDevice:
    """The device on a sheet with the scene, without one on a sheet that nothing touches."""
    if scene_name is None:
        return EmulatedDevice(idle_source(layout.electrodes), layout.electrodes, **settings)
    scene = load_scene(scene_name)
    simulator = Simulator(layout, scene)

    def scan(t: float, sequence: int, order: np.ndarray) -> np.ndarray:
        simulator.row_period, simulator.grounded = device.row_period, order
        return simulator.frame(t, sequence)

    device = EmulatedDevice(
        scan,
        layout.electrodes,
        own_reading=scene.own_reading,
        **settings,
        adc_bits=scene.adc.bits if scene.adc else 16,
        range=scene.adc.range if scene.adc else scene.drive_voltage,
        drive_voltage=scene.drive_voltage,
    )
    return device


def _printing(
    layout: Layout, scene_name: str | None, text_format: str, rate: float
) -> PrintingDevice:
    """The same sheets behind a sensor that prints its readings."""
    order = np.array(layout.scan or range(layout.electrodes))
    if scene_name is None:
        volts = volts_per_unit(text_format, DEFAULT_DRIVE)
        return PrintingDevice(idle_source(layout.electrodes), order, volts, rate)
    scene = load_scene(scene_name)
    simulator = Simulator(layout, scene, row_period=1.0 / (rate * len(order)))
    volts = volts_per_unit(text_format, scene.drive_voltage)
    return PrintingDevice(lambda t, number, order: simulator.frame(t, number), order, volts, rate)


def serve(arguments: argparse.Namespace) -> None:
    """Run the emulator until it is interrupted; it prints what a host opens, and for people how."""
    device = _make_device(arguments)
    (protocol,) = [name for name in arguments.protocol if name in FORMATS] or ["binary"]

    def announce(path: str) -> None:
        print(path, flush=True)
        print(
            f"a sensor without hardware, until Ctrl-C; in another shell: tomotactile watch --layout "
            f"{arguments.layout} --port {path}"
            + (f" --protocol {protocol}" * (protocol != "binary")),
            file=sys.stderr,
        )

    try:
        Emulator(device, port_maker(arguments.port)).run(announce)
    except OSError as error:
        raise InputError(f"port: {arguments.port}: {error.strerror or error}") from None
