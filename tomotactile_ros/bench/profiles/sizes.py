"""How the error of the force of single discs depends on their size, pressure and place."""

from __future__ import annotations

import numpy as np

from tomotactile_ros.bench.profiles.data import SHEETS, disc, places_of, simulate
from tomotactile_ros.bench.profiles.figures import Runner, matched

RADII = (0.002, 0.003, 0.004, 0.005, 0.006, 0.008, 0.010, 0.012, 0.015, 0.020)  # m
PRESSURES = (2e3, 10e3, 30e3, 100e3)  # Pa


def sizes(layout, pipelines, count, seed):
    """Prints median and 95th percentile of the force's error, %, for discs of all RADII; returns
    the same."""
    random = np.random.default_rng(seed)
    groups, kinds = [], []
    for radius in RADII:
        for pressure in PRESSURES:
            for _ in range(count):
                for kind, place in places_of(layout, radius, random).items():
                    groups.append([disc(place, pressure, radius)])
                    kinds.append((radius, pressure, kind))
    kinds, table = np.array(kinds, object), {}
    for sheet, variation in SHEETS.items():
        frames = simulate(layout, groups, variation)
        for profile, pipeline in pipelines.items():
            run = Runner(pipeline, np.arange(layout.electrodes))
            errors = [
                matched(run(frame).contacts, group)[1][0] for frame, group in zip(frames, groups)
            ]
            rows = size_rows(100 * np.array(errors), kinds)
            table[f"{sheet}, {profile}"] = rows
            head = "".join(f"{1e3 * radius:9.0f} mm" for radius in RADII)
            print(f"\nforce error, % (median / 95 %): {sheet}, {profile}\n{'':20}{head}")
            for name, row in rows.items():
                print(f"{name:20}" + "".join(f"{m:6.1f}/{p:5.0f}" for m, p in row))
    return table


def size_rows(errors, kinds):
    """Median and 95th percentile of `errors` (N,) for each radius, by pressure, kind of place and
    in all."""
    rows = {f"{pressure / 1e3:g} kPa": kinds[:, 1] == pressure for pressure in PRESSURES}
    rows |= {kind: kinds[:, 2] == kind for kind in dict.fromkeys(kinds[:, 2])}
    rows["all up to 30 kPa"] = kinds[:, 1] < 50e3
    return {
        name: [
            np.percentile(errors[those & (kinds[:, 0] == radius)], [50, 95]).tolist()
            for radius in RADII
        ]
        for name, those in rows.items()
    }
