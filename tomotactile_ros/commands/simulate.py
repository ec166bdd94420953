"""`tomotactile simulate`: frames of a scene, with the truth beside them."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

import numpy as np

from tomotactile_ros.frames_file import save_frames
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.sheet import MODELS
from tomotactile_ros.simulation import ROW_PERIOD, Simulator
from tomotactile_ros.support import checks, memory
from tomotactile_ros.support.checks import plain
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import check_out
from tomotactile_ros.support.progress import track

HELP = "simulate the voltage frames of a scene"


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("--layout", required=True, help="layout file or name of an installed one")
    parser.add_argument("--scene", required=True, help="scene file or name of an installed one")
    parser.add_argument("--frames", required=True, type=int, help="number of frames")
    parser.add_argument("--out", required=True, help="file to write (.npz)")
    parser.add_argument(
        "--rate", type=float, help="frames per second (default: one right after the other)"
    )
    parser.add_argument(
        "--row-period",
        type=float,
        help="s from row to row, 0 for all at once (default: 1e-3, less where --rate asks for it)",
    )
    parser.add_argument("--model", default="fem", choices=MODELS, help="physics (default: fem)")


def run(args: Namespace) -> None:
    layout, scene = load_layout(args.layout), load_scene(args.scene)
    if args.frames < 1:
        raise InputError(f"--frames: {args.frames} is not a positive number of frames")
    if args.rate is not None and not 0 < args.rate < 1e6:
        raise InputError(f"--rate: {args.rate:g} is not between 0 and 1e6 frames per second")
    row_period, rate = _pace(args.row_period, args.rate, len(layout.grounded))
    check_out(args.out, ".npz")
    simulator = Simulator(layout, scene, args.model, row_period=row_period)
    one = 8.0 * len(layout.grounded) * layout.electrodes  # bytes
    memory.check(2.0 * args.frames * one, f"--frames: {args.frames} frames")  # twice, to stack them
    stamps = np.arange(args.frames) / rate
    voltages = np.stack(
        [simulator.frame(t, n) for n, t in enumerate(track(stamps, "simulating frames"))]
    )
    save_frames(args.out, layout, scene, voltages, simulator.grounded, stamps, row_period)
    rows = f"rows {plain(1e3 * row_period)} ms apart" if row_period else "rows all at once"
    print(
        f"{args.out}: {args.frames} frames of {layout.name} under {scene.name}, "
        f"{plain(rate)} per second, {rows}, by model {simulator.model}"
    )


def _pace(row_period: float | None, rate: float | None, rows: int) -> tuple[float, float]:
    """Row period, s, and frames per second: what was asked for, the other to fit."""
    if row_period is None:
        row_period = ROW_PERIOD if rate is None else min(ROW_PERIOD, 1 / (rate * rows))
    checks.not_negative(row_period, "--row-period", "time in s")
    if rate is None:
        rate = 1 / (rows * (row_period or ROW_PERIOD))
    if rate * rows * row_period > 1 + 1e-9:
        raise InputError(
            f"--row-period: {rows} rows of {row_period:g} s last longer than a frame at "
            f"{rate:g} frames per second"
        )
    return row_period, rate
