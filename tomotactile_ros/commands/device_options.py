"""Options shared by all commands that take frames from a sensor: real, recorded or simulated."""

from __future__ import annotations

import argparse
import math
import time
from argparse import ArgumentParser, Namespace
from contextlib import suppress

from tomotactile_ros.devices import PROTOCOLS, Device, DeviceSettings, Frame, make_device
from tomotactile_ros.devices.stream import FrameStream
from tomotactile_ros.frame import DEFAULT_DRIVE
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.scenes.scene import Scene, load_scene
from tomotactile_ros.support.command_line import positive
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.progress import Progress

# Options that say where frames come from, one at a time: the kind of device, and the help.
SOURCES = {
    "port": ("serial", "sensor at /dev/tty..., usb:VID:PID, socket://HOST:PORT"),
    "recording": ("replay", "recorded frames (.npz or rosbag2) at their own pace"),
    "scene": ("fake", "simulated sensor under this scene (default: default)"),
}
FRESH = 1.0  # s, age up to which readings are shown as what is now


def add_device_arguments(parser: ArgumentParser, layout: str | None = None) -> None:
    """Add the options; `layout` is the default, without one it must be given."""
    parser.add_argument(
        "--layout",
        default=layout,
        required=layout is None,
        help="layout file or name of an installed one"
        + (f" (default: {layout})" if layout else ""),
    )
    source = parser.add_mutually_exclusive_group()
    for option, (_, text) in SOURCES.items():
        source.add_argument(f"--{option}", help=text)
    parser.add_argument("--baud", type=int, default=2_000_000, help="speed of a serial port, bit/s")
    parser.add_argument(
        "--protocol",
        choices=PROTOCOLS,
        default="binary",
        help="of a serial port: binary, or printed lines in V, mV or counts (default: binary)",
    )
    parser.add_argument(
        "--drive-voltage",
        type=positive,
        default=DEFAULT_DRIVE,
        help=f"V, for text and recordings that do not hold it (default: {DEFAULT_DRIVE})",
    )
    parser.add_argument(
        "--rate", type=positive, default=0.0, help="frames/s (default: the sensor's own)"
    )


def open_device(
    args: Namespace, layout: Layout, max_age: float = 0.0, capture: str = ""
) -> tuple[Device, Scene | None]:
    """The device that the options name, not yet open, and its scene if it is simulated.

    Readings older than `max_age` (s) are dropped and counted; 0 for any age. `capture` is a file
    for all bytes of a line.
    """
    option, value = _source(args)
    scene = load_scene(value) if option == "scene" else None
    if scene is not None:
        scene.check(layout)
    settings = DeviceSettings(
        layout,
        SOURCES[option][0],
        args.rate,
        scene,
        port=args.port or "",
        baud=args.baud,
        protocol=args.protocol,
        drive_voltage=args.drive_voltage,
        recording=args.recording or "",
        max_age=max_age,
        capture=capture,
    )
    return make_device(settings), scene


def collect(device: Device, most: int | None = None, duration: float | None = None) -> list[Frame]:
    """At least one frame: as many as asked for, or those of `duration` s, or until Ctrl-C."""
    frames: list[Frame] = []
    total = most or duration or 0
    label = "recording frames" if most else "recording, s"
    with (
        suppress(KeyboardInterrupt),
        FrameStream(device) as stream,
        Progress(label, int(total)) as progress,
    ):
        end = math.inf
        while not stream.ended and len(frames) < (most or math.inf) and time.monotonic() < end:
            frame = stream.take()
            if frame is None:
                continue
            if not frames and duration:
                end = time.monotonic() + duration
            frames.append(frame)
            if total:
                done = len(frames) if most else total - (end - time.monotonic())
                progress.update(int(done))
    if not frames:
        raise InputError("no frame has come")
    return frames


def source_of(args: Namespace) -> str:
    """What the frames come from, for people."""
    option, value = _source(args)
    return value if option in ("port", "recording") else f"{option} {value}"


def _source(args: Namespace) -> tuple[str, str]:
    """Which of `SOURCES` is given, and its value."""
    given = ((option, getattr(args, option)) for option in SOURCES)
    return next((each for each in given if each[1]), ("scene", "default"))


def count(text: str) -> int:
    """Type of an option: a whole number above 0."""
    with suppress(ValueError):
        value = int(text)
        if value > 0:
            return value
    raise argparse.ArgumentTypeError(f"{text} is not a whole number above 0")
