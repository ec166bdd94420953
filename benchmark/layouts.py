"""Layouts compared: free layouts against grids, ground conditions, times.

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

from tomotactile_ros.evaluation.gram import Gram
from tomotactile_ros.evaluation.layout_quality import evaluate_layout
from tomotactile_ros.evaluation.metrics import quality, worst
from tomotactile_ros.evaluation.paper_model import default_contact_radius, paper_transfer
from tomotactile_ros.evaluation.profile_quality import evaluate_profile
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.optimizer.equalize import equalize
from tomotactile_ros.optimizer.grounding import scans
from tomotactile_ros.optimizer.options import start_layout
from tomotactile_ros.optimizer.request import Request
from tomotactile_ros.optimizer.workers import Workers
from tomotactile_ros.sheet import make_sheet

COUNTS = (4, 8)
SIZE = (0.2, 0.2)  # m
LAMBDAS = (1000.0, 100.0, 10000.0)
LABELS = [f"{label} {each:g}" for each in LAMBDAS for label in ("HWHM", "tenth", "PE")]
SCALES = np.linspace(0.7, 0.98, 15)
STATISTICS = "mean", "worst_tenth"
GOALS = {4: (0.73, 0.72, 0.74), 8: (0.81, 0.83, 0.70)}  # mean HWHM, worst tenth, mean PE
OTHER_GOALS = (0.95, 0.95, 1.0)  # the same for lambda^2 / 10 and * 10
LATTICE_COUNTS = (4, 8, 16)  # electrodes along a side; 16 without finite elements, which take long
LATTICES = (36, 38, 42, 44, 46, 48)  # contacts along a side; the goals are for 40
SHIFTS = np.random.default_rng(7).uniform(-0.5, 0.5, (3, 2))  # of contacts, in pixels
MODELS = ("paper", "paper's model"), ("fem", "FEM, shunting")
CONDITIONS = (64, 48, 32, 24, 16, 12, 8, 6, 4)


def row(*cells):
    print("| " + " | ".join(str(cell) for cell in cells) + " |")


def header(*cells):
    row(*cells)
    row(*("---" for _ in cells))


def scaled_grids(equal):
    """The equal grid, scaled so that the largest of its three figures, or their product, is
    smallest."""
    grids = [replace(equal, positions=equal.positions * scale) for scale in SCALES]
    start = on_lattice(equal, "paper", 40)
    ratios = np.array([on_lattice(grid, "paper", 40) / start for grid in grids])
    best = {int(np.argmin(ratios.max(axis=1))), int(np.argmin(ratios.prod(axis=1)))}
    return [(f"grid scaled by {SCALES[each]:.2f}", grids[each]) for each in sorted(best)]


def compared(count):
    """(name, layout) of all layouts of count x count electrodes."""
    equal = load_layout(f"equal-{count}x{count}")
    out = [("grid from rim to rim", equal), *scaled_grids(equal)]
    out.append(("paper's method", load_layout(f"optimized-{count}x{count}")))
    out.append(("free", load_layout(f"free-{count}x{count}")))
    if count == 4:
        out.append(("balanced", load_layout("balanced-4x4")))
    return out


def free_tables():
    for count in COUNTS:
        (_, equal), *layouts = compared(count)
        print(f"\n{count} x {count}, relative to the equal grid from rim to rim\n")
        header("layout", "model", *LABELS, "over goal")
        for model, label in MODELS:
            base = three_lambdas(equal, model)
            for name, layout in layouts:
                ratios = three_lambdas(layout, model) / base
                over = (ratios / [GOALS[count], OTHER_GOALS, OTHER_GOALS]).max() - 1
                cells = (f"{ratio:.3f}" for ratio in ratios.ravel())
                row(name, label, *cells, f"{100 * over:.0f} %")


def lattice_table():
    """What is left where the search did not look."""
    print("\nother contacts, relative to the equal grid: mean HWHM / worst tenth / mean PE\n")
    header("electrodes", "layout", "model", *(where for where, _, _ in PLACES))
    for count in LATTICE_COUNTS:
        equal = load_layout(f"equal-{count}x{count}")
        layouts = [*scaled_grids(equal), ("free", load_layout(f"free-{count}x{count}"))]
        for model, label in MODELS if count in COUNTS else MODELS[:1]:
            base = elsewhere(equal, model)
            for name, layout in layouts:
                found = zip(elsewhere(layout, model), base)
                cells = [np.mean(figures / start, axis=0) for figures, start in found]
                cells = (" / ".join(f"{ratio:.3f}" for ratio in cell) for cell in cells)
                row(f"{count} x {count}", name, label, *cells)


def elsewhere(layout, model):
    """For each of `PLACES` (n, 3) mean HWHM, worst tenth and mean position error."""
    return [np.array([measure(layout, model, p) for p in places]) for _, measure, places in PLACES]


def profile_table():
    """What a sensor's own images gain: frames with noise by finite elements, profile `fast`."""
    print("\nimages of the profile fast: discs of 3 to 8 mm radius, 1 mV of noise\n")
    header(
        "layout", "mean HWHM/mm", "worst tenth/mm", "mean PE/mm", "worst tenth of PE/mm",
        "ghosts", "missed", "place, median and p95/mm",
    )  # fmt: skip
    for count in COUNTS:
        for name, layout in compared(count):
            found = evaluate_profile(layout, "fast")
            keys = "hwhm", "position_error"
            values = [found.metrics[key][each] for key in keys for each in STATISTICS]
            contacts = found.contacts
            row(
                f"{count} x {count}, {name}",
                *(f"{1e3 * value:.2f}" for value in values),
                str(contacts["ghosts"] + contacts["doubled"]),
                f"{contacts['missed']} of {contacts['true']}",
                ", ".join(f"{1e3 * contacts['place'][key]:.2f}" for key in ("median", "p95")),
            )


