"""`tomotactile tare`: the readings of an untouched sensor, which later commands subtract."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace
from dataclasses import replace

from tomotactile_ros.commands.device_options import (
    add_device_arguments,
    collect,
    count,
    open_device,
    source_of,
)
from tomotactile_ros.devices import Frame
from tomotactile_ros.devices.recording import load_recording, save_recording
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline
from tomotactile_ros.reconstruction.at_rest import Rest, at_rest
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import check_out

HELP = "measure the readings of a sensor that nothing touches"
_FRAMES = 32


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
        frames = list(load_recording(args.recording, layout))
    else:
        frames = collect(open_device(args, layout)[0], args.frames)
    rest = _at_rest(source_of(args), frames)
    save_recording(args.out, layout, [replace(frames[0], voltages=rest.mean)])
    print(
        f"{args.out}: mean of {len(frames)} frames of {layout.name}, median reading {rest.median:.4f} "
        f"V, noise {rest.noise:.4f} V rms"
    )
    if rest.doubt:
        print(f"tomotactile tare: {rest.doubt}", file=sys.stderr)


def add_tare_argument(parser: ArgumentParser) -> None:
    """Add the option of all commands that make images."""
    parser.add_argument(
        "--tare", metavar="FRAMES", help="file of 'tare', or frames of an idle sheet"
    )


def apply_tare(path: str | None, pipeline: Pipeline) -> None:
    """Take the mean of the frames of a file off all that the pipeline gets from now on."""
    if path is not None:
        idle = load_recording(path, pipeline.layout)
        _at_rest(path, list(idle))
        pipeline.tare(idle)


def _at_rest(source: str, frames: list[Frame]) -> Rest:
    """What frames of a source show at rest; InputError, with its name, where they do not."""
    try:
        return at_rest([frame.voltages for frame in frames], frames[0].drive_voltage)
    except InputError as error:
        raise InputError(f"{source}: {error}") from None
