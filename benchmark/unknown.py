"""What each unknown of the fit costs in time, and what leaving it out costs in contacts.

    scripts/setup python3 benchmark/unknown.py [SENSOR ...] [--step 2]

Frames are those of the parts of `tomotactile bench --parts`, and of 4 x 4 electrodes, from a model that
does not reconstruct them. `accurate` with all unknowns, then without each. Minutes.
"""

import time
from dataclasses import replace

import numpy as np

from tomotactile_ros.bench import reference_slides, tables
from tomotactile_ros.bench.cases import DEFAULT_LAYOUT
from tomotactile_ros.bench.program import options
from tomotactile_ros.bench.sensor.changes import sliding
from tomotactile_ros.bench.sensor.parts import WIRINGS, WORN
from tomotactile_ros.bench.sensor.states import fingers, states
from tomotactile_ros.bench.sensor.trial import judge, presses
from tomotactile_ros.bench.trials import DRIVE, NOISE, make_pipeline
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.learning.recorded import learn
from tomotactile_ros.reconstruction.settings import AUTO, UNKNOWN

SPEED = 0.2  # m/s, of contacts that move
LEARNED, LAST = 30, 12  # touches learned from, of which the last frames judge
SHEETS, TEXTBOOK, FOUR = "sheets-8x8", "textbook-8x8", "4 x 4"
SENSORS = {  # family, case, most, and wiring
    "textbook": (TEXTBOOK, None, 48, WIRINGS["textbook"]),
    "worn": (SHEETS, "random 20%", None, WORN),
    "learned": (SHEETS, "random 20%", None, WORN),
    "knitted": (SHEETS, "anisotropy 1.5", None, WIRINGS["textbook"]),
    "settling": (TEXTBOOK, None, 48, WIRINGS["0.5 % of the row before"]),
    "moving": (),
    "wide": ("wide-8x8", "line 100 x 5", None, WIRINGS["textbook"]),
    "4 x 4": (FOUR, None, None, WIRINGS["textbook"]),
    "4 x 4, gains": (FOUR, None, None, WIRINGS["gains 2 %"]),
}


def frames_of(name, step):
    """Frames of a sensor, every `step`-th press."""
    if name == "moving":
        return sliding(name, reference_slides.load(DEFAULT_LAYOUT), SPEED, step)
    family, case, most, wiring = SENSORS[name]
    if family == FOUR:
        random = np.random.default_rng(4)
        places = random.uniform(-0.085, 0.085, (24 // step, 2))
        return presses(name, fingers(load_layout("equal-4x4"), places, random), wiring)
    return presses(name, states(family, case, most).every(step), wiring)


def main():
    args = options(__doc__, *SENSORS, step=(2, "every so manieth press"))
    table = tables.Table("sensor", "left out", "ms a frame", *tables.titles(tables.SCORES))
    for name in args.cases or SENSORS:
        trial, sensor = frames_of(name, args.step), None
        if name == "learned":
            frames = frames_of(name, 1).frames[: 2 * LEARNED]
            grounded = trial.layout.grounded
            sensor = learn(trial.layout, frames, grounded, DRIVE, noise=2 * NOISE).state
            trial = replace(trial, frames=trial.frames[-LAST:], truths=trial.truths[-LAST:])
        for left_out in (None, *UNKNOWN):
            unknown = tuple(each for each in UNKNOWN if each != left_out)
            pipeline = make_pipeline(trial.layout, sensor=sensor, unknown=unknown)
            begun = time.process_time()
            found = judge(pipeline, trial)
            taken = 1e3 * (time.process_time() - begun) / len(trial.frames)
            table.add(name, left_out or AUTO, f"{taken:.1f}", *tables.cells(tables.SCORES, found))


if __name__ == "__main__":
    main()
