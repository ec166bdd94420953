"""Where to look for better electrode positions: starts, descent by the gradient, probing.

On a uniform rectangle several starts, the layout scaled and warped, descend by the gradient; after
every round the worse half is dropped. Probing can refine the best, but finds hardly anything. Both
are searches of scipy (`descent`). Other outlines have no closed form: there probing alone searches,
with scores from finite elements, twice side by side with different first radii.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import repeat

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.optimizer.constraints import Constraints
from tomotactile_ros.optimizer.descent import Descending, Probing
from tomotactile_ros.optimizer.objective import Objective
from tomotactile_ros.optimizer.orbits import Orbits, find_orbits, shared_group
from tomotactile_ros.optimizer.work import Work
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

    def run(self, effort: Effort, seed: int, work: Work) -> Iterator[tuple[np.ndarray, float]]:
        """Positions (E, 2) and score of the best so far, after every round and probe."""
        layout, positions = self.objective.reference, self._orbits.positions
        rounds = effort.total(layout) - effort.probes  # of descent, where there is a gradient
        starts, score = self._starts(effort.starts if rounds else 1, seed, work)
        best, descents = starts[0], [Descending(each, self._step) for each in starts]
        for _ in range(rounds):
            descents = work.map(self._descend, descents, repeat(effort.descents))
            descents = sorted(descents, key=lambda each: each.score)[: (len(descents) + 1) // 2]
            best, score = descents[0].best, descents[0].score
            yield positions(best), score
        step = self._step / 4 if self.objective.differentiable else self._step
        probes = [
            Probing(best, score, step, reach, (seed, number))
            for number, reach in enumerate(_REACHES)
        ]
        for _ in range(effort.probes):
            probes = work.map(self._probe, probes, repeat(_evaluations(len(best))))
            lead = min(probes, key=lambda each: each.score)
            yield positions(lead.best), lead.score

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

    def _feasible(self, parameters):
        """Parameters nearby that obey the constraints, or None.

        They are rounded, so that a difference in the last digit (linear algebra with another number
        of threads) ends here, instead of growing with every step.
        """
        orbits, grain = self._orbits, _GRAIN * self._step
        rounded = np.round(parameters / grain) * grain
        positions = self.constraints.project(orbits.positions(rounded))
        if positions is None:
            return None
        parameters = orbits.parameters(positions)
        return parameters if self.constraints.kept_by(orbits.positions(parameters)) else None

    def _try(self, parameters):
        """Feasible parameters nearby and their score; infinite where there are none."""
        moved = self._feasible(parameters)
        if moved is None:
            return parameters, np.inf
        return moved, self.objective.score(self._orbits.positions(moved))

    def _descend(self, descent, evaluations):
        def value_and_gradient(parameters):
            score, gradient = self.objective(self._orbits.positions(parameters))
            return score, self._orbits.matrix.T @ gradient.ravel()

        descent.run(value_and_gradient, self._feasible, evaluations)
        return descent

    def _probe(self, probing, evaluations):
        probing.run(self._try, evaluations)
        return probing

    def _starts(self, count, seed, work):
        """Parameters of `count` layouts to start from, first the best scaled one, then warps of it;
        and the score of the first.

        A warp that cannot be is halved until it can. Where none can there are fewer starts.
        """
        layout, constraints, orbits = self.objective.reference, self.constraints, self._orbits
        scaled = [orbits.parameters(layout.positions * scale) for scale in _SCALES]
        first, score = min(work.map(self._try, scaled), key=lambda each: each[1])
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
            moved = self._feasible(orbits.parameters(warped))
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
