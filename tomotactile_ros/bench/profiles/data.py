"""Frames for the profiles in depth: groups of contacts, each in one frame, by finite elements."""

from __future__ import annotations

import numpy as np

from tomotactile_ros.bench.trials import BITS, DRIVE, LAW, NOISE
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.defects import Adc, Defects, Noise, SheetVariation
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import Simulator

APART = (0.020, 0.024, 0.028, 0.032, 0.036, 0.040, 0.045, 0.050, 0.060)  # m
SHEETS = {"uniform": None, "10 % variation": SheetVariation(0.1, 0.05, 3)}
_INSIDE = 0.095  # m, centres of contacts on the sheet of 200 mm


def collect(layout, variation, count, pairs, seed):
    """Groups of contacts and their frames by name: `count` singles, `pairs` at each distance of
    APART and two of different strength, one contact many times, wide shapes."""
    random = np.random.default_rng(seed)
    singles = [[disc(p)] for p in random.uniform(-_INSIDE, _INSIDE, (count, 2))]
    data = {"singles": (singles, simulate(layout, singles, variation))}
    for distance in APART:
        groups = pairs_at(distance, pairs, random)
        data[distance] = groups, simulate(layout, groups, variation)
    groups = pairs_at((0.05, 0.12), pairs, random, (10e3, 30e3))
    data["two"] = groups, simulate(layout, groups, variation)
    repeats = [[disc((0.013, -0.021))]] * 40
    data["repeats"] = repeats, simulate(layout, repeats, variation)
    shapes = outline_shapes()
    frames = simulate(layout, list(shapes.values()), variation)
    data["shapes"] = {name: (group, frame) for (name, group), frame in zip(shapes.items(), frames)}
    return data


def simulate(layout, groups, variation):
    """(N, E, E) frames of N groups of contacts."""
    contacts = []
    for i, group in enumerate(groups):
        for shape in group:
            contacts.append(Contact(**shape, start=float(i), end=float(i + 1)))
    defects = Defects(sheet_variation=variation)
    scene = Scene("benchmark", DRIVE, contacts, LAW, Noise(NOISE), Adc(BITS, DRIVE), defects)
    simulator = Simulator(layout, scene)
    return np.array([simulator.frame(i + 0.5, i) for i in range(len(groups))])


def disc(position, pressure=20e3, radius=0.005):
    """The arguments of `Contact` for a disc."""
    return {"shape": "disc", "center": tuple(position), "radius": radius, "pressure": pressure}


def pairs_at(distance, count, random, pressures=(20e3, 20e3)):
    """`count` pairs of discs, centres `distance` (m, or a range) apart, all on the sheet."""
    pairs = []
    while len(pairs) < count:
        middle, turn = random.uniform(-_INSIDE, _INSIDE, 2), random.uniform(0, np.pi)
        length = random.uniform(*distance) if np.ndim(distance) else distance
        half = length / 2 * np.array([np.cos(turn), np.sin(turn)])
        if (np.abs([middle - half, middle + half]) <= _INSIDE).all():
            pairs.append([disc(middle - half, pressures[0]), disc(middle + half, pressures[1])])
    return pairs


def outline_shapes():
    """Wide, L-shaped and ring contacts as groups; the ring is cut open by 2 degrees."""
    turn = np.radians(np.linspace(1, 359, 90))
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    ring = np.concatenate([0.06 * circle, 0.04 * circle[::-1]])
    ell = [
        (-0.06, -0.06),
        (0.05, -0.06),
        (0.05, -0.03),
        (-0.03, -0.03),
        (-0.03, 0.05),
        (-0.06, 0.05),
    ]
    wide = {"shape": "rectangle", "center": (0.01, 0.005), "size": (0.08, 0.05), "pressure": 10e3}
    return {
        "wide": [wide],
        "L": [{"shape": "polygon", "points": np.array(ell), "pressure": 10e3}],
        "ring": [{"shape": "polygon", "points": ring, "pressure": 10e3}],
    }


def moving(layout, count=16, step=0.0005):
    """Frames (N, E, E) of contacts that move by `step` (m) from frame to frame."""
    shift = step * np.arange(count)
    pairs = [[disc((-0.05 + s, 0.02)), disc((0.04, s - 0.03))] for s in shift]
    wide = {"shape": "rectangle", "size": (0.08, 0.05), "pressure": 10e3}
    groups = {
        "two discs of 5 mm": pairs,
        "disc of 15 mm": [[disc((s - 0.03, 0.02), radius=0.015)] for s in shift],
        "80 mm x 50 mm": [[wide | {"center": (s - 0.01, 0.005)}] for s in shift],
    }
    return {name: simulate(layout, group, None) for name, group in groups.items()}


def places_of(layout, radius, random):
    """Places of a disc of `radius` (m): on an electrode, between two, amid four, at the rim,
    anywhere."""
    half = np.array(layout.outline.size) / 2 - radius
    side = round(layout.electrodes**0.5)
    pitch = (layout.positions.max(axis=0) - layout.positions.min(axis=0)) / (side - 1)
    corner = layout.positions.min(axis=0) + pitch * random.integers(1, side - 2, 2)
    jitter = random.uniform(-0.1, 0.1, 2)
    rim = random.uniform(-half, half)
    rim[random.integers(2)] = 1.0
    return {
        "on an electrode": corner + pitch * jitter,
        "between two": corner + pitch * (jitter + [0.5, 0.0]),
        "amid four": corner + pitch * (jitter + [0.5, 0.5]),
        "at the rim": np.where(rim == 1.0, half - random.uniform(0, 0.004), rim),
        "anywhere": random.uniform(-half, half),
    }
