"""`tomotactile run`: a live picture of a sensor, real, recorded or simulated."""

from __future__ import annotations

import time
from argparse import ArgumentParser, Namespace
from collections import deque
from contextlib import suppress

import numpy as np

from tomotactile_ros.commands.device_options import (
    FRESH,
    add_device_arguments,
    open_device,
    source_of,
)
from tomotactile_ros.commands.tare import add_tare_argument, apply_tare
from tomotactile_ros.devices import Device
from tomotactile_ros.devices.health import late_of
from tomotactile_ros.devices.stream import FrameStream
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.calibration import load_calibration
from tomotactile_ros.reconstruction.deadline import period_of
from tomotactile_ros.reconstruction.settings import PROFILES
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.support.command_line import positive
from tomotactile_ros.support.files import check_picture
from tomotactile_ros.view.display import Display, Shot

HELP = "show a live picture of a sensor, simulated unless --port or --recording names one"


def add_arguments(parser: ArgumentParser) -> None:
    add_chain_arguments(parser)
    parser.add_argument("--out", help="picture of the last image to write at the end (.png)")


def add_chain_arguments(parser: ArgumentParser) -> None:
    """Add the options of all commands that show what a sensor feels."""
    add_device_arguments(parser, layout="equal-8x8")
    parser.add_argument(
        "--profile", default=Settings.profile, choices=PROFILES, help=f"default: {Settings.profile}"
    )
    add_tare_argument(parser)
    parser.add_argument(
        "--calibration", help="file of 'calibrate'; without it forces are not known"
    )
    parser.add_argument("--duration", type=positive, help="s (default: until Ctrl-C)")


def run(args: Namespace) -> None:
    layout = load_layout(args.layout)
    if args.out:
        check_picture(args.out)
    device, scene, pipeline = open_chain(args, layout)
    calibrated = pipeline.settings.contact_law is not None
    display = Display(layout, scene, source_of(args), calibrated=calibrated)
    display.say(f"layout {layout.name}, {source_of(args)}, {pipeline.report}")
    try:
        with suppress(KeyboardInterrupt), FrameStream(device) as stream:
            for shot in shots(stream, pipeline, args.duration):
                display.show(shot)
    finally:
        display.close()
    if args.out and display.last is not None:
        display.save(args.out)


def open_chain(args: Namespace, layout: Layout) -> tuple[Device, Scene | None, Pipeline]:
    """The device that the options name, not yet open, its scene if it is simulated, and what makes
    images of its frames."""
    device, scene = open_device(args, layout, FRESH)
    law = load_calibration(args.calibration) if args.calibration else None
    if law is None and scene is not None:
        law = scene.contact_law
    pipeline = Pipeline(layout, Settings(args.profile, contact_law=law))
    apply_tare(args.tare, pipeline)
    return device, scene, pipeline


def shots(stream: FrameStream, pipeline: Pipeline, duration: float | None):
    """Images of the newest frames, for `duration` s from the first one on."""
    arrivals: deque[float] = deque(maxlen=32)
    # of each frame that was shown: how many came since the one before, how many of them late or cut
    late_ones: deque[tuple[int, int]] = deque(maxlen=128)
    first = before = None
    while not stream.ended:
        frame = stream.take(newest=True)
        if frame is None:
            continue
        limit = period_of(frame)
        result = pipeline.process(frame, deadline=limit)
        arrivals.append(time.monotonic())
        lasts, age = len(frame.grounded) * frame.row_period, time.time() - frame.stamp
        if first is None:  # frame k of a simulated sensor begins k periods into the scene
            first = frame.stamp - frame.sequence * lasts, arrivals[0]
        since = 1 if before is None else max(frame.sequence - before, 1)
        before = frame.sequence
        late = age - lasts > limit or not result.complete
        late_ones.append((since, since - 1 + late))
        total, late = np.sum(late_ones, axis=0).tolist()
        span = arrivals[-1] - arrivals[0]
        yield Shot(
            pressure=result.image,
            contacts=result.contacts,
            scene_time=frame.stamp + result.holds - first[0],
            rate=(len(arrivals) - 1) / span if span > 0 else 0.0,
            age=age - result.holds,
            reason=result.reason,
            late=late_of(late, total, "frames"),
            faults=result.faults,
            complete=result.complete,
            alternative=result.alternative,
        )
        if duration and arrivals[-1] - first[1] >= duration:
            return
