"""What the electrodes see of the benchmark's presses, by the reference model, kept in a file.

`benchmark/data/sensor.npz` holds for each set of presses the packed admittances (N, E (E + 1) / 2) in
single precision (`reference.Admittance`) and the presses as JSON. Made again by
`scripts/setup python3 benchmark/reference_data.py` (a quarter of an hour).
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np

import tomotactile_ros
from tomotactile_ros.bench.reference import Admittance, Conductance, ReferenceSheet
from tomotactile_ros.bench.sensor import odd_layouts
from tomotactile_ros.bench.sensor.presses import (
    Group,
    conductance,
    crowds,
    pairs,
    singles,
    truth,
)
from tomotactile_ros.defects import SheetVariation
from tomotactile_ros.errors import InputError
from tomotactile_ros.layout import Layout
from tomotactile_ros.simulation import random_sheet

COUNT = 24  # presses of a set
_BESIDE = 12  # pairs, and the first of each alone
_LENGTH, _SEED = 0.05, 3  # of the random field, m
_RING_REACH = 0.6  # of the radius, to which contacts lie on the ring's sheet
_FILE = "benchmark/data/sensor.npz"


@dataclass(frozen=True)
class Kind:
    """A set of presses: on which layout and sheet, and which.

    `conductance(layout)` gives the sheet's as a function of points, None: uniform
    """

    layout: Callable[[], Layout]
    presses: Callable[[Layout], list[Group]]
    conductance: Callable[[Layout], Conductance] | None = None


@dataclass(frozen=True, eq=False)
class States:
    """N presses on `layout`: what the electrodes see, and what is true (`evaluation.scoring`)."""

    layout: Layout
    seen: list[Admittance]
    truths: list[list[dict]]

    def part(self, step: int) -> States:
        """Every `step`-th press."""
        return States(self.layout, self.seen[::step], self.truths[::step])


def field(relative: float) -> Callable[[Layout], Conductance]:
    """Log-normal sheet resistance with a correlation length of 50 mm."""

    def on(layout):
        resistance = random_sheet(SheetVariation(relative, _LENGTH, _SEED), layout.sheet_resistance)
        return lambda points: 1 / resistance(points)

    return on


def gradient(part: float) -> Callable[[Layout], Conductance]:
    """Sheet resistance that grows along x by `part` of its mean from the middle to the rim."""

    def on(layout):
        half = layout.outline.size[0] / 2
        return lambda points: 1 / (layout.sheet_resistance * (1 + part * points[:, 0] / half))

    return on


def anisotropic(
    ratio: float, field: Callable[[Layout], Conductance] | None = None
) -> Callable[[Layout], Conductance]:
    """Conducts `ratio` times as well along x as along y, with the same geometric mean."""
    tensor = np.diag([ratio**0.5, ratio**-0.5])

    def on(layout):
        if field is None:
            return lambda points: np.tile(tensor / layout.sheet_resistance, (len(points), 1, 1))
        scalar = field(layout)
        return lambda points: scalar(points)[:, None, None] * tensor

    return on


def _alone(layout):
    return singles(layout, COUNT, seed=21)


def _with_first(layout):
    """The first of each pair alone, then the pairs."""
    groups = pairs(layout, _BESIDE, seed=22)
    return [group[:1] for group in groups] + groups


KINDS = {
    "even": Kind(odd_layouts.grid, _alone),
    "beside": Kind(odd_layouts.grid, _with_first),
    "crowd": Kind(odd_layouts.grid, lambda layout: crowds(layout, COUNT, seed=23)),
    "field 10 %": Kind(odd_layouts.grid, _alone, field(0.1)),
    "field 20 %": Kind(odd_layouts.grid, _alone, field(0.2)),
    "gradient 20 %": Kind(odd_layouts.grid, _alone, gradient(0.2)),
    "anisotropy 1.5:1": Kind(odd_layouts.grid, _alone, anisotropic(1.5)),
    "worn": Kind(odd_layouts.grid, _alone, anisotropic(1.3, field(0.2))),
    "void": Kind(odd_layouts.void, _alone),
    "ring": Kind(odd_layouts.ring, lambda layout: singles(layout, COUNT, 24, _RING_REACH)),
    "random": Kind(odd_layouts.random_places, _alone),
    "ell": Kind(odd_layouts.ell, lambda layout: singles(layout, COUNT, seed=25)),
}


def solve(kind: Kind, track: Callable[[Iterable], Iterable] = iter) -> States:
    """Solve all presses of a set; about 3 s each. `track` wraps them, to show progress."""
    layout = kind.layout()
    sheet = ReferenceSheet(layout, kind.conductance and kind.conductance(layout))
    groups = kind.presses(layout)
    seen = [sheet.solve([(disc, conductance(disc)) for disc in group]) for group in track(groups)]
    return States(layout, seen, [truth(group) for group in groups])


def save(path: str | Path, sets: dict[str, States]) -> None:
    """Write the sets by their names."""
    arrays = {}
    for name, states in sets.items():
        arrays[f"{name}: seen"] = np.array([each.packed for each in states.seen], np.float32)
        arrays[f"{name}: truth"] = json.dumps(states.truths)
    np.savez_compressed(path, **arrays)


def load(name: str, path: str | Path | None = None) -> States:
    """A set by its name; InputError where the file is not there, or made for another layout."""
    path = find() if path is None else Path(path)
    layout = KINDS[name].layout()
    content = _content(path)
    seen, text = content.get(f"{name}: seen"), content.get(f"{name}: truth")
    if seen is None or seen.shape[1] != layout.electrodes * (layout.electrodes + 1) // 2:
        raise InputError(f"{path}: holds no '{name}' for the layout {layout.name}; {_AGAIN}")
    return States(layout, [Admittance.unpack(each) for each in seen], json.loads(str(text)))


def find() -> Path:
    """The file of the repository."""
    for folder in Path(tomotactile_ros.__path__[0]).resolve().parents:
        if (folder / _FILE).is_file():
            return folder / _FILE
    raise InputError(f"{_FILE}: is not there; the benchmark of the sensor runs in the repository")


_AGAIN = "benchmark/reference_data.py makes it again"


@cache
def _content(path):
    with np.load(path, allow_pickle=False) as file:
        return {key: file[key] for key in file.files}
