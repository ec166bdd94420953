"""Electrode positions as free variables: less blur about the true position everywhere.

The score (`objective`) holds the HWHM, its worst tenth, the position error and the noise gain
against those of the layout given, for the lambda^2 wanted and for two others. Symmetries that the
outline and the layout share are kept: all electrodes of an orbit move together (`orbits`). Spacing,
margin and keep-out zones are never violated (`constraints`).

On a uniform rectangle several starts, the layout scaled and warped, descend by the gradient; after
every round the worse half is dropped, and the best is refined by evolution (`descent`). Other
outlines have no closed form: there evolution alone searches, with scores from finite elements.
"""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import Executor
from dataclasses import dataclass, replace
from functools import lru_cache, partial

import numpy as np

from tomotactile_ros import checks
from tomotactile_ros.errors import InputError
from tomotactile_ros.evaluation.layout_quality import evaluate_layout
from tomotactile_ros.layout import Layout
from tomotactile_ros.optimizer.constraints import Constraints
from tomotactile_ros.optimizer.descent import Descent, Evolution
from tomotactile_ros.optimizer.objective import Aims, Objective
from tomotactile_ros.optimizer.orbits import Orbits, find_orbits, shared_group
from tomotactile_ros.optimizer.step import Clock, Step

REGULARIZATIONS = (1000.0, 100.0, 10000.0)
SPACING = 2.2  # smallest distance of two centres by default, in radii
_SCALES = np.linspace(1.0, 0.7, 13)  # of the layout given, tried before anything else
_SPREAD = np.array([0.06, 0.1, 0.1, 0.06])  # of starts: scale, and the amounts of `_warp`
_SAME = 1e-6  # scores closer than this are the same
DEFAULT_AIMS = Aims()


@dataclass(frozen=True)
class Effort:
    """How long to search.

    starts       layouts to descend from
    rounds       of descent; after each the worse half of the starts is dropped
    descents     gradient steps in each round
    generations  of evolution afterwards
    """

    starts: int = 8
    rounds: int = 5
    descents: int = 12
    generations: int = 10

    def total(self, layout: Layout) -> int:
        """Number of steps: descent is possible on uniform rectangles only."""
        return self.generations + (self.rounds if layout.outline.is_uniform_rectangle else 0)


def effort_for(layout: Layout, generations: int | None = None) -> Effort:
    """Effort by default: less than a minute for 8 x 8 electrodes on two cores."""
    usual = 10 if layout.outline.is_uniform_rectangle else 30
    return Effort(generations=usual if generations is None else generations)


def free(
    layout: Layout,
    *,
    regularizations=REGULARIZATIONS,
    aims: Aims = DEFAULT_AIMS,
    constraints: Constraints | None = None,
    symmetric: bool = True,
    effort: Effort = Effort(),
    seed: int = 0,
    executor: Executor | None = None,
    resolution: int = 40,
) -> Iterator[Step]:
    """Search for a better layout.

    Parameters
    ----------
    layout : start and reference; the rim-to-rim grid is what the default aims are meant for
    regularizations : lambda^2 values, the first is the one that the layout is made for
    aims : what each figure should come to
    constraints : by default only a spacing of 2.2 radii
    symmetric : keep the symmetries that layout and outline share
    executor : any `concurrent.futures` executor; the result does not depend on it
    resolution : contact positions along the longer side

    Yields the start (iteration 0) and the best layout after each round and generation; its score is
    1 for the aims, lower is better.

    Raises InputError for constraints that cannot be met.
    """
    constraints = constraints or Constraints(layout.outline, SPACING * layout.radius)
    constraints.check(layout.electrodes, layout.radius)
    for each in regularizations:
        checks.positive(each, "regularizations", "number")
    task = _Task(layout, tuple(regularizations), aims, constraints, symmetric, resolution)
    evaluate = partial(
        evaluate_layout, regularization=task.regularizations[0], resolution=resolution
    )
    run = _Runner(executor).map
    rounds = effort.rounds if task.differentiable else 0
    clock = Clock(effort.total(layout))
    yield clock.step(0, evaluate(layout), task.problem.score(layout.positions))
    best = _Best(layout.positions, task.problem.score(layout.positions))
    for iteration, found in enumerate(_search(task, effort, rounds, seed, run), 1):
        best.offer(*found)
        quality = evaluate(replace(layout, positions=best.positions, provenance={}))
        yield clock.step(iteration, quality, best.score)


class _Best:
    def __init__(self, positions, score):
        self.positions, self.score = positions, score

    def offer(self, positions, score):
        if score < self.score - _SAME:
            self.positions, self.score = positions, score


class _Runner:
    """`map` of an executor, or of this process."""

    def __init__(self, executor):
        self._executor = executor

    def map(self, function, *items):
        if self._executor is None:
            return [function(*each) for each in zip(*items)]
        return list(self._executor.map(function, *items))


