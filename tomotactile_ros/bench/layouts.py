"""Layouts compared by what they are for: contacts that the profiles report on frames of the
reference model.

All layouts of an outline get the same contacts on the same sheets (`touches`): single discs on an
even sheet and on sheets that are uneven by 10 %, and pairs of discs at several distances. No
optimizer knows these places, and the reference model shares nothing with the model that
optimizers use.

place  distance of the strongest reported contact from the true one, m; where nothing is reported
       as far as the middle of the sheet
force  relative error of that contact's force, the contact law being known; 1 where nothing is
       reported
pairs  part of the pairs told apart: exactly two contacts, each nearer to its own than to the
       middle between them
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from tomotactile_ros.bench.accuracy import distances, force_errors, told_apart
from tomotactile_ros.bench.reference_cases import Family, Sheet, pair_states, textbook_states
from tomotactile_ros.bench.reference_data import ReferenceData, load, make, save
from tomotactile_ros.bench.sensor.readings import potentials, readings, untouched
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.sheet_field import SheetVariation

PROFILES = ("fast", "balanced", "accurate")
EVEN, UNEVEN = "even", "random 10 %"
_RELATIVE, _LENGTH = 0.1, 0.05  # of uneven sheets; m
_SHEETS = 4  # uneven ones
_ELEMENTS = 35  # of the reference model along the longer side: 0.15 mV off, noise is 1 mV
_SEED = 170
_ENOUGH = 0.8  # of the pairs that have to be told apart


@dataclass(frozen=True)
class Amount:
    """How much is measured: single contacts on each kind of sheet; pairs, for each of `apart`, m."""

    singles: int = 60
    pairs: int = 16
    apart: tuple[float, ...] = (0.016, 0.02, 0.024, 0.028, 0.034, 0.04, 0.05, 0.06)


def touches(layout: Layout, amount: Amount) -> Family:
    """The states of the sheet that are measured; they depend on the outline alone."""
    sheets = [Sheet(EVEN)]
    sheets += [
        Sheet(UNEVEN, variation=SheetVariation(_RELATIVE, _LENGTH, _SEED + i))
        for i in range(_SHEETS)
    ]
    random = np.random.default_rng(_SEED)
    states = textbook_states(layout, random, amount.singles, EVEN)
    for i, press in enumerate(textbook_states(layout, random, amount.singles, UNEVEN)):
        states.append(replace(press, sheet=1 + i % _SHEETS))
    random = np.random.default_rng(_SEED + 1)
    states += pair_states(layout, random, amount.apart, amount.pairs)
    return Family(layout.name, layout, states, sheets)


def reference(layout: Layout, amount: Amount, folder: Path | None = None) -> ReferenceData:
    """What electrodes see of `touches`; kept in `folder`, and read from there where it is."""
    h = max(layout.outline.size) / _ELEMENTS
    if folder is None:
        return make(touches(layout, amount), h)
    counts = f"{amount.singles}-{amount.pairs}-{len(amount.apart)}"
    path = folder / f"{layout.id.replace('#', '-')}-{counts}.npz"
    if not path.exists():
        folder.mkdir(parents=True, exist_ok=True)
        save(make(touches(layout, amount), h), path)
    return load(path)


@dataclass(frozen=True, eq=False)
class Measured:
    """What one profile reports.

    place, force : by kind of sheet the distances (N,), m, and relative errors of force (N,)
    apart (S,), m, and told (S,) the part of pairs at that distance that are told apart
    """

    layout: Layout
    profile: str
    place: dict[str, np.ndarray]
    force: dict[str, np.ndarray]
    apart: np.ndarray
    told: np.ndarray

    @property
    def closest(self) -> float:
        """Distance, m, from which on 80 % of the pairs are told apart, between those measured;
        infinite if never."""
        few = np.flatnonzero(self.told < _ENOUGH)
        if not len(self.told):
            return float("nan")
        if not len(few):
            return float(self.apart[0])
        last = few[-1]
        if last + 1 == len(self.apart):
            return float("inf")
        here, there = self.told[last], self.told[last + 1]
        share = (_ENOUGH - here) / (there - here)
        return float(self.apart[last] + share * (self.apart[last + 1] - self.apart[last]))

    @cached_property
    def figures(self) -> dict:
        """Plain data: mean, median and p95 of the place by kind of sheet, m, of the force's errors
        likewise, and pairs."""
        out: dict = {
            kind: {
                "mean": float(values.mean()),
                "median": float(np.median(values)),
                "p95": float(np.percentile(values, 95)),
                "force": [float(np.percentile(self.force[kind], part)) for part in (50, 95)],
            }
            for kind, values in self.place.items()
        }
        told = {f"{each:g}": float(part) for each, part in zip(self.apart, self.told, strict=True)}
        return out | {"told": told, "closest": self.closest}


def measure(
    data: ReferenceData,
    profiles: Sequence[str] = PROFILES,
    rows: Sequence[int] | None = None,
    pairs: bool = True,
) -> Iterator[Measured]:
    """The profiles on the states of `data`, each with noise and conversion of its own.

    rows : electrodes to ground, as read; those of the layout's scan without it
    pairs : whether they are measured, too
    """
    rows = np.asarray(data.layout.grounded if rows is None else rows)
    frames = [readings(potentials(data.state(i)), seed=(_SEED, i))[rows] for i in range(len(data))]
    idle = readings(untouched(data.layout.electrodes), seed=(_SEED, len(data)))[rows]
    true = [np.array([[c["x"], c["y"]] for c in state["contacts"]]) for state in data.states]
    for profile in profiles:
        pipeline = Pipeline(data.layout, Settings(profile, noise=NOISE, contact_law=LAW))
        found, force = {}, {}
        for case, numbers in data.cases().items():
            if not pairs and case not in (EVEN, UNEVEN):
                continue
            results = []
            for i in numbers:  # each after a frame without any contact
                pipeline.process(idle, rows, DRIVE)
                results.append(pipeline.process(frames[i], rows, DRIVE))
            single = case in (EVEN, UNEVEN)
            judge = distances if single else told_apart
            found[case] = judge(results, [true[i] for i in numbers])
            if single:
                pressed = [data.states[i]["contacts"][0]["force"] for i in numbers]
                force[case] = force_errors(results, pressed)
        told = {case: told for case, told in found.items() if case not in (EVEN, UNEVEN)}
        yield Measured(
            data.layout,
            profile,
            {kind: found[kind] for kind in (EVEN, UNEVEN)},
            force,
            np.array([float(case.split()[0]) / 1e3 for case in told]),
            np.array([each.mean() for each in told.values()]),
        )
