"""What rows that contacts choose tell of them, against rows that were chosen for the whole sheet.

    scripts/setup python3 benchmark/scan_order.py [--layout L] [--rows 8]

The bound on the place error of one contact (`evaluation.posterior`; 1.6 N on a disc of 5 mm, 1 mV,
channels known) at places all over the sheet, mean and worst tenth: of all rows, of the best fixed
ones (`optimizer.scan`), of those that an adaptive frame of as many rows grounds
(`layouts.scan_order`), and of those that are best at each place, found one after another, repeated
ones among them: what a rule could reach at the most.
"""

from __future__ import annotations

import argparse
import os
import time

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from tomotactile_ros.bench.tables import markdown
from tomotactile_ros.evaluation.metrics import worst
from tomotactile_ros.evaluation.places import lattice
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.layouts.scan_order import AdaptiveOrder
from tomotactile_ros.optimizer.scan import Chooser


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--layout", default="equal-8x8")
    parser.add_argument("--rows", type=int, default=8)
    parser.add_argument("--places", type=int, default=6, help="along the longer side")
    args = parser.parse_args()
    layout = load_layout(args.layout)
    chooser = Chooser(layout, places=args.places)
    places, figures = lattice(layout, args.places), chooser.information.figures
    order = AdaptiveOrder(layout.positions, args.rows)
    adaptive, best = [], []
    for i, place in enumerate(places):
        adaptive.append(figures(order.frame(place[None]))[0][i])
        rows: list[int] = []
        while len(rows) < args.rows:
            costs = [figures([*rows, e])[0][i] for e in range(layout.electrodes)]
            rows.append(int(np.argmin(costs)))
        best.append(figures(rows)[0][i])
    begun = time.perf_counter()
    for _ in range(100):
        order.frame(places[:3])
    lasts = (time.perf_counter() - begun) / 100
    table = [
        (f"all {layout.electrodes}", figures(range(layout.electrodes))[0]),
        (f"best {args.rows} for the sheet", figures(chooser.best(args.rows))[0]),
        (f"{args.rows} of an adaptive frame", np.array(adaptive)),
        (f"best {args.rows} at each place", np.array(best)),
    ]
    cells = [[name, f"{1e6 * v.mean():.1f}", f"{1e6 * worst(v):.1f}"] for name, v in table]
    print("\n".join(markdown(["rows", "mean / µm", "worst tenth / µm"], cells)))
    print(f"{1e3 * lasts:.2f} ms for the order of a frame under three contacts")


if __name__ == "__main__":
    main()
