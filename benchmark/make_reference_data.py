"""Makes the reference data of the benchmark, benchmark/data/*.npz, by the reference model.

    scripts/setup python3 benchmark/make_reference_data.py [--only NAME ...] [--again] [--few N]

One file for each family of states (tomotactile_ros/bench/reference_cases.py); what is there already
is left alone. About a second for each of some 870 states. Needs Gmsh and scikit-fem.
"""

import argparse
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

from tomotactile_ros.bench import reference_data
from tomotactile_ros.bench.reference_cases import families
from tomotactile_ros.support.errors import InputError

FOLDER = Path(__file__).resolve().parent / "data"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", metavar="NAME", help="families to be made")
    parser.add_argument("--again", action="store_true", help="make also what is there")
    parser.add_argument("--few", type=int, metavar="N", help="only the first N states of each")
    parser.add_argument("--h", type=float, help="element size, m (side/50)")
    parser.add_argument("--out", type=Path, default=FOLDER, help="folder for the files")
    args = parser.parse_args()
    makers = families()
    unknown = set(args.only or ()) - set(makers)
    if unknown:
        parser.error(f"--only: {', '.join(sorted(unknown))}: none of {', '.join(makers)}")
    args.out.mkdir(parents=True, exist_ok=True)
    for name in args.only or makers:
        path = args.out / f"{name}.npz"
        if path.exists() and not args.again:
            print(f"{name}: is there")
            continue
        family = makers[name]()
        family = replace(family, states=family.states[: args.few])
        start = time.perf_counter()
        reference_data.save(reference_data.make(family, args.h), path)
        seconds = time.perf_counter() - start
        size = path.stat().st_size / 1e6
        print(f"{name}: {len(family.states)} states, {seconds:.0f} s, {size:.2f} MB", flush=True)


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"make_reference_data: {error}")
