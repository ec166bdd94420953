"""Sheets that were cut, printed or torn otherwise than the layout has it, before and after learning.

    scripts/setup python3 benchmark/cut_sheets.py [CASE ...] [--touches 30] [--presses 12]

Readings come from the reference model (bench/reference.py), whose mesh has the true outline, radii and
slits; the estimator has the layout alone. One contact of 0.5 to 3 N on 6 mm radius, 1 mV of noise;
`learned` is `accurate` after as many touches of unknown place and force as `--touches` says.
About a second a frame. Needs Gmsh and scikit-fem.
"""

import argparse
import os
from dataclasses import replace

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from tomotactile_ros.bench.reference import ReferenceSheet
from tomotactile_ros.bench.reference_cases import Press
from tomotactile_ros.bench.reference_mesh import disc
from tomotactile_ros.bench.sensor import tables
from tomotactile_ros.bench.sensor.states import solved
from tomotactile_ros.bench.sensor.trial import judge, presses
from tomotactile_ros.bench.tables import text
from tomotactile_ros.bench.trials import DRIVE, NOISE, make_pipeline
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.learning.recorded import learn

RADIUS, SLIT = 0.006, 0.0005  # m, of contacts, and how wide a tear gapes


def grid(side, count=8, half=0.1, radius=None, holes=()):
    """`count` x `count` electrodes from -half to half, m, on a square of `side`, m."""
    at = np.linspace(-half, half, count)
    places = np.array([[x, y] for y in at for x in at])
    outline = Outline.rectangle(side, side, holes=holes)
    return Layout(f"grid-{count}", outline, 1e4, radius or 0.02 / count, places)


def slit(x0, y0, x1, y1):
    along = np.array([x1 - x0, y1 - y0])
    across = SLIT / 2 * np.array([-along[1], along[0]]) / np.hypot(*along)
    start, end = np.array([x0, y0]), np.array([x1, y1])
    return [start - across, end - across, end + across, start + across]


HOLE = [(0.016, 0.006), (0.026, 0.006), (0.026, 0.022), (0.016, 0.022)]
CASES = {  # layout, and what was made of it
    "as drawn": (grid(0.2), grid(0.2)),
    "204 mm": (grid(0.2), grid(0.204)),
    "220 mm": (grid(0.2), grid(0.22)),
    "180 on 210 mm": (grid(0.2, half=0.09), grid(0.21, half=0.09)),
    "radius 3.5 mm": (grid(0.2), grid(0.2, radius=0.0035)),
    "tear of 90 mm": (grid(0.2), grid(0.2, holes=[slit(-0.045, 0.027, 0.045, 0.027)])),
    "tear of 60 mm": (grid(0.2), grid(0.2, holes=[slit(0.0, -0.099, 0.0, -0.039)])),
    "hole of 10 x 16 mm": (grid(0.2), grid(0.2, holes=[HOLE])),
    "4 x 4, 204 mm": (grid(0.2, 4), grid(0.204, 4)),
    "4 x 4, radius 6 mm": (grid(0.2, 4), grid(0.2, 4, radius=0.006)),
}


def pressed(layout, random, count):
    """`count` touches at random places, clear of rims."""
    found = []
    while len(found) < count:
        at = random.uniform(-0.09, 0.09, 2)
        if layout.outline.rim_distance(at[None])[0] >= 1.5 * RADIUS:
            pressure = random.uniform(0.5, 3.0) / (np.pi * RADIUS**2)
            found.append(Press(disc(at, RADIUS), "disc", pressure))
    return found


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("cases", nargs="*", metavar="CASE", help=", ".join(CASES))
    parser.add_argument("--touches", type=int, default=30, help="to learn from; 0: none (30)")
    parser.add_argument("--presses", type=int, default=12, help="that are judged (12)")
    args = parser.parse_args()
    if not set(args.cases) <= set(CASES):
        parser.error(f"CASE: one of {', '.join(CASES)} is needed")
    rows = []
    for name in args.cases or CASES:
        drawn, made = CASES[name]
        sheet, random = ReferenceSheet(made), np.random.default_rng(3)
        judging = solved(sheet, pressed(made, random, args.presses))
        trial = replace(presses(name, judging), layout=drawn)
        methods = {each: make_pipeline(drawn, each) for each in ("fast", "accurate")}
        if args.touches:
            touched = presses(name, solved(sheet, pressed(made, random, args.touches)))
            frames = np.where(np.eye(len(drawn.positions), dtype=bool), np.nan, touched.frames)
            state = learn(drawn, frames, drawn.grounded, DRIVE, noise=NOISE).state
            methods["learned"] = make_pipeline(drawn, sensor=state)
        for method, pipeline in methods.items():
            found = judge(pipeline, trial)
            rows.append([name, method, *tables.cells(found)])
            print("  ".join(rows[-1]), flush=True)
    print("\n".join(["", *text(("case", "method", *tables.HEADER), rows, fixed=2)]))


if __name__ == "__main__":
    main()
