"""Makes the reference data of the benchmark, benchmark/data/*.npz, by the reference model.

    scripts/setup python3 benchmark/make_reference_data.py [--only NAME ...] [--few N] [--out FOLDER]

One file for each family of states (tomotactile_ros/bench/reference_cases.py), and for touches that
slide (tomotactile_ros/bench/reference_slides.py); what is there already is left alone. About a
second for each of some 600 states and for each of 294 places of a slide. Needs Gmsh and scikit-fem.
"""

import sys
from dataclasses import replace
from pathlib import Path

from tomotactile_ros.bench import reference_slides
from tomotactile_ros.bench.program import options
from tomotactile_ros.bench.reference_cases import FAMILIES, family
from tomotactile_ros.bench.sensor.states import solved
from tomotactile_ros.support.errors import InputError

FOLDER = Path(__file__).resolve().parent / "data"
SLIDES = "slides/equal-8x8"


def main():
    names = [*FAMILIES, SLIDES]
    args = options(
        __doc__,
        only=(names, None, names),
        few=(int, "the first N states of each, or slides"),
        out=(FOLDER, "folder for the files"),
    )
    for name in args.only:
        path = args.out / f"{name}.npz"
        if path.exists():
            print(f"{name}: is there")
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        if name == SLIDES:
            reference_slides.make(path.stem, path, most=args.few)
        else:
            made = family(name)
            solved(replace(made, states=made.states[: args.few])).save(path)
        print(f"{name}: {path.stat().st_size / 1e6:.2f} MB", flush=True)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"make_reference_data: {error}")
