"""Contacts row by row: the recursive form of the estimate, one row after the other.

The belief about contacts and sheet is brought to the time of a row and corrected by its readings:
the iterated extended Kalman filter of the cost that `solver` minimises (Bell and Cathey 1993). A
row that the expected contacts do not explain is looked at again: contacts may have moved or changed
at once, one or all of them have gone, one has come, or one that has just come was somewhere else; and
with each of these, some readings may be wrong (`row_outliers`). Of these the likeliest is believed,
-2 ln(likelihood) with the belief marginal, and what begins or ends costs in addition what its prior
probability says. One that comes must, besides, exceed what noise does anywhere on the lattice (`births`).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
from scipy.special import chdtri

from tomotactile_ros.estimation.arrangement import other_sides
from tomotactile_ros.estimation.births import Births
from tomotactile_ros.estimation.equations import REACH
from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import RATES
from tomotactile_ros.estimation.row_model import Known, RowModel
from tomotactile_ros.estimation.row_outliers import outliers
from tomotactile_ros.estimation.row_state import (
    MOVING,
    PLACE,
    STATE,
    STRENGTH,
    Belief,
    RowState,
)
from tomotactile_ros.estimation.touch import RADIUS

_SURPRISING = 0.01  # probability of a chi-squared as large: such rows are looked at again
_CONFUSING = 1e-5  # the same of rows that are counted: noise makes two in ten once in two weeks
_UNEXPLAINED = 1e-9  # the same of a row that nothing explains: one in 12 days at 1 kHz
_EVENT = 1e-3  # probability that a contact begins or ends in a given row: one event a second
_COST = -2 * float(np.log(_EVENT))  # of such an event, in units of chi-squared
_CALMING = 0.9  # part of the surprises that the next row remembers: ten rows
_CONFUSED = (
    2.8  # surprises of late: one touch or its end makes two; more, and rows are not believed
)
_LOOSE = (1e-3, 1e-3, 1.0, 1.0, 1.0)  # m, m/s and of ln c: what may change from one row to the next
_NEW_STRENGTH = 5.0  # of ln c: nothing is known of a new one
YOUNG = 12  # rows within which a new contact may turn out to be elsewhere
_FADING = 0.05  # s of fading that are made up for at once: a thousandth of it
_STEPS, _FIRST_STEPS = 8, 2  # of a fit at the most; of each of several starts
_GONE = 3.0  # standard deviations of ln c: below, it is not known that a contact conducts
_BESIDE = 1.0  # spacings from the rim of a wide contact within which nothing begins
_RESTED = 128  # rows: those of what has not come since, nor moves, hardly tell of the sensor
_PART, _PATTERN = (
    0.25,
    0.6180339887,
)  # of other rows that do; golden section: all electrodes' in turn
_MOST_DISTRUSTED = 0.25  # of the channels: if rows contradict so many, they are not believed
# contacts that may begin in one row. Of 16 scenes in which two touches of 1 N begin in the same
# row beside a resting one, all rows were withheld until the frame with 1, and 24 of 1,024 are with
# 2; 3 are no better
_TOGETHER = 2
# rows that all contacts must have been there for that. Of 16 scenes each with two and three
# touches of 1 N that begin in the same row on an untouched sheet, 200 of 2,048 rows show a contact
# that is none, and 449 would from 0 rows on
_SURE = 3
# events in one row, at most: contacts that begin or end, and readings that are wrong (two
# exchanged wires, and another). With more, a touch on a sensor of which only four channels of 16
# read anything was two others
_AT_ONCE = 3
_ACROSS = 0.3  # spacings from an electrode within which all of its sides are tried
_CLOSE = 1.0  # sum of radii: contacts nearer to each other are one
_Read = tuple[np.ndarray, np.ndarray]  # (n,) readings, parts of V0, and which are valid


class _Fit:
    """How likely a row was, and what the belief is after it: `prior`, the belief before the row, and
    what the compiled model says."""

    def __init__(self, prior: Belief, found: Any) -> None:
        self.prior, self.found, self.mean = prior, found, found.mean
        self.chi_squared, self.cost = found.chi_squared, found.cost

    def believed(self) -> Belief:
        """The belief after the row."""
        prior, found = self.prior, self.found
        rows = tuple(each + 1 for each in prior.rows)
        return prior.after(self.mean, found.corrected(prior.covariance), rows)


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
        self._half = tuple(side / 2 for side in operator.layout.outline.size)

    def begin(self, known: Known) -> RowState:
        """Nothing touches, no row was read."""
        return RowState(
            Belief.untouched(known.shift_deviation),
            RowModel(self.operator, known),
            self.births.nothing(),
            np.zeros(self.operator.count, int),
        )

    def follow(
        self, state: RowState, readings: np.ndarray, valid: np.ndarray, ground: int, time: float
    ) -> None:
        """Takes a row into `state`.

        readings (n,) parts of V0 of the electrodes in use; valid (n,) bool; ground : the grounded
            one of them
        time : s, of the row, not before the one before
        """
        lasts = max(time - state.time, 0.0) if np.isfinite(state.time) else 0.0
        state.time = time
        state.unfaded += lasts
        faded = state.unfaded if state.unfaded > _FADING else 0.0
        state.unfaded -= faded
        expected = state.belief.later(lasts, state.model.known.shift_deviation, faded)
        state.distrusted = np.maximum(state.distrusted - 1, 0)
        valid = valid & (state.distrusted == 0)
        read = (np.where(valid, readings, 0.0), valid)
        count = int(np.count_nonzero(valid))
        learns = self._learns(expected, state.read)
        steps = 1 if self._is_linear(expected) else _STEPS
        fit = self._fit(state.model, expected, read, ground, steps, learns=learns)
        surprising, confusing, unexplained = _limits(max(count, 1))
        state.confused *= _CALMING
        if fit.chi_squared > surprising:
            confuses = fit.chi_squared > confusing
            fit = self._explained(state, expected, fit, read, ground, surprising)
            left_out = (state.distrusted == len(valid)).any()  # in this row
            state.confused += confuses * (1 + (fit.chi_squared > confusing)) + left_out
            doubtful = np.count_nonzero(state.distrusted) >= _MOST_DISTRUSTED * len(valid)
            # what rows say from here on rests on what was wrong
            if state.confused > _CONFUSED or doubtful:
                state.confused = np.inf
        else:
            state.sums = self.births.nothing()
            if expected.count and state.model.known.wide is None:
                # what a multiplexer that settles slowly leaves of a touch surprises nobody
                gone = self._gone(state.model, expected, read)
                fit = min(fit, gone, key=lambda each: each.cost + (_COST if each is gone else 0.0))
            fit = self._ended(state, fit, read, ground)
        state.unexplained = state.unexplained + 1 if fit.chi_squared > unexplained else 0
        state.belief = self._tidied(fit.believed())
        self._passed(state, bool(np.isinf(fit.found.row.own)), fit.chi_squared / max(count, 1))

    def wait(self, state: RowState, readings: np.ndarray, valid: np.ndarray, time: float) -> None:
        """Takes a row into `state` that is not believed, as a frame has to tell first: all that it says
        is whether anything touches. Arguments as of `follow`."""
        state.time, state.unexplained = time, 0
        state.distrusted = np.maximum(state.distrusted - 1, 0)
        valid = valid & (state.distrusted == 0)
        readings = np.where(valid, readings, 0.0)
        count = max(int(np.count_nonzero(valid)), 1)
        gone, most = self._gone(state.model, state.belief, (readings, valid)), _limits(count)[0]
        if gone.chi_squared > most >= _at_least(gone):  # maybe a few readings are wrong
            left, _ = outliers(gone.found.misfit, gone.found.root, valid, _AT_ONCE)
            rest = valid.copy()
            rest[left] = False
            gone = self._gone(state.model, state.belief, (np.where(rest, readings, 0.0), rest))
            if gone.chi_squared <= most:
                state.distrusted[left] = len(valid)
        untouched = bool(valid.any()) and gone.chi_squared <= most
        if untouched:
            state.belief = gone.believed()
        self._passed(state, untouched, gone.chi_squared / count)

    def _passed(self, state: RowState, untouched: bool, misfit: float) -> None:
        """What a row that was taken in leaves."""
        if state.model.known.wide is not None and untouched:
            state.model = RowModel(self.operator, replace(state.model.known, wide=None))
            state.wide = []
        state.untouched, state.misfit = untouched, misfit
        if untouched:
            state.confused, state.touched_at_once = 0.0, False
        elif not state.read:  # a row tells one contact from several only where one comes at a time
            state.confused, state.touched_at_once = np.inf, True
        state.read += 1

    def _ended(self, state: RowState, fit: _Fit, read: _Read, ground: int) -> _Fit:
        """The same fit, or one without the contacts that have gone: one that is let go ever more softly
        surprises nobody either, but what was left of it is not there in one row after the other."""
        count = fit.prior.count
        spent = {}
        for i in reversed(range(count)):
            number, at = fit.prior.numbers[i], STATE * i + STRENGTH
            fallen = fit.prior.mean[at] - fit.mean[at]
            before = state.fading.get(number, 0.0)
            if not before and fallen**2 < fit.prior.covariance[at, at]:
                continue
            if fallen < 0 and not before:
                continue
            rest = self._fit(state.model, fit.prior.without(i), read, ground, _FIRST_STEPS)
            gained = before + fit.cost - rest.cost
            if gained > _COST:
                fit = rest
            elif gained > 0:
                spent[number] = gained
        state.fading = spent
        return fit

    def _is_linear(self, belief: Belief) -> bool:
        """Whether contacts are known to where one linearisation holds: they are not after a pause."""
        variances = belief.covariance.diagonal()[: STATE * belief.count].reshape(-1, STATE)
        return bool((variances[:, PLACE] < (REACH * self.operator.pitch) ** 2).all())

    def _learns(self, belief: Belief, number: int) -> bool:
        """Whether a row is to tell of the sensor: those of contacts that have come or move do, of
        resting ones each fourth, in a pattern that meets all electrodes."""
        fast = any(
            vx**2 + vy**2 > MOVING**2 for _, _, vx, vy, _ in _each(belief.mean, belief.count)
        )
        return fast or min(belief.rows, default=0) < _RESTED or (number * _PATTERN) % 1 < _PART

    def _explained(
        self,
        state: RowState,
        expected: Belief,
        plain: _Fit,
        read: _Read,
        ground: int,
        surprising: float,
    ) -> _Fit:
        """The likeliest of what may have happened; `surprising` : chi-squared from which on a row is."""
        model = state.model
        tried = [(0, plain)]

        def offer(fit: _Fit, events: int) -> None:
            tried.append((events, fit))

        if expected.count:
            variances = np.array(_LOOSE) ** 2
            offer(self._fit(model, expected.loosened(variances), read, ground, _STEPS), 0)
            left = [expected.without(i) for i in range(expected.count)]
            for rest in left:
                offer(self._fit(model, rest, read, ground, 3), 1)
            if expected.count > 1:
                offer(self._gone(model, expected, read), 1)
            for i, rest in enumerate(left):
                if expected.rows[i] < YOUNG:
                    names = expected.numbers[i], expected.begun[i]
                    before = self._fit(model, rest, read, ground, 1)
                    for fit in self._born(model, rest, before, read, ground, None, names):
                        offer(fit, 2)
        if model.known.wide is not None:
            offer(self._gone(model, expected, read), 1)
        base = plain
        # on an untouched sheet one contact may explain what several do
        sure = min(expected.rows, default=0) >= _SURE
        for number in range(1, 1 + (_TOGETHER if sure else 1)):
            names = state.last + number, state.time
            given = base.prior, base, read, ground, state if number == 1 else None, names
            born = list(self._born(model, *given))
            for fit in born:
                offer(fit, number)
            if not born:
                break
            base = min(born, key=lambda fit: fit.cost)
            if base.chi_squared < surprising:
                break
        best = self._trusted(state, tried, read, ground)
        last = max(best.prior.numbers, default=0)
        if last > state.last:
            state.last, state.sums = last, self.births.nothing()
        return best

    def _trusted(
        self, state: RowState, tried: list[tuple[int, _Fit]], read: _Read, ground: int
    ) -> _Fit:
        """The likeliest of fits with so many events, without readings that are rather wrong. Those are
        not read for a frame, which can tell."""
        readings, valid = read
        wrong = [
            outliers(fit.found.misfit, fit.found.root, valid, _AT_ONCE - events)
            for events, fit in tried
        ]
        costs = [
            fit.cost + events * _COST - gained for (events, fit), (_, gained) in zip(tried, wrong)
        ]
        likeliest = int(np.argmin(costs))
        best, (left, _) = tried[likeliest][1], wrong[likeliest]
        if not left:
            return best
        state.distrusted[left] = len(valid)
        valid = valid.copy()
        valid[left] = False
        readings = np.where(valid, readings, 0.0)
        if np.isinf(best.found.row.own):
            return self._idle(state.model, best.prior, readings, valid)
        return self._fit(state.model, best.prior, (readings, valid), ground, _STEPS, best.mean)

    def _gone(self, model: RowModel, belief: Belief, read: _Read) -> _Fit:
        """Nothing touches any more, nor anything wide."""
        return self._idle(model, belief.of_sensor(), *read)

    def _born(
        self,
        model: RowModel,
        belief: Belief,
        before: _Fit,
        read: _Read,
        ground: int,
        state: RowState | None,
        names: tuple[int, float],
    ) -> Iterator[_Fit]:
        """Fits of `belief` and one contact more, where the row asks for it: where `before`, a fit of
        that belief, does not explain it."""
        sums = self.births.nothing() if state is None else state.sums
        gains, conductances, sums = self.births.look(
            model, before.found, ground, sums, model.known.gain
        )
        if state is not None:
            state.sums = sums
        if gains.max() < self.births.threshold:
            return
        deviations = [*(2 * side for side in self._half), RATES[0], RATES[0], _NEW_STRENGTH]
        variances = np.square(deviations)
        fits = []
        for x, y, strength in self.births.starts(gains, conductances):
            if self._within(belief, x, y) or self._beside(model.known.wide, x, y):
                continue
            mean = np.array([x, y, 0.0, 0.0, strength])
            begun = belief.with_contact(mean, variances, self._size, *names)
            start = np.insert(before.mean, STATE * belief.count, mean)
            fits.append((begun, self._fit(model, begun, read, ground, _FIRST_STEPS, start)))
        if fits:
            begun, first = min(fits, key=lambda each: each[1].cost)
            found = self._fit(model, begun, read, ground, _STEPS, first.mean)
            yield found
            across = [
                self._fit(model, begun, read, ground, _FIRST_STEPS, each)
                for each in self._across(model, found)
            ]
            if across:
                nearest = min(across, key=lambda each: each.cost)
                yield self._fit(model, begun, read, ground, _STEPS, nearest.mean)

    def _across(self, model: RowModel, fit: _Fit) -> Iterator[np.ndarray]:
        """The state with its last contact on the three other sides of the electrode next to it: one row
        hardly tells which side it is. None of them where no electrode is near."""
        at = STATE * (fit.prior.count - 1)
        place = fit.mean[at : at + 2]
        distance, nearest = self.operator.layout.nearest(place[None])
        if distance[0] > _ACROSS * self.operator.pitch:
            return
        for side in other_sides(place, self.operator.layout.positions[nearest[0]]):
            mean = fit.mean.copy()
            mean[at : at + 2] = side
            yield model.limited(mean, mean, fit.prior.count)

    def _beside(self, wide: Unknowns | None, x: float, y: float) -> bool:
        """Whether what is new there may be a change of a wide contact: frames tell them apart."""
        if wide is None:
            return False
        apart = np.hypot(*(wide.contacts[:, :2] - [x, y]).T)
        reach = _BESIDE * self.operator.pitch + np.exp(wide.contacts[:, RADIUS])
        return bool((apart < reach).any())

    def _within(self, belief: Belief, x: float, y: float) -> bool:
        if not belief.count:
            return False
        contacts = belief.contacts()
        apart = np.hypot(*(contacts[:, :2] - [x, y]).T)
        return bool((apart < _CLOSE * (np.exp(contacts[:, 3]) + np.exp(self._size[0]))).any())

    def _fit(
        self,
        model: RowModel,
        prior: Belief,
        read: _Read,
        ground: int,
        steps: int,
        start: np.ndarray | None = None,
        learns: bool = True,
    ) -> _Fit:
        """The belief after the row, linearised `steps` times at the most, about `start` first; of
        the contacts alone where the row is not to tell of the sensor."""
        mutual = None
        if prior.count > 1:
            mutual = model.mutual(prior.contacts(prior.mean if start is None else start))
        believed = prior.mean, prior.covariance, prior.sizes[:, 0], mutual
        return _Fit(prior, model.fit(*believed, *read, ground, steps, start, learns))

    def _idle(
        self, model: RowModel, prior: Belief, readings: np.ndarray, valid: np.ndarray
    ) -> _Fit:
        """Nothing touches and drives the sheet: all that is read are offsets and noise, and nothing
        is learned."""
        return _Fit(prior, model.idle_fit(prior.mean, readings, valid))

    def _tidied(self, belief: Belief) -> Belief:
        """Without contacts of which it is no longer known that they conduct, and of which two are
        one."""
        for i in reversed(range(belief.count)):
            at = STATE * i + STRENGTH
            if belief.covariance[at, at] > _GONE**-2 and belief.rows[i] > 1:
                belief = belief.without(i)
        contacts = _each(belief.mean, belief.count)
        for i in reversed(range(1, belief.count)):
            x, y = contacts[i][:2]
            for (other_x, other_y, *_), size in zip(contacts[:i], belief.sizes):
                if np.hypot(other_x - x, other_y - y) < _CLOSE * np.exp(size[0]):
                    belief = belief.without(i)
                    break
        return belief


def _at_least(untouched: _Fit) -> float:
    """Chi-squared of an untouched sheet, whose readings are independent, without those that contradict most:
    what remains of it whichever are wrong."""
    each = (untouched.found.misfit / untouched.found.root.diagonal()) ** 2
    return float(np.sort(each)[:-_AT_ONCE].sum())


def _each(mean: np.ndarray, count: int) -> list[list[float]]:
    """The numbers of each of `count` contacts of a state."""
    return mean[: STATE * count].reshape(count, STATE).tolist()


@cache
def _limits(count: int) -> tuple[float, ...]:
    """Chi-squared of `count` readings from which on a row is surprising, confusing, unexplained."""
    return tuple(float(chdtri(count, p)) for p in (_SURPRISING, _CONFUSING, _UNEXPLAINED))
