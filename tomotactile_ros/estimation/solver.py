"""The one solver (`core/src/solver.cpp`): maximum a posteriori of contacts, sheet and channels."""

from __future__ import annotations

from typing import Any

import numpy as np

from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import Prior

STEPS: int = compiled.STEPS  # at most, from one start


def approach(fit: Fit, most: float = np.inf) -> Fit:
    """Nearer to the best fit, by steps of the contacts alone, of which each costs a third of a whole
    one; `steps` is their number. It ends after `most` work, see `Fit`."""
    return _ended(fit, compiled.approach(fit.core, most))


def solve(
    operator: SheetOperator,
    start: Unknowns,
    rows: Rows,
    prior: Prior,
    steps: int = STEPS,
    known: Any = None,
    goal: float = np.inf,
    at: Fit | None = None,
    most: float = np.inf,
) -> Fit:
    """The best fit that at most `steps` steps from `start` lead to, with its covariance.

    It ends where nothing tells that a cost as low as `goal` will be reached, and after `most` work,
    see `Fit`. `at` : the fit of `start`, where it is known; `known` : equations that an earlier fit
    ended with.
    """
    fit = at or Fit(operator, start, rows, prior)
    return _ended(fit, compiled.solve(fit.core, steps, known, goal, most))


def _ended(like: Fit, found: tuple) -> Fit:
    core, equations, covariance, steps, work = found
    fit = Fit(like.operator, None, like.rows, like.prior, core=core)
    fit.equations, fit.covariance, fit.steps, fit.work = equations, covariance, steps, work
    return fit
