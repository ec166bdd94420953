"""`tomotactile watch`: the state of a sensor, one line per second: rate, losses, readings, dead channels."""

from __future__ import annotations

import math
import time
from argparse import ArgumentParser, Namespace
from contextlib import suppress

import numpy as np

from tomotactile_ros.commands.device_options import (
    FRESH,
    add_device_arguments,
    open_device,
)
from tomotactile_ros.devices import Frame, Status
from tomotactile_ros.devices.stream import FrameStream
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.support.command_line import positive
from tomotactile_ros.support.errors import InputError

HELP = "print the state of a sensor every second"
_EVERY = 1.0  # s
_PATIENCE = 10.0  # s until the first frame
_FLOATING = (
    0.9  # of the drive voltage: the least reading of a row is above where nothing is grounded
)
_PRESSED = 0.01  # of the drive voltage: a median reading above it shows a contact


def add_arguments(parser: ArgumentParser) -> None:
    add_device_arguments(parser)
    parser.add_argument(
        "--duration",
        type=positive,
        help=f"s from the first frame on, for which {_PATIENCE:.0f} s are waited (default: until Ctrl-C)",
    )


def run(args: Namespace) -> None:
    layout = load_layout(args.layout)
    device, _ = open_device(args, layout, FRESH)
    with suppress(KeyboardInterrupt), FrameStream(device, math.inf) as stream:
        start = now = time.monotonic()
        due, frames = start + _EVERY, []
        end, seen = start + _PATIENCE if args.duration else math.inf, False
        while not stream.ended:
            frame = stream.take()
            now = time.monotonic()
            if frame is not None:
                frames.append(frame)
                if args.duration and not seen:
                    end = now + args.duration
                seen = True
            if now >= due:
                print(line(now - start, device.status(), frames, layout), flush=True)
                due, frames = due + _EVERY, []
            if now >= end:
                break
        if frames or due == start + _EVERY:  # what a second has not yet told, once at least
            print(line(now - start, device.status(), frames, layout), flush=True)
    if args.duration and not seen:
        raise InputError("no frame has come")


def _strongest(readings: np.ndarray, drive_voltage: float, layout: Layout) -> str:
    """The electrode that reads most, next to whatever presses: a press at a known place tells
    whether electrodes are numbered as in the layout."""
    counts = np.count_nonzero(np.isfinite(readings), axis=(0, 1))
    means = np.nansum(readings, axis=(0, 1)) / np.maximum(counts, 1)
    if np.median(means) < _PRESSED * drive_voltage:
        return ""
    electrode = int(np.argmax(means))
    x, y = 1e3 * layout.positions[electrode]
    return f", most at electrode {electrode} ({x:+.0f}, {y:+.0f}) mm"


def _floating(frame: Frame) -> str:
    """Which rows show the drive voltage alone, where most do not."""
    rows = np.fmin.reduce(frame.voltages, axis=1) > _FLOATING * frame.drive_voltage
    if not 0 < np.count_nonzero(rows) < len(rows) / 2:
        return ""
    named = ", ".join(map(str, frame.grounded[rows]))
    return f"  all read the drive voltage while electrode {named} should be grounded: not connected, or held by what presses"


def line(seconds: float, status: Status, frames: list[Frame], layout: Layout) -> str:
    """The state of a device, and what the frames of the last second hold."""
    text = f"{seconds:6.1f} s  {status.state}"
    if frames:
        readings = np.array([frame.voltages for frame in frames])
        text += f"  {status.counters['rate_seen']:5.1f} frames/s"
        lost = frames[-1].sequence - frames[0].sequence + 1 - len(frames)
        text += f", {lost} lost" if lost > 0 else ""
        if np.isfinite(readings).any():
            text += f"  {np.nanmin(readings):.3f} to {np.nanmax(readings):.3f} V"
            text += f", median {np.nanmedian(readings):.3f} V"
        text += _strongest(readings, frames[0].drive_voltage, layout)
        text += _floating(frames[-1])
    if status.dead:
        text += f"  electrodes that look dead: {', '.join(map(str, status.dead))}"
    if status.troubles:
        text += "  " + "; ".join(trouble.text for trouble in status.troubles)
    elif not frames:
        text += f"  {status.message}"
    return text