@dataclass(frozen=True, eq=False)
class _Task:
    """Everything that a worker needs to score positions."""

    layout: Layout
    regularizations: tuple[float, ...]
    aims: Aims
    constraints: Constraints
    symmetric: bool
    resolution: int

    @property
    def differentiable(self) -> bool:
        return self.layout.outline.is_uniform_rectangle

    @property
    def problem(self):
        return _problem(self)

    def orbits(self, positions) -> Orbits:
        if not self.symmetric:
            return find_orbits(positions, np.eye(2)[None])
        return find_orbits(positions, shared_group(self.layout.outline, positions))

    def feasible(self, orbits: Orbits, parameters):
        """Parameters nearby that obey the constraints, or None."""
        positions = self.constraints.project(orbits.positions(parameters))
        return None if positions is None else orbits.parameters(positions)

    def key(self):
        """What makes two tasks the same, in whichever process."""
        layout = self.layout
        return (layout.positions.tobytes(), layout.radius, layout.outline.shell.tobytes(),
                self.regularizations, self.aims, self.resolution)  # fmt: skip

    def __hash__(self):
        return hash(self.key())

    def __eq__(self, other):
        return isinstance(other, _Task) and self.key() == other.key()


@lru_cache(maxsize=2)
def _problem(task: _Task):
    """The objective, made once in every process."""
    return Objective(task.layout, task.regularizations, task.aims, resolution=task.resolution)


def _search(task, effort, rounds, seed, run):
    """(positions, score) of the best so far, round by round and generation by generation."""
    starts = _starts(task, effort.starts, seed, run)
    orbits = task.orbits(starts[0])
    parameters = [orbits.parameters(start) for start in starts]
    step = 0.02 * np.sqrt(task.layout.outline.area / task.layout.electrodes)
    best = (starts[0], _score(task, orbits, parameters[0]))
    if rounds:
        total = rounds * effort.descents
        states = [Descent(each, step, total) for each in parameters]
        for _ in range(rounds):
            count = len(states)
            states = run(
                _descend, [task] * count, [orbits] * count, states, [effort.descents] * count
            )
            states.sort(key=lambda state: state.score)
            states = states[: max(1, (count + 1) // 2)]
            best = (orbits.positions(states[0].best), states[0].score)
            yield best
    evolution = Evolution(orbits.parameters(best[0]), step / (4 if rounds else 1), seed)
    for _ in range(effort.generations):
        candidates = evolution.ask()
        count = len(candidates)
        found = run(_try, [task] * count, [orbits] * count, candidates)
        evolution.tell(
            np.array([parameters for parameters, _ in found]), [score for _, score in found]
        )
        if evolution.score < best[1]:
            best = (orbits.positions(evolution.best), evolution.score)
        yield best


def _descend(task, orbits, state, steps):
    problem = task.problem

    def value_and_gradient(parameters):
        score, gradient = problem(orbits.positions(parameters))
        return score, orbits.matrix.T @ gradient.ravel()

    state.run(value_and_gradient, partial(task.feasible, orbits), steps)
    return state


def _try(task, orbits, parameters):
    """Feasible parameters nearby and their score; infinite where there are none."""
    moved = task.feasible(orbits, parameters)
    return (parameters, np.inf) if moved is None else (moved, _score(task, orbits, moved))


def _score(task, orbits, parameters):
    return task.problem.score(orbits.positions(parameters))


def _starts(task, count, seed, run):
    """(count) layouts to start from: first the best scaled one, then warps of it."""
    layout = task.layout
    given = task.constraints.project(layout.positions)
    if given is None:
        raise InputError(
            f"constraints: no layout near {layout.name!r} keeps {task.constraints.spacing:g} m "
            f"spacing, {task.constraints.margin:g} m margin and the zones to keep out of"
        )
    orbits = task.orbits(given)
    scaled = [task.feasible(orbits, orbits.parameters(given * scale)) for scale in _SCALES]
    scaled = [each for each in scaled if each is not None]
    scores = run(_score, [task] * len(scaled), [orbits] * len(scaled), scaled)
    order = np.argsort(scores, kind="stable")
    starts = [orbits.positions(scaled[order[0]])]
    random = np.random.default_rng(seed)
    half = np.array(layout.outline.size) / 2
    while len(starts) < count:
        scale, *amount = random.uniform(-1, 1, 4) * _SPREAD
        warped = _warp(starts[0] / half, amount) * half * (1 + scale)
        moved = task.feasible(orbits, orbits.parameters(warped))
        starts.append(starts[0] if moved is None else orbits.positions(moved))
    return starts


def _warp(positions, amount):
    """Positions in [-1, 1]^2 drawn outward or inward: in the middle, near the rim, diagonally."""
    radial, rim, diagonal = amount
    square = positions**2
    change = radial * (1 - square) + rim * square * (1 - square) * 2 + diagonal * square[:, ::-1]
    return positions * (1 + change)
