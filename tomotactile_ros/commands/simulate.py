"""`tomotactile simulate`: frames of a scene, with the truth beside them."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

import numpy as np

from tomotactile_ros.errors import InputError
from tomotactile_ros.files import check_folder
from tomotactile_ros.frames_file import save_frames
from tomotactile_ros.layout import load_layout
from tomotactile_ros.progress import track
from tomotactile_ros.scene import load_scene
from tomotactile_ros.sheet import MODELS
from tomotactile_ros.simulation import Simulator

HELP = "simulate the voltage frames of a scene"


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("--layout", required=True, help="layout file or name of an installed one")
    parser.add_argument("--scene", required=True, help="scene file or name of an installed one")
    parser.add_argument("--frames", required=True, type=int, help="number of frames")
    parser.add_argument("--out", required=True, help="file to write (.npz)")
    parser.add_argument("--rate", type=float, help="frames per second (default: 1 ms a row)")
    parser.add_argument("--model", default="fem", choices=MODELS, help="physics (default: fem)")


def run(args: Namespace) -> None:
    layout, scene = load_layout(args.layout), load_scene(args.scene)
    if args.frames < 1:
        raise InputError(f"--frames: {args.frames} is not a positive number of frames")
    if args.rate is not None and not 0 < args.rate < 1e6:
        raise InputError(f"--rate: {args.rate:g} is not between 0 and 1e6 frames per second")
    check_folder(args.out)
    simulator = Simulator(layout, scene, args.model)
    rate = args.rate or 1 / (simulator.row_period * len(simulator.grounded))
    stamps = np.arange(args.frames) / rate
    voltages = np.stack(
        [simulator.frame(t, n) for n, t in enumerate(track(stamps, "simulating frames"))]
    )
    save_frames(args.out, layout, scene, voltages, simulator.grounded, stamps)
    print(
        f"{args.out}: {args.frames} frames of {layout.name} under {scene.name}, "
        f"{rate:.3g} per second, by model {simulator.model}"
    )
