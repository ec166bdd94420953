"""How well the force of contacts is known that conduct so well that the sheet hardly sees how well.

A contact of conductance g on a sheet of R_s ohm/sq draws its current through the sheet around it: by
itself it adds 1/g to about R_s / 2 pi. The table goes through radii and g R_s / 2 pi, single contacts at
random places, and shows by what the reported forces are off, what the reports say that they may be off
by, and how many true forces lie within two of these standard deviations. `inf` : a bare conductor as far
as readings tell; its force is a lower bound, and counts as held where it is one.

    scripts/setup python3 benchmark/nearly_bare.py [--layout equal-8x8] [--count 8] [--profile accurate] [--rims]

Frames are made by finite elements, the reconstruction uses closed forms. With --rims: places of bare conductors
on and beside electrodes, against the reference model, whose elements are bent along both rims.
"""

import argparse

import numpy as np

from tomotactile_ros.bench.reference import ReferenceSheet, reference_frame
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE, make_pipeline, make_scene
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.simulation import Simulator

RADII = 0.16, 0.32, 0.6, 1.2, 1.8  # spacings
STRENGTHS = 0.3, 1.0, 2.0, 4.0, 8.0, 16.0  # g R_s / 2 pi
DISCS = 0.003, 0.008  # m: radii of bare conductors, from and to
BARE = 1e4  # S/m2
# gaps between the rims of conductor and electrode, radii of the electrode
GAPS = {"covers it": (-np.inf, -2), "rims cross": (-2, 0), "beside it": (0, 1)}


def rims(layout: Layout, count: int, profile: str) -> None:
    """Print how far off places are, and how many lie in their ellipses of 95 %."""
    found: dict[str, list[tuple[float, bool]]] = {name: [] for name in GAPS}
    sheet, draw, other = ReferenceSheet(layout), np.random.default_rng(1), 0
    while min(len(each) for each in found.values()) < count:
        electrode, radius = draw.choice(layout.positions), draw.uniform(*DISCS)
        away, turn = draw.uniform(0, radius + 2 * layout.radius), draw.uniform(0, 2 * np.pi)
        at = electrode + away * np.array([np.cos(turn), np.sin(turn)])
        gap = (away - radius) / layout.radius - 1
        (case,) = [name for name, (least, most) in GAPS.items() if least <= gap <= most]
        outline = layout.outline
        whole = outline.contains(at[None])[0] and outline.rim_distance(at[None])[0] > radius
        if not whole or len(found[case]) == count:
            continue
        disc = Contact("disc", center=tuple(at), radius=radius)
        frame = reference_frame(sheet.solve([(disc, BARE)]), DRIVE)
        frame += draw.normal(0, NOISE, frame.shape)
        contacts = make_pipeline(layout, profile).process(frame, layout.grounded, DRIVE).contacts
        if len(contacts) != 1:
            other += 1
            continue
        way = np.array([contacts[0].x, contacts[0].y]) - at
        spread = np.reshape(contacts[0].position_covariance, (2, 2))
        found[case].append((1e3 * np.hypot(*way), way @ np.linalg.solve(spread, way) < 5.99))
    print("             off by mm: median  worst  within 95 %")
    for name, cases in found.items():
        off, within = np.array(cases).T
        print(f"{name:12s} {np.median(off):17.2f}  {off.max():5.2f}  {within.sum():.0f}/{len(off)}")
    print(f"not one contact: {other}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--layout", default="equal-8x8")
    parser.add_argument("--count", type=int, default=8, help="contacts in a row of the table")
    parser.add_argument("--profile", default="accurate")
    parser.add_argument("--rims", action="store_true", help="bare conductors at electrodes instead")
    given = parser.parse_args()
    layout = load_layout(given.layout)
    if given.rims:
        rims(layout, given.count, given.profile)
        return
    pitch, half = float(np.median(layout.pitches)), np.array(layout.outline.size) / 2
    pipeline, draw = make_pipeline(layout, given.profile), np.random.default_rng(1)
    print("radius mm  g R_s/2 pi  off by %: median  worst  said %: median  inf  held  other count")
    for radius in pitch * np.array(RADII):
        area = np.pi * radius**2
        for strength in STRENGTHS:
            pressure = float(LAW.pressure(strength * 2 * np.pi / layout.sheet_resistance / area))
            off, said, held, others = [], [], 0, 0
            for _ in range(given.count):
                centre = tuple(draw.uniform(radius - half, half - radius))
                contact = Contact("disc", center=centre, radius=float(radius), pressure=pressure)
                frame = Simulator(layout, make_scene([contact], 0), model="fem").frame(0.0, 0)
                found = pipeline.process(frame, layout.grounded, DRIVE).contacts
                if len(found) != 1:
                    others += 1
                    continue
                error = found[0].force / (pressure * area) - 1
                deviation = found[0].force_std / found[0].force
                bare = not np.isfinite(deviation)
                held += error < 0.05 if bare else abs(error) < 2 * deviation
                off.append(100 * abs(error))
                said.append(100 * deviation)
            print(
                f"{1e3 * radius:9.1f}  {strength:10.1f}  {np.median(off):16.1f}  {max(off):5.1f}"
                f"  {np.median(said):14.1f}  {np.isinf(said).sum():3d}  {held}/{len(off)}  {others}",
                flush=True,
            )


if __name__ == "__main__":
    main()
