"""Electrodes where contacts are known best: the default of `tomotactile optimize`.

What is made small follows from the estimator's own model without any frame
(`evaluation.posterior`): three lengths, the mean error of place, that of the worst tenth, and the
distance from which on pairs are told apart. With q_i each of them relative to the start

    ln score = mean(ln q_i) + 3 sum(max(ln q_i, 0))

so that a per cent of one is worth a per cent of another, and none is given up for the others.

The criterion is evaluated as it stands, by the operators of the estimator on any outline; there is
no cheaper model of it and no derivative. A search therefore has few evaluations. It moves all
electrodes together along a few smooth fields (`moves`), more of them round by round, and their
common radius where that is free: several starts side by side, each by the linear trust region
method of Powell (1994; `scipy.optimize`, COBYLA), the worse half dropped after every round.

Contacts of the search lie on one lattice. The score of a step is that on another one, which only
chooses among the few trials of a round: what a search gains on 64 to 256 places is in part chance.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import partial
from itertools import repeat

import numpy as np
from scipy.optimize import minimize

from tomotactile_ros.evaluation.layout_quality import evaluate_layout
from tomotactile_ros.evaluation.places import usual_apart
from tomotactile_ros.evaluation.posterior import Conditions, Posterior, expected
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.optimizer.constraints import Constraints
from tomotactile_ros.optimizer.moves import keeps_fixed, smooth_moves
from tomotactile_ros.optimizer.orbits import shared_group
from tomotactile_ros.optimizer.step import Step, Steps
from tomotactile_ros.optimizer.work import Work
from tomotactile_ros.support import checks
from tomotactile_ros.support.checks import plain
from tomotactile_ros.support.errors import InputError

ROUNDS = 2
STARTS = 2
_SCALES = (1.0, 0.95, 0.9, 0.97, 0.93, 0.86, 0.88, 0.82)  # of the starts, of the fullest layout
_FULL = 1.01  # a start that can be scaled by less fills the sheet already
_HALVINGS = 20
_FIRST_MOVES = 3  # in the first round; twice as many in each after it
_EVALUATIONS = 5  # of one trial in a round, and one more for each move
_REACH = 0.04  # of a spacing: how far the first trial moves electrodes, root mean square
_RADIUS_REACH = 0.2  # the same for the logarithm of the radius
_PLACES = 8, 16  # contacts along the longer side while searching, at least and at most
_BY_SPACING = 64  # of these, over the electrodes along a side, where that lies between
_PAIRS = 24
_UNSEEN = 3  # more of these by which a step is judged
_PENALTY = 3.0  # for what is worse than at the start
_FORBIDDEN = 10.0  # score where no electrodes can be


@dataclass(frozen=True, eq=False)
class Trial:
    """A layout that is being improved.

    positions (E, 2), m; radius, m; score; reach : of the next moves, in parts of the first ones
    """

    positions: np.ndarray
    radius: float
    score: float
    reach: float = 1.0


@dataclass(frozen=True, eq=False)
class TouchObjective:
    """The score of electrodes, relative to those of `reference`.

    reference : layout whose score is 1; gives outline and sheet
    conditions : what is pressed and how well it is read
    start : (3,) `Posterior.lengths` of the reference
    places : contacts along the longer side
    """

    reference: Layout
    conditions: Conditions
    start: np.ndarray
    places: int

    def posterior(self, positions: np.ndarray, radius: float) -> Posterior:
        """What is expected with electrodes of `radius` (m) at `positions` (E, 2), m."""
        layout = replace(self.reference, positions=positions, radius=radius, provenance={})
        return expected(layout, self.conditions, self.places, pairs=_PAIRS)

    def judge(self, trial: Trial) -> tuple[Trial, Posterior]:
        """The same trial with the score by these places, and what is expected."""
        found = self.posterior(trial.positions, trial.radius)
        return replace(trial, score=self.score(found)), found

    def score(self, found: Posterior) -> float:
        """1 for the reference, less for what is better."""
        ratios = np.log(found.lengths / self.start)
        return float(np.exp(ratios.mean() + _PENALTY * np.maximum(ratios, 0).sum()))


@dataclass(frozen=True, eq=False)
class TouchSearch:
    """Everything that a worker needs to improve a layout.

    radii : (smallest, largest) radius, m; None: that of the reference
    symmetric : keep the symmetries that outline, electrodes and zones to keep out of share
    """

    objective: TouchObjective
    constraints: Constraints
    radii: tuple[float, float] | None
    symmetric: bool

    def first(self, number: int) -> Trial | None:
        """The start scaled about the middle, but for what is fixed; None where it is not allowed.

        The start is first, as it is. One that leaves the rim free is then drawn outwards as far as
        the sheet and its margin allow: small steps from electrodes gathered in the middle end
        where pairs get a little worse before everything gets better. Where the radius is free every
        second one has the smallest, with the same scale.
        """
        reference = self.objective.reference
        scales = self.scales
        scale = number if self.radii is None else number // 2
        positions = reference.positions * scales[scale % len(scales)]
        held = list(self.constraints.fixed)
        positions[held] = reference.positions[held]
        radius = reference.radius
        if self.radii is not None:
            radius = self.radii[0] if number % 2 else float(np.clip(radius, *self.radii))
        itself = Trial(reference.positions, reference.radius, 1.0)
        return self._try(positions, radius, {_key(itself): itself})

    @property
    def scales(self) -> tuple[float, ...]:
        """Of the starts, the start itself first: those that fill the sheet, and smaller ones."""
        full = self._fullest()
        return _SCALES if full < _FULL else (1.0, *(full * scale for scale in _SCALES))

    def _fullest(self) -> float:
        """By how much the start can be scaled about the middle without leaving the sheet; zones
        to keep out of and fixed electrodes do not count, others give way to them."""
        positions = self.objective.reference.positions
        sheet = replace(self.constraints, keep_out=(), fixed=())
        if not sheet.kept_by(positions):
            return 1.0
        low, high = 1.0, float(max(sheet.outline.size) / np.abs(positions).max())
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            low, high = (middle, high) if sheet.kept_by(middle * positions) else (low, middle)
        return low

    def improve(self, trial: Trial, moves: int, evaluations: int) -> Trial:
        """The best of `evaluations` layouts near a trial, along its `moves` smoothest moves."""
        fields = smooth_moves(trial.positions, self._group(trial), moves, self.constraints.fixed)
        count = len(fields) + (self.radii is not None)
        if not count:
            return trial
        reference = self.objective.reference
        spacing = np.sqrt(reference.outline.area / reference.electrodes)
        reach = _REACH * spacing * trial.reach
        best = trial
        known = {_key(trial): trial}

        def score(steps):
            nonlocal best
            positions = trial.positions + reach * np.tensordot(steps[: len(fields)], fields, 1)
            radius = trial.radius
            if self.radii is not None:
                radius *= np.exp(_RADIUS_REACH * trial.reach * steps[-1])
                radius = float(np.clip(radius, *self.radii))
            found = self._try(positions, radius, known)
            if found is None:
                return _FORBIDDEN
            known[_key(found)] = found
            if found.score < best.score:
                best = found
            return found.score

        how = {"rhobeg": 1.0, "maxiter": max(evaluations, count + 2)}
        minimize(score, np.zeros(count), method="COBYLA", tol=0.05, options=how)
        return replace(best, reach=trial.reach * (0.5 if best is trial else 0.7))

    def _try(self, positions, radius, known: dict) -> Trial | None:
        """Electrodes nearby that obey the constraints, and their score, which is found out where it is
        not `known`, by `_key`."""
        obeying = self.constraints.project(positions)
        if obeying is None:
            return None
        xmin, ymin, xmax, ymax = self.constraints.outline.bounds
        obeying = np.clip(obeying, [xmin, ymin], [xmax, ymax])  # what is left of rounding
        here = Trial(obeying, radius, np.inf)
        if _key(here) in known:
            return known[_key(here)]
        try:
            found = self.objective.posterior(obeying, radius)
        except InputError:  # outside a curved rim by rounding
            return None
        return replace(here, score=self.objective.score(found))

    def _group(self, trial):
        if not self.symmetric:
            return np.eye(2)[None]
        zones = self.constraints.keep_out
        group = shared_group(self.objective.reference.outline, trial.positions, zones)
        return keeps_fixed(group, trial.positions, self.constraints.fixed)


def touch(
    layout: Layout,
    *,
    constraints: Constraints,
    conditions: Conditions | None = None,
    radii: tuple[float, float] | None = None,
    symmetric: bool = True,
    rounds: int = ROUNDS,
    starts: int = STARTS,
    work: Work | None = None,
    places: int | None = None,
    **evaluation,
) -> Iterator[Step]:
    """Search for a layout by which contacts are known better.

    Parameters
    ----------
    layout : start, with which all is compared
    conditions : what is pressed; pairs `usual_apart` by default
    radii : (smallest, largest) radius of electrodes, m, where that is free
    rounds, starts : effort
    work : who does it; the result does not depend on that
    places : contacts along the longer side while searching; None: by the number of electrodes
    evaluation : keywords of `evaluate_layout`, for the images that are shown beside

    Yields the start (iteration 0) and the best layout after each round; a score below 1 is better
    than the start, at places that the search does not see.

    Raises InputError for constraints that cannot be met.
    """
    conditions = conditions or Conditions(apart=usual_apart(layout))
    _check_fixed(layout, constraints)
    work, steps = work or Work(), Steps(rounds)
    if places is None:
        places = int(np.clip(round(_BY_SPACING / np.sqrt(layout.electrodes)), *_PLACES))
    evaluate = partial(evaluate_layout, **evaluation)
    look = partial(expected, layout, conditions, pairs=_PAIRS)
    seen, found = work.map(look, (places, places + _UNSEEN))
    judge = TouchObjective(layout, conditions, found.lengths, places + _UNSEEN)
    allowed = constraints.kept_by(layout.positions)
    yield steps.next(work.do(evaluate, layout), 1.0, found, allowed)
    objective = TouchObjective(layout, conditions, seen.lengths, places)
    search = TouchSearch(objective, constraints, radii, symmetric)
    trials = [each for each in work.map(search.first, range(starts)) if each is not None]
    if not trials:
        raise InputError(
            f"constraints: no layout near {layout.name!r} keeps {constraints.spacing:g} m spacing, "
            f"{constraints.margin:g} m margin and the zones to keep out of; where there is room, another "
            "start helps, for instance fewer electrodes or, with electrodes, a larger inset"
        )
    judged = trials  # the starts as they are, too
    known = {_key(layout): (Trial(layout.positions, layout.radius, 1.0), found)}  # at these places
    for number in range(1, rounds + 1):
        moves = _FIRST_MOVES * 2 ** (number - 1)
        trials = work.map(search.improve, trials, repeat(moves), repeat(_EVALUATIONS + moves))
        trials = sorted(trials, key=lambda each: each.score)[: max(len(trials) // 2, 2)]
        judged = judged + trials if number == 1 else trials
        new = list({_key(each): each for each in judged if _key(each) not in known}.values())
        known |= zip(map(_key, new), work.map(judge.judge, new), strict=True)
        best, found = min((known[_key(each)] for each in judged), key=lambda each: each[0].score)
        moved = replace(layout, positions=best.positions, radius=best.radius, provenance={})
        yield steps.next(work.do(evaluate, moved), best.score, found)


def _key(electrodes: Layout | Trial) -> tuple[bytes, float]:
    """The same for the same electrodes: what is expected of them is not found out twice."""
    return electrodes.positions.tobytes(), electrodes.radius


def _check_fixed(layout, constraints):
    """Electrodes that cannot move have to obey as they are."""
    fixed = [checks.integer(each, "fixed", 0, layout.electrodes - 1) for each in constraints.fixed]
    held = layout.positions[fixed]
    if len(fixed) and not constraints.kept_by(held):
        raise InputError(
            f"fixed: these electrodes violate the spacing, the margin or a zone to keep out of by "
            f"{plain(1e3 * constraints.violation(held))} mm where they are"
        )
