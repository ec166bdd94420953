"""Makes the reference data of the benchmark, benchmark/data/*.npz, by the reference model.

    scripts/setup python3 benchmark/make_reference_data.py [--only NAME ...] [--again] [--few N]

One file for each family of states (tomotactile_ros/bench/reference_cases.py), and for touches that
slide (tomotactile_ros/bench/reference_slides.py); what is there already is left alone. About a
second for each of some 600 states and for each of 294 places of a slide. Needs Gmsh and scikit-fem.
"""

import argparse
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

from tomotactile_ros.bench import reference_data, reference_slides
from tomotactile_ros.bench.reference_cases import families
from tomotactile_ros.support.errors import InputError

FOLDER = Path(__file__).resolve().parent / "data"
SLIDES = "slides/equal-8x8"


def main():
    makers = families()
    names = [*makers, SLIDES]
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=names, default=names)
    parser.add_argument("--again", action="store_true", help="make also what is there")
    parser.add_argument(
        "--few", type=int, metavar="N", help="the first N states of each, or slides"
    )
    parser.add_argument("--h", type=float, help="element size, m (side/50)")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder for the files")
    args = parser.parse_args()
    for name in args.only:
        path = args.out / f"{name}.npz"
        if path.exists() and not args.again:
            print(f"{name}: is there")
            continue
        path.parent.mkdir(parents=True, exist_ok=True)
        start = time.perf_counter()
        if name == SLIDES:
            reference_slides.make(path.stem, path, args.h, args.few)
        else:
            family = makers[name]()
            reference_data.make(replace(family, states=family.states[: args.few]), path, args.h)
        seconds = time.perf_counter() - start
        print(f"{name}: {seconds:.0f} s, {path.stat().st_size / 1e6:.2f} MB", flush=True)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"make_reference_data: {error}")
