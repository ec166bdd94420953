"""`tomotactile reconstruct`: images and contacts of recorded or simulated frames."""

from __future__ import annotations

import json
import time
from argparse import ArgumentParser, Namespace
from dataclasses import asdict

import numpy as np

from tomotactile_ros.devices.recording import load_recording
from tomotactile_ros.errors import complaints_at
from tomotactile_ros.files import check_folder
from tomotactile_ros.frames_file import save_arrays
from tomotactile_ros.layout import load_layout
from tomotactile_ros.progress import track
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.calibration import load_calibration
from tomotactile_ros.reconstruction.settings import PROFILES, ContactEstimate, Result
from tomotactile_ros.sheet import MODELS

HELP = "make pressure images and contacts of frames"


def add_arguments(parser: ArgumentParser) -> None:
    parser.add_argument("frames", help="recorded frames: .npz or rosbag2")
    parser.add_argument("--layout", required=True, help="layout file or name of an installed one")
    parser.add_argument("--profile", default="fast", choices=PROFILES, help="default: fast")
    parser.add_argument("--out", required=True, help="file to write (.npz)")
    parser.add_argument("--resolution", type=int, default=40, help="cells along the longer side")
    parser.add_argument(
        "--regularization", type=float, help="lambda_J^2 of eq. 1 (default: by noise)"
    )
    parser.add_argument("--noise", type=float, default=0.001, help="of a reading, V rms")
    parser.add_argument("--contact-radius", type=float, default=0.005, help="typical, m")
    parser.add_argument("--calibration", help="file of 'calibrate' (default: the frames' own law)")
    parser.add_argument("--drive-voltage", type=float, help="V (default: the frames' own)")
    parser.add_argument("--deadline", type=float, default=0.05, help="of profile auto, s a frame")
    parser.add_argument("--model", default="auto", choices=MODELS, help="physics (default: auto)")


def run(args: Namespace) -> None:
    layout = load_layout(args.layout)
    recorded = load_recording(args.frames, layout, args.drive_voltage)
    check_folder(args.out)
    law = load_calibration(args.calibration) if args.calibration else recorded.contact_law
    settings = Settings(
        args.profile,
        resolution=args.resolution,
        regularization=args.regularization,
        noise=args.noise,
        contact_law=law,
        contact_radius=args.contact_radius,
        deadline=args.deadline,
        model=args.model,
    )
    pipeline = Pipeline(layout, settings)
    results, latency = [], []
    for voltages in track(recorded.voltages, "reconstructing frames"):
        start = time.perf_counter()
        with complaints_at(f"{args.frames}: "):
            results.append(pipeline.process(voltages, recorded.grounded, recorded.drive_voltage))
        latency.append(time.perf_counter() - start)
    save_results(args.out, results, latency)
    left_out = sorted({e for result in results for e in result.excluded})
    print(
        f"{args.out}: {len(results)} frames, {pipeline.report}, "
        f"{1e3 * np.median(latency):.2f} ms a frame"
        + (f", electrodes left out: {', '.join(map(str, left_out))}" if left_out else "")
    )


def save_results(path: str, results: list[Result], latency: list[float]) -> None:
    """pressure (N, H, W) Pa, potential (N, H, W) V, contacts as JSON, latency (N,) s; where
    contacts of some frame are withheld, reason (N,), empty for the others."""
    contacts = [[contact_entry(contact) for contact in result.contacts] for result in results]
    content = {
        "pressure": np.array([result.pressure for result in results], np.float32),
        "potential": np.array([result.potential for result in results], np.float32),
        "contacts": json.dumps(contacts),
        "latency": np.array(latency),
    }
    if any(result.reason for result in results):
        content["reason"] = np.array([result.reason for result in results])
    save_arrays(path, content)


def contact_entry(contact: ContactEstimate) -> dict[str, float]:
    """What a result file says of a contact; standard deviations (m, N) only where they were estimated."""
    entry = asdict(contact)
    covariance = np.reshape(entry.pop("position_covariance"), (2, 2))
    if not np.isfinite(covariance).all():
        del entry["force_std"], entry["probability"]
        return entry
    return {**entry, "position_std": float(np.sqrt(np.linalg.eigvalsh(covariance)[-1]))}