def on_lattice(layout, model, count, regularization=LAMBDAS[0]):
    """(3,) mean HWHM, worst tenth and mean position error for count x count contacts and pixels.

    lambda^2, that of 40 x 40, is scaled to mean the same.
    """
    scaled = regularization * (count / 40) ** 2
    how = {"model": model, "resolution": count, "regularization": scaled}
    return three(evaluate_layout(layout, **how).quality)


def off_pixels(layout, model, shift):
    """The same for contacts that are `shift` (in pixels) away from the 40 x 40 pixels."""
    grid = Grid.for_outline(layout.outline, 40)
    contacts = grid.pixels + np.multiply(shift, grid.cell_size)
    points = np.concatenate([grid.pixels, contacts])
    radius = default_contact_radius(layout)
    if model == "paper":
        transfer = paper_transfer(layout, points, radius)
    else:
        transfer = make_sheet(layout, model).transfer(points, radius)
    products = Gram(transfer).rows(np.arange(len(points)))[:, : len(grid.pixels)]
    square, readings = np.split(products, 2)  # J'J, and J' times the readings of each contact
    square[np.diag_indices_from(square)] += LAMBDAS[0]
    return three(quality(np.linalg.solve(square, readings.T).T, contacts, grid))


def three(found):
    return np.array([found.hwhm.mean(), worst(found.hwhm), found.position_error.mean()])


PLACES = (  # contacts that the search does not know: it looks at 40 x 40 and at 43 x 43
    ("40 x 40", on_lattice, (40,)),
    ("36 to 48", on_lattice, LATTICES),
    ("60 x 60", on_lattice, (60,)),
    ("40 x 40, moved", off_pixels, SHIFTS),
)


def three_lambdas(layout, model="paper"):
    """(3, 3) mean HWHM, worst tenth and mean position error for every lambda^2."""
    return np.array([on_lattice(layout, model, 40, each) for each in LAMBDAS])


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


def times():
    layout = load_layout("equal-8x8")
    taken = []
    for _ in range(5):
        start = time.perf_counter()
        list(equalize(layout, 5))
        taken.append(time.perf_counter() - start)
    print(f"\nequalize 8 x 8, five updates: {statistics.median(taken):.2f} s", file=sys.stderr)
    start = time.perf_counter()
    with Workers(2) as executor:
        list(Request(start_layout(8, 8, SIZE), "free").steps_of(executor))
    print(f"free 8 x 8, two processes: {time.perf_counter() - start:.1f} s", file=sys.stderr)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parts = {
        "free": free_tables,
        "lattices": lattice_table,
        "profile": profile_table,
        "grounding": grounding_table,
        "times": times,
    }
    parser.add_argument("--only", choices=parts)
    only = parser.parse_args().only
    for name, part in parts.items():
        if only in (None, name):
            part()


if __name__ == "__main__":
    main()
