"""`tomotactile learn`: what is wrong with a sensor, from frames of touches of unknown place and
force."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace
from pathlib import Path

import numpy as np

from tomotactile_ros.devices.recording import load_recording
from tomotactile_ros.frames_file import FramesFile
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.learning import findings
from tomotactile_ros.learning.file import load_sensor, save_sensor
from tomotactile_ros.learning.picture import save_picture
from tomotactile_ros.learning.recorded import MOST, learn
from tomotactile_ros.sheet import MODELS
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import YAML, check_out, check_picture
from tomotactile_ros.support.progress import track

HELP = "learn what is wrong with a sensor from touches of unknown place and force"


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("frames", nargs="+", help="recorded frames: .npz or rosbag2")
    parser.add_argument("--layout", required=True, help="layout file or name of an installed one")
    parser.add_argument("--out", help="sensor file (.yaml) to write")
    parser.add_argument(
        "--picture", help="picture (.png) to write (default: beside the sensor file)"
    )
    parser.add_argument("--sensor", help="sensor file to go on from")
    parser.add_argument("--noise", type=float, default=0.001, help="noise of a reading, V rms")
    parser.add_argument("--contact-radius", type=float, default=0.005, help="typical, m")
    parser.add_argument(
        "--drive-voltage", type=float, help="drive voltage, V (default: the frames' own)"
    )
    parser.add_argument(
        "--touches", type=int, default=MOST, help=f"most frames to learn from (default: {MOST})"
    )
    parser.add_argument("--model", default="auto", choices=MODELS, help="physics (default: auto)")


def run(args: Namespace) -> None:
    layout = load_layout(args.layout)
    checks.positive(args.noise, "--noise", "voltage in V")
    checks.length(args.contact_radius, "--contact-radius")
    checks.integer(args.touches, "--touches", 1, 10_000)
    if args.out:
        check_out(args.out, *YAML)
    picture = args.picture or (args.out and Path(args.out).with_suffix(".png"))
    if picture:
        check_picture(picture)
    recorded = _all_of(args.frames, layout, args.drive_voltage)
    state = load_sensor(args.sensor, layout, args.model) if args.sensor else None
    learned = learn(
        layout,
        recorded,
        noise=args.noise,
        radius=args.contact_radius,
        model=args.model,
        most=args.touches,
        state=state,
        watch=track,
    )
    print("\n".join(findings.lines(learned)))
    if picture:
        save_picture(picture, layout, learned)
        print(f"{picture} written")
    if args.out:
        save_sensor(args.out, layout, learned.operator, learned.state)
        print(f"{args.out} written: reconstruct --sensor {args.out}")


def _all_of(paths: list[str], layout: Layout, drive_voltage: float | None) -> FramesFile:
    """The frames of all recordings one after the other; they must agree in rows and drive
    voltage."""
    found = [load_recording(path, layout, drive_voltage) for path in paths]
    first = found[0]
    for path, each in zip(paths, found):
        if not np.array_equal(each.grounded, first.grounded):
            raise InputError(
                f"{path}: grounded: its rows are not those of {paths[0]}; learn from one file after the other, with --sensor"
            )
        if each.drive_voltage != first.drive_voltage:
            raise InputError(
                f"{path}: drive_voltage: {each.drive_voltage:g} V, {paths[0]} has {first.drive_voltage:g} V"
            )
    voltages = np.concatenate([each.voltages for each in found])
    return FramesFile(voltages, first.grounded, first.drive_voltage)
