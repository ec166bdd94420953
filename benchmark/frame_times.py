"""Processor time of single frames by what they show: an untouched sheet, a new touch, one that rests.

    scripts/setup python3 benchmark/frame_times.py [--profiles accurate ...] [--cases NAME ...] [--states N]

States of the reference model on 8 x 8 electrodes, 1 mV, 12 bits, no times of rows: of each two frames of
the untouched sheet, one of the touch, three more of it. The first line is the product of a float32
matrix of 1600 x 4032 with the readings, the least that an image takes, in the same run. One thread.
"""

from __future__ import annotations

import argparse
import os
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from tomotactile_ros.bench.cases import PROFILES
from tomotactile_ros.bench.sensor.parts import WIRINGS, WORN
from tomotactile_ros.bench.sensor.readings import potentials, readings, untouched
from tomotactile_ros.bench.sensor.states import states
from tomotactile_ros.bench.tables import markdown
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE
from tomotactile_ros.reconstruction import Pipeline, Settings

# family, case and wiring
CASES = {
    "one contact": ("textbook-8x8", None, "textbook"),
    "gains off by 2 %": ("textbook-8x8", None, "gains 2 %"),
    "uneven by 20 %": ("sheets-8x8", "random 20%", "textbook"),
    "worn and uneven by 20 %": ("sheets-8x8", "random 20%", "worn"),
    "two contacts": ("beside-8x8", "two", "textbook"),
    "three contacts": ("crowd-8x8", "3 contacts", "textbook"),
    "six contacts": ("crowd-8x8", "6 contacts", "textbook"),
    "disc of 30 mm": ("wide-8x8", "disc of 30 mm", "textbook"),
    "rectangle of 80 x 50 mm": ("wide-8x8", "rectangle 80 x 50", "textbook"),
    "hand": ("wide-8x8", "hand", "textbook"),
    "plate of 100 mm": ("wide-8x8", "plate of 100 mm", "textbook"),
    "whole sheet, 100 N": ("wide-8x8", "whole sheet, 100 N", "textbook"),
}
KINDS = "untouched", "new", "at rest"
_WIRINGS = WIRINGS | {"worn": WORN}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.split("\n", 1)[0])
    parser.add_argument("--profiles", nargs="+", default=["accurate", *PROFILES], metavar="PROFILE")
    parser.add_argument("--cases", nargs="+", default=list(CASES), choices=CASES, metavar="NAME")
    parser.add_argument("--states", type=int, default=24, metavar="N", help="of each case, at most")
    asked = parser.parse_args()
    print(f"product of 1600 x 4032, float32: {dense():.2f} ms\n")
    rows = []
    for case in asked.cases:
        for profile in dict.fromkeys(asked.profiles):
            times = measured(*CASES[case], profile, asked.states)
            cells = (f"{np.median(t):.1f} / {np.percentile(t, 95):.1f}" for t in times)
            rows.append((case, profile, *cells))
    heads = [f"{kind}, ms: median / p95" for kind in KINDS]
    print(*markdown(("case", "profile", *heads), rows), sep="\n")


def dense() -> float:
    """ms that the least of an image takes, matrices not in the caches."""
    matrices = np.ones((8, 1600, 4032), np.float32)
    frame, times = matrices[0, 0].copy(), []
    for _ in range(3):
        for matrix in matrices:
            start = time.process_time()
            matrix @ frame
            times.append(1e3 * (time.process_time() - start))
    return float(np.median(times))


def measured(family: str, case: str | None, wiring: str, profile: str, most: int):
    """ms of frames of each of `KINDS`."""
    pressed, wires = states(family, case, most), _WIRINGS[wiring]
    electrodes = pressed.layout.electrodes
    pipeline = Pipeline(pressed.layout, Settings(profile, noise=NOISE, contact_law=LAW))
    nothing, times = untouched(electrodes), [[] for _ in KINDS]
    for number, seen in enumerate(pressed.seen):
        touched = potentials(seen, wires)
        for k, kind in enumerate((0, 0, 1, 2, 2, 2)):
            frame = readings(touched if kind else nothing, wires, (number, k))
            start = time.process_time()
            pipeline.process(frame, np.arange(electrodes), DRIVE)
            times[kind].append(1e3 * (time.process_time() - start))
    return times


if __name__ == "__main__":
    main()
