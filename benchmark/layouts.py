"""Layouts compared: the paper's tables, free layouts against grids, ground conditions, times.

    scripts/setup python3 benchmark/layouts.py
    scripts/setup python3 benchmark/layouts.py --only free

Tables are Markdown on standard output, times go to standard error.

Tables of docs/layouts.md come from here.
"""

from __future__ import annotations

import argparse
import statistics
import sys
import time
from dataclasses import replace

import numpy as np

from tomotactile_ros.evaluation.layout_quality import evaluate_layout
from tomotactile_ros.layout import load_layout
from tomotactile_ros.optimizer.equalize import equalize
from tomotactile_ros.optimizer.grounding import scans
from tomotactile_ros.optimizer.objective import Aims
from tomotactile_ros.optimizer.request import Request, processes, start_layout

COUNTS = (4, 8)
SIZE = (0.2, 0.2)  # m
LAMBDAS = (1000.0, 100.0, 10000.0)
PAPER = {  # Kojima et al. 2023, section 3: equal grid in % of the side, best step relative to it
    4: {"mean": 32.4, "worst region": 38.8, "after": (0.958, 0.81, 0.90), "updates": 3},
    8: {"mean": 17.3, "worst region": 18.0, "after": (0.96, 0.93, 0.95), "updates": 5},
}
SCALES = np.linspace(0.7, 1.0, 16)
FIGURES = (
    ("mean HWHM", "hwhm", "mean"),
    ("worst region", "hwhm", "worst_region"),
    ("worst tenth", "hwhm", "worst_tenth"),
    ("mean PE", "position_error", "mean"),
)
GOALS = {4: (0.73, 0.72, 0.74), 8: (0.81, 0.83, 0.70)}  # mean HWHM, worst tenth, mean PE
OTHER_GOALS = (0.95, 0.95, 1.0)  # the same for lambda^2 / 10 and * 10
ALLOWED = {4: (1.0, 1.1, 2.0), 8: (1.0, 2.0)}  # position errors there, relative to the equal grid
LATTICES = (36, 38, 42, 44, 46, 48)  # contacts along a side; the goals are for 40
CONDITIONS = (64, 48, 32, 24, 16, 12, 8, 6, 4)


def figures(metrics):
    return np.array([metrics[group][key] for _, group, key in FIGURES])


def row(*cells):
    print("| " + " | ".join(str(cell) for cell in cells) + " |")


def header(*cells):
    row(*cells)
    row(*("---" for _ in cells))


def paper_tables():
    for count in COUNTS:
        paper = PAPER[count]
        print(f"\n{count} x {count}, equalize: % of the side, and relative to the equal grid\n")
        header("model", "updates", *(label for label, _, _ in FIGURES))
        after = (f"x {factor}" for factor in paper["after"])
        mean, worst, error = after
        row("paper's result", 0, paper["mean"], paper["worst region"], "", "")
        row("paper's result", paper["updates"], mean, worst, "", error)
        for model, label in (("paper", "points with a radius"), ("fem", "equipotentials, FEM")):
            start = None
            for step in equalize(load_layout(f"equal-{count}x{count}"), 5, model=model):
                found = figures(step.metrics)
                start = found if start is None else start
                cells = [f"{100 * v / 0.2:.2f}, x {v / s:.3f}" for v, s in zip(found, start)]
                row(label, step.iteration, *cells)


def best_scaled(equal):
    """The equal grid, scaled so that the largest of its three figures is smallest."""
    start = figures(evaluate_layout(equal).metrics)
    tried = [replace(equal, positions=equal.positions * scale) for scale in SCALES]
    largest = [max((figures(evaluate_layout(each).metrics) / start)[[0, 2, 3]]) for each in tried]
    best = int(np.argmin(largest))
    return SCALES[best], tried[best]


def free_tables():
    ways = [("paper's model", {"model": "paper"}), ("FEM, shunting", {"model": "fem"})]
    for count in COUNTS:
        equal = load_layout(f"equal-{count}x{count}")
        scale, scaled = best_scaled(equal)
        layouts = [
            (f"grid scaled by {scale:.2f}", scaled),
            ("paper's method", load_layout(f"optimized-{count}x{count}")),
            ("free", load_layout(f"free-{count}x{count}")),
        ]
        if count == 4:
            layouts.append(("balanced", load_layout("balanced-4x4")))
        print(f"\n{count} x {count}, relative to the equal grid from rim to rim\n")
        header("layout", "model", "lambda^2", *(label for label, _, _ in FIGURES), "noise gain")
        for label, how in ways:
            for regularization in LAMBDAS:
                how = how | {"regularization": regularization}
                base = evaluate_layout(equal, **how).metrics
                for name, layout in layouts:
                    found = evaluate_layout(layout, **how).metrics
                    ratios = [f"{ratio:.3f}" for ratio in figures(found) / figures(base)]
                    noise = found["noise_gain"] / base["noise_gain"]
                    row(name, label, f"{regularization:g}", *ratios, f"{noise:.3f}")


def lattice_table():
    """What is left on other lattices of contact positions, lambda^2 scaled to mean the same."""
    print("\nother lattices of contact positions, relative to the equal grid from rim to rim\n")
    header("layout", "positions along a side", "mean HWHM", "worst tenth", "mean PE")
    for count in COUNTS:
        equal = load_layout(f"equal-{count}x{count}")
        scale, scaled = best_scaled(equal)
        free = load_layout(f"free-{count}x{count}")
        for name, layout in ((f"grid scaled by {scale:.2f}", scaled), (free.name, free)):
            at, *others = (
                on_lattice(layout, each) / on_lattice(equal, each) for each in (40, *LATTICES)
            )
            row(name, 40, *(f"{ratio:.3f}" for ratio in at))
            columns = zip(np.mean(others, 0), np.min(others, 0), np.max(others, 0))
            cells = (f"{mean:.3f} ({low:.3f} to {high:.3f})" for mean, low, high in columns)
            row(name, f"{LATTICES[0]} to {LATTICES[-1]}", *cells)


