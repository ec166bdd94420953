"""Models of the sheet: how far their voltages are off, and what they cost.

    scripts/setup python3 benchmark/sheet.py [--parts accuracy reference speed]

accuracy   largest error of any reading of a frame, mV of 3.3 V, median (maximum) over 20 random places: the
           closed form against finite elements of side/160 with 32 nodes to an electrode, finite elements
           against the closed form with 12 charges to an electrode; twice as many patches to a contact
reference  errors of the readings of a frame, mV of 3.3 V, root mean square (maximum): the reference model
           against elements of half the size, the other two against these. Needs Gmsh and scikit-fem
speed      ms of transfer objects to 41 x 41 nodes, and of frames. All in turn: median, interquartile range,
           shortest
"""

from dataclasses import replace
from itertools import count

import numpy as np

from tomotactile_ros.bench import tables, timing
from tomotactile_ros.bench.peers import lattice
from tomotactile_ros.bench.program import options
from tomotactile_ros.bench.reference import ReferenceSheet, reference_frame
from tomotactile_ros.bench.reference_mesh import default_size
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.scenes.touches import Touch, Touches
from tomotactile_ros.sheet.closed_form import ClosedFormSheet
from tomotactile_ros.sheet.contact_points import contact_points
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.sheet.voltages import frame
from tomotactile_ros.simulation import Simulator, patches_across

SIDE, DRIVE, CELLS = 0.2, 3.3, 40
LAYOUT = equal_grid(8, 8, (SIDE, SIDE), 0.0025, 1e4)
ANYWHERE = {  # radius m, conductance S/m^2
    "disc 5 mm, 20 kPa": (0.005, 2.0),
    "disc 5 mm, 200 kPa": (0.005, 20.0),
    "disc 15 mm, 20 kPa": (0.015, 2.0),
    "bare disc 2.5 mm": (0.0025, np.inf),
}
PLACES = 20  # random ones
SPEEDS, WAY = (0.002, 0.01, 0.2, 1.0), 0.12  # m/s; s


def disc(x, y, radius, **more):
    return Contact("disc", center=(x, y), radius=radius, **more)


LINE = Contact("rectangle", center=(0.013, 0.021), size=(0.1, 0.005), angle=37.0)
PLACED = {  # contact, conductance S/m^2
    "disc 5 mm, 20 kPa": (disc(0.013, 0.021, 0.005), 2.0),
    "disc 5 mm, 400 kPa": (disc(0.013, 0.021, 0.005), 40.0),
    "disc 8 mm over an electrode, 20 kPa": (disc(0.0143, 0.0153, 0.008), 2.0),
    "disc 12 mm over a corner, 20 kPa": (disc(0.095, 0.095, 0.012), 2.0),
    "line 100 x 5 mm, 20 kPa": (LINE, 2.0),
    "bare disc 5 mm": (disc(0.0, 0.0, 0.005), np.inf),
}


def readings(sheet, contact, conductance, across):
    return frame(*contact_points(sheet, [(contact.patches(across), conductance)]), DRIVE)


def accuracy():
    fine_fem = FemSheet(LAYOUT, h=SIDE / 160, ring=32)
    fine_closed = ClosedFormSheet(LAYOUT, ring=12)
    models = {
        "closed form": (ClosedFormSheet(LAYOUT), fine_fem),
        "closed form, no shunting": (ClosedFormSheet(LAYOUT, shunting=False), fine_fem),
        "FEM, h = side/40": (FemSheet(LAYOUT, h=SIDE / 40), fine_closed),
        "FEM, h = side/80": (FemSheet(LAYOUT, h=SIDE / 80), fine_closed),
    }
    random, rows = np.random.default_rng(0), []
    for words, (radius, conductance) in ANYWHERE.items():
        errors = []
        while len(errors) < PLACES:
            centre = (random.random(2) - 0.5) * (SIDE - 2 * radius)
            gap = np.linalg.norm(LAYOUT.positions - centre, axis=1).min() - radius - LAYOUT.radius
            if conductance == np.inf and gap < 1e-3:
                continue  # on an electrode's rim a bare contact is a switch, not a sample
            contact = disc(*centre, radius)
            across = patches_across(contact, SIDE)
            exact = {
                fine: readings(fine, contact, conductance, 2 * across)
                for fine in (fine_fem, fine_closed)
            }
            off = (readings(m, contact, conductance, across) - exact[f] for m, f in models.values())
            errors.append([1e3 * np.nanmax(np.abs(each)) for each in off])
        cells = zip(np.median(errors, axis=0), np.max(errors, axis=0))
        rows.append((words, *(f"{median:.1f} ({most:.1f})" for median, most in cells)))
    return ("contact", *models), rows


