"""Solves the presses of the benchmark's parts (channels, sheets, layouts, crowd, time) once, with the
reference model, and keeps what the electrodes see: benchmark/data/sensor.npz, 2 MB, a quarter of an hour.

    scripts/setup python3 benchmark/reference_data.py [--only NAME ...]

With --only the other sets stay as they are in the file. Needs scikit-fem and gmsh.
"""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from tomotactile_ros.bench.sensor.states import KINDS, load, save, solve
from tomotactile_ros.errors import InputError
from tomotactile_ros.progress import track

OUT = Path(__file__).resolve().parent / "data" / "sensor.npz"


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", nargs="+", choices=KINDS, default=list(KINDS))
    args = parser.parse_args()
    sets = {}
    for name, kind in KINDS.items():
        if name not in args.only:
            sets[name] = load(name, OUT)
            continue
        sets[name] = solve(kind, lambda groups, name=name: track(groups, name))
    OUT.parent.mkdir(exist_ok=True)
    save(OUT, sets)
    print(f"{OUT}: {OUT.stat().st_size / 1e6:.1f} MB")


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"reference_data: {error}")
