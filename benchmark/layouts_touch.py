"""Layouts compared by reported contacts, on frames of the reference model; rank correlation with
what is expected without frames.

    scripts/setup python3 benchmark/layouts_touch.py 4
    scripts/setup python3 benchmark/layouts_touch.py 8 --layout mine.yaml --only equal r_2 mine
    scripts/setup python3 benchmark/layouts_touch.py 4 --only equal r_2 --singles 120
    scripts/setup python3 benchmark/layouts_touch.py 8 --only equal r_2 --pairs 20 --apart 0.012 0.014
    scripts/setup python3 benchmark/layouts_touch.py ring-16 --layout mine.yaml

Tables are Markdown on standard output. What electrodes see is kept in build/layouts: half a minute
for a layout of 4 x 4, three for one of 8 x 8, ten for one of 16 x 16, and half as much for the
profiles. Needs Gmsh and scikit-fem. Tables of docs/layouts.md come from here.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import sys
from dataclasses import replace
from functools import partial
from pathlib import Path

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np
from scipy.stats import spearmanr

from tomotactile_ros.bench.layouts import EVEN, PROFILES, UNEVEN, Amount, measure, reference
from tomotactile_ros.bench.tables import markdown
from tomotactile_ros.evaluation.places import usual_apart
from tomotactile_ros.evaluation.posterior import Conditions, expected
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.optimizer.scan import Chooser, spread
from tomotactile_ros.optimizer.touch_report import save_comparison
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

ROOT = Path(__file__).resolve().parent.parent
DATA = ROOT / "build" / "layouts"
JUDGES = ("bench", "estimation", "evaluation", "reconstruction", "sheet")  # what figures rest on
SCALES = (0.95, 0.9, 0.86)
SHIPPED = ("free", "optimized", "balanced", "touch")
DRAWS = 4000  # of the bootstrap
MOVED = 0.25  # of a spacing, uniform, of layouts at random
AMOUNTS = {
    "4": Amount(40, 16, (0.04, 0.05)),
    "8": Amount(30, 10, (0.014, 0.018, 0.022, 0.026)),
    "16": Amount(8, 4, (0.014, 0.018)),
    "hex-37": Amount(30, 10, (0.014, 0.018, 0.022, 0.026)),
    "ring-16": Amount(40, 16, (0.04, 0.05)),
}
ELLIPSES = {"4": 12, "8": 12, "16": 12, "hex-37": 16, "ring-16": 12}  # along a side, of pictures
PLACES = {
    "4": 24,
    "8": 12,
    "16": 12,
    "hex-37": 16,
    "ring-16": 16,
}  # of what is expected, along a side


def layouts(kind: str) -> dict[str, Layout]:
    """All that are compared: of `kind` x `kind` electrodes, or like the shipped layout `kind`."""
    grid = kind.isdigit()
    equal = load_layout(f"equal-{kind}x{kind}" if grid else kind)
    found = {"equal": equal}
    if grid:
        for scale in SCALES:
            found[f"x{scale:g}"] = replace(equal, positions=equal.positions * scale)
        for seed in (1, 2):
            reach = MOVED * 2 / (int(kind) - 1) * np.array(equal.outline.size) / 2
            moves = np.random.default_rng(seed).uniform(-1, 1, equal.positions.shape) * reach
            limit = np.array(equal.outline.size) / 2
            moved = np.clip(equal.positions + moves, -limit, limit)
            found[f"rand{seed}"] = replace(equal, positions=moved)
    found["r_2"] = replace(equal, radius=equal.radius / 2)
    found["r_1.6"] = replace(equal, radius=equal.radius * 1.6)
    for name in SHIPPED:
        try:
            found[name] = load_layout(f"{name}-{kind}x{kind}" if grid else f"{name}-{kind}")
        except InputError:
            continue  # is not shipped
    return {name: replace(layout, name=f"{kind}-{name}") for name, layout in found.items()}


WORDS = {
    "equal": "grid from rim to rim",
    "rand1": "moved at random, 1",
    "rand2": "moved at random, 2",
    "r_2": "electrodes of half the radius",
    "r_1.6": "electrodes of 1.6 times the radius",
    "optimized": "paper's method",
}


def words(name: str, kind: str) -> str:
    if not kind.isdigit():
        return kind if name == "equal" else WORDS.get(name, name)
    return WORDS.get(name, f"grid scaled by {name[1:]}" if name.startswith("x") else name)


def figures(layout: Layout, kind: str, amount: Amount, profiles) -> dict:
    """What is expected and what is measured, as plain data."""
    found = expected(layout, Conditions(apart=usual_apart(layout)), PLACES[kind])
    folder = DATA if amount.apart in ((), AMOUNTS[kind].apart) else DATA / _distances(amount)
    measured = list(measure(reference(layout, amount, folder), profiles, layout.grounded))
    return {
        "expected": [*map(float, found.lengths), found.score],
        "measured": {each.profile: each.figures for each in measured},
        "places": {
            each.profile: {sheet: errors.tolist() for sheet, errors in each.place.items()}
            for each in measured
        },
    }


def version() -> str:
    """Of the code that figures rest on: those of another estimator are not taken for today's."""
    code = hashlib.sha256()
    for room in JUDGES:
        for path in sorted((ROOT / "tomotactile_ros" / room).rglob("*.py")):
            code.update(path.read_bytes())
    return code.hexdigest()[:8]


