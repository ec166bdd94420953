"""Where to look for better electrode positions: starts, descent by the gradient, probing.

On a uniform rectangle several starts, the layout scaled and warped, descend by the gradient; after
every round the worse half is dropped. Probing can refine the best, but finds hardly anything. Both
are searches of scipy (`descent`). Other outlines have no closed form: there probing alone searches,
with scores from finite elements, twice side by side with different first radii.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import repeat

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.optimizer.checkpoint import Kept, State
from tomotactile_ros.optimizer.constraints import Constraints
from tomotactile_ros.optimizer.descent import Descending, Probing
from tomotactile_ros.optimizer.objective import Objective
from tomotactile_ros.optimizer.orbits import Orbits, find_orbits, shared_group
from tomotactile_ros.support.errors import InputError, doubt

_SCALES = np.linspace(1.0, 0.7, 13)  # of the layout given, tried before anything else
_SPREAD = np.array([0.06, 0.1, 0.1, 0.06])  # of starts: scale, and the amounts of `_warp`
_HALVINGS = 6  # of a warp that cannot be
_STEP = 0.02  # unit of lengths, of the mean pitch
_GRAIN = 1e-3  # of a step: parameters are whole multiples
_REACHES = 8.0, 4.0  # first radii of probing, in such steps


@dataclass(frozen=True)
class Effort:
    """How long to search.

    starts    layouts to descend from
    rounds    of descent; after each the worse half of the starts is dropped
    descents  evaluations of score and gradient in each round, for each start
    probes    afterwards, without a gradient, of some evaluations each
    """

    starts: int = 8
    rounds: int = 4
    descents: int = 10
    probes: int = 0

    def total(self, layout: Layout) -> int:
        """Number of steps: descent is possible on uniform rectangles only."""
        return self.probes + (self.rounds if layout.outline.is_uniform_rectangle else 0)


def effort_for(layout: Layout, probes: int | None = None, starts: int | None = None) -> Effort:
    """Effort by default: less than a minute for 8 x 8 electrodes on two cores.

    One more round for every doubling of the starts.
    """
    if probes is None:
        probes = 0 if layout.outline.is_uniform_rectangle else 30
    starts = Effort.starts if starts is None else starts
    return Effort(starts, 1 + max(starts - 1, 1).bit_length(), Effort.descents, probes)


@dataclass(frozen=True, eq=False)
class Search:
    """Everything that a worker needs to score positions and to move them.

    symmetric : keep the symmetries that outline, electrodes and zones to keep out of share
    """

    objective: Objective
    constraints: Constraints
    symmetric: bool

    def run(
        self, effort: Effort, seed: int, spread, state: State | None = None
    ) -> Iterator[tuple[np.ndarray, float, Sequence[Kept]]]:
        """Positions (E, 2) and score of the best so far, after every round and probe, and what goes
        on from there.

        spread : `map`, or that of an executor
        state : to go on from; its trials are those of `read`
        """
        orbits, rounds = self._orbits, self._rounds(effort)
        trials: list
        if state is None:
            done = 0
            starts, score = self._starts(effort.starts if rounds else 1, seed, spread)
            best, trials = starts[0], [Descending(each, self._step) for each in starts]
        else:
            done, trials = state.done, list(state.trials)
            best, score = trials[0].best, trials[0].score
        for _ in range(done, rounds):
            trials = list(spread(self._descend, repeat(orbits), trials, repeat(effort.descents)))
            trials = sorted(trials, key=lambda each: each.score)[: (len(trials) + 1) // 2]
            best, score = trials[0].best, trials[0].score
            yield orbits.positions(best), score, trials
        if done <= rounds:
            trials = [
                Probing(best, score, self._probing_step, reach, (seed, number))
                for number, reach in enumerate(_REACHES)
            ]
        evaluations = _evaluations(len(best))
        for _ in range(max(done, rounds), rounds + effort.probes):
            trials = list(spread(self._probe, repeat(orbits), trials, repeat(evaluations)))
            lead = min(trials, key=lambda trial: trial.score)
            yield orbits.positions(lead.best), lead.score, trials

    def read(self, effort: Effort, seed: int, done: int, plain: list[dict]) -> Sequence[Kept]:
        """What `run` has left after `done` rounds and probes, from plain values.

        Raises ValueError, KeyError or TypeError where they are nothing of that kind.
        """
        count = self._orbits.matrix.shape[1]
        if done <= self._rounds(effort):
            return [Descending.read(each, count, self._step) for each in plain]
        if len(plain) != len(_REACHES):
            raise ValueError(f"trials: {len(plain)}, where {len(_REACHES)} are needed")
        return [
            Probing.read(each, count, self._probing_step, (seed, number))
            for number, each in enumerate(plain)
        ]

    def _rounds(self, effort):
        """Of descent, for which there has to be a gradient."""
        return effort.total(self.objective.reference) - effort.probes

    @cached_property
    def _orbits(self) -> Orbits:
        """Of the start, and of all that keeps its symmetries."""
        return find_orbits(self.objective.reference.positions, self.group)

    @cached_property
    def group(self) -> np.ndarray:
        """(g, 2, 2) symmetries that are kept: of outline, start and zones to keep out of.

        A zone on one side alone breaks a symmetry; electrodes need not avoid its mirror image.
        """
        layout = self.objective.reference
        if not self.symmetric:
            return np.eye(2)[None]
        return shared_group(layout.outline, layout.positions, self.constraints.keep_out)

    @property
    def _step(self) -> float:
        """Unit of lengths of the searches, m."""
        layout = self.objective.reference
        return _STEP * np.sqrt(layout.outline.area / layout.electrodes)

    @property
    def _probing_step(self) -> float:
        return self._step / 4 if self.objective.differentiable else self._step

    def _feasible(self, orbits, parameters):
        """Parameters nearby that obey the constraints, or None.

        They are rounded, so that a difference in the last digit (linear algebra with another number
        of threads) ends here, instead of growing with every step.
        """
        grain = _GRAIN * self._step
        rounded = np.round(parameters / grain) * grain
        positions = self.constraints.project(orbits.positions(rounded))
        if positions is None:
            return None
        parameters = orbits.parameters(positions)
        return parameters if self.constraints.kept_by(orbits.positions(parameters)) else None

    def _score(self, orbits, parameters):
        return self.objective.score(orbits.positions(parameters))

    def _try(self, orbits, parameters):
        """Feasible parameters nearby and their score; infinite where there are none."""
        moved = self._feasible(orbits, parameters)
        return (parameters, np.inf) if moved is None else (moved, self._score(orbits, moved))

    def _descend(self, orbits, state, evaluations):
        def value_and_gradient(parameters):
            score, gradient = self.objective(orbits.positions(parameters))
            return score, orbits.matrix.T @ gradient.ravel()

        state.run(value_and_gradient, lambda moved: self._feasible(orbits, moved), evaluations)
        return state

    def _probe(self, orbits, trial, evaluations):
        trial.run(lambda parameters: self._try(orbits, parameters), evaluations)
        return trial

    def _starts(self, count, seed, spread):
        """Parameters of `count` layouts to start from, first the best scaled one, then warps of it;
        and the score of the first.

        A warp that cannot be is halved until it can. Where none can there are fewer starts.
        """
        layout, constraints, orbits = self.objective.reference, self.constraints, self._orbits
        scaled = [orbits.parameters(layout.positions * scale) for scale in _SCALES]
        first, score = min(spread(self._try, repeat(orbits), scaled), key=lambda each: each[1])
        if not np.isfinite(score):
            raise InputError(
                f"constraints: no layout near {layout.name!r} keeps {constraints.spacing:g} m "
                f"spacing, {constraints.margin:g} m margin and the zones to keep out of"
            )
        random = np.random.default_rng(seed)
        starts = [first]
        for _ in range(count - 1):
            warped = self._warped(starts, random.uniform(-1, 1, 4) * _SPREAD)
            if warped is not None:
                starts.append(warped)
        if len(starts) < count:
            doubt(
                f"starts: {len(starts)} instead of {count}; for the others there is no room beside "
                f"these with {constraints.spacing:g} m spacing, {constraints.margin:g} m margin and the "
                "zones to keep out of"
            )
        return starts, score

    def _warped(self, starts, warp):
        """The first start changed by `warp`, or by a half, a quarter, ... of it, so that it is
        feasible and none of the starts; None where there is no such change."""
        orbits = self._orbits
        half = np.array(self.objective.reference.outline.size) / 2
        for halving in range(_HALVINGS + 1):
            scale, *amount = warp * 0.5**halving
            warped = _warp(orbits.positions(starts[0]) / half, amount) * half * (1 + scale)
            moved = self._feasible(orbits, orbits.parameters(warped))
            if moved is None:
                continue
            away = np.abs(np.array(starts) - moved).max(axis=1, initial=0.0).min()
            if away > _GRAIN * self._step:
                return moved
        return None


def _evaluations(parameters):
    """Of each trial in one probe: more where there are more parameters, but not many more."""
    return 2 + int(1.5 * np.log(max(parameters, 1)))


def _warp(positions, amount):
    """Positions in [-1, 1]^2 drawn outward or inward: in the middle, near the rim, diagonally."""
    radial, rim, diagonal = amount
    square = positions**2
    change = radial * (1 - square) + rim * square * (1 - square) * 2 + diagonal * square[:, ::-1]
    return positions * (1 + change)
