"""`tomotactile replay`: runs the driver on a raw capture again."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from contextlib import ExitStack

from tomotactile_ros.devices.base import Frame
from tomotactile_ros.devices.recording import frames_writer
from tomotactile_ros.devices.relive import relive
from tomotactile_ros.devices.serial import NOBODY
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.support.files import check_out

HELP = "run parser and driver on the bytes of a raw capture again, to the bit"


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("--raw", required=True, metavar="FILE", help="raw capture of a line")
    parser.add_argument("--layout", help="layout of the sensor, to be named in the frames")
    parser.add_argument("--out", help="frames to write (.npz)")


def run(args: Namespace) -> None:
    if args.out:
        check_out(args.out, ".npz")
    layout = load_layout(args.layout) if args.layout else None
    count = 0
    with ExitStack() as stack:
        take = None
        if args.out:
            take = stack.enter_context(frames_writer(args.out, layout.id if layout else None))

        def taken(frame: Frame) -> None:
            nonlocal count
            count += 1
            if take is not None:
                take(frame)

        device = relive(args.raw, taken)
    status = device.status()
    identity = device.identity
    who = identity.name
    if identity is not NOBODY:
        who += f" {identity.serial}, protocol {identity.version}"
    print(f"{args.raw}: {who}, {count} frames" + (f" in {args.out}" if args.out else ""))
    for name in ("packets", "packets_lost", "frames_incomplete", "frames_lost", "crc_errors"):
        print(f"  {name:<20}{status.counters[name]:>12.0f}")
