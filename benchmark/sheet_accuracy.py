"""Voltages of each sheet model against a finer model of the other kind, in mV of 3.3 V.

    python3 benchmark/sheet_accuracy.py [--contacts 20]

The closed form is scored on finite elements of side/160 with 32 nodes to an electrode, finite
elements on the closed form with 12 charges to an electrode and twice as many patches to a contact.
Contacts lie at seeded random places of an 8 x 8 sheet of 200 mm, 10 kohm/sq, electrodes of radius
2.5 mm.
"""

import argparse

import numpy as np

from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.sheet.closed_form import ClosedFormSheet
from tomotactile_ros.sheet.contact_points import contact_points
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.sheet.voltages import frame
from tomotactile_ros.simulation import patches_across

SIDE, DRIVE = 0.2, 3.3
CASES = (  # radius m, conductance S/m^2, words
    (0.005, 2.0, "disc 5 mm, 20 kPa"),
    (0.005, 20.0, "disc 5 mm, 200 kPa"),
    (0.015, 2.0, "disc 15 mm, 20 kPa"),
    (0.0025, np.inf, "bare disc 2.5 mm"),
    (0.001, np.inf, "bare disc 1 mm"),
)


def reading(sheet, contact, conductance, across):
    return frame(*contact_points(sheet, [(contact.patches(across), conductance)]), DRIVE)


def main():
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--contacts", type=int, default=20, help="places for each case")
    count = parser.parse_args().contacts
    layout = equal_grid(8, 8, (SIDE, SIDE), 0.0025, 1e4)
    fine_fem = FemSheet(layout, h=SIDE / 160, ring=32)
    fine_closed = ClosedFormSheet(layout, ring=12)
    models = {
        "closed form": (ClosedFormSheet(layout), fine_fem),
        "closed form, no shunting": (ClosedFormSheet(layout, shunting=False), fine_fem),
        "FEM, h = side/40": (FemSheet(layout, h=SIDE / 40), fine_closed),
        "FEM, h = side/80": (FemSheet(layout, h=SIDE / 80), fine_closed),
    }
    print("| contact | " + " | ".join(models) + " |")
    print("|---|" + "---|" * len(models))
    random = np.random.default_rng(0)
    for radius, conductance, words in CASES:
        errors = {name: [] for name in models}
        while len(errors["closed form"]) < count:
            centre = (random.random(2) - 0.5) * (SIDE - 2 * radius)
            gap = np.linalg.norm(layout.positions - centre, axis=1).min() - radius - layout.radius
            if conductance == np.inf and gap < 1e-3:
                continue  # on an electrode's rim a bare contact is a switch, not a sample
            contact = Contact("disc", center=centre, radius=radius)
            across = patches_across(contact, SIDE)
            exact = {
                id(model): reading(model, contact, conductance, 2 * across)
                for model in (fine_fem, fine_closed)
            }
            for name, (model, reference) in models.items():
                error = reading(model, contact, conductance, across) - exact[id(reference)]
                errors[name].append(1e3 * np.nanmax(np.abs(error)))
        cells = [f"{np.median(e):.1f} ({np.max(e):.1f})" for e in errors.values()]
        print(f"| {words} | " + " | ".join(cells) + " |")
    print("\nlargest error of a frame, mV: median (maximum) over", count, "places")


if __name__ == "__main__":
    main()
