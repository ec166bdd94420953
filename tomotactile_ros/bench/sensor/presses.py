"""Random presses with a seed: discs on a sheet, alone, in pairs that keep apart, in crowds."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tomotactile_ros.bench.trials import LAW
from tomotactile_ros.contact import Contact
from tomotactile_ros.layout import Layout

RADII = 0.004, 0.008  # m, from and to
PRESSURES = 10e3, 30e3  # Pa
APART = 0.03  # m between centres, about the pitch of 8 x 8 on 200 mm
STRONGEST = 10.0  # of a crowd, times the force of the weakest
_CROWD = 3, 4, 5, 6  # contacts
_TRIES = 10000

Group = list[Contact]


def singles(layout: Layout, count: int, seed: int, reach: float = 1.0) -> list[Group]:
    """`count` presses of one disc, wholly on the sheet, centres within `reach` of its size."""
    random = np.random.default_rng(seed)
    return [[_disc(layout, [], random, reach)] for _ in range(count)]


def pairs(layout: Layout, count: int, seed: int) -> list[Group]:
    """`count` presses of two discs that are `APART` or more."""
    random = np.random.default_rng(seed)
    return [_several(layout, 2, random) for _ in range(count)]


def crowds(layout: Layout, count: int, seed: int) -> list[Group]:
    """`count` presses of 3, 4, 5 and 6 discs in turn, the strongest with ten times the force of the
    weakest, those between evenly by ratio."""
    random = np.random.default_rng(seed)
    out = []
    for i in range(count):
        group = sorted(_several(layout, _CROWD[i % len(_CROWD)], random), key=force)
        steps = STRONGEST ** np.linspace(-1, 0, len(group))
        forces = steps * force(group[-1])
        out.append([_with_force(disc, each) for disc, each in zip(group, forces, strict=True)])
    return out


def force(disc: Contact) -> float:
    """N."""
    return disc.pressure * np.pi * disc.radius**2


def truth(group: Sequence[Contact]) -> list[dict]:
    """True contacts for `evaluation.scoring`."""
    return [
        {"x": float(c.center[0]), "y": float(c.center[1]), "force": float(force(c))} for c in group
    ]


def conductance(disc: Contact) -> float:
    """S/m²."""
    return float(LAW.conductance(disc.pressure))


def _several(layout, count, random):
    group: Group = []
    while len(group) < count:
        group.append(_disc(layout, group, random, 1.0))
    return group


def _disc(layout, others, random, reach):
    low, size = np.array(layout.outline.bounds[:2]), np.array(layout.outline.size)
    radius, pressure = random.uniform(*RADII), random.uniform(*PRESSURES)
    for _ in range(_TRIES):
        point = low + size * random.random(2)
        inside = layout.outline.contains(point[None])[0]
        fits = inside and layout.outline.rim_distance(point[None])[0] > radius
        near = np.linalg.norm(point) <= reach * size.max() / 2 if reach < 1 else True
        apart = all(np.linalg.norm(point - other.center) >= APART for other in others)
        if fits and near and apart:
            return Contact("disc", center=point, radius=radius, pressure=pressure)
    raise RuntimeError(f"no room for another contact on {layout.name}")


def _with_force(disc, wanted):
    pressure = wanted / (np.pi * disc.radius**2)
    return Contact("disc", center=disc.center, radius=disc.radius, pressure=pressure)
