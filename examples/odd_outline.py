#!/usr/bin/env python3
"""Place 12 electrodes on a sheet that is no rectangle and has a hole, and see what it brings.

    python3 examples/odd_outline.py --steps 10 --out l-shaped.yaml

The same search as `tomotactile optimize --method free`, on an outline of one's own. Outlines other
than rectangles have no closed form: the search goes by scores from finite elements alone, without a gradient.
"""

import argparse
from dataclasses import replace

import numpy as np

import tomotactile_ros as tt

SHELL = [(-0.1, -0.1), (0.1, -0.1), (0.1, 0.0), (0.0, 0.0), (0.0, 0.1), (-0.1, 0.1)]  # m, an L
HOLE = [(-0.07, -0.07), (-0.05, -0.07), (-0.05, -0.05), (-0.07, -0.05)]  # m, for a screw
PITCH = 0.055  # m, of the lattice to start from


def start_layout() -> tt.Layout:
    """A square lattice, of which those places are kept that lie 8 mm or more inside."""
    outline = tt.Outline.polygon(SHELL, holes=[HOLE])
    steps = np.arange(-1.5, 2) * PITCH
    places = np.array([(x, y) for y in steps for x in steps])
    inside = outline.contains(places) & (outline.rim_distance(places) > 0.008)
    return tt.Layout("l-start", outline, 1e4, 0.003, places[inside])


def tell(label: str, figures: dict) -> None:
    """How far images of contacts spread (which the search lowers), how wide they are, how far beside."""
    print(
        f"{label:5}  mean blur {1e3 * figures['blur']['mean']:.1f} mm"
        f"  HWHM {1e3 * figures['hwhm']['mean']:.1f} mm"
        f"  position error {1e3 * figures['position_error']['mean']:.1f} mm",
        flush=True,
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=10, help="of the search (default: 10)")
    parser.add_argument("--resolution", type=int, default=20, help="contacts along the longer side")
    parser.add_argument("--out", default="l-shaped.yaml", help="layout file to write")
    args = parser.parse_args()

    request = tt.Request(
        start_layout(),
        "free",
        steps=args.steps,
        margin=0.004,  # m, from the rim to a centre
        resolution=args.resolution,
        seed=1,
    )
    print(f"{request.layout.electrodes} electrodes, {args.steps} steps of some seconds", flush=True)
    history, best = tt.best_of(request.steps_of(), lambda step: tell("step", step.metrics))
    tell("start", history[0].metrics)
    tell("best", best.metrics)
    replace(best.layout, name="l-shaped").save(args.out)
    print(f"{args.out} written")


if __name__ == "__main__":
    try:
        main()
    except tt.InputError as error:
        raise SystemExit(f"odd_outline: {error}") from None
