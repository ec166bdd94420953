"""Contacts row by row: the recursive form of the estimate, one row after the other.

The belief about contacts and sheet is brought to the time of a row and corrected by its readings:
the iterated extended Kalman filter of the cost that `solver` minimises (Bell and Cathey 1993). A
row that the expected contacts do not explain is looked at again: contacts may have moved or changed
at once, one or all of them have gone, one has come, or one that has just come was somewhere else.
Of these the likeliest is believed, -2 ln(likelihood) with the belief marginal, and what begins or
ends costs in addition what its prior probability says. One that comes must, besides, exceed what
noise does anywhere on the lattice (`births`).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np
from scipy.linalg.lapack import dtrtrs
from scipy.stats import chi2

from tomotactile_ros.estimation.births import Births
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.row_model import Known, Row, RowModel
from tomotactile_ros.estimation.row_state import PLACE, STATE, STRENGTH, Belief, RowState
from tomotactile_ros.estimation.solver import RATES, REACH, REACH_STRENGTH
from tomotactile_ros.estimation.touch import RADIUS

_SURPRISING = 0.01  # probability of a chi-squared as large: such rows are looked at again
_CONFUSING = 1e-5  # the same of rows that are counted: noise makes two in ten once in two weeks
_UNEXPLAINED = 1e-9  # the same of a row that nothing explains: one in 12 days at 1 kHz
_EVENT = 1e-3  # probability that a contact begins or ends in a given row: one event a second
_CALMING = 0.9  # part of the surprises that the next row remembers: ten rows
_CONFUSED = (
    2.8  # surprises of late: one touch or its end makes two; more, and rows are not believed
)
_LOOSE = (1e-3, 1e-3, 1.0, 1.0, 1.0)  # m, m/s and of ln c: what may change from one row to the next
_NEW_STRENGTH = 5.0  # of ln c: nothing is known of a new one
YOUNG = 12  # rows within which a new contact may turn out to be elsewhere
_STEPS, _FIRST_STEPS = 8, 2  # of a fit at the most; of each of several starts
_SETTLED = 0.05  # standard deviations that a last step moves a contact
_NOT_READ = 1e6  # variance of a reading that was not read, parts of V0 squared
_GONE = 3.0  # standard deviations of ln c: below, it is not known that a contact conducts
_BESIDE = 1.0  # spacings from the rim of a wide contact within which nothing begins
_CLOSE = 1.0  # sum of radii: contacts nearer to each other are one


@dataclass(frozen=True)
class _Fit:
    """A belief after a row, and how likely the row was: cost -2 ln(likelihood), chi-squared, what
    is left, its factor."""

    belief: Belief
    cost: float
    chi_squared: float
    row: Row
    misfit: np.ndarray
    root: np.ndarray


class Follower:
    """Follows contacts of one set of electrodes.

    Parameters
    ----------
    radius, spread : of contacts, m, and standard deviation of its logarithm, as of `solver.Prior`
    """

    def __init__(self, operator: SheetOperator, radius: float, spread: float):
        self.operator = operator
        self._size = np.array([np.log(radius), spread**2])
        self.births = Births(operator, radius)
        self._half = np.array(operator.layout.outline.size) / 2
        self._least = float(np.log(1e-6 * operator.admittance.diagonal().max()))
        self._most = float(np.log(10 * operator.admittance.diagonal().max()))

    def begin(self, known: Known) -> RowState:
        """Nothing touches, no row was read."""
        state = RowState(Belief.untouched(known.shift_deviation))
        state.model, state.sums = RowModel(self.operator, known), self.births.nothing()
        return state

    def follow(self, state: RowState, readings, valid, ground: int, time: float) -> None:
        """Takes a row into `state`.

        readings (n,) parts of V0 of the electrodes in use; valid (n,) bool; ground : the grounded
            one of them
        time : s, of the row, not before the one before
        """
        lasts = max(time - state.time, 0.0) if np.isfinite(state.time) else 0.0
        state.time = time
        expected = state.belief.later(lasts, state.model.known.shift_deviation)
        read = (np.where(valid, readings, 0.0), valid)
        count = int(np.count_nonzero(valid))
        fit = self._fit(state.model, expected, read, ground, 1)
        surprising, confusing, unexplained = _limits(max(count, 1))
        state.confused *= _CALMING
        if fit.chi_squared > surprising:
            confuses = fit.chi_squared > confusing
            fit = self._explained(state, expected, fit, read, ground, lasts)
            state.confused += confuses * (1 + (fit.chi_squared > confusing))
            if state.confused > _CONFUSED:  # what rows say from here on rests on what was wrong
                state.confused = np.inf
        else:
            state.sums = self.births.nothing()
        state.unexplained = state.unexplained + 1 if fit.chi_squared > unexplained else 0
        if state.model.known.wide is not None and np.isinf(fit.row.own):
            state.model = RowModel(self.operator, replace(state.model.known, wide=None))
            state.wide = []
        state.belief = self._tidied(fit.belief)
        if np.isinf(fit.row.own):
            state.confused = 0.0
        state.touched_at_once |= not state.read and not np.isinf(fit.row.own)
        state.read += 1

    def _explained(self, state, expected, plain, read, ground, lasts) -> _Fit:
        """The likeliest of what may have happened."""
        model, event = state.model, -2 * np.log(_EVENT)
        tried = [(plain.cost, plain)]

        def offer(fit: _Fit, events: int) -> None:
            tried.append((fit.cost + events * event, fit))

        if expected.count:
            variances = np.array(_LOOSE) ** 2
            offer(self._fit(model, expected.loosened(variances), read, ground, _STEPS), 0)
            left = [expected.without(i) for i in range(expected.count)]
            for rest in left:
                offer(self._fit(model, rest, read, ground, 3), 1)
            if expected.count > 1:
                offer(self._gone(model, expected, read, ground), 1)
            for i, rest in enumerate(left):
                if expected.rows[i] < YOUNG:
                    names = expected.numbers[i], expected.begun[i]
                    before = self._fit(model, rest, read, ground, 1)
                    for fit in self._born(model, rest, before, read, ground, None, names):
                        offer(fit, 2)
        if model.known.wide is not None:
            offer(self._gone(model, expected, read, ground), 1)
        names = state.last + 1, state.time
        for fit in self._born(model, expected, plain, read, ground, state, names):
            offer(fit, 1)
        best = min(tried, key=lambda each: each[0])[1]
        if names[0] in best.belief.numbers:
            state.last += 1
            state.sums = self.births.nothing()
        return best

    def _gone(self, model, belief, read, ground) -> _Fit:
        """Nothing touches any more, nor anything wide."""
        while belief.count:
            belief = belief.without(0)
        return self._idle(model, belief, *read, ground)

    def _born(self, model, belief, before, read, ground, state, names):
        """Fits of `belief` and one contact more, where the row asks for it."""
        sums = self.births.nothing() if state is None else state.sums
        gains, conductances, sums = self.births.look(
            model, before.row, ground, before.misfit, before.root, sums, model.known.gain
        )
        if state is not None:
            state.sums = sums
        if gains.max() < self.births.threshold:
            return
        variances = [*(2 * self._half) ** 2, RATES[0] ** 2, RATES[0] ** 2, _NEW_STRENGTH**2]
        fits = []
        for x, y, strength in self.births.starts(gains, conductances):
            if self._within(belief, x, y) or self._beside(model.known.wide, x, y):
                continue
            mean = np.array([x, y, 0.0, 0.0, strength])
            begun = belief.with_contact(mean, variances, self._size, *names)
            fits.append((begun, self._fit(model, begun, read, ground, _FIRST_STEPS)))
        if fits:
            begun, first = min(fits, key=lambda each: each[1].cost)
            yield self._fit(model, begun, read, ground, _STEPS, first.belief.mean)

    def _beside(self, wide, x, y) -> bool:
        """Whether what is new there may be a change of a wide contact: frames tell them apart."""
        if wide is None:
            return False
        apart = np.hypot(*(wide.contacts[:, :2] - [x, y]).T)
        reach = _BESIDE * self.operator.pitch + np.exp(wide.contacts[:, RADIUS])
        return bool((apart < reach).any())

    def _within(self, belief, x, y) -> bool:
        if not belief.count:
            return False
        contacts = belief.contacts()
        apart = np.hypot(*(contacts[:, :2] - [x, y]).T)
        return bool((apart < _CLOSE * (np.exp(contacts[:, 3]) + np.exp(self._size[0]))).any())

    def _fit(
        self, model: RowModel, prior: Belief, read, ground: int, steps: int, start=None
    ) -> _Fit:
        """The belief after the row, linearised `steps` times at the most, about `start` first."""
        readings, valid = read
        if not prior.count and model.known.wide is None:
            return self._idle(model, prior, readings, valid, ground)
        mean, best = prior.mean if start is None else start, None
        ours = slice(0, STATE * prior.count)
        mutual = model.mutual(prior.contacts()) if prior.count > 1 else 0.0
        by_sensor = slice(STATE * prior.count, None)
        modes = len(prior.mean) - len(readings)  # each gain changes its own reading alone
        unread = np.where(valid, 0.0, _NOT_READ)
        both = np.outer(valid, valid)
        for step in range(steps):
            row = model.row(prior.contacts(mean), ground, mean[by_sensor], mutual)
            slopes = np.zeros((len(readings), modes))
            for i in range(prior.count):
                slopes[:, STATE * i : STATE * i + 2] = row.by_contact[:, 3 * i : 3 * i + 2]
                slopes[:, STATE * i + STRENGTH] = row.by_contact[:, 3 * i + 2]
            slopes[:, STATE * prior.count :] = row.by_sheet
            slopes *= valid[:, None]
            driven = np.where(valid, row.driven, 0.0)
            way = prior.mean - mean
            left = np.where(valid, readings - row.readings, 0.0)
            left -= slopes @ way[:modes] + driven * way[modes:]
            spread = prior.covariance[:, :modes] @ slopes.T + prior.covariance[:, modes:] * driven
            scatter = slopes @ spread[:modes] + driven[:, None] * spread[modes:]
            scatter += np.outer(row.common, row.common) * both
            scatter[np.diag_indices(len(scatter))] += np.where(valid, row.variance, unread)
            root = np.linalg.cholesky(scatter)
            white = _solved(root, np.column_stack([left, spread.T]))
            white, shares = white[:, 0], white[:, 1:]
            chi_squared = float(white @ white)
            cost = chi_squared + 2 * float(np.log(root.diagonal()).sum())
            best = _Fit(prior, cost, chi_squared, row, left, root)
            step_to = prior.mean + white @ shares
            taken = self._limited(mean, step_to, prior.count)
            moved, mean = (taken - mean)[ours], taken
            known = prior.covariance.diagonal()[ours] - (shares[:, ours] ** 2).sum(axis=0)
            if (moved**2 <= _SETTLED**2 * known).all():
                break
        covariance = prior.covariance - shares.T @ shares
        rows = tuple(each + 1 for each in prior.rows)
        belief = replace(prior, mean=mean, covariance=covariance, rows=rows)
        return replace(best, belief=belief)

    def _idle(self, model, prior, readings, valid, ground) -> _Fit:
        """Nothing touches and drives the sheet: all that is read are offsets and noise, and nothing
        is learned."""
        row = model.row(np.empty((0, 4)), ground, prior.shift)
        left = np.where(valid, readings - row.readings, 0.0)
        deviation = np.sqrt(np.where(valid, row.variance, _NOT_READ))
        chi_squared = float(((left / deviation) ** 2).sum())
        cost = chi_squared + 2 * float(np.log(deviation).sum())
        return _Fit(prior, cost, chi_squared, row, left, np.diag(deviation))

    def _limited(self, now, wanted, count):
        """The way from `now` to `wanted`, cut to what one linearisation holds for, on the sheet."""
        way = (wanted - now)[: STATE * count].reshape(-1, STATE)
        reach = REACH * self.operator.pitch
        longest = max(
            np.abs(way[:, PLACE]).max(initial=0.0) / reach,
            np.abs(way[:, STRENGTH]).max(initial=0.0) / REACH_STRENGTH,
            1.0,
        )
        out = now + (wanted - now) / longest
        each = out[: STATE * count].reshape(-1, STATE)
        each[:, PLACE] = np.clip(each[:, PLACE], -self._half, self._half)
        each[:, STRENGTH] = np.clip(each[:, STRENGTH], self._least, self._most)
        return out

    def _tidied(self, belief: Belief) -> Belief:
        """Without contacts of which it is no longer known that they conduct, and of which two are
        one."""
        for i in reversed(range(belief.count)):
            at = STATE * i + STRENGTH
            if belief.covariance[at, at] > _GONE**-2 and belief.rows[i] > 1:
                belief = belief.without(i)
        if belief.count > 1:
            contacts = belief.contacts()
            for i in reversed(range(1, belief.count)):
                apart = np.hypot(*(contacts[:i, :2] - contacts[i, :2]).T)
                if (apart < _CLOSE * np.exp(contacts[:i, 3])).any():
                    belief = belief.without(i)
        return belief


@cache
def _limits(count: int) -> tuple[float, ...]:
    """Chi-squared of `count` readings from which on a row is surprising, confusing, unexplained."""
    return tuple(float(chi2.isf(p, count)) for p in (_SURPRISING, _CONFUSING, _UNEXPLAINED))


def _solved(root: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solution of root x = right with the lower triangle `root`: a row has no time for checks."""
    return dtrtrs(root, right, lower=1)[0]
