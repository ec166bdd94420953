"""The recursion: one frame after another is added to what is known about the sensor.

Kept is the precision (inverse covariance) of theta and its mean. A frame with contacts is fitted
with what is known; its information, contacts marginal, is taken where the fit ended (iterated
extended Kalman filter in information form; Bell and Cathey 1993) and added with the weight that
`Ledger` gives. Untouched frames give offsets.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from functools import partial
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tomotactile_ros.estimation.arrangement import as_known, resting
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.information import Information, information
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.search import Search
from tomotactile_ros.estimation.solver import solve
from tomotactile_ros.estimation.touch import RADIUS, patches_for
from tomotactile_ros.learning.kept_out import LEAST, KeptOut, Predicted, forgotten
from tomotactile_ros.learning.ledger import Ledger
from tomotactile_ros.learning.readings import Offsets
from tomotactile_ros.learning.state import OFFSET_WANDER, PARTS, WIDE, SensorState
from tomotactile_ros.support.errors import InputError

EXPLAINED = 1.5  # `left_over`: one contact, and noise is all that is left
# chi^2 with the prior's share: beyond, nothing is learned from the frame; two contacts taken for
# one (scene `default`, `equal-8x8`) had 9 without that share and 240 with it
DOUBTFUL = 15.0
_HELD = 1e-4  # of what was expected: as good as fixed
_STEPS = 20  # steps: most of a fit
_FAR = (
    4.0  # a whole deviation for each number of a sensor, which one frame tells little of, is much
)
# models of the sheet that one frame is tried with; of chi^2: what one must lower it to, to be
# worth another
_AGAIN, _WORTH = 4, 0.9
_SUSPECTS = 5  # electrodes that leave most over: two of them may be exchanged
_SWAPPED = 0.25  # of chi-squared is left at most if they are
_SIZES = 1.0, 2.5  # times the typical radius: where the fit of one contact starts
# radii of an electrode: width of a patch. One that an electrode's rim crosses is taken for partly on the
# electrode, and with wider ones a touch at a rim moves resistances by more than a hundred ohm
_PATCH = 0.5
_MOST_ACROSS = 24  # patches to a touch's width: 450 of them
# of the mean pressure, rms: each mode; what an elastic ball has in all, sqrt(1/8). With 0.2
# resistances are 13.4 ohm off instead of 13.1, and a disc between four electrodes moves the sheet
# by 3.6 deviations instead of 2.4
_UNEVEN = 0.35
# fits of a touch, until the sensor stays within a deviation of where the fit took it to be; with
# one the disc over an electrode moves the sheet by 9.0 deviations, with two or three by 0.4 to 1.0
_FITTED = 4


class Exchanged(NamedTuple):
    """Electrodes whose wires are exchanged, and by how many standard deviations that is sure."""

    pair: tuple[int, int]
    sure: float


class Learner:
    """Learns one sensor.

    Parameters
    ----------
    operator : of the electrodes in use; radius : typical of a contact, m
    drive : V; state : what is known, None for nothing
    """

    def __init__(
        self,
        operator: SheetOperator,
        radius: float,
        drive: float,
        state: SensorState | None = None,
    ):
        self.search, self.operator = Search(operator), operator
        self.like = Prior.unknown(operator, WIDE.for_layout(operator.layout), radius, drive)
        self.drive = drive
        self.ledger = Ledger(self.operator.pitch)
        state = state or SensorState.unknown(operator)
        self._where = state.indices(operator.used)
        self.set(state)
        self.about()

    def about(self) -> None:
        """Take up the model of the sheet as it is known now, where it is known to be uneven."""
        try:
            operator = self.operator.near(self.state["sheet"], self.state.tears)
        except InputError:
            # tears that meet leave some sheets in pieces: the one before is right enough
            if self.operator.tears != self.state.tears:
                raise
            return
        if operator is not self.operator:
            self.operator, self.search = operator, Search(operator)

    def set(self, state: SensorState) -> None:
        """Go on from `state`."""
        self._state = self._about = state
        self._scale = state.expected
        correlated = state.covariance / self._scale[:, None] / self._scale
        self._precision = _inverse(correlated)
        self._mean = state.mean.copy()

    @property
    def state(self) -> SensorState:
        """What is known now."""
        if self._state is None:
            covariance = _inverse(self._precision) * self._scale[:, None] * self._scale
            self._state = self._about.learned(self._mean, covariance)
        return self._state

    def prior(self) -> Prior:
        """What the estimator is to expect."""
        return self.state.prior(self.operator, self.drive, self.like)

    def look(self, rows: Rows, enough: float = DOUBTFUL) -> Fit:
        """Contacts of a frame: one if it leaves less than `enough` (`left_over`), else what the
        search finds."""
        prior = self.prior()
        one = self._relinearised(self._single(rows, prior))
        if one is not None and left_over(one) < enough:
            return self._finer(one)
        found = self._finer(self.search.contacts(rows, prior))
        return found if one is None or left_over(found) < left_over(one) / 2 else self._finer(one)

    def exchanged(
        self, fit: Fit, likely: Iterable[tuple[int, int]] = ()
    ) -> tuple[tuple[int, int], Fit] | None:
        """Two electrodes whose wires are exchanged, if that explains far more than `fit`, and the
        fit then; `likely` ones are tried first.

        Reciprocity holds for exchanged wires, too; what contradicts is the sheet. Gains and offsets
        are the channels', and stay with them.
        """
        rows, prior = fit.rows.corrected(fit.prior), self.prior()
        prior = replace(prior, gain=np.ones(rows.readings.shape[1]), offset=0 * prior.offset)
        left = rows.weights * fit.misfit**2
        by_electrode = left.sum(axis=0)
        np.add.at(by_electrode, rows.grounded, left.sum(axis=1))
        suspects = np.argsort(by_electrode)[-_SUSPECTS:]
        first = [tuple(self.operator.position[list(pair)].tolist()) for pair in likely]
        tried = []
        for pair in [*first, *combinations(sorted(suspects.tolist()), 2)]:
            one = self._single(_with_exchanged(rows, pair), prior)
            if one is not None:
                tried.append((one.cost, pair, one))
                if left_over(one) < EXPLAINED:
                    break
        if not tried:
            return None
        _, pair, found = min(tried, key=lambda each: each[0])
        if left_over(found) > DOUBTFUL:  # more than one contact, maybe
            found = self.search.contacts(_with_exchanged(rows, pair), prior)
        if left_over(found) > min(DOUBTFUL, _SWAPPED * left_over(fit)):
            return None
        first, second = self.operator.used[list(pair)].tolist()
        return (first, second), found

    def exchanged_in(self, fits: Sequence[Fit]) -> Exchanged | None:
        """Two electrodes whose exchange explains most of `fits`, which nothing else does."""
        found: dict[tuple[int, int], list[float]] = {}
        for fit in fits:
            swapped = self.exchanged(fit, found)
            if swapped is not None:
                pair, then = swapped
                gained = (fit.chi_squared - then.chi_squared) / then.doubt
                found.setdefault(pair, []).append(float(np.sqrt(max(gained, 0.0))))
        for pair, sure in found.items():
            if len(sure) > len(fits) / 2:
                return Exchanged(pair, min(sure))
        return None

    def settle(self, unknowns: Unknowns, rows: Rows) -> Fit:
        """Contacts fitted anew from `unknowns` with the sensor held where it is known to be."""
        own, expected, state = self.prior(), self.state.expected, self.state
        held = tuple(
            _HELD * expected[state.slice(part)][self.operator.used] / unit
            for part, unit in zip(PARTS[1:], (1.0, self.drive, 1.0, 1.0, 1.0), strict=True)
        )
        sheet = _HELD * expected[state.slice("sheet")]
        return solve(
            self.operator,
            as_known(unknowns, own),
            rows,
            replace(own, sheet_deviation=sheet, deviations=held, precision=None),
        )

    def learn(self, fit: Fit, time: float = 0.0) -> bool:
        """Take what a frame says of the sensor, once its contacts are explained; whether it was
        taken."""
        contacts = fit.unknowns.contacts
        if not len(contacts) or left_over(fit) > DOUBTFUL:
            return False
        self._take(fit, time)
        self.about()
        self._count(frames=1, touches=int(self.ledger.add(contacts, time)))
        return True

    def weighed(self, fit: Fit, ledger: Ledger, time: float = 0.0) -> tuple[Information, float]:
        """What a frame says of the sensor where its fit is, and how often that counts after what is
        in the `ledger`."""
        found = information(fit.operator, fit.unknowns, fit.rows, self.like, self.drive, _UNEVEN)
        misfit = found.chi_squared / max(found.readings, 1)
        return found, ledger.weight(fit.unknowns.contacts, misfit, time)

    def _take(self, fit: Fit, time: float):
        """Add what a frame says.

        A fit that bent the sensor to explain what its contacts cannot is not where the sensor comes
        to be: the frame is fitted again about that, and what it says is taken there.
        """
        before = self._precision, self._mean
        for _ in range(_FITTED):
            at = self._theta(fit.unknowns)
            self._precision, self._mean = before
            self._add([self.weighed(fit, self.ledger, time)], at)
            if (np.abs(self._mean - at) < self.state.deviation).all():
                break
            fit = self.settle(fit.unknowns, fit.rows)

    def untouched(self, found: Offsets, frames: int = 1) -> None:
        """Take what untouched `frames` say."""
        where = self._about.slice("offset")
        scale = self._scale[where]
        self._precision[where, where] += np.diag(found.information * scale**2)
        change = np.zeros_like(self._mean)
        change[where] = (found.pull - found.information * self._mean[where]) * scale
        self._move(self._mean, change)
        self._count(idle=frames)

    def again(self, start: SensorState, parts, at: np.ndarray) -> SensorState:
        """What is known after all frames anew from `start`: parts (Information, weight), taken where
        theta is `at` (D,)."""
        about = self._about
        self.set(start)
        self._about = about
        self._add(parts, at)
        return self.state

    def judged(
        self, start: SensorState, parts, touches: Sequence[int], at: np.ndarray
    ) -> KeptOut | None:
        """How well `touches` that `parts`, as `again` has them, are of, are predicted from each other; what does
        not help is as at the `start` then. None of fewer than are needed."""
        if len(set(touches)) < LEAST:
            return None
        vary = np.zeros(len(self._mean))
        vary[self._about.slice("offset")] = OFFSET_WANDER**2
        vary, known = vary[self._where], self.state
        learned = partial(self.again, start, at=at)
        found = Predicted(parts, touches, at, self._where, learned, start, vary).judged()
        self.set(replace(forgotten(known, start, found.left_out), left_out=found.left_out))
        self.about()
        return found

    def _add(self, parts, at):
        """Information that was taken at theta `at` (D,)."""
        change = self._precision @ ((self._mean - at) / self._scale)
        self._precision = self._precision.copy()
        scale = self._scale[self._where]
        block = np.ix_(self._where, self._where)
        for found, weight in parts:
            self._precision[block] += weight * found.matrix * scale[:, None] * scale
            change[self._where] += weight * found.vector * scale
        self._move(at, change)

    def _move(self, at, change):
        step = cho_solve(cho_factor(self._precision), change)
        self._mean = at + self._scale * step
        self._state = None

    def _count(self, **more):
        added = {name: getattr(self._about, name) + n for name, n in more.items()}
        self._about = replace(self._about, **added)
        if self._state is not None:
            self._state = replace(self._state, **added)

    def _theta(self, unknowns):
        """(D,) of the unknowns; what they do not have stays where it is."""
        theta = self._mean.copy()
        theta[self._where] = np.concatenate(
            [
                unknowns.sheet,
                unknowns.gain,
                unknowns.offset * self.drive,
                unknowns.resistance,
                *unknowns.aside,
            ]
        )
        return theta

    def _single(self, rows, prior):
        """The best fit of one contact, None where nothing is seen."""
        expected = rows.corrected(prior)
        look = self.search.detector.first_look(expected, *prior.deviations[:2])
        seen = look.points(prior.radius) or look.contacts()
        best = None
        for size in _SIZES if seen else ():
            place, strength = seen[0]
            start = self._one(prior, place, strength, size * prior.radius)
            fit = solve(self.operator, start, rows, prior, _STEPS)
            best = fit if best is None or fit.cost < best.cost else best
            if left_over(best) < EXPLAINED:
                break
        return best

    def _relinearised(self, fit: Fit | None) -> Fit | None:
        """The same or a fit with the model of the sheet that it found, if it explains too little."""
        for _ in range(_AGAIN):
            if fit is None or fit.chi_squared < EXPLAINED * fit.rows.count:
                break
            operator = fit.operator.near(fit.unknowns.sheet, fit.operator.tears)
            tried = solve(operator, fit.unknowns, fit.rows, fit.prior, _STEPS)
            if tried.chi_squared > _WORTH * fit.chi_squared:
                break
            fit = tried
        return fit

    def _finer(self, fit: Fit) -> Fit:
        """The same or a fit of discs cut as finely as learning asks for."""
        u = fit.unknowns
        wanted = zip(u.across, self._patches(u.contacts), strict=True)
        across = tuple(had if had < 0 else max(had, more) for had, more in wanted)
        if across == tuple(u.across):
            return fit
        finer = replace(u, across=across)
        return solve(fit.operator, finer, fit.rows, fit.prior, _STEPS)

    def _patches(self, contacts: np.ndarray) -> list[int]:
        """Patches to the width of each contact (k, 6)."""
        wanted = np.ceil(2 * np.exp(contacts[:, RADIUS]) / (_PATCH * self.operator.layout.radius))
        return [int(each) for each in np.minimum(wanted, _MOST_ACROSS)]

    def _one(self, prior, place, strength, radius):
        """One disc, `strength` S or less: half of what a bare conductor of that size has."""
        _, own = self.operator.points(place[None], np.array([radius]))
        strength = min(strength, 0.5 / max(own[0], 1e-9))
        contact = np.array([[*place, np.log(strength), np.log(radius), 0.0, 0.0]])
        free = np.array([[True] * 4 + [False] * 2])
        across = [patches_for(radius, self.operator.pitch)]
        return resting(self.operator, prior).with_contacts(contact, across, free)


def left_over(fit: Fit) -> float:
    """Chi-squared a reading that contacts leave; what the prior of the sensor takes of the cost counts
    as well, because a sensor that nobody would believe explains nothing: one contact in the place of
    two is explained by gains that are half of what they should be."""
    return (fit.chi_squared + fit.of_sensor) / max(fit.rows.count, 1)


def surprise(fit: Fit) -> float:
    """How far a frame is from what was known before it, about 1 or less where nothing has changed.

    Chi-squared a reading, or `_FAR` times the squared way that the sensor had to go, in the
    deviations of what was known, a number of the sensor, whichever is more: a sensor that has changed
    may leave no misfit, as the fit moves what is known.
    """
    apart = fit.prior.apart(fit.unknowns)
    way = float(apart @ fit.prior.pull(apart)) / len(apart)
    return max(fit.chi_squared / max(fit.rows.count, 1), _FAR * way)


def _with_exchanged(rows: Rows, pair: tuple[int, int]) -> Rows:
    """The same with two electrodes in the place of each other."""
    order = np.arange(rows.readings.shape[1])
    order[list(pair)] = order[list(pair)[::-1]]
    return replace(
        rows,
        readings=rows.readings[:, order],
        weights=rows.weights[:, order],
        grounded=order[rows.grounded],
    )


def _inverse(matrix):
    out = cho_solve(cho_factor(matrix), np.eye(len(matrix)))
    return (out + out.T) / 2
