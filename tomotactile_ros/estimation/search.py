"""Contacts one by one, each as long as the readings ask for it.

The matched filter says where one more contact would explain most; the fit then moves all of them. A
contact is there if it lowers the cost (minus twice the logarithm of the posterior) by more than
noise does anywhere on the sheet but with the stated probability, a chi-squared test with its four
parameters for as many places as can be told apart (Wilks 1938; look-elsewhere by Bonferroni). What
the model cannot explain is no white noise: readings of one electrode err together, so the threshold
grows with the excess of chi-squared for each electrode (`Fit.doubt`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

import numpy as np
from scipy.spatial.distance import cdist
from scipy.special import chdtri, expit

from tomotactile_ros.estimation.arrangement import (
    CLOSE,
    are_long,
    as_discs,
    as_known,
    beyond,
    chosen,
    clustered,
    halved,
    most_together,
    one_of,
    overlaps,
    resting,
    with_cells,
)
from tomotactile_ros.estimation.detection import Detector
from tomotactile_ros.estimation.equations import SAME, Contacts, Equations, Linear, similar
from tomotactile_ros.estimation.first_look import FirstLook
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.fits import (
    DYNAMIC,
    FORM,
    LEFT_OVER,
    MISFIT,
    SIZES,
    WITHIN,
    Fits,
    least_after,
)
from tomotactile_ros.estimation.forward import RATED, Unknowns
from tomotactile_ros.estimation.joining import groups as joined
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.one_state import (
    ROUNDS,
    TORN,
    Channels,
    Reciprocity,
    channels_alone,
    of_one_state,
    reciprocity,
)
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.shape import (
    Shapes,
    at_rest,
    explains,
    from_cells,
    groups,
    occam,
    whole,
)
from tomotactile_ros.estimation.solver import STEPS, solve
from tomotactile_ros.estimation.touch import (
    CONDUCTANCE,
    MOST_ACROSS,
    RADIUS,
    STRETCH,
)

FALSE_ALARMS = 1e-7  # contacts a frame that noise alone may show
# mean of noise, in its standard deviations, of which a converter that begins at 0 V cuts off the
# negative half
CUT_OFF = (2 * np.pi) ** -0.5
# deviations of offsets: smaller readings may be offsets alone, which are then fitted first. A
# converter that begins at 0 V cuts off the lower half of the noise, whose mean is (2 pi)^-1/2 of
# its deviation then: learned offsets may be off by as much here. Without that an untouched frame of
# a learned 8 x 8 sensor took 500 ms instead of 16
_OFFSETS = 5.0
TOLD = 0.05  # of both: a hypothesis that is as likely is told beside the likeliest
AS_LIKELY = float(2 * np.log(1 / TOLD - 1))  # the same of minus twice the logarithm of the evidence
_CONTINUED = 0.2  # spacings that a contact may be from where it was expected
# chi-squared per reading that such a disc leaves at most with the sensor as expected, if it is of the right
# size: 1.0 to 1.3, of a wrong one 1.7 and more
_NEAR = 1.5
# deviations of what is expected of the radius of contacts: a part of a shape that a disc may stand for is smaller
_SMALL = 2.0
# deviations, rms, that electrodes lie aside: more is not what was expected of them; and chi^2 a reading that contacts
# leave over then at the most, 1.2 to 2.2 with electrodes 1 mm aside: those of another kind leave tens
_ASIDE, _BUT_FOR_PLACES = 3.0, 3.0
_NEW = 1.5  # times what one more contact promised before, it must promise to be tried again
# of what noise does not explain: what one step from the last frame's contacts does if they are still
# there
_MOSTLY = 0.75
# discs: beside each other that may be fingertips, where one contact explains as much; a disc of 30
# mm as six of them took 2.6 s instead of 0.1
_FEW = 3
# readings times parts about a spacing wide: so few are tried as discs beside a shape whatever it explains, which takes
# some milliseconds: five fingertips on 16 electrodes are 1,200
_CHEAP = 5000
_POOR = 1.25  # chi-squared per reading of a fit that more contacts are sure to be better than
# chi^2, in parts of what reciprocity says that any contacts leave: what right ones leave
_RIGHT = 1.05
# chi-squared per reading from which on channels are doubted and other rows tried
SUSPECT = 12.0
# patches to the width of a contact at most, in `balanced`, and in `fast` for frames that it hands
# on
BOUNDED = 8
# patches, in all evaluations of the forward model for one frame: what no few discs explain is given
# up
BUDGET = 25000
_MANY = 8  # contacts for which that is enough: of more each has as much
_FOR_OTHERS = 0.5  # of what is left of that, kept for other forms while small discs are fitted with the sensor
FIRST_LOOK = 2000  # the same of a search that begins with what was there before
_TOLD = 0.5  # of the deviation of speeds before any row: below, readings tell how fast a contact is
_MOVES = 5.0  # standard deviations of its speed, at which a contact moves


@dataclass(frozen=True)
class Start:
    """What a first `look` at rows shows, and the `fit` near which the best one is looked for; if that is
    a shape of cells, beside it few `discs` that may be it instead."""

    look: FirstLook
    fit: Fit
    discs: Fit | None = None


class Solver(Protocol):
    """A fit from a start, of the rows that another is a fit of; given up where `goal` is out of
    reach."""

    def __call__(self, start: Unknowns, like: Fit, *, goal: float = np.inf) -> Fit: ...


class Misplaced(Exception):
    """Electrodes lie further aside than was expected of them, by a `fit` of few contacts."""

    def __init__(self, fit: Fit):
        super().__init__("electrodes lie further aside than expected")
        self.fit = fit


class Search(Fits):
    """Finds contacts in rows of a sensor, with at most `across` patches to the width of each; `round` : all
    are discs; `learned` : whether it is known what to expect of the places of electrodes, else `Misplaced` may be raised."""

    def __init__(
        self,
        operator: SheetOperator,
        across: int = MOST_ACROSS,
        round: bool = False,
        learned: Callable[[], bool] = lambda: True,
    ):
        self.detector, self.shapes = Detector(operator), Shapes(operator)
        threshold = float(chdtri(FORM, FALSE_ALARMS / len(self.detector.pixels)))
        super().__init__(operator, across, threshold)
        self._round, self._learned = round, learned
        self._most = len(operator.used)  # contacts, each of which an electrode is nearest to
        self._refused = 0.0
        self._alike: tuple[Rows, int] | None = None  # the last answer of `of_one_state`
        self._reciprocity: Reciprocity | None = None  # that of `reciprocity`
        self._obeyed: tuple[Rows, float] | None = None  # that of `_least`
        self._quiet: tuple[Rows, Prior, Fit | None] | None = None  # that of `untouched`
        self._rest: Equations | None = None  # of the untouched sheet, as expected
        self._asked: tuple[Fit, tuple] | None = None  # that of `_next`
        self._led: tuple[Fit, bool] | None = None  # the last answer of `_leads_on`
        self._cells: tuple[FirstLook, Fit | None] | None = None  # that of `_in_cells`
        # that of `_whole`
        self._finished: tuple[Fit, Fit | None] | None = None

    def contacts(
        self,
        rows: Rows,
        prior: Prior,
        start: Fit | None = None,
        budget: int = BUDGET,
        known: Equations | None = None,
        refused: float = 0.0,
        usual: float = 1.0,
        needed: np.ndarray | None = None,
        other: Unknowns | None = None,
    ) -> Fit:
        """The fit with as many contacts as the readings ask for, from those of `start`, a point of the
        same rows, on.

        known : equations that an earlier fit ended with, or None
        refused : what one more contact promised when an earlier fit ended; it was tried then, and
            is not again
        usual : chi-squared per reading that the fit left of which `start` is
        needed : contacts (k, 6) that an earlier fit needed; as long as they are much the same they are
            not asked for again
        other : what was nearly as likely in an earlier frame, which is tried again
        """
        self._left, self._known, self._refused, self._tried = budget, known, refused, []
        self._spent = False
        quiet = self.untouched(rows, prior)
        if quiet is not None:
            return quiet
        if start is not None and start.unknowns.bond is not None:
            fit = self._reshaped(start, usual)
        elif start is not None and len(start.unknowns.contacts):
            fit = self._continued(start, usual)
        else:
            begun = resting(self.operator, prior) if start is None else start.unknowns
            fit = self._first(Fit(self.operator, self._told(begun, rows, prior), rows, prior))
        if fit.unknowns.bond is not None:
            return fit
        tried = None if other is None or other.bond is not None else self._solve(other, fit)
        likeliest = self._likeliest(fit, tried)
        if likeliest is not fit:
            fit, needed = likeliest, None
        while len(fit.unknowns.contacts) < self._most and self._left > 0:
            more = self._one_more(fit)
            if more is None:
                break
            fit = more
        contacts, pitch = fit.unknowns.contacts, self.operator.pitch
        if needed is not None and similar(contacts, needed, pitch, SAME):
            fit.needed = needed
            return self._without_idle(fit)
        simple = self._simplified(fit)
        # what is one now may be two others
        return simple if simple is fit else self._simplified(self._split(simple, self._solve))

    def _reshaped(self, start: Fit, usual: float) -> Fit:
        """The fit of a shape from `start` on, or from the beginning if its cells alone do not explain what has changed:
        the sensor is the same."""
        most, found = MISFIT, None
        if start.chi_squared > most * usual * start.rows.count:
            start, most = from_cells(start), LEFT_OVER
        if start.chi_squared < most * usual * start.rows.count:
            found = at_rest(start, self._known, usual)
        return found or self._first(self._at_rest(start.rows, start.prior))

    def _continued(self, start: Fit, usual: float) -> Fit:
        """The fit from `start` on, or from what a first look shows where that is nearer to the
        readings."""
        if start.chi_squared > _POOR * usual * start.rows.count and not self._leads_on(
            start, usual
        ):
            rest = self._at_rest(start.rows, start.prior)
            seen = self._looks_like(rest)
            if seen is not None and seen.fit.cost < start.cost:
                return self._first(rest, seen)
        found = self._without_idle(self._from(start))
        another = self._left > 0 and self._is_another(start.unknowns, found, usual)
        if another and not self.is_torn(found):
            found = self._likelier(found, self._first(self._at_rest(start.rows, start.prior)))
        return found

    def _at_rest(self, rows: Rows, prior: Prior) -> Fit:
        """No contact."""
        return Fit(self.operator, self._expected(rows, prior), rows, prior)

    def _expected(self, rows: Rows, prior: Prior) -> Unknowns:
        """No contact, the sensor as expected, with channels as `_told`."""
        return self._told(resting(self.operator, prior), rows, prior)

    def _told(self, unknowns: Unknowns, rows: Rows, prior: Prior) -> Unknowns:
        """The same with channels as rows tell them by themselves, where these contradict what was
        expected."""
        channels = self._contradicting(rows, prior)
        if channels is None:
            return unknowns
        return replace(unknowns, gain=channels.gain, offset=channels.offset)

    def _contradicting(self, rows: Rows, prior: Prior) -> Channels | None:
        """Channels as rows tell them by themselves; None where these do not contradict what was expected
        (chi-squared test)."""
        found = self.reciprocity(rows, prior)
        if found.misfit > TORN:
            return None
        channels, *deviations = channels_alone(found, prior)
        apart = channels.gain - prior.gain, channels.offset - prior.offset
        squares = sum(((a / d) ** 2).sum() for a, d in zip(apart, deviations))
        return None if squares < chdtri(2 * len(prior.gain), FALSE_ALARMS) else channels

    def gave_up(self, fit: Fit) -> bool:
        """Whether a fit leaves more over than right contacts do, much more or when the budget was used up: others, which
        were not tried, may be likelier."""
        spent = self._spent or self._left <= 0
        return fit.chi_squared > (LEFT_OVER if spent else _NEAR) * fit.rows.count

    def _likeliest(self, fit: Fit, other: Fit | None) -> Fit:
        """The same, or what explains the readings and is likelier by far: an `other`, or as many contacts or fewer that
        were tried before."""
        most = len(fit.unknowns.contacts)
        few = [each for each in self._besides(fit) if len(each.unknowns.contacts) <= most]
        discs = [each for each in few if each.unknowns.bond is None]
        best = min(discs if other is None else [*discs, other], key=self.price, default=None)
        if best is None or best.chi_squared > LEFT_OVER * fit.rows.count:
            return fit
        if self.price(best, fit.doubt) + AS_LIKELY < self.price(fit, fit.doubt):
            return self._solve(best.unknowns, best)
        return fit

    def _besides(self, fit: Fit) -> list[Fit]:
        """What else was tried of the rows of a fit."""
        tried = (each for _, each in self._tried if each.rows is fit.rows)
        return [each for each in tried if each.unknowns is not fit.unknowns]

    def others(self, fit: Fit) -> Iterator[tuple[Fit, float]]:
        """What else was tried of the rows of a fit and is nearly as likely, or may be by the next ones, and how likely
        it is, in parts of both; the likeliest first."""
        contacts, pitch, doubt = fit.unknowns.contacts, self.operator.pitch, fit.doubt
        tried = self._besides(fit)
        others = [each for each in tried if not similar(each.unknowns.contacts, contacts, pitch)]
        if not others:
            return
        least, shaped = self.price(fit, doubt), fit.unknowns.bond is not None

        def price(other: Fit) -> float:
            if shaped and other.unknowns.bond is None:  # as for `_has_more_evidence`
                return self._anywhere(other.cost, other.unknowns.free, doubt)
            return self.price(other, doubt)

        for more, i in sorted((price(each) - least, i) for i, each in enumerate(others)):
            if more > 2 * AS_LIKELY:
                return
            other = others[i]
            if other.unknowns.bond is None:
                other = solve(self.operator, other.unknowns, fit.rows, fit.prior, most=FIRST_LOOK)
            yield other, float(expit(-more / 2))

    def goes_on(self, start: Fit, usual: float = 1.0, known: Equations | None = None) -> bool:
        """Whether the contacts of `start` are still those of the rows, near where it says; `usual` and
        `known` as in `contacts`."""
        self._known = known
        if start.chi_squared < MISFIT * start.rows.count:
            return True
        return bool(len(start.unknowns.contacts)) and self._leads_on(start, usual)

    def _leads_on(self, start: Fit, usual: float) -> bool:
        """Whether one step from `start` explains most: the contacts are still those."""
        if self._led is None or self._led[0] is not start:
            self._led = start, self._explains_most(start, usual)
        return self._led[1]

    def _explains_most(self, start: Fit, usual: float) -> bool:
        excess = start.cost - usual * start.rows.count
        for of_all in (False, True):  # of contacts alone, which is cheap
            linear = Linear(start, self._known) if of_all else Contacts(start)
            reached = linear.step(0.0)
            if linear.whole and linear.promised > _MOSTLY * excess:
                return _is_likely(start.prior.apart(reached), start.prior)
        return False

    def _from(self, start: Fit) -> Fit:
        """The best fit from the contacts of `start`, or from them and one that has come."""
        found = self._solve(start.unknowns, start)
        if found.chi_squared < MISFIT * found.rows.count or self._left <= 0:
            return found
        place, strength = self._next(start)
        if place is None:
            return found
        added = self._added(start.unknowns, place, strength, start.prior.radius)
        more = self._begin(added, start, 1, goal=found.cost)
        return more if more.cost < found.cost - self._threshold * more.doubt else found

    def _is_another(self, start: Unknowns, found: Fit, usual: float) -> bool:
        """Whether a fit is too far from where it started to be of the same contacts: then it may
        have stopped anywhere between them and what is there now."""
        contacts = found.unknowns.contacts[: len(start.contacts)]
        if len(contacts) != len(start.contacts):
            return True
        apart = np.hypot(*(contacts - start.contacts)[:, :2].T)
        moved = (apart > _CONTINUED * self.operator.pitch).any()
        # how much the model errs changes with the place
        poor = MISFIT if start.moving.any() else _POOR
        return bool(moved or found.chi_squared > poor * usual * found.rows.count)

    def moving(self, rows: Rows, prior: Prior, start: Unknowns | None) -> Fit:
        """The fit of contacts that move while the rows are read, as many as they ask for, from those
        of `start` on."""
        self._changing = True
        there = None
        if start is not None and start.bond is None:
            there = Fit(self.operator, start.in_motion(), rows, prior)
        try:
            return self.contacts(rows, prior, there, FIRST_LOOK)
        finally:
            self._changing = False

    def moved(
        self,
        start: Unknowns,
        rows: Rows,
        prior: Prior,
        steps: int = STEPS,
        budget: int = FIRST_LOOK,
    ) -> Fit:
        """The fit of the contacts of `start`, moving, in so many steps at most; shapes do not."""
        self._left, self._known = budget, None
        if start.bond is not None:
            return self._reshaped(Fit(self.operator, start, rows, prior), 1.0)
        like = Fit(self.operator, start.in_motion(), rows, prior)
        return self._simplified(self._solve(like.unknowns, like, steps))

    def of_any_size(
        self, start: Unknowns, rows: Rows, prior: Prior, steps: int, budget: int
    ) -> Fit:
        """The fit of contacts from where `start` has them, each in so many steps at most, of other sizes
        as well where these leave a little over: much is something else."""
        best: Fit | None = None
        for factor in sorted(SIZES, key=lambda factor: abs(np.log(factor))):
            self._left, self._known = budget, None
            radii = factor * np.exp(start.contacts[:, RADIUS])
            like = Fit(self.operator, as_discs(start, radii, self.operator.pitch), rows, prior)
            tried = self._simplified(self._solve(like.unknowns, like, steps))
            best = tried if best is None or tried.cost < best.cost else best
            left = best.chi_squared + best.of_sensor
            if not _POOR * rows.count < left < MISFIT * rows.count:
                break
        assert best is not None  # there is a first size
        return best

    def one_more(self, fit: Fit) -> Fit:
        """The same, or with one more contact, if the readings ask for it."""
        self._left = FIRST_LOOK
        more = None if fit.unknowns.bond is not None else self._one_more(fit)
        return fit if more is None else self._simplified(more)

    def parts(self, fit: Fit) -> np.ndarray:
        """(k,) `groups` of a fit of a shape, told apart as contacts are anywhere."""
        return groups(fit, self._threshold * fit.doubt, following=True)

    def allows(self, contacts: Unknowns, fit: Fit, fewer: bool) -> bool:
        """Whether the readings of a fit allow other contacts as well, all that is free fitted anew, one in the place of
        two at the price of these; `fewer` : or do not ask for one contact more than those."""
        limit = fit.cost + (self._threshold if fewer else 2 * WITHIN) * _left(fit)
        # to the end: neighbours give way slowly
        start = Fit(self.operator, self._coarse(contacts), fit.rows, fit.prior)
        if contacts.bond is not None:
            return from_cells(start, fit.equations).cost < limit
        found = solve(self.operator, start.unknowns, fit.rows, fit.prior, at=start, most=BUDGET)
        return found.cost < limit

    def lost_without(self, fit: Fit, which: np.ndarray) -> float:
        """What the cost grows by without the contacts `which` (k,) of a fit, all else fitted anew, in parts
        of the fit's doubt."""
        others = self._coarse(chosen(fit.unknowns, ~which))
        found = solve(self.operator, others, fit.rows, fit.prior, most=FIRST_LOOK)
        return (found.cost - fit.cost) / fit.doubt

    def elsewhere(self, fit: Fit, which: int) -> np.ndarray:
        """(3, 3) what is not known of contact `which`, of its place, m, and of ln c, as it may as well be on
        another side of an outermost electrode: second moment about where it is, each place as likely as its
        fit."""
        u, moment, likely = fit.unknowns, np.zeros((3, 3)), 1.0
        place = u.contacts[which, :2]
        for start in beyond(place, self.operator.layout, self.operator.used):
            contacts = u.contacts.copy()
            contacts[which, :2] = start
            begun = self._coarse(replace(u, contacts=contacts))
            found = solve(self.operator, begun, fit.rows, fit.prior, most=FIRST_LOOK)
            apart = found.unknowns.contacts[which, :2] - place
            if np.hypot(*apart) > _CONTINUED * self.operator.pitch:
                stronger = np.log([each.prediction.conductances[which] for each in (found, fit)])
                aside = np.append(apart, stronger[0] - stronger[1])
                weight = np.exp(-max(found.cost - fit.cost, 0.0) / (2 * fit.doubt))
                moment += weight * np.outer(aside, aside)
                likely += weight
        return moment / likely

    def at_rest(self, fit: Fit) -> Fit:
        """The same, or a fit of contacts that rest, if the readings tell that they do."""
        if (
            not fit.unknowns.moving.any()
            or not tells_speeds(fit)
            or (np.abs(fit.unknowns.rates[:, :2]) > _MOVES * _spread(fit)).any()
        ):
            return fit
        rest = self._solve(fit.unknowns.in_motion(False), fit)
        rests = rest.cost < fit.cost + self._threshold * fit.doubt
        return self._simplified(rest) if rests else fit

    def in_motion(self, fit: Fit) -> Fit:
        """The same or a fit of contacts that move while the rows are read, if the readings ask for
        it."""
        u = fit.unknowns
        if fit.rows.times is None or not len(u.contacts) or u.bond is not None:
            return fit
        tried = self._solve(fit.unknowns.in_motion(), fit)
        return tried if tried.cost < fit.cost - self._threshold * tried.doubt else fit

    def untouched(self, rows: Rows, prior: Prior) -> Fit | None:
        """The fit without contacts, where offsets of the channels may be all there is, and are;
        else None."""
        if self._quiet is None or self._quiet[0] is not rows or self._quiet[1] is not prior:
            self._quiet = rows, prior, self._untouched(rows, prior)
        return self._quiet[2]

    def _untouched(self, rows: Rows, prior: Prior) -> Fit | None:
        if prior.learned:  # of one that is not, offsets are expected to be off by as much
            prior = prior.with_offsets_off(CUT_OFF * float(rows.weights.max()) ** -0.5)
        largest = (_OFFSETS * prior.deviations[1]) ** 2
        squares = (rows.weights * (rows.readings - prior.offset) ** 2).sum()
        if squares > (rows.weights * largest).sum() + 2.0 * rows.count:
            return None
        expected = Fit(self.operator, resting(self.operator, prior), rows, prior)
        self._rest = Linear(expected, self._rest).equations
        rest = solve(self.operator, expected.unknowns, rows, prior, known=self._rest, at=expected)
        return None if self.sees_more(rest) else rest

    def sees_more(self, fit: Fit) -> bool:
        """Whether one more contact somewhere would explain more than noise does."""
        gains, _ = self.detector.gains(fit)
        return bool(gains.max() > self._threshold)

    def _seen(self, fit: Fit) -> FirstLook | None:
        """A first look at the rows of `fit`, of no contacts; None where noise explains all."""
        gains, _ = self.detector.gains(fit)
        if gains.max() < self._threshold:
            return None
        found = self.reciprocity(fit.rows, fit.prior)
        channels, *deviations = channels_alone(found, fit.prior)
        return self.detector.first_look(fit.rows.corrected(channels), *deviations)

    def _as_discs(
        self, seen: list[tuple[np.ndarray, float]], fit: Fit, factor: float = 1.0
    ) -> Unknowns:
        """`fit`, of no contacts, with discs of `factor` times the typical radius where contacts were
        seen."""
        discs = fit.unknowns
        for place, strength in seen[: self._most]:
            discs = self._added(discs, place, strength, factor * fit.prior.radius)
        return discs

    def _of_any_size(self, points: list[tuple[np.ndarray, float]], like: Fit) -> Fit:
        """Near discs at `points`, from other sizes as well where the typical one leads to none that
        explain the readings with the sensor as expected, a single one unless it meets an electrode most: a
        disc that covers half an electrode may not come to cover it, and the sheet would be bent to it. Of
        several that sizes lead to, that which would leave the least with the sensor free, to first
        order."""
        found: list[Fit] = []
        for factor in sorted(SIZES, key=lambda factor: abs(np.log(factor))):
            seen = self._as_discs(points, like, factor)
            tried = self._approached(self._begun(seen, like, len(seen.contacts)))
            if len(points) > _FEW:
                return tried
            contacts, pitch = tried.unknowns.contacts, self.operator.pitch
            if not any(similar(contacts, each.unknowns.contacts, pitch) for each in found):
                found.append(tried)
            left, enough = tried.chi_squared / tried.rows.count, MISFIT
            if len(contacts) == 1:
                enough = _NEAR if self.meets_electrode(contacts).any() else SUSPECT
            if left < enough:
                break
        return found[0] if len(found) == 1 else min(found, key=self._after_a_step)

    def _together(self, points: list[tuple[np.ndarray, float]]) -> int:
        """How many of `points` are near each other, at the most: three may be one long or wide thing."""
        places = np.array([place for place, _ in points]).reshape(-1, 2)
        return most_together(places, self.operator.pitch / CLOSE)

    def _first(self, fit: Fit, start: Start | None = None) -> Fit:
        """The fit of what a first look at the rows of `fit`, of no contacts, shows; `start` where it is
        known."""
        start = start or self._looks_like(fit)
        if start is None:
            return fit
        first = start.fit
        if first.unknowns.bond is None:
            self._left *= max(len(first.unknowns.contacts) / _MANY, 1.0)
            return self._as_few(first, start.look, fit)
        return self._as_shape(first, fit, start)

    def _as_few(self, first: Fit, look: FirstLook, rest: Fit) -> Fit:
        """The likeliest fit from `first` on, also in other numbers and forms if contacts fall short; a
        first `look` at the rows of `rest`, of no contacts, shows which."""
        found = first
        if found.equations is None:
            found = self._simplified(self._solve(first.unknowns, first))
        for which in range(len(found.unknowns.contacts)):
            found = self._beyond(found, which)
            if self.meets_electrode(found.unknowns.contacts)[which]:
                found = self._other_sizes(found, which)
        split = found is first  # whose long contacts were asked whether they are two
        short = self._falls_short(found, split)
        if short and not (self._changing or self._round):
            found = self._of_any_shape(found, look, rest)
            if found.unknowns.bond is not None:
                return found
            short = self._falls_short(found, split)
        if short and self._left > 0:
            found = self._formed(found)
        if not split or found is not first:
            found = self._split(found, self._solve)
        if short and self._left > 0 and self._falls_short(found):
            many = self._as_discs(look.contacts(), rest)
            if len(many.contacts) > len(first.unknowns.contacts):
                goal = np.inf if found.chi_squared > _POOR * found.rows.count else found.cost
                tried = self._simplified(self._begin(many, rest, len(many.contacts), goal=goal))
                found = self._split(self._likelier(found, tried), self._solve)
        if found.chi_squared > LEFT_OVER * found.rows.count and self._left > 0:
            found = self.in_motion(found)  # rather than of another size
        for which in range(len(found.unknowns.contacts)):
            found = self._other_sizes(found, which)
        return found

    def _of_any_shape(self, found: Fit, look: FirstLook, rest: Fit) -> Fit:
        """What was `found`, or what is likelier: a shape of cells, as a first `look` at the rows of
        `rest`, of no contacts, shows it, or discs and ellipses in the place of its parts.

        Cells together with sheet and channels explain nearly everything: a shape is believed only where it
        leaves little over with the sensor as expected, or less than discs and the sensor that they need.
        """
        shape = self._in_cells(look, rest)
        if shape is None:
            return found
        least = found.chi_squared + found.of_sensor
        if not explains(shape) and shape.chi_squared + shape.of_sensor > least:
            return found
        return self._shape_or(shape, found) or found

    def _in_cells(self, look: FirstLook, rest: Fit) -> Fit | None:
        """The best fit of cells alone to the rows of `rest`, of no contacts, that `look` is one at."""
        if self._cells is None or self._cells[0] is not look:
            channels = channels_alone(self.reciprocity(rest.rows, rest.prior), rest.prior)[0]
            self._cells = look, self.shapes.fitted(look, rest, channels)
        return self._cells[1]

    def _as_shape(self, cells: Fit, rest: Fit, start: Start) -> Fit:
        """The likeliest of what `cells` alone explain nearly: discs and ellipses in the place of all parts, or what
        `start` has beside them, if these explain the readings and are no parts of one thing, or themselves, with the
        sensor and with discs in the place of small parts."""
        seen, discs, shape = start.look.contacts(), start.discs, None
        if discs is None and len(seen) * rest.rows.count < _CHEAP:
            discs = self._near(self._as_discs(seen, rest), rest)
        parts = self._split(self._parts(cells, rest), self._near)
        parts = self._likelier(discs, parts, near=True)
        left = self._after_a_step(parts)
        many = len(parts.unknowns.contacts) > _FEW
        wide = self._is_wide(cells)
        if wide and max(left, many * parts.chi_squared) > _POOR * parts.rows.count:
            shape = self._whole(cells)
            believed = shape is not None and shape.chi_squared < _NEAR * shape.rows.count
            if shape is not None and believed and self._is_wide(shape):
                least = least_after(left, shape)
                if self._has_more_evidence(shape, least, parts.unknowns.free):
                    return shape
        found = self._simplified(self._solve(parts.unknowns, parts))
        if self._falls_short(found):
            found = self._split(found, self._solve)
            for which in range(len(found.unknowns.contacts)):
                found = self._other_sizes(found, which)
            if shape is None and self._form_matters(found):
                found = self._split(self._formed(found), self._solve)
        if shape is not None and self._is_likelier(shape, found):
            return shape
        things, count = self._things(found), len(found.unknowns.contacts)
        doubtful = things < count or (count > 1 and are_long(found.unknowns.contacts).any())
        poor = found.chi_squared > _POOR * found.rows.count
        if shape is None and (doubtful or (self._falls_short(found) if wide else poor)):
            shape = self._whole(cells)
            if shape is not None and self._is_likelier(shape, found):
                return shape
        if shape is not None:
            as_few = things < count and shape.chi_squared < _NEAR * shape.rows.count
            return shape if as_few and self.parts(shape).max() < things else found
        if not poor:
            return found
        near = self._near(self._as_discs(seen, rest), rest)
        return self._likelier(found, self._as_few(near, start.look, rest))

    def _things(self, found: Fit) -> int:
        """How many contacts the discs of a fit are."""
        return int(joined(found, self.allows).max(initial=-1)) + 1

    def _shape_or(self, cells: Fit, found: Fit) -> Fit | None:
        """Of cells and discs `found` what is likelier; None where the former are unlikely, and the discs fall
        short."""
        if not self._falls_short(found):
            return found
        shape = self._whole(cells)
        if shape is None:
            return None
        return shape if self._is_likelier(shape, found) else found

    def _whole(self, cells: Fit) -> Fit | None:
        """The best fit of `cells` and the sensor, discs in the place of small parts; None where that is unlikely, as
        what cells leave over is no small part of nearly any readings."""
        if self._finished is None or self._finished[0] is not cells:
            begun, shape = self._with_parts(cells)
            apart = shape.prior.apart(shape.unknowns) / np.sqrt(shape.doubt)
            shape.begun = begun
            good = shape.unknowns.bond is not None and _is_likely(apart, shape.prior)
            if good:
                self._remember(shape)
            self._finished = cells, shape if good else None
        return self._finished[1]

    def _with_parts(self, cells: Fit) -> tuple[Fit, Fit]:
        """Where the best fit of `cells` begins, the sensor as it is there and discs in the place of some parts, and that
        fit."""
        begun = self._with_discs(cells, cells)
        shape = whole(begun, self._threshold)
        if shape.chi_squared > cells.chi_squared:  # where the sensor was held: discs led nowhere
            begun, shape = cells, whole(cells, self._threshold)
        # parts that show once the sensor is free
        while (again := self._with_discs(begun, shape)) is not begun:
            begun, shape = again, whole(again, self._threshold)
        while shape.unknowns.bond is not None:
            tries = [begun, *self._of_long(begun, shape)]
            best = min(tries, key=partial(self.price, doubt=shape.doubt))
            if best is begun:
                break
            begun, shape = best, whole(best, self._threshold)
        return begun, shape

    def _with_discs(self, begun: Fit, found: Fit) -> Fit:
        """`begun` with a disc in the place of each part of what was `found` from there that is small; itself if none
        is."""
        small = [each for each in self._narrow(found) if not each[1].free[-1, STRETCH]]
        return self._replaced(begun, found, small) if small else begun

    def _of_long(self, begun: Fit, found: Fit) -> Iterator[Fit]:
        """The same with an ellipse or two discs in the place of one part that is long."""
        for which, one in self._narrow(found):
            two = halved(one, 0, found.prior.radius, self.operator.pitch)
            if two is None:
                continue
            for each in (one, two):
                tried = self._replaced(begun, found, [(which, each)])
                discs = tried.unknowns.contacts[: tried.unknowns.alone]
                if not overlaps(discs, len(discs) - 1):
                    yield tried

    def _is_wide(self, shape: Fit) -> bool:
        """Whether discs cannot stand for all parts of a shape."""
        return not all(self._is_narrow(one, shape) for _, one in self._parts_of(shape))

    def _narrow(self, cells: Fit) -> list[tuple[np.ndarray, Unknowns]]:
        """`_parts_of` cells that discs or ellipses may stand for."""
        return [each for each in self._parts_of(cells) if self._is_narrow(each[1], cells)]

    def _is_narrow(self, one: Unknowns, cells: Fit) -> bool:
        """Whether a part is as narrow as contacts may be; cells make it wider by their own side."""
        side = np.sqrt(np.pi) * np.exp(cells.unknowns.contacts[-1, RADIUS])
        most = np.hypot(cells.prior.radius * np.exp(_SMALL * cells.prior.spread), side)
        radius, *stretch = one.contacts[0, RADIUS:]
        return bool(radius - np.hypot(*stretch) < np.log(most))

    def _parts_of(self, cells: Fit) -> list[tuple[np.ndarray, Unknowns]]:
        """Which cells are a part (k,) bool, and a disc or an ellipse in the place of it, alone; the strongest first."""
        u = cells.unknowns
        if u.bond is None:
            return []
        group = groups(cells, _left(cells) * self._threshold)
        sums = np.bincount(group, np.exp(u.contacts[:, CONDUCTANCE]))
        strong = [e for e in np.argsort(-sums) if e >= u.alone and sums[e] > DYNAMIC * sums.max()]
        nothing = chosen(u, np.arange(0))
        return [(group == e, one_of(u, group == e, nothing, self.operator.pitch)) for e in strong]

    def _replaced(self, begun: Fit, found: Fit, parts: list[tuple[np.ndarray, Unknowns]]) -> Fit:
        """Near the best fit with contacts in the place of `parts` of what was `found`, and the other cells that it had
        `begun` with."""
        cells, u = begun.unknowns, found.unknowns
        nearest = cdist(cells.contacts[:, :2], u.contacts[u.alone :, :2]).argmin(axis=1)
        kept = ~np.any([which[u.alone :] for which, _ in parts], axis=0)[nearest]
        kept[: cells.alone] = False
        both = chosen(u, np.arange(u.alone))
        for _, part in parts:
            both = with_cells(both, part)
        both = with_cells(both, chosen(cells, kept))
        tried = Fit(self.operator, both, begun.rows, begun.prior)
        return from_cells(tried) if kept.any() else self._approached(tried)

    def reciprocity(self, rows: Rows, prior: Prior) -> Reciprocity:
        """How far rows obey it."""
        if self._reciprocity is None or self._reciprocity.rows is not rows:
            self._reciprocity = reciprocity(rows, prior)
        return self._reciprocity

    def of_one_state(self, rows: Rows, prior: Prior) -> int:
        """How many of the last rows may be of one state of the sheet, whatever that is: those among
        which reciprocity holds."""
        if self._alike is None or self._alike[0] is not rows:
            holds = self.reciprocity(rows, prior).misfit < TORN
            self._alike = rows, len(rows.grounded) if holds else of_one_state(rows, prior)
        return self._alike[1]

    def is_torn(self, fit: Fit) -> bool:
        """Whether the rows of a fit that leaves much over are of several states, which no contacts
        explain."""
        rows = fit.rows
        suspect = rows.times is not None and fit.chi_squared > SUSPECT * rows.count
        return suspect and self.of_one_state(rows, fit.prior) < len(rows.grounded)

    def _falls_short(self, fit: Fit, split: bool = False) -> bool:
        """Whether contacts in other numbers or forms are to be tried: too much is left over, several
        contacts need an unlikely sensor, or another contact, or one of another form, would explain
        more than noise does, to first order; or a long one may be two, unless that was asked (`split`)."""
        if self._leaves_over(fit):
            return True
        several = len(fit.unknowns.contacts) > 1
        if several and not _is_likely(fit.prior.apart(fit.unknowns), fit.prior):
            return True
        self._next(fit)
        if self._counts(fit, fit.promised) or self._form_matters(fit):
            return True
        # of which no first order tells
        return not split and bool(are_long(fit.unknowns.contacts).any())

    def _leaves_over(self, fit: Fit) -> bool:
        """Whether other contacts may leave less over: more is than of right ones, also in parts of what
        reciprocity says that any leave (hum, say)."""
        left = fit.chi_squared / fit.rows.count
        if left > _POOR or fit.unknowns.moving.any():
            return left > LEFT_OVER
        if left < LEFT_OVER:
            return left > _RIGHT * self.reciprocity(fit.rows, fit.prior).least(fit.rows.count)
        return left > _RIGHT * self._least(fit.rows, fit.prior)

    def _least(self, rows: Rows, prior: Prior) -> float:
        if self._obeyed is None or self._obeyed[0] is not rows:
            found = reciprocity(rows, prior, ROUNDS)
            self._obeyed = rows, found.least(rows.count)
        return self._obeyed[1]

    def _counts(self, fit: Fit, promised: float) -> bool:
        """Whether it would be significant if so much less of the cost were left over."""
        return promised > self._threshold * fit.doubt_after(promised)

    def _form_matters(self, fit: Fit) -> bool:
        """Whether discs of another form would explain more than noise does, to first order.

        A disc in the place of two contacts has the wrong second moments: what its stretch would take
        off the cost tells (score test, Rao 1948).
        """
        held = ~fit.unknowns.free
        return bool(held.any()) and self._counts(fit, fit.equations.score(fit, held))

    def _formed(self, fit: Fit) -> Fit:
        """The same or a fit of ellipses in the place of discs, if that is better."""
        start = replace(fit.unknowns, free=np.ones_like(fit.unknowns.free))
        tried = self._solve(as_known(start, self._expected(fit.rows, fit.prior)), fit)
        price = 0.0 if fit.unknowns.free.all() else self._threshold * tried.doubt
        return tried if tried.cost < fit.cost - price else fit

    def _likelier(self, first: Fit | None, second: Fit, near: bool = False) -> Fit:
        """Of two fits the one with more contacts only if it is so much better as each of them must
        be; `near` : of two that are only near the best, with the sensor as expected, by what one whole step
        from each leads to, to first order."""
        if first is None:
            return second
        fewer, more = sorted((first, second), key=lambda fit: np.count_nonzero(fit.unknowns.free))
        counts = [np.count_nonzero(fit.unknowns.free) for fit in (fewer, more)]
        extra = (counts[1] - counts[0]) / FORM
        left = [self._after_a_step(fit) if near else fit.cost for fit in (fewer, more)]
        doubt = max(min(left) / more.rows.count, 1.0) if near else more.doubt
        return more if left[1] < left[0] - extra * self._threshold * doubt else fewer

    def _looks_like(self, like: Fit) -> Start | None:
        """Where a fit of the rows of `like`, of no contacts, begins, the sensor being as expected: near
        discs where points explain the currents, or with few small contacts that explain them on a sensor
        that is not, or else with a shape of cells that explains most, or near the likeliest of discs and of what looks like something wide. None where noise explains
        all."""
        look = self._seen(like)
        if look is None:
            return None
        points, discs = look.points(like.prior.radius), None
        one = None if points is None else self._as_one(points, like)
        if one is not None:
            return Start(look, one)
        if points is not None:
            discs = self._of_any_size(points, like)
            if self._is_near(discs):
                return Start(look, discs)
        if not self._changing:
            few = self._of_sensor(look, discs, like)
            if few is not None:
                return Start(look, few)
        shape = None if self._changing or self._round else self._in_cells(look, like)
        if shape is not None and explains(shape):
            return Start(look, shape, discs)
        seen = self._near(self._as_discs(look.contacts(), like), like)
        return Start(look, self._likelier(discs, seen, near=True))

    def _as_one(self, points: list[tuple[np.ndarray, float]], like: Fit) -> Fit | None:
        """The best fit of one contact in the place of each three or more `points` near each other, if it leaves
        nothing over: something long or wide, rather than several beside each other."""
        together = self._together(points)
        if self._changing or together < 3:
            return None
        seen = self._as_discs(points, like)
        few = clustered(seen, self.operator.pitch)
        found = self._approached(self._begun(few, like, len(few.contacts)))
        if found.chi_squared > MISFIT * found.rows.count:
            return None
        found = self._simplified(self._solve(found.unknowns, found))
        if self._falls_short(found):
            return None
        if together > _FEW:
            return found
        discs = self._approached(self._begun(seen, like, len(seen.contacts)))
        left = self._after_a_step(discs)
        least = min(left, least_after(left, found))
        extra = (np.count_nonzero(seen.free) - np.count_nonzero(found.unknowns.free)) / FORM
        if least > found.cost - extra * self._threshold:
            return found
        return self._likelier(found, self._simplified(self._solve(discs.unknowns, discs)))

    def _of_sensor(self, look: FirstLook, discs: Fit | None, like: Fit) -> Fit | None:
        """The best fit from near `discs`, or else from the strongest points of a first look, the sensor
        being free, if that explains the readings with a likely one: what few small contacts leave
        over may be the sheet's."""
        if discs is None:
            strongest = look.strongest(like.prior.radius)
            if not strongest or self._together(strongest) > 2:
                return None
            discs = self._of_any_size(strongest, like)
        elif most_together(discs.unknowns.contacts[:, :2], self.operator.pitch) > 1:
            return None
        if self._after_a_step(discs) > SUSPECT * like.rows.count:
            return None
        kept = _FOR_OTHERS * self._left
        self._left -= kept
        found = self._simplified(self._solve(discs.unknowns, discs))
        if not self._learned() and is_misplaced(found):
            raise Misplaced(found)
        if self._falls_short(found):
            found = self._split(self._formed(found), self._solve)
        self._left += kept
        likely = _is_likely(found.prior.apart(found.unknowns), found.prior)
        return found if likely and not self._falls_short(found, split=True) else None

    def _parts(self, shape: Fit, like: Fit) -> Fit:
        """Near the best fit of one disc or ellipse for each part of a shape."""
        found = like.unknowns
        for _, one in self._parts_of(shape)[: self._most]:
            found = found.joined_by(one.contacts[0], one.across[0], one.free[0])
        return self._approached(self._begun(found, like, len(found.contacts)))

    def _is_likelier(self, shape: Fit, found: Fit) -> bool:
        """Whether the evidence is for a `shape`, the last one of `_whole`, rather than for what was found; what would
        be withheld is none."""
        suspect = SUSPECT * found.rows.count
        if shape.chi_squared < suspect < found.chi_squared:
            return True
        return self._has_more_evidence(
            shape, found.chi_squared + found.of_sensor, found.unknowns.free
        )

    def _has_more_evidence(self, shape: Fit, cost: float, free: np.ndarray) -> bool:
        """Whether a `shape`, the last one of `_whole`, has more evidence than discs of a `cost` with as many
        parameters `free` (k, 6)."""
        assert self._finished is not None
        excess = min(cost, shape.chi_squared) - shape.rows.count
        doubt = 1.0 + max(excess, 0.0) / self.operator.count
        return bool(self.price(shape, doubt) < self._anywhere(cost, free, doubt))

    def _anywhere(self, cost: float, free: np.ndarray, doubt: float) -> float:
        """What discs of a `cost`, doubted, with as many parameters are worth that might each be anywhere."""
        return cost / doubt + self._threshold * np.count_nonzero(free) / FORM

    def price(self, fit: Fit, doubt: float = 1.0) -> float:
        """The same of any fit: cells cost for what they might all have been where it had begun."""
        u = fit.unknowns
        if u.bond is None:
            return super().price(fit, doubt)
        return self._anywhere(fit.cost, u.free[: u.alone], doubt) + occam(fit.begun or fit, doubt)

    def _is_near(self, fit: Fit) -> bool:
        """Whether a fit of contacts alone, found as points, is one to begin with: it explains the
        readings, or contacts near its own would with a likely sensor, to first order. Three near
        each other may be parts of something long or wide, whatever they explain."""
        contacts = fit.unknowns.contacts
        most = most_together(contacts[:, :2], self.operator.pitch)
        if fit.chi_squared < (_NEAR if most > _FEW else MISFIT) * fit.rows.count:
            return True
        if most > _FEW:
            return False
        if most != 2 and len(contacts) > 1:
            return most == 1
        return self._after_a_step(fit) < LEFT_OVER * fit.rows.count

    def _near(self, start: Unknowns, like: Fit, goal: float = np.inf) -> Fit:
        """Near the best fit from `start`, by steps of contacts alone."""
        return self._approached(Fit(self.operator, self._coarse(start), like.rows, like.prior))

    def _split(self, fit: Fit, solved: Solver) -> Fit:
        """The same or a fit with two discs in the place of each long contact: two fingers side by
        side are no rod."""
        which = 0
        self._go_on()
        while which < len(fit.unknowns.contacts) and self._left > 0:
            start = halved(
                fit.unknowns, which, fit.prior.radius, self.operator.pitch, self._changing
            )
            count, which = len(fit.unknowns.contacts), which + 1
            if start is not None:
                # with the sensor as expected, or bent to the long one, whichever is nearer
                expected = as_known(start, self._expected(fit.rows, fit.prior))
                starts = [self._begun(each, fit, 2) for each in (expected, start)]
                begun = min(starts, key=lambda each: each.cost)
                tried = solved(begun.unknowns, begun, goal=fit.cost)
                if not overlaps(tried.unknowns.contacts, len(start.contacts) - 1):
                    whole = solved == self._solve
                    one = partial(self._one_or_two, fit, which - 1)
                    fit = one(tried) if whole else self._likelier(fit, tried)
            if len(fit.unknowns.contacts) > count:  # both are the last ones now
                which -= 1
        return fit

    def _next(self, fit: Fit) -> tuple[np.ndarray | None, float]:
        """Place (2,), m, and conductance, S, of the contact that would explain most beside those of
        a fit; None, 0 if noise may."""
        if self._asked is None or self._asked[0] is not fit:
            self._asked = fit, self._next_of(fit)
        return self._asked[1]

    def _next_of(self, fit: Fit) -> tuple[np.ndarray | None, float]:
        gains, strengths = self.detector.gains(fit)
        for contact in fit.unknowns.contacts:
            apart = np.hypot(*(self.detector.pixels - contact[:2]).T)
            gains[apart < 1.3 * np.exp(contact[RADIUS]) + self.detector.side] = 0.0
        best = int(gains.argmax())
        fit.promised = float(gains[best])
        if gains[best] < max(self._threshold, _NEW * self._refused):
            return None, 0.0
        return self.detector.pixels[best], strengths[best]

    def _one_more(self, fit: Fit) -> Fit | None:
        place, strength = self._next(fit)
        if place is None:
            return None
        found = self._started(fit, place, strength)
        if fit.cost - found.cost < self._threshold * found.doubt:
            return None
        contacts = found.unknowns.contacts
        if contacts[-1, CONDUCTANCE] < contacts[:, CONDUCTANCE].max() + np.log(DYNAMIC):
            return None
        if overlaps(contacts, len(contacts) - 1):
            return None
        return found

    def _started(self, fit: Fit, place: np.ndarray, strength: float) -> Fit:
        """The best fit with one more contact at `place` (2,) of conductance `strength` (S)."""
        start = self._added(fit.unknowns, place, strength, fit.prior.radius)
        found = self._begin(start, fit, 1)
        return self._other_sizes(found, len(found.unknowns.contacts) - 1)


