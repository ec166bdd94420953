"""`tomotactile record`: frames of a sensor into a file."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace

from tomotactile_ros.commands.device_options import (
    add_device_arguments,
    collect,
    count,
    open_device,
    source_of,
)
from tomotactile_ros.devices.recording import save_recording
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.support.checks import plain
from tomotactile_ros.support.command_line import positive
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import check_out

HELP = "record the frames of a sensor, or all bytes of its line"


def add_arguments(parser: ArgumentParser) -> None:
    add_device_arguments(parser)
    parser.add_argument("--out", help="file to write (.npz)")
    parser.add_argument(
        "--raw", metavar="FILE", help="raw capture of the line of --port, for replay --raw"
    )
    parser.add_argument("--frames", type=count, help="number of frames (default: until Ctrl-C)")
    parser.add_argument("--duration", type=positive, help="s (default: until Ctrl-C)")


def run(args: Namespace) -> None:
    if not (args.out or args.raw):
        raise InputError("--out: is missing, and so is --raw: nothing would be written")
    if args.raw and not args.port:
        raise InputError("--raw: needs --port, only a line has bytes to capture")
    layout = load_layout(args.layout)
    if args.out:
        check_out(args.out, ".npz")
    device, scene = open_device(args, layout, capture=args.raw or "")
    if args.frames is None and args.duration is None and sys.stderr.isatty():
        print("recording; Ctrl-C ends it", file=sys.stderr)
    frames = collect(device, args.frames, args.duration)
    if args.out:
        save_recording(args.out, layout, frames, scene.contact_law if scene else None)
    span = frames[-1].stamp - frames[0].stamp
    rate = f", {plain((len(frames) - 1) / span)} per second" if span > 0 else ""
    lost = frames[-1].sequence - frames[0].sequence + 1 - len(frames)
    print(
        f"{' and '.join(filter(None, (args.out, args.raw)))}: {len(frames)} frames of {layout.name} from {source_of(args)}{rate}"
        + (f", {lost} lost" if lost > 0 else "")
    )
