"""`tomotactile tare`: what a sensor reads with nothing on it, for all that follow to take off."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from dataclasses import replace

import numpy as np

from tomotactile_ros.commands.device_options import (
    add_device_arguments,
    collect,
    count,
    open_device,
    source_of,
)
from tomotactile_ros.devices import Frame
from tomotactile_ros.devices.recording import load_recording, save_recording
from tomotactile_ros.frames_file import FramesFile
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.reconstruction import Pipeline
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import check_out

HELP = "measure the readings of a sensor that nothing touches"
_FRAMES = 32
_ASKED, _REFUSED = 0.01, 0.1  # of the drive voltage: median readings that look like a load
_MOVED = 0.01  # of the drive voltage: so far may a frame's mean reading go from the others


def add_arguments(parser: ArgumentParser) -> None:
    add_device_arguments(parser)
    parser.add_argument("--out", required=True, help="file to write (.npz), for --tare of others")
    parser.add_argument(
        "--frames", type=count, default=_FRAMES, help=f"to average (default: {_FRAMES})"
    )


def run(args: Namespace) -> None:
    layout = load_layout(args.layout)
    check_out(args.out, ".npz")
    if args.recording:
        frames = _recorded_frames(args.recording, layout)
    else:
        frames = collect(open_device(args, layout)[0], args.frames)
    mean, middle, noise = _at_rest(source_of(args), frames)
    _refuse_pressed(source_of(args), middle, frames[0].drive_voltage)
    save_recording(args.out, layout, [replace(frames[0], voltages=mean)])
    print(
        f"{args.out}: mean of {len(frames)} frames of {layout.name}, median reading {middle:.4f} V, "
        f"noise {noise:.4f} V rms"
    )
    if middle > _ASKED * frames[0].drive_voltage:
        print(
            f"tomotactile tare: {middle:.3f} V is much for a sheet that nothing touches: whatever "
            "presses on it now is taken off all that follows",
            file=sys.stderr,
        )


def add_tare_argument(parser: ArgumentParser) -> None:
    """Add the option of all commands that make images."""
    parser.add_argument(
        "--tare", metavar="FRAMES", help="file of 'tare', or frames of an idle sheet"
    )


def apply_tare(path: str | None, pipeline: Pipeline) -> None:
    """Take the mean of the frames of a file off all that the pipeline gets from now on."""
    if path is not None:
        idle = load_recording(path, pipeline.layout)
        middle = _at_rest(path, _frames_of(idle))[1]
        _refuse_pressed(path, middle, idle.drive_voltage)
        pipeline.tare((voltages, idle.grounded) for voltages in idle.voltages)


def _recorded_frames(path: str, layout: Layout) -> list[Frame]:
    return _frames_of(load_recording(path, layout))


def _frames_of(found: FramesFile) -> list[Frame]:
    stamps = np.arange(len(found.voltages)) if found.stamps is None else found.stamps
    return [
        Frame(each, found.grounded, i, float(stamp), found.drive_voltage, found.row_period)
        for i, (each, stamp) in enumerate(zip(found.voltages, stamps, strict=True))
    ]


def _refuse_pressed(source: str, middle: float, drive_voltage: float) -> None:
    """Refuse frames whose median reading, V, shows a contact: it would be taken off for good."""
    if middle > _REFUSED * drive_voltage:
        raise InputError(
            f"{source}: median reading {middle:.3f} V: something presses on the sheet; "
            "take it off and tare again"
        )


def _at_rest(source: str, frames: list[Frame]) -> tuple[np.ndarray, float, float]:
    """Mean frame (L, E), V, NaN where nothing valid was read; its median reading and noise, V."""
    stack = np.array([frame.voltages for frame in frames], float)
    valid = np.isfinite(stack)
    counts = np.count_nonzero(valid, axis=0)
    if not counts.any():
        raise InputError(f"{source}: no valid reading")
    mean = np.where(valid, stack, 0.0).sum(axis=0) / np.maximum(counts, 1)
    left = np.where(valid, stack - mean, 0.0)
    moved = np.abs(left.sum(axis=(1, 2)) / np.maximum(np.count_nonzero(valid, axis=(1, 2)), 1))
    if moved.max() > _MOVED * frames[0].drive_voltage:
        raise InputError(
            f"{source}: readings change by {moved.max():.3f} V on average: something moves "
            "on the sheet; take your hands off and tare again"
        )
    mean[counts == 0] = np.nan
    noise = np.sqrt((left**2).sum() / max(valid.sum() - np.count_nonzero(counts), 1))
    return mean, float(np.nanmedian(np.abs(mean))), float(noise)