def _is_likely(apart: np.ndarray, prior: Prior) -> bool:
    """Whether sheet and channels may be so far `apart` (J + 3 n,) from what is expected."""
    return bool(apart @ prior.pull(apart) < chdtri(len(apart), FALSE_ALARMS))


def further_aside(fit: Fit) -> float:
    """How many times as far aside electrodes lie as was expected of them, rms."""
    aside = (fit.unknowns.aside - fit.prior.aside) / fit.prior.deviations[3:]
    return float(np.sqrt(np.mean(aside**2)))


def is_misplaced(fit: Fit) -> bool:
    """Whether contacts explain the readings but for places of electrodes that were not expected so."""
    explained = fit.chi_squared < _BUT_FOR_PLACES * fit.rows.count
    return explained and further_aside(fit) > _ASIDE


def tells_speeds(fit: Fit) -> bool:
    """Whether the readings of a fit of contacts that move tell how fast they are."""
    return bool((_spread(fit) < _TOLD * np.array(fit.prior.rates[:2])).all())


def _spread(fit: Fit) -> np.ndarray:
    """(k, 2) standard deviation of the velocity of each contact, all of which move, m/s."""
    rates = fit.covariance.diagonal()[np.count_nonzero(fit.unknowns.free) :]
    return np.sqrt(rates.reshape(-1, len(RATED))[:, :2] * fit.doubt)


def _left(fit: Fit) -> float:
    """What a fit leaves over in parts of noise: so much less sure is what it says of parts."""
    return max(fit.chi_squared / fit.rows.count, 1.0)
