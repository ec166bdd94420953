"""How well the force of contacts is known that conduct so well that the sheet hardly sees how well.

A contact of conductance g on a sheet of R_s ohm/sq draws its current through the sheet around it: by
itself it adds 1/g to about R_s / 2 pi. The table goes through radii and g R_s / 2 pi, single contacts at
random places, and shows by what the reported forces are off, what the reports say that they may be off
by, and how many true forces lie within two of these standard deviations. `inf` : a bare conductor as far
as readings tell; its force is a lower bound, and counts as held where it is one.

    scripts/setup python3 benchmark/nearly_bare.py [--count 8] [--rims]

Frames are made by finite elements, the reconstruction uses closed forms. With --rims: places of bare conductors
on and beside electrodes, against the reference model, whose elements are bent along both rims.
"""

from itertools import product

import numpy as np

from tomotactile_ros.bench.cases import DEFAULT_LAYOUT
from tomotactile_ros.bench.program import options, spread
from tomotactile_ros.bench.reference import ReferenceSheet, reference_frame
from tomotactile_ros.bench.reference_mesh import disc
from tomotactile_ros.bench.tables import Table
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE, make_pipeline, make_scene
from tomotactile_ros.evaluation.scoring import score_frame
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.simulation import Simulator

RADII = 0.16, 0.32, 0.6, 1.2, 1.8  # spacings
STRENGTHS = 0.3, 1.0, 2.0, 4.0, 8.0, 16.0  # g R_s / 2 pi
DISCS = 0.003, 0.008  # m: radii of bare conductors, from and to
BARE = 1e4  # S/m2
# gaps between the rims of conductor and electrode, radii of the electrode
GAPS = {"covers it": (-np.inf, -2), "rims cross": (-2, 0), "beside it": (0, 1)}


def rims(layout: Layout, count: int) -> None:
    """How far off places are, and how many lie in their ellipses of 95 %."""
    found: dict[str, list[tuple[float, bool]]] = {name: [] for name in GAPS}
    sheet, draw, other = ReferenceSheet(layout), np.random.default_rng(1), 0
    while min(len(each) for each in found.values()) < count:
        electrode, radius = draw.choice(layout.positions), draw.uniform(*DISCS)
        away, turn = draw.uniform(0, radius + 2 * layout.radius), draw.uniform(0, 2 * np.pi)
        at = electrode + away * np.array([np.cos(turn), np.sin(turn)])
        gap = (away - radius) / layout.radius - 1
        (case,) = [name for name, (least, most) in GAPS.items() if least <= gap <= most]
        if not layout.outline.holds(at[None], radius)[0] or len(found[case]) == count:
            continue
        frame = reference_frame(sheet.solve([(disc(at, radius), BARE)]), DRIVE)
        frame += draw.normal(0, NOISE, frame.shape)
        contacts = make_pipeline(layout).process(frame, layout.grounded, DRIVE).contacts
        if len(contacts) != 1:
            other += 1
            continue
        score = score_frame(contacts, [{"x": at[0], "y": at[1], "force": None}], reach=np.inf)
        found[case].append((1e3 * score.place[0], score.place_covered[0]))
    table = Table("", "off by mm: median", "worst", "within 95 %")
    for name, cases in found.items():
        off, within = np.array(cases).T
        table.add(name, *spread(off, 2, (0.5, 1)).split(" / "), f"{within.sum():.0f}/{len(off)}")
    print(f"not one contact: {other}")


def strengths(layout: Layout, count: int) -> None:
    """How far off forces are, and by how much they may be as they say."""
    pitch, half = float(np.median(layout.pitches)), np.array(layout.outline.size) / 2
    pipeline, draw = make_pipeline(layout), np.random.default_rng(1)
    table = Table(
        *("radius mm", "g R_s/2 pi", "off by %: median", "worst"),
        *("said %: median", "inf", "held", "other count"),
    )
    for radius, strength in product(pitch * np.array(RADII), STRENGTHS):
        area = np.pi * radius**2
        pressure = float(LAW.pressure(strength * 2 * np.pi / layout.sheet_resistance / area))
        off, said, held = [], [], 0
        for _ in range(count):
            centre = tuple(draw.uniform(radius - half, half - radius))
            contact = Contact("disc", center=centre, radius=float(radius), pressure=pressure)
            frame = Simulator(layout, make_scene([contact], 0), model="fem").frame(0.0, 0)
            found = pipeline.process(frame, layout.grounded, DRIVE).contacts
            if len(found) != 1:
                continue
            error = found[0].force / (pressure * area) - 1
            deviation = found[0].force_std / found[0].force
            held += abs(error) < 2 * deviation if np.isfinite(deviation) else error < 0.05
            off.append(100 * abs(error))
            said.append(100 * deviation)
        table.add(
            *(f"{1e3 * radius:.1f}", f"{strength:.1f}", f"{np.median(off):.1f}", f"{max(off):.1f}"),
            *(f"{np.median(said):.1f}", f"{np.isinf(said).sum()}", f"{held}/{len(off)}"),
            f"{count - len(off)}",
        )


def main() -> None:
    given = options(
        __doc__,
        count=(8, "contacts in a row of the table"),
        rims=(False, "bare conductors at electrodes instead"),
    )
    measure = rims if given.rims else strengths
    measure(load_layout(DEFAULT_LAYOUT), given.count)


if __name__ == "__main__":
    main()
