"""Electrode positions as free variables: less blur about the true position everywhere.

The score (`objective`) holds the HWHM, its worst tenth, the position error and the noise gain
against those of the layout given, for the lambda^2 wanted and for two others. Symmetries that the
outline and the layout share are kept: all electrodes of an orbit move together (`orbits`). Spacing,
margin and keep-out zones are never violated (`constraints`), and a zone that lacks a symmetry takes
it from the layout. How it searches: see `search`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from tomotactile_ros.evaluation.layout_quality import evaluate_layout
from tomotactile_ros.evaluation.point_spread import REGULARIZATION, RESOLUTION
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.optimizer.constraints import Constraints
from tomotactile_ros.optimizer.objective import DEFAULT_AIMS, Aims, Objective
from tomotactile_ros.optimizer.orbits import shared_group
from tomotactile_ros.optimizer.search import Effort, Search, effort_for
from tomotactile_ros.optimizer.step import Step, Steps
from tomotactile_ros.optimizer.work import Work
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import doubt

SPACING = 2.2  # smallest distance of two centres by default, in radii
_SAME = 1e-6  # scores closer than this are the same


def free(
    layout: Layout,
    *,
    regularization: float = REGULARIZATION,
    aims: Aims = DEFAULT_AIMS,
    constraints: Constraints | None = None,
    symmetric: bool = True,
    effort: Effort | None = None,
    seed: int = 0,
    work: Work | None = None,
    resolution: int = RESOLUTION,
) -> Iterator[Step]:
    """Search for a better layout.

    Parameters
    ----------
    layout : start and reference; the rim-to-rim grid is what the default aims are meant for
    regularization : lambda^2 that the layout is made for
    aims : what each figure should come to
    constraints : by default only a spacing of 2.2 radii
    symmetric : keep the symmetries that layout and outline share
    work : who does it; the result does not depend on that
    resolution : contact positions along the longer side

    Yields the start (iteration 0) and the best layout after each round and probe; its score is
    1 for the aims, lower is better.

    Raises InputError for constraints that cannot be met.
    """
    constraints = constraints or Constraints(layout.outline, SPACING * layout.radius)
    constraints.check(layout.electrodes, layout.radius)
    checks.positive(regularization, "regularization", "number")
    objective = Objective(layout, regularization, aims, resolution=resolution)
    effort = effort or effort_for(layout)
    search, steps = Search(objective, constraints, symmetric), Steps(effort.total(layout))
    work = work or Work()
    evaluate = partial(evaluate_layout, regularization=regularization, resolution=resolution)
    score, allowed = objective.score(layout.positions), constraints.kept_by(layout.positions)
    _say_what_is_dropped(search)
    quality = work.do(evaluate, layout)
    yield steps.next(quality, score, allowed=allowed)
    best = score if allowed else np.inf
    for positions, score in search.run(effort, seed, work):
        if score < best - _SAME:
            best = score
            quality = work.do(evaluate, replace(layout, positions=positions, provenance={}))
        yield steps.next(quality, best)


def _say_what_is_dropped(search):
    """Zones to keep out of need not have the symmetries that outline and start share."""
    layout = search.objective.reference
    shared = len(shared_group(layout.outline, layout.positions)) if search.symmetric else 1
    if len(search.group) < shared:
        doubt(
            f"keep_out: the zones have {len(search.group)} of the {shared} symmetries of the layout; "
            "only these are kept (mirrored zones keep the others, too)"
        )