def place_table(found: dict, profiles, kind) -> list[str]:
    header = ["layout", "expected, mean and worst tenth/um"]
    header += [f"{p}, {sheet}: mean, p95/mm" for p in profiles for sheet in (EVEN, UNEVEN)]
    rows = []
    for name, each in found.items():
        mean, tenth = (f"{1e6 * length:.0f}" for length in each["expected"][:2])
        cells = [words(name, kind), f"{mean}, {tenth}"]
        for profile in profiles:
            for sheet in (EVEN, UNEVEN):
                figure = each["measured"][profile][sheet]
                cells.append(f"{1e3 * figure['mean']:.3f}, {1e3 * figure['p95']:.3f}")
        rows.append(cells)
    return list(markdown(header, rows))


def force_table(found: dict, profiles, kind) -> list[str]:
    header = ["layout"]
    header += [f"{p}, {sheet}: median, p95/%" for p in profiles for sheet in (EVEN, UNEVEN)]
    rows = []
    for name, each in found.items():
        both = [each["measured"][p][sheet]["force"] for p in profiles for sheet in (EVEN, UNEVEN)]
        rows.append([words(name, kind), *(f"{100 * a:.1f}, {100 * b:.1f}" for a, b in both)])
    return list(markdown(header, rows))


def ratio_table(found: dict, profiles, kind) -> list[str]:
    """Mean and p95 of the place relative to the first layout, on the same contacts: with intervals
    of 95 % by the bootstrap over contacts, in pairs."""
    first, *others = found
    header = ["layout", *(f"{p}, {sheet}: mean, p95" for p in profiles for sheet in (EVEN, UNEVEN))]
    rows = []
    for name in others:
        cells = [words(name, kind)]
        for profile in profiles:
            for sheet in (EVEN, UNEVEN):
                errors = [np.array(found[k]["places"][profile][sheet]) for k in (name, first)]
                drawn = np.random.default_rng(0).integers(
                    len(errors[0]), size=(DRAWS, len(errors[0]))
                )
                parts = []
                for figure in (np.mean, partial(np.percentile, q=95)):
                    mine, its = (figure(each[drawn], axis=1) for each in errors)
                    low, high = np.percentile(mine / its, (2.5, 97.5))
                    ratio = figure(errors[0]) / figure(errors[1])
                    parts.append(f"x {ratio:.2f} ({low:.2f} to {high:.2f})")
                cells.append(", ".join(parts))
        rows.append(cells)
    return list(markdown(header, rows))


def pair_table(found: dict, profiles, kind) -> list[str]:
    apart = list(next(iter(found.values()))["measured"][profiles[0]]["told"])
    header = ["layout", *(f"{p}, {1e3 * float(d):g} mm" for p in profiles for d in apart)]
    rows = []
    for name, each in found.items():
        told = [each["measured"][p]["told"][d] for p in profiles for d in apart]
        rows.append([words(name, kind), *(f"{100 * part:.0f} %" for part in told)])
    return list(markdown(header, rows))


