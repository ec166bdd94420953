"""Learns sensors from touches of unknown place, size and force, and judges them by others.

    scripts/setup python3 benchmark/learning.py [--source reference|simulator] [--cases 0 1 ...]
    [--before]
                                                [--plot out/learning.png] [--out out/learning.json]
                                                [--markdown]
    scripts/setup python3 benchmark/learning.py --read out/learning.json ... [--plot ...] [--markdown]
    scripts/setup python3 benchmark/learning.py --damage [NUMBER ...] | --healthy FRAMES

Cases are those of tomotactile_ros/bench/learned.py. Frames of 1 mV noise and 12 bits; each touch
after an untouched frame. `--damage`: what is named of sensors that break after they were learned,
and when; `--healthy`: what is named of one that does not (tomotactile_ros/bench/damage.py).
"""

import argparse
import json
import os
import sys
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

from tomotactile_ros.bench import damage, learned
from tomotactile_ros.support.errors import InputError


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--source", choices=learned.SOURCES, default=learned.SOURCES[0])
    parser.add_argument("--cases", type=int, nargs="+", help="numbers of the cases (default: all)")
    parser.add_argument("--before", action="store_true", help="judge without learning, too")
    parser.add_argument("--plot", type=Path, help="picture (.png) of errors against touches")
    parser.add_argument("--out", type=Path, help="all figures as JSON")
    parser.add_argument("--read", type=Path, nargs="+", help="show these figures, measure nothing")
    parser.add_argument("--markdown", action="store_true")
    parser.add_argument(
        "--damage", type=int, nargs="*", help="numbers of the kinds of damage (default: all)"
    )
    parser.add_argument("--healthy", type=int, metavar="FRAMES", help="of a sensor under load")
    args = parser.parse_args()
    if args.damage is not None or args.healthy is not None:
        print_health(parser, args)
        return
    rows = stored(args.read) if args.read else measured(parser, args)
    print("\n".join(learned.text(rows, args.markdown)))
    if args.plot:
        args.plot.parent.mkdir(parents=True, exist_ok=True)
        learned.save_plot(args.plot, rows)


def print_health(parser, args):
    if args.damage is not None:
        kinds = damage.damages()
        if not set(args.damage) <= set(range(len(kinds))):
            parser.error(f"--damage: numbers from 0 to {len(kinds) - 1} are needed")
        for row in damage.measure([kinds[n] for n in args.damage or range(len(kinds))]):
            when = "not named" if row["first"] is None else f"named at touch {row['first']}"
            print(f"{row['damage']}: {when}", flush=True)
            for text, sure in row["found"]:
                print(f"    {text} ({sure:.0f} standard deviations)", flush=True)
    if args.healthy is not None:
        if args.healthy < 1:
            parser.error("--healthy: a number of frames from 1 on is needed")
        for name, value in damage.healthy(args.healthy).items():
            print(f"{name}: {value}")


def stored(paths):
    return [row for path in paths for row in json.loads(path.read_text(encoding="utf-8"))]


def measured(parser, args):
    cases = learned.CASES
    if args.cases is not None:
        if not set(args.cases) <= set(range(len(cases))):
            parser.error(f"--cases: numbers from 0 to {len(cases) - 1} are needed")
        cases = [cases[number] for number in args.cases]
    rows = []
    for row, _ in learned.measure(cases, args.source, args.before):
        rows.append(row)
        print(
            f"{row['case']}, {row['touches']} touches: {row['learning, s']:.1f} s", file=sys.stderr
        )
        if args.out:
            save(args.out, rows)
    return rows


def save(path, rows):
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(json.dumps(rows, indent=1), encoding="utf-8")


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"learning: {error}")
