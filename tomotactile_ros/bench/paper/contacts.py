"""What counts at the end: places, pairs and forces of contacts that are found with each layout.

All layouts of an outline get the same contacts on the same sheets: single discs on an even sheet and
on sheets that are uneven by 10 %, and pairs of discs at two distances. No optimizer knows these
places, and the reference model, which makes the frames, shares nothing with the model that
optimizers and estimator use. Ratios of two layouts, contact by contact, have intervals of 95 % by
the bootstrap over contacts (Efron 1979).

place  distance of the strongest reported contact from the true one, m; where nothing is reported
       as far as the middle of the sheet
force  relative error of that contact's force, the contact law being known; 1 where nothing is
       reported
pairs  part of the pairs told apart: exactly two contacts, each nearer to its own than to the
       middle between them
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.bench.accuracy import distances, force_errors, told_apart
from tomotactile_ros.bench.reference_cases import Family, Sheet, pair_states, textbook_states
from tomotactile_ros.bench.sensor.readings import potentials, readings, untouched
from tomotactile_ros.bench.sensor.states import solved
from tomotactile_ros.bench.trials import DRIVE, make_pipeline
from tomotactile_ros.evaluation.places import usual_apart
from tomotactile_ros.evaluation.scoring import FIGURES
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.scenes.sheet_field import SheetVariation

EVEN, UNEVEN = "even", "random 10 %"
COMPARED = "mean", "p95"  # figures
_RELATIVE, _LENGTH = 0.1, 0.05  # of uneven sheets; m
_SHEETS = 4  # uneven ones
_ELEMENTS = 35  # of the reference model along the longer side: 0.15 mV off, noise is 1 mV
_SEED = 170
_CLOSER = 0.8  # of the usual distance of pairs, at which layouts differ
_DRAWS = 4000


@dataclass(frozen=True, eq=False)
class Found:
    """What the profile `accurate` reports.

    place, force : by kind of sheet the distances (N,), m, and relative errors of force (N,)
    told : by distance, m, the part of pairs that are told apart
    """

    place: dict[str, np.ndarray]
    force: dict[str, np.ndarray]
    told: dict[float, float]


def pairs_of(singles: int) -> int:
    """As many pairs at each distance there are beside so many single contacts."""
    return max(1, singles // 2)


def touches(layout: Layout, singles: int) -> Family:
    """The states of the sheet that are measured; they depend on outline and number of electrodes."""
    sheets = [Sheet(EVEN)]
    sheets += [
        Sheet(UNEVEN, variation=SheetVariation(_RELATIVE, _LENGTH, _SEED + i))
        for i in range(_SHEETS)
    ]
    random = np.random.default_rng(_SEED)
    states = textbook_states(layout, random, singles, EVEN)
    for i, press in enumerate(textbook_states(layout, random, singles, UNEVEN)):
        states.append(replace(press, sheet=1 + i % _SHEETS))
    random = np.random.default_rng(_SEED + 1)
    apart = (round(_CLOSER * usual_apart(layout), 3), round(usual_apart(layout), 3))
    states += pair_states(layout, random, apart, pairs_of(singles))
    return Family(layout, states, sheets)


def found(layout: Layout, singles: int) -> Found:
    """What is found of `touches`, with noise and conversion, each frame after one without contact."""
    touched = solved(touches(layout, singles), max(layout.outline.size) / _ELEMENTS)
    rows = np.asarray(layout.grounded)
    idle = readings(untouched(layout.electrodes), seed=(_SEED, len(touched.seen)))[rows]
    pipeline = make_pipeline(layout)
    seen: dict[str, list[tuple]] = {}  # by case what is there, and what is reported
    every = zip(touched.cases, touched.truths, touched.seen, strict=True)
    for number, (case, true, state) in enumerate(every):
        frame = readings(potentials(state), seed=(_SEED, number))[rows]
        pipeline.process(idle, rows, DRIVE)
        seen.setdefault(case, []).append((true, pipeline.process(frame, rows, DRIVE)))
    place, force, told = {}, {}, {}
    for case, both in seen.items():
        there, results = zip(*both, strict=True)
        if case in (EVEN, UNEVEN):
            place[case] = distances(results, there)
            force[case] = force_errors(results, there)
        else:
            told[float(case.split()[0]) / 1e3] = float(told_apart(results, there).mean())
    return Found(place, force, told)


def ratio(mine: np.ndarray, first: np.ndarray, figure: str) -> tuple[float, float, float]:
    """One of `COMPARED` of errors (N,) over that of another layout's of the same contacts, and the
    ends of its interval."""
    of = FIGURES[figure]
    drawn = np.random.default_rng(0).integers(len(mine), size=(_DRAWS, len(mine)))
    low, high = np.percentile(of(mine[drawn], axis=1) / of(first[drawn], axis=1), (2.5, 97.5))
    return float(of(mine) / of(first)), float(low), float(high)
