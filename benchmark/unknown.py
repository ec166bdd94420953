"""What each unknown of the fit costs in time, and what leaving it out costs in contacts.

    scripts/setup python3 benchmark/unknown.py [SENSOR ...] [--step 2]

Frames are those of the parts of `tomotactile bench --parts`, and of 4 x 4 electrodes, from a model that
does not reconstruct them. `accurate` with all unknowns, then without each. Minutes.
"""

import argparse
import os
import time
from dataclasses import replace

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from tomotactile_ros.bench import reference_slides, tables
from tomotactile_ros.bench.cases import DEFAULT_LAYOUT
from tomotactile_ros.bench.reference import ReferenceSheet
from tomotactile_ros.bench.reference_cases import Press
from tomotactile_ros.bench.reference_mesh import disc
from tomotactile_ros.bench.sensor import changes
from tomotactile_ros.bench.sensor.parts import WIRINGS, WORN
from tomotactile_ros.bench.sensor.states import solved, states
from tomotactile_ros.bench.sensor.trial import judge, presses
from tomotactile_ros.bench.trials import DRIVE, NOISE, make_pipeline
from tomotactile_ros.evaluation import scoring
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.learning.recorded import learn
from tomotactile_ros.reconstruction.settings import AUTO, UNKNOWN

SPEED = 0.2  # m/s, of contacts that move
LEARNED = 30  # touches


def on_four(step):
    """24 presses of 0.5 to 3 N and 6 mm radius on 4 x 4 electrodes."""
    random = np.random.default_rng(4)
    places = random.uniform(-0.085, 0.085, (24 // step, 2))
    area = np.pi * 0.006**2
    return solved(
        ReferenceSheet(load_layout("equal-4x4")),
        (Press(disc(at, 0.006), "disc", random.uniform(0.5, 3.0) / area) for at in places),
    )


def worn(step):
    return presses("worn", states("sheets-8x8", "random 20%").every(step), WORN)


def textbook(step, wiring="textbook"):
    return presses(wiring, states("textbook-8x8", most=48).every(step), WIRINGS[wiring])


SENSORS = {
    "textbook": textbook,
    "worn": worn,
    "learned": worn,
    "knitted": lambda step: presses("knitted", states("sheets-8x8", "anisotropy 1.5").every(step)),
    "settling": lambda step: textbook(step, "0.5 % of the row before"),
    "moving": lambda step: changes.sliding(
        "moving", reference_slides.load(DEFAULT_LAYOUT), SPEED, step
    ),
    "wide": lambda step: presses("wide", states("wide-8x8", "line 100 x 5").every(step)),
    "4 x 4": lambda step: presses("4 x 4", on_four(step)),
    "4 x 4, gains": lambda step: presses("4 x 4, gains", on_four(step), WIRINGS["gains 2 %"]),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("sensors", nargs="*", metavar="SENSOR", help=", ".join(SENSORS))
    parser.add_argument("--step", type=int, default=2, help="every so manieth press")
    args = parser.parse_args()
    if not set(args.sensors) <= set(SENSORS):
        parser.error(f"SENSOR: one of {', '.join(SENSORS)} is needed")
    rows = []
    for name in args.sensors or SENSORS:
        trial, sensor = SENSORS[name](args.step), None
        if name == "learned":
            touched = presses(name, states("sheets-8x8", "random 20%").every(1), WORN)
            frames = touched.frames[: 2 * LEARNED]
            grounded = trial.layout.grounded
            sensor = learn(trial.layout, frames, grounded, DRIVE, noise=2 * NOISE).state
            trial = replace(trial, frames=trial.frames[-12:], truths=trial.truths[-12:])
        for left_out in (None, *UNKNOWN):
            unknown = tuple(each for each in UNKNOWN if each != left_out)
            pipeline = make_pipeline(trial.layout, sensor=sensor, unknown=unknown)
            begun = time.process_time()
            found = judge(pipeline, trial)
            taken = 1e3 * (time.process_time() - begun) / len(trial.frames)
            rows.append([name, left_out or AUTO, f"{taken:.1f}", *scoring.cells(found)])
            print("  ".join(rows[-1]), flush=True)
    header = ("sensor", "left out", "ms a frame", *scoring.HEADER)
    print("\n".join(["", *tables.text(header, rows, fixed=2)]))


if __name__ == "__main__":
    main()
