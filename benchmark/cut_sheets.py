"""Sheets that were cut, printed or torn otherwise than the layout has it, before and after learning.

    scripts/setup python3 benchmark/cut_sheets.py [CASE ...] [--touches 30] [--presses 12]

Readings come from the reference model (bench/reference.py), whose mesh has the true outline, radii and
slits; the estimator has the layout alone. One contact of 0.5 to 3 N on 6 mm radius, 1 mV of noise;
`learned` is `accurate` after as many touches of unknown place and force as `--touches` says.
About a second a frame. Needs Gmsh and scikit-fem.
"""

from dataclasses import replace

import numpy as np

from tomotactile_ros.bench import tables
from tomotactile_ros.bench.program import options
from tomotactile_ros.bench.sensor.states import FINGER, fingers
from tomotactile_ros.bench.sensor.trial import judge, presses
from tomotactile_ros.bench.trials import DRIVE, NOISE, make_pipeline
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.learning.recorded import learn
from tomotactile_ros.scenes.sheet_field import Tear

SLIT = 0.0005  # m, how wide a tear gapes


def grid(side, count=8, half=0.1, radius=None, holes=()):
    """`count` x `count` electrodes from -half to half, m, on a square of `side`, m."""
    at = np.linspace(-half, half, count)
    places = np.array([[x, y] for y in at for x in at])
    outline = Outline.rectangle(side, side, holes=holes)
    return Layout(f"grid-{count}", outline, 1e4, radius or 0.02 / count, places)


ALONG = Tear(((-0.045, 0.027), (0.045, 0.027)), SLIT).corners
INWARDS = Tear(((0.0, -0.099), (0.0, -0.039)), SLIT).corners
HOLE = [(0.016, 0.006), (0.026, 0.006), (0.026, 0.022), (0.016, 0.022)]
CASES = {  # layout, and what was made of it
    "as drawn": (grid(0.2), grid(0.2)),
    "204 mm": (grid(0.2), grid(0.204)),
    "220 mm": (grid(0.2), grid(0.22)),
    "180 on 210 mm": (grid(0.2, half=0.09), grid(0.21, half=0.09)),
    "radius 3.5 mm": (grid(0.2), grid(0.2, radius=0.0035)),
    "tear of 90 mm": (grid(0.2), grid(0.2, holes=[ALONG])),
    "tear of 60 mm": (grid(0.2), grid(0.2, holes=[INWARDS])),
    "hole of 10 x 16 mm": (grid(0.2), grid(0.2, holes=[HOLE])),
    "4 x 4, 204 mm": (grid(0.2, 4), grid(0.204, 4)),
    "4 x 4, radius 6 mm": (grid(0.2, 4), grid(0.2, 4, radius=0.006)),
}


def places(layout, random, count):
    """So many, clear of rims."""
    while count:
        at = random.uniform(-0.09, 0.09, 2)
        if layout.outline.holds(at[None], 1.5 * FINGER)[0]:
            count -= 1
            yield at


def main():
    args = options(
        __doc__,
        *CASES,
        touches=(30, "to learn from; 0: none (30)"),
        presses=(12, "that are judged (12)"),
    )
    table = tables.Table("case", "method", *tables.titles(tables.HELD))
    for name in args.cases or CASES:
        drawn, made = CASES[name]
        random = np.random.default_rng(3)
        judging = presses(name, fingers(made, places(made, random, args.presses), random))
        methods = {each: make_pipeline(drawn, each) for each in ("fast", "accurate")}
        if args.touches:
            touched = presses(name, fingers(made, places(made, random, args.touches), random))
            frames = np.where(np.eye(len(drawn.positions), dtype=bool), np.nan, touched.frames)
            state = learn(drawn, frames, drawn.grounded, DRIVE, noise=NOISE).state
            methods["learned"] = make_pipeline(drawn, sensor=state)
        for method, pipeline in methods.items():
            found = judge(pipeline, replace(judging, layout=drawn))
            table.add(name, method, *tables.cells(tables.HELD, found))


if __name__ == "__main__":
    main()
