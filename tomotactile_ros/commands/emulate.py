"""`tomotactile emulate`: a sensor without hardware that speaks the real wire protocol."""

from __future__ import annotations

import math
import sys
from argparse import ArgumentParser, Namespace
from contextlib import suppress

import numpy as np

from tomotactile_ros.devices.emulator import Emulator
from tomotactile_ros.devices.firmware import MAX_RATE, MIN_RATE, EmulatedDevice, idle_source
from tomotactile_ros.devices.ports import port_maker
from tomotactile_ros.devices.printer import PrintingDevice
from tomotactile_ros.devices.protocol import ALL_ADDRESSES, VERSIONS
from tomotactile_ros.devices.text import FORMATS, volts_per_unit
from tomotactile_ros.frame import DEFAULT_DRIVE
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.errors import InputError

HELP = "act as a sensor without hardware, on a pseudo-terminal or a TCP port"
VERSION_NAMES = tuple(map(str, VERSIONS))


def add_arguments(parser: ArgumentParser) -> None:
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


def run(args: Namespace) -> None:
    """It prints what a host opens, and for people how."""
    device = _make_device(args)
    (protocol,) = [name for name in args.protocol if name in FORMATS] or ["binary"]

    def announce(path: str) -> None:
        print(path, flush=True)
        print(
            f"a sensor without hardware, until Ctrl-C; in another shell: tomotactile watch --layout "
            f"{args.layout} --port {path}" + (f" --protocol {protocol}" * (protocol != "binary")),
            file=sys.stderr,
        )

    try:
        with suppress(KeyboardInterrupt):  # the way to end it
            Emulator(device, port_maker(args.port)).run(announce)
    except OSError as error:
        raise InputError(f"port: {args.port}: {error.strerror or error}") from None


def _make_device(args: Namespace) -> EmulatedDevice | PrintingDevice:
    layout = load_layout(args.layout)
    if not MIN_RATE <= args.rate <= MAX_RATE:
        raise InputError(f"rate: {args.rate:g}, expected {MIN_RATE:g} to {MAX_RATE:g} frames/s")
    if not 0 <= args.address < ALL_ADDRESSES:
        raise InputError(f"address: {args.address}, expected 0 (none) to 254")
    text = [name for name in args.protocol if name in FORMATS]
    if text:
        if len(args.protocol) > 1 or args.address:
            raise InputError(
                f"protocol: {text[0]} cannot be combined with another protocol or an address"
            )
        return _printing(layout, args.scene, text[0], args.rate)
    settings = {
        "rate": args.rate,
        "versions": [int(name) for name in args.protocol],
        "address": args.address,
    }
    device = _simulated(layout, args.scene, settings)
    device.temperature = args.temperature
    return device


def _simulated(layout: Layout, scene_name: str | None, settings: dict) -> EmulatedDevice:
    """The device on a sheet with the scene, without one on a sheet that nothing touches."""
    if scene_name is None:
        return EmulatedDevice(idle_source(layout.electrodes), layout.electrodes, **settings)
    scene = load_scene(scene_name)
    simulator = Simulator(layout, scene)

    def scan(t: float, sequence: int, order: np.ndarray) -> np.ndarray:
        return simulator.scanned(device.row_period, order, t, sequence)

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