def reference():
    h = default_size(LAYOUT)
    coarse, fine = ReferenceSheet(LAYOUT, h=h), ReferenceSheet(LAYOUT, h=h / 2)
    models, rows = (ClosedFormSheet(LAYOUT), FemSheet(LAYOUT, h=SIDE / 80)), []
    for words, (contact, conductance) in PLACED.items():
        expected, *found = (
            reference_frame(sheet.solve([(contact, conductance)]), DRIVE)
            for sheet in (fine, coarse)
        )
        found += [readings(model, contact, conductance, 12) for model in models]
        errors = (1e3 * np.abs(each - expected) for each in found)
        cells = ((np.sqrt(np.nanmean(each**2)), np.nanmax(each)) for each in errors)
        rows.append((words, *("{:.2f} ({:.1f})".format(*each) for each in cells)))
    return ("contact", "reference", "closed form", "FEM, h = side/80"), rows


def speed():
    nodes, size, scene = lattice(LAYOUT, CELLS)[0], SIDE / CELLS, load_scene("default")
    calls = {
        "transfer object, finite elements": lambda: FemSheet(LAYOUT, h=size).transfer(
            nodes, size / 4
        ),
        "transfer object, closed form": lambda: ClosedFormSheet(LAYOUT).transfer(nodes, size / 4),
    }
    at_rest = [
        disc(*place, 0.005, pressure=2e4)
        for place in ((-0.071, 0.048), (0.069, -0.052), (0.012, 0.017))
    ]
    calls["three contacts at rest"] = _frames(scene, at_rest)
    for velocity in SPEEDS:
        words = f"two contacts at {1e3 * velocity:g} mm/s, each row at its time"
        calls[words] = _frames(scene, _two(velocity))
    calls["two live touches, each frame anywhere"] = _live()
    times = timing.in_turn({name: [call] for name, call in calls.items()}, seconds=20, turn=0.05)
    rows = []
    for name, seconds in times.items():
        summary = timing.summary(seconds)
        figures = summary["median"], summary["spread"], timing.undisturbed(seconds)
        rows.append((name, *(f"{1e3 * each:.3g}" for each in figures)))
    return ("8 x 8 electrodes, 41 x 41 nodes", "ms", "spread ms", "shortest ms"), rows


def _frames(scene, contacts):
    """Makes one frame after the other, again and again."""
    simulator, clock = Simulator(LAYOUT, replace(scene, contacts=tuple(contacts))), count()
    return lambda: simulator.frame(0.064 * (number := next(clock)) % WAY, number)


def _two(velocity):
    """Discs that stay on the sheet for `WAY` s at the highest of `SPEEDS`."""
    larger = disc(-0.07, 0.05, 0.008, pressure=2e4, velocity=(velocity, -velocity / 5))
    return larger, disc(0.07, -0.05, 0.005, pressure=2e4, velocity=(-velocity, velocity / 5))


def _live():
    """Makes a frame of two live touches, which are anywhere and new in every frame."""
    simulator, clock = Simulator(LAYOUT, load_scene("live")), count()
    simulator.live = Touches(LAYOUT)

    def call():
        number = next(clock)
        places = np.random.default_rng(number).uniform(-0.09, 0.09, (2, 2)).tolist()
        simulator.live.press([Touch(*place, 2.0, 0.006) for place in places], 0.064 * number)
        return simulator.frame(0.064 * number, number)

    return call


PARTS = {"accuracy": accuracy, "reference": reference, "speed": speed}


def main():
    args = options(__doc__, parts=(list(PARTS), None, PARTS))
    for name in args.parts:
        print("\n".join([*tables.markdown(*PARTS[name]()), ""]), flush=True)


if __name__ == "__main__":
    main()
