"""Electrode positions as free variables: less blur about the true position everywhere.

The score (`objective`) holds the HWHM, its worst tenth, the position error and the noise gain
against those of the layout given, for the lambda^2 wanted and for two others. Symmetries that the
outline and the layout share are kept: all electrodes of an orbit move together (`orbits`). Spacing,
margin and keep-out zones are never violated (`constraints`), and a zone that lacks a symmetry takes
it from the layout. How it searches: see `search`.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import replace
from functools import partial

import numpy as np

from tomotactile_ros.evaluation.layout_quality import evaluate_layout
from tomotactile_ros.evaluation.point_spread import REGULARIZATION, RESOLUTION
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.optimizer.checkpoint import Checkpoint, Trial
from tomotactile_ros.optimizer.constraints import Constraints
from tomotactile_ros.optimizer.objective import DEFAULT_AIMS, Aims, Objective
from tomotactile_ros.optimizer.orbits import shared_group
from tomotactile_ros.optimizer.search import Effort, Search, effort_for
from tomotactile_ros.optimizer.step import Clock, Step, after_resuming
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
    executor: Executor | None = None,
    checkpoint: Checkpoint | None = None,
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
    executor : any `concurrent.futures` executor; the result does not depend on it
    checkpoint : where the state is kept after every round and probe, and taken from
    resolution : contact positions along the longer side

    Yields the start (iteration 0) and the best layout after each round and probe; its score is
    1 for the aims, lower is better. A search that goes on yields the start and the best of what is
    done.

    Raises InputError for constraints that cannot be met.
    """
    constraints = constraints or Constraints(layout.outline, SPACING * layout.radius)
    constraints.check(layout.electrodes, layout.radius)
    checks.positive(regularization, "regularization", "number")
    objective = Objective(layout, regularization, aims, resolution=resolution)
    effort = effort or effort_for(layout)
    search, total = Search(objective, constraints, symmetric), effort.total(layout)
    state = None
    if checkpoint is not None:
        read = partial(search.read, effort, seed)
        state = checkpoint.taken(total, layout.electrodes, read)
    done = 0 if state is None else state.done
    clock = Clock(total, after_resuming(total, done))
    best = Trial(layout.positions, layout.radius, objective.score(layout.positions))
    allowed = constraints.kept_by(best.positions)
    _say_what_is_dropped(search)
    quality = partial(evaluate_layout, regularization=regularization, resolution=resolution)

    def moved():
        return quality(replace(layout, positions=best.positions, provenance={}))

    yield clock.step(0, quality(layout), best.score, allowed)
    if not allowed:
        best = replace(best, score=np.inf)
    if state is not None:
        best = state.best
        yield clock.step(done, moved(), best.score)
    spread = map if executor is None else executor.map
    found = search.run(effort, seed, spread, state)
    for iteration, (positions, score, trials) in enumerate(found, done + 1):
        if score < best.score - _SAME:
            best = replace(best, positions=positions, score=score)
        if checkpoint is not None:
            checkpoint.keep(iteration, trials, best)
        yield clock.step(iteration, moved(), best.score)


def _say_what_is_dropped(search):
    """Zones to keep out of need not have the symmetries that outline and start share."""
    layout = search.objective.reference
    shared = len(shared_group(layout.outline, layout.positions)) if search.symmetric else 1
    if len(search.group) < shared:
        doubt(
            f"keep_out: the zones have {len(search.group)} of the {shared} symmetries of the layout; "
            "only these are kept (mirrored zones keep the others, too)"
        )
