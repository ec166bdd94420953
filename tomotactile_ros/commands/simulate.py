"""`tomotactile simulate`: frames of a scene, with the truth beside them."""

from __future__ import annotations

import json

import numpy as np

from tomotactile_ros.errors import InputError
from tomotactile_ros.layout import load_layout
from tomotactile_ros.progress import track
from tomotactile_ros.scene import load_scene
from tomotactile_ros.sheet import MODELS
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.yamlio import write_atomic

HELP = "simulate the voltage frames of a scene"


def add_arguments(parser):
    parser.add_argument("--layout", required=True, help="layout file or name of an installed one")
    parser.add_argument("--scene", required=True, help="scene file or name of an installed one")
    parser.add_argument("--frames", required=True, type=int, help="number of frames")
    parser.add_argument("--out", required=True, help="file to write (.npz)")
    parser.add_argument("--rate", type=float, help="frames per second (default: 1 ms a row)")
    parser.add_argument("--model", default="fem", choices=MODELS, help="physics (default: fem)")


def run(args):
    layout, scene = load_layout(args.layout), load_scene(args.scene)
    if args.frames < 1:
        raise InputError(f"--frames: {args.frames} is not a positive number of frames")
    simulator = Simulator(layout, scene, args.model)
    rate = args.rate or 1 / (simulator.row_period * len(simulator.grounded))
    if not 0 < rate < 1e6:
        raise InputError(f"--rate: {args.rate:g} is not between 0 and 1e6 frames per second")
    stamps = np.arange(args.frames) / rate
    voltages = np.stack(
        [simulator.frame(t, n) for n, t in enumerate(track(stamps, "simulating frames"))]
    )
    write_frames(args.out, layout, scene, voltages, simulator.grounded, stamps)
    print(
        f"{args.out}: {args.frames} frames of {layout.name} under {scene.name}, "
        f"{rate:.3g} per second, by model {simulator.model}"
    )


def write_frames(path, layout, scene, voltages, grounded, stamps):
    """Write recorded or simulated frames, with the scene's truth, as `.npz`.

    voltages (N, L, E) V, grounded (L,), stamps (N,) s, truth JSON: for each frame a list of contacts;
    beside these layout_id, drive_voltage (V) and contact_law (coefficient, exponent), empty if none.
    """
    law = scene.contact_law
    content = {
        "voltages": voltages.astype(np.float32),
        "grounded": grounded.astype(np.uint16),
        "stamps": stamps,
        "truth": json.dumps([scene.truth(t) for t in stamps]),
        "layout_id": layout.id,
        "drive_voltage": scene.drive_voltage,
        "contact_law": [] if law is None else [law.coefficient, law.exponent],
    }
    write_npz(path, content)


def write_npz(path, content):
    """Write arrays as compressed `.npz`, whole or not at all."""
    import io

    buffer = io.BytesIO()
    np.savez_compressed(buffer, **content)
    write_atomic(path, buffer.getvalue())
