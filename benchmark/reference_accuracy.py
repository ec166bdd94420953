"""How well the reference model has converged, and how far the other two are from it, in mV of 3.3
V.

    scripts/setup python3 benchmark/reference_accuracy.py

Root mean square (and maximum) over the readings of a frame, 8 x 8 electrodes of radius 2.5 mm on
200 mm, 10 kohm/sq. The reference at its default against elements of half the size; closed form and
finite elements as the simulation has them against the latter.
"""

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")

import numpy as np

from tomotactile_ros.bench.reference import ReferenceSheet, reference_frame
from tomotactile_ros.bench.reference_mesh import default_size
from tomotactile_ros.bench.tables import markdown
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.sheet.closed_form import ClosedFormSheet
from tomotactile_ros.sheet.contact_points import contact_points
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.sheet.voltages import frame

DRIVE, SIDE = 3.3, 0.2


def disc(x, y, radius):
    return Contact("disc", center=(x, y), radius=radius)


CASES = {  # contact, conductance S/m^2
    "disc 4 mm, 5 kPa": (disc(0.0, 0.01, 0.004), 0.5),
    "disc 5 mm, 20 kPa": (disc(0.013, 0.021, 0.005), 2.0),
    "disc 5 mm, 400 kPa": (disc(0.013, 0.021, 0.005), 40.0),
    "disc 5 mm beside an electrode, 20 kPa": (disc(0.0193, 0.0143, 0.005), 2.0),
    "disc 8 mm over an electrode, 20 kPa": (disc(0.0143, 0.0153, 0.008), 2.0),
    "disc 12 mm over a corner, 20 kPa": (disc(0.095, 0.095, 0.012), 2.0),
    "line 100 x 5 mm, 20 kPa": (
        Contact("rectangle", center=(0.013, 0.021), size=(0.1, 0.005), angle=37.0),
        2.0,
    ),
    "disc 60 mm, 5 kPa": (disc(0.003, 0.001, 0.06), 0.5),
    "bare disc 5 mm": (disc(0.0, 0.0, 0.005), np.inf),
}


def main():
    layout = equal_grid(8, 8, (SIDE, SIDE), 0.0025, 1e4)
    h = default_size(layout)
    coarse, fine = ReferenceSheet(layout, h=h), ReferenceSheet(layout, h=h / 2)
    models = ClosedFormSheet(layout), FemSheet(layout, h=SIDE / 80)
    rows = []
    for words, (contact, g) in CASES.items():
        expected = reference_frame(fine.solve([(contact, g)]), DRIVE)
        found = [reference_frame(coarse.solve([(contact, g)]), DRIVE)]
        found += [frame(*contact_points(m, [(contact.patches(12), g)]), DRIVE) for m in models]
        rows.append((words, *(_error(each - expected) for each in found)))
    head = "contact", "reference", "closed form", "FEM, h = side/80"
    print("\n".join(markdown(head, rows)))


def _error(difference):
    squared = 1e6 * difference[~np.isnan(difference)] ** 2
    return f"{np.sqrt(squared.mean()):.2f} ({np.sqrt(squared.max()):.1f})"


if __name__ == "__main__":
    main()
