"""The one solver: maximum a posteriori of contacts, sheet and channels by Gauss-Newton with
Levenberg's damping.

Minimises the sum of ((reading - prediction) / noise)^2 and of what the priors take for each unknown
(Tarantola 2005, chapter 3). Channels are eliminated first; the damping acts on contacts alone, the
rest is nearly linear.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from tomotactile_ros.estimation.equations import FIRST_DAMPING, Contacts, Equations, Linear
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import Prior

# of the cost, which is in units of the noise: a twentieth of one standard deviation squared
_CONVERGED = 0.05
STEPS = 12  # at most, from one start
_TRIES = 6  # of damping in one step
# after so many tries a step that promises less of what noise does not explain is not insisted on
_FEW_TRIES, _LITTLE = 2, 0.2
# of the doubted cost: a standard deviation, squared; the whole fit takes on from there
_NEARER = 1.0
# steps at most with the derivatives of where a step began that went too far; and from the second of
# them on, the part of the cost above that beginning which one may leave
_CHORDS, _CONTRACTS = 5, 0.5
_MANY_STEPS = 3.0  # take as long as new derivatives by the contacts
# steps in turn that gain less than this part of what they promise are the last ones: they creep along a
# valley that bends, and another start or a fit with the sensor free leaves it
_CREEPING, _CREEPS = 2, 0.05
_HOPE = 3.0  # times what a step gained, all that follow may gain


def approach(fit: Fit, most: float = np.inf) -> Fit:
    """Nearer to the best fit, by steps of the contacts alone, of which each costs a third of a whole
    one; `steps` is their number. It ends after `most` work, see `Fit`.

    Far from where they belong, contacts and sheet together may end where a sheet that is bent to
    the readings holds contacts in a wrong place. What the sensor leaves over is doubted in the same
    way as everywhere (`Fit.doubt`), so that it does not bend the contacts either.
    """
    rows, damping, steps, work, creeps = fit.rows, FIRST_DAMPING, 0, 0, 0
    while steps < STEPS and work < most and creeps < _CREEPING:
        doubted = fit.weighed(replace(rows, weights=rows.weights / fit.doubt))
        linear = Contacts(doubted)
        better, damping, more = _descend(linear, damping)
        steps, work = steps + 1, work + more
        if better is None:
            break
        fit = better.weighed(rows)
        creeps = creeps + 1 if doubted.cost - better.cost < _CREEPS * linear.promised else 0
        if max(doubted.cost - better.cost, linear.promised) < _NEARER:
            break
    fit.steps, fit.work = steps, work
    return fit


def solve(
    operator: SheetOperator,
    start: Unknowns,
    rows: Rows,
    prior: Prior,
    steps: int = STEPS,
    known: Equations | None = None,
    goal: float = np.inf,
    at: Fit | None = None,
    most: float = np.inf,
) -> Fit:
    """The best fit that at most `steps` steps from `start` lead to, with its covariance.

    It ends where nothing tells that a cost as low as `goal` will be reached, and after `most` work,
    see `Fit`. `at` : the fit of `start`, where it is known; `known` : equations that an earlier fit
    ended with.
    """
    fit, damping, work = at or Fit(operator, start, rows, prior), FIRST_DAMPING, 0
    slow = False
    for step in range(steps):
        linear = Linear(fit, known, slow)
        known = linear.equations
        better, damping, more = _descend(linear, damping, _CHORDS)
        work += more
        gained = 0.0 if better is None else fit.cost - better.cost
        if better is not None:
            fit = better
        settled = _CONVERGED * fit.doubt
        # after a short whole step the next takes off less than what the linear model was wrong by
        exact = linear.whole and abs(gained - linear.promised) < settled and known.sheet.serves(fit)
        if gained < settled or exact or work >= most:
            break
        if step and fit.cost - _HOPE * gained > goal:
            break
        slow = linear.whole and _is_slow(linear.promised, linear.promised - gained, settled)
    if known.bends(fit):
        linear = Linear(fit, known)
        known = linear.equations
    fit.steps, fit.work = step + 1, work
    fit.covariance, fit.equations = linear.covariance(), known
    return fit


def _is_slow(promised: float, left: float, settled: float) -> bool:
    """Whether steps each of which leaves as much of what it `promised` as this one, `left`, take longer to
    settle than new derivatives."""
    if not settled < left < promised:
        return left >= promised
    return bool(np.log(left / settled) > _MANY_STEPS * np.log(promised / left))


def _back(linear: Contacts, tried: Fit, chords: int) -> tuple[Fit | None, int]:
    """What is better than the fit that `linear` is of, and the work that it took; None where there is
    nothing.

    The valley of equal misfit bends: a step along it leads to a slope beside it, from where the same
    derivatives lead back (second-order correction, Nocedal and Wright 2006, chapter 15).
    """
    fit, work = linear.fit, 0
    for chord in range(chords):
        reached = Fit(fit.operator, linear.about(tried).step(0.0), fit.rows, fit.prior)
        work += reached.prediction.size
        if reached.cost < fit.cost:
            return reached, work
        if chord and reached.cost - fit.cost > _CONTRACTS * (tried.cost - fit.cost):
            break
        tried = reached
    return None, work


def _descend(linear: Contacts, damping: float, chords: int = 0) -> tuple[Fit | None, float, int]:
    """The next fit that is better, None if there is none, the damping to begin with there, and the
    work that it took."""
    fit, work = linear.fit, 0
    for tries in range(_TRIES):
        reached = linear.step(damping)
        if linear.promised < _CONVERGED * fit.doubt:
            break
        if tries >= _FEW_TRIES and linear.promised < _LITTLE * (fit.chi_squared - fit.rows.count):
            break
        tried = Fit(fit.operator, reached, fit.rows, fit.prior)
        work += tried.prediction.size
        if tried.cost < fit.cost:
            return tried, damping / 10, work
        if not tries:
            back, more = _back(linear, tried, chords)
            work += more
            if back is not None:
                return back, max(damping, 1e-4) * 10, work
        damping = max(damping, 1e-4) * 10
    return None, damping, work