def on_lattice(layout, count):
    """(3,) mean HWHM, worst tenth and mean position error for count x count contacts."""
    how = {"resolution": count, "regularization": LAMBDAS[0] * (count / 40) ** 2}
    return figures(evaluate_layout(layout, **how).metrics)[[0, 2, 3]]


def searched(count, allowed):
    """What `free` finds from the equal grid with `allowed` position error at other lambda^2."""
    aims = Aims(GOALS[count], (*OTHER_GOALS[:2], allowed))
    with processes(2) as executor:
        *_, last = Request(start_layout(count, count, SIZE), "free", aims=aims).steps_of(executor)
    return last.layout


def front(plot=None):
    """What the figures at lambda^2 = 1000 cost at 100 and 10,000: one search for each allowance."""
    found = {}
    for count in COUNTS:
        start = three_lambdas(start_layout(count, count, SIZE))
        print(f"\n{count} x {count}, free with more and more position error allowed elsewhere\n")
        labels = [f"{label} {each:g}" for each in LAMBDAS for label in ("HWHM", "tenth", "PE")]
        header("allowed", *labels, "over goal")
        for allowed in ALLOWED[count]:
            ratios = three_lambdas(searched(count, allowed)) / start
            over = (ratios / [GOALS[count], OTHER_GOALS, OTHER_GOALS]).max() - 1
            cells = (f"{value:.3f}" for value in ratios.ravel())
            row(f"{allowed:g}", *cells, f"{100 * over:.1f} %")
            found.setdefault(count, []).append(ratios)
    if plot:
        plot_front(plot, found)


def plot_front(path, found):
    """The largest figure at lambda^2 = 1000, relative to its goal, over position error at 100."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(10, 4.2), layout="constrained")
    for axes, (count, ratios) in zip(
        figure.subplots(1, len(found), squeeze=False)[0], found.items()
    ):
        equal = load_layout(f"equal-{count}x{count}")
        grids = [replace(equal, positions=equal.positions * scale) for scale in SCALES[3::2]]
        for label, style, points in (
            ("equal grid, scaled", "s", [three_lambdas(g) / three_lambdas(equal) for g in grids]),
            ("free", "o-", ratios),
        ):
            x, y = zip(*sorted((p[1, 2], (p[0] / GOALS[count]).max()) for p in points))
            axes.plot(x, y, style, label=label)
        axes.axhspan(0, 1, 0, 1, color="tab:green", alpha=0.1)
        axes.axvspan(0, 1, color="tab:green", alpha=0.1)
        axes.set(xlim=(0.9, 1.6), ylim=(0.95, 1.4), title=f"{count} x {count}")
        axes.set(xlabel="mean PE at lambda² = 100, relative to rim-to-rim")
        axes.set(ylabel="worst figure at lambda² = 1000 / goal")
        axes.grid(alpha=0.3)
        axes.legend()
    figure.savefig(path, dpi=100)


def three_lambdas(layout):
    """(3, 3) mean HWHM, worst tenth and mean position error for every lambda^2."""
    return np.array(
        [
            figures(evaluate_layout(layout, regularization=each).metrics)[[0, 2, 3]]
            for each in LAMBDAS
        ]
    )


def grounding_table():
    print("\nfree-8x8, ground conditions (1 kHz switching)\n")
    header("conditions", "frames/s", "mean HWHM/mm", "worst tenth/mm", "mean PE/mm", "noise gain")
    for scan in scans(load_layout("free-8x8"), CONDITIONS):
        metrics = scan.quality.metrics
        row(
            len(scan.grounded),
            f"{1000 / len(scan.grounded):.1f}",
            f"{1e3 * metrics['hwhm']['mean']:.1f}",
            f"{1e3 * metrics['hwhm']['worst_tenth']:.1f}",
            f"{1e3 * metrics['position_error']['mean']:.1f}",
            f"{metrics['noise_gain']:.2e}",
        )


def times(free_too):
    layout = load_layout("equal-8x8")
    taken = []
    for _ in range(5):
        start = time.perf_counter()
        list(equalize(layout, 5))
        taken.append(time.perf_counter() - start)
    print(f"\nequalize 8 x 8, five updates: {statistics.median(taken):.2f} s", file=sys.stderr)
    if free_too:
        start = time.perf_counter()
        with processes(2) as executor:
            list(Request(start_layout(8, 8, SIZE), "free").steps_of(executor))
        print(f"free 8 x 8, two processes: {time.perf_counter() - start:.1f} s", file=sys.stderr)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = {
        "paper": paper_tables,
        "free": free_tables,
        "lattice": lattice_table,
        "front": front,
        "grounding": grounding_table,
    }
    parser.add_argument("--only", choices=[*parts, "times"])
    parser.add_argument("--plot", help="picture (.png) of the front")
    args = parser.parse_args()
    only = args.only
    for name, part in parts.items():
        if only in (None, name):
            part(args.plot) if part is front else part()
    if only in (None, "times"):
        times(free_too=True)


if __name__ == "__main__":
    main()