def rows_table(kind: str, rows: int, name: str, profiles) -> list[str]:
    """The profiles with the best `rows` rows, and with all of them."""
    layout = layouts(kind)[name]
    data = reference(layout, AMOUNTS[kind], DATA)
    chosen = spread(layout.positions, Chooser(layout).best(rows))
    header = ["profile", "rows", *(f"{sheet}: mean, median, p95/mm" for sheet in (EVEN, UNEVEN))]
    cells = []
    for order in (range(layout.electrodes), chosen):
        for found in measure(data, profiles, rows=list(order), pairs=False):
            place = [found.figures[sheet] for sheet in (EVEN, UNEVEN)]
            cells.append([found.profile, str(len(order))])
            cells[-1] += [
                ", ".join(f"{1e3 * each[key]:.3f}" for key in ("mean", "median", "p95"))
                for each in place
            ]
    return list(markdown(header, cells))


def rank_table(found: dict, profiles, _kind) -> list[str]:
    """Spearman's rho between the score that is expected and what was measured."""
    score = [each["expected"][-1] for each in found.values()]
    header = ("profile", *(f"{k}, {q}" for k in (EVEN, UNEVEN) for q in ("mean", "median", "p95")))
    rows = []
    for profile in profiles:
        cells = [profile]
        for sheet in (EVEN, UNEVEN):
            for key in ("mean", "median", "p95"):
                values = [each["measured"][profile][sheet][key] for each in found.values()]
                cells.append(f"{spearmanr(score, values).statistic:.2f}")
        rows.append(cells)
    return list(markdown(header, rows))


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("kind", choices=AMOUNTS, help="electrodes along a side, or a layout")
    parser.add_argument("--only", nargs="+", metavar="NAME", help="layouts to compare")
    parser.add_argument("--layout", action="append", default=[], help="another one, a file")
    parser.add_argument("--singles", type=int, help="so many single contacts, and no pairs")
    parser.add_argument("--pairs", type=int, help="so many pairs at each distance")
    parser.add_argument("--apart", type=float, nargs="+", help="distances of pairs, m, rising")
    parser.add_argument("--profiles", nargs="+", choices=PROFILES, default=PROFILES)
    parser.add_argument("--rows", type=int, help="best so many rows against all of them, instead")
    parser.add_argument("--picture", help="ellipses of the layouts, a file, instead")
    args = parser.parse_args()
    if args.picture:
        chosen = layouts(args.kind)
        found = []
        for name in args.only or ("equal", "r_2"):
            layout = replace(chosen[name], name=words(name, args.kind))
            found.append((layout, expected(layout, places=ELLIPSES[args.kind])))
        save_comparison(args.picture, found)
        return
    if args.rows is not None:
        name = (args.only or ["equal"])[0]
        print("\n".join(rows_table(args.kind, args.rows, name, args.profiles)))
        return
    every, amount = layouts(args.kind), AMOUNTS[args.kind]
    if args.singles is not None:
        amount = Amount(checks.integer(args.singles, "--singles", 1, 10_000), 0, ())
    if args.pairs is not None:
        count = checks.integer(args.pairs, "--pairs", 1, 10_000)
        amount = replace(amount, pairs=count, apart=AMOUNTS[args.kind].apart)
    if args.apart is not None:
        apart = tuple(checks.length(each, "--apart") for each in args.apart)
        amount = replace(amount, apart=apart)
    every |= {Path(path).stem: load_layout(path) for path in args.layout}
    found = {}
    DATA.mkdir(parents=True, exist_ok=True)
    today = version()
    for name, layout in every.items():
        if args.only and name not in args.only and layout.name not in map(_stem, args.layout):
            continue
        which = "-".join([today, str(amount.singles), *args.profiles])
        if amount.pairs and amount != AMOUNTS[args.kind]:
            which += f"-{amount.pairs}-{_distances(amount)}"
        kept = DATA / f"{layout.id.replace('#', '-')}-errors-{which}.json"
        if kept.exists():
            found[name] = json.loads(kept.read_text())
        else:
            found[name] = figures(layout, args.kind, amount, args.profiles)
            kept.write_text(json.dumps(found[name]))
        print(name, json.dumps(found[name]), file=sys.stderr, flush=True)
    tables = [place_table, force_table]
    if len(found) > 1:
        tables.append(ratio_table)
    if amount.pairs:
        tables.append(pair_table)
    if len(found) > 2:
        tables.append(rank_table)
    for table in tables:
        print()
        print("\n".join(table(found, args.profiles, args.kind)))


def _distances(amount):
    """Those of its pairs, mm, as part of a name."""
    return "-".join(f"{1e3 * each:g}" for each in amount.apart)


def _stem(path):
    return Path(path).stem


if __name__ == "__main__":
    try:
        main()
    except InputError as error:
        sys.exit(f"layouts_touch: {error}")
