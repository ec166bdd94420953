"""Fits of given contacts within a budget of work, with patches as fine as each contact asks for; from other
starts, where a fit may have ended short of the best; and with as few contacts as explain as much.

Which contacts there are, `search` says.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np

from tomotactile_ros.estimation.arrangement import (
    CLOSE,
    are_long,
    as_known,
    chosen,
    clusters,
    gathered,
    merged,
    other_sides,
    overlaps,
    with_disc,
)
from tomotactile_ros.estimation.equations import Equations, Linear, similar
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.solver import STEPS, approach, solve
from tomotactile_ros.estimation.touch import CONDUCTANCE, RADIUS, STRETCH, patches_for, patches_of
from tomotactile_ros.layouts.region import enclosed

_RADII = (0.5, 2.0, 4.0)  # times the radius at which a fit ended that explains too little
# times the typical radius: starts with the sensor held as it is known; at the first look as well
# (without: 2 of 12 textbook presses 0.7 and 1 mm off, said to be known to 0.05)
SIZES = (0.5, 1.0, 2.0)
FILLED = 0.6  # largest part of the conductance of a bare conductor at which a fit starts
DYNAMIC = 0.02  # of the strongest contact: what the form of a contact is not known to
_WIDENED = (
    2.0  # times the radius at which a fit ended beyond the electrodes: there it is seen worst
)
_WIDER = 1.0  # of ln a: so much wider a contact is made at once
_DOUBTFUL = 0.2  # of the strongest: weaker contacts are tried without
# times the threshold: a contact that a linear test is so sure of is not tried without
_CERTAIN = 2.0
_DOUBT = 10.0  # beyond, a fit is not one whose contacts are too many but one that came to nothing
_WORTH = 10.0  # times the goal: from there on patches of another size are not worth trying
# chi-squared per reading above which other starts are tried, and contacts are moved alone first
MISFIT = 3.0
# discs: more are one wide shape and get coarser patches; patches to the width: of these: finer ones
# cost four times as much and are no truer; a plate of 60 mm at 89 N came out at 103 N with up to
# 14, at 89 N with 5
_FEW, _COARSE = 3, 5
# patches to the width of a disc that an electrode or the rim of the sheet is near: with 4 a disc that the sheet's
# rim nearly cut, beyond the outermost electrodes, was 4 deviations off
_AT_ELECTRODE, _AT_RIM = 4, 6
_MEETS = 1.1  # of its radius: how far from a disc's centre the rim of an electrode is that it meets
_RIM = 2.0  # of its radius: how far from a disc's centre the rim of the sheet is that it is near
# patches to the width of a contact that moves: with 8 a wide touch that begins was withheld, with
# 14 a tap took 4.5 s
_IN_MOTION = 10
# chi^2: above it other numbers and shapes of new contacts are tried: right ones leave at most 1.05
# where electrodes may be misplaced; at 3, two contacts 25 mm apart were one in 1 of 40 crowds
LEFT_OVER = 1.1
LEAST_WORK = 3000  # the same of one fit, whatever is left: about half a second
# of what is left beyond the shape: after one whole step from discs, the best fit of them leaves so
# much: 0.6 to 0.9 where one step leaves less than three times the noise, and where it leaves more a
# twentieth would do (parts `wide`, `wide-channels`)
_AT_LEAST = 0.25
FORM = 4  # parameters of a disc
# of the cost: what each parameter more of contacts near each other is worth, where noise makes two of one of 50 long
# ones (chi-squared, two parameters)
WITHIN = -float(np.log(0.02))
_KEPT = 8  # fits that are remembered: one is reported, and one as what may be as well


class Fits:
    """Fits for one sensor, with at most `across` patches to the width of each contact; `threshold` : of
    the cost, what one contact more must explain."""

    def __init__(self, operator: SheetOperator, across: int, threshold: float):
        self.operator, self.across, self._threshold = operator, across, threshold
        self._left = 0.0  # of the budget for the frame at hand
        self._spent = False  # whether that was not enough
        self._known: Equations | None = None  # with which the last fit ended
        self._simple: Fit | None = None  # the last answer of `_simplified`
        self._changing = False  # whether motion is the likeliest reason of what is left over
        # of the rows at hand the likeliest of each number and places of contacts, and their prices
        self._tried: list[tuple[float, Fit]] = []

    def _begin(self, start: Unknowns, like: Fit, new: int, goal: float = np.inf) -> Fit:
        """The best fit from `start`, see `_solve` and `_begun`."""
        begun = self._begun(start, like, new)
        return self._solve(begun.unknowns, begun, goal=goal)

    def _solve(self, start: Unknowns, like: Fit, steps: int = STEPS, goal: float = np.inf) -> Fit:
        """The best fit from `start` of the rows that `like` is a fit of; given up where `goal`
        seems out of reach."""
        start = self._coarse(start)
        at = like if like.unknowns is start else Fit(self.operator, start, like.rows, like.prior)
        far = at.chi_squared > MISFIT * at.rows.count  # from the touch that goes on, say
        if far and like.prior.learned and len(start.contacts):
            at = Fit(self.operator, self._settled(start, like), like.rows, like.prior)
        if steps > 1 and len(start.contacts) and not at.steps:
            at = self._approached(at)
        most = max(self._left, LEAST_WORK)
        given = self.operator, at.unknowns, like.rows, like.prior, steps, self._known, goal
        fit = solve(*given, at, most)
        self._known = fit.equations
        across = self._patches(fit.unknowns)
        if across != fit.unknowns.across and fit.cost < _WORTH * goal:
            finer = replace(fit.unknowns, across=across)
            work = fit.work
            given = self.operator, finer, like.rows, like.prior, steps, self._known, goal
            fit = solve(*given, most=most)
            fit.work += work
        self._left -= fit.work
        self._remember(fit)
        return fit

    def _remember(self, fit: Fit) -> None:
        """Keep a fit that was tried if it is the likeliest of its number and places of contacts, and among the
        likeliest of all."""
        if self._tried and self._tried[0][1].rows is not fit.rows:
            self._tried = []
        contacts, pitch = fit.unknowns.contacts, self.operator.pitch
        alike = [
            i for i, e in enumerate(self._tried) if similar(contacts, e[1].unknowns.contacts, pitch)
        ]
        price = self.price(fit)
        if any(self._tried[i][0] <= price for i in alike):
            return
        if fit.unknowns.bond is None:  # its equations would take as much memory as all else
            fit = Fit(self.operator, fit.unknowns, fit.rows, fit.prior, core=fit.core)
        others = [each for i, each in enumerate(self._tried) if i not in alike]
        self._tried = sorted([*others, (price, fit)], key=lambda each: each[0])[:_KEPT]

    def price(self, fit: Fit, doubt: float = 1.0) -> float:
        """Minus twice the logarithm of the evidence for a fit of discs, doubted: its cost, for contacts near each other
        what one that noise shows anywhere may take off it, and for each parameter more of theirs what these may."""
        u = fit.unknowns
        things = int(clusters(u.contacts, self.operator.pitch).max(initial=-1)) + 1
        more = np.count_nonzero(u.free) - FORM * things
        return fit.cost / doubt + self._threshold * things + WITHIN * more

    def _approached(self, fit: Fit) -> Fit:
        """The same, or nearer where it leaves much over."""
        if fit.chi_squared < MISFIT * fit.rows.count:
            return fit
        fit = approach(fit, self._left)
        self._left -= fit.work
        return self._wide_enough(fit, _are_bare(fit))

    def _most_across(self, unknowns: Unknowns) -> int:
        """Patches to the width of each contact at most: fewer of many, which together are one wide
        shape, and of contacts that move, whose form shows later."""
        if len(unknowns.contacts) > _FEW:
            return min(_COARSE, self.across)
        return min(_IN_MOTION, self.across) if np.any(unknowns.moving) else self.across

    def _patches(self, unknowns: Unknowns) -> tuple[int, ...]:
        """Patches across each contact as its radius asks for, or what it has where that is near."""
        most, least = self._most_across(unknowns), self._least_across(unknowns.contacts)
        return tuple(
            self._across(each, had, fewest, most)
            for each, had, fewest in zip(unknowns.contacts, unknowns.across, least)
        )

    def _across(self, contact: np.ndarray, before: int, least: int, most: int) -> int:
        wanted = patches_of(contact, self.operator.pitch, before < 0)
        wanted = min(max(wanted, least) if wanted > 0 else wanted, most)
        if wanted * before < 0:
            return wanted
        more = abs(wanted) - abs(before)
        return wanted if more > 0 or more < -2 else before

    def _coarse(self, unknowns: Unknowns) -> Unknowns:
        """The same with no more patches than so many contacts, or those that move, are allowed, and as
        many as the rims of electrodes and sheet ask for."""
        most, least = self._most_across(unknowns), self._least_across(unknowns.contacts)
        across = tuple(
            min(had if had < 0 else max(had, int(fewest)), most)
            for had, fewest in zip(unknowns.across, least)
        )
        return unknowns if across == unknowns.across else replace(unknowns, across=across)

    def _least_across(self, contacts: np.ndarray) -> np.ndarray:
        """(k,) patches to the width of each of contacts (k, 6) at least: where rims are near it."""
        if not len(contacts):
            return np.empty(0, int)
        depth = self.operator.layout.outline.depth(contacts[:, :2])[0]
        near = depth < _RIM * np.exp(contacts[:, RADIUS])
        return np.where(near, _AT_RIM, np.where(self.meets_electrode(contacts), _AT_ELECTRODE, 1))

    def meets_electrode(self, contacts: np.ndarray) -> np.ndarray:
        """(k,) which of contacts (k, 6) cover a part of an electrode, or nearly."""
        layout, used = self.operator.layout, self.operator.used
        apart = contacts[:, None, :2] - layout.positions[used]
        gaps = np.hypot(*apart.transpose(2, 0, 1)).min(axis=1) - layout.radius
        return gaps < _MEETS * np.exp(contacts[:, RADIUS])

    def _settled(self, start: Unknowns, like: Fit) -> Unknowns:
        """Contacts from `start` on, also from other sizes, with the sensor held as it was
        learned."""
        held = like.prior.held()
        best: Fit | None = None
        for factor in (None, *SIZES):
            contacts, across = start.contacts.copy(), start.across
            if factor is not None:
                contacts[:, RADIUS] = np.log(factor * like.prior.radius)
                patches = patches_for(factor * like.prior.radius, self.operator.pitch)
                across = (patches,) * len(contacts)
            own = replace(as_known(start, held), contacts=contacts, across=across)
            fit = solve(self.operator, own, like.rows, held, STEPS, self._known)
            self._left -= fit.work
            best = fit if best is None or fit.cost < best.cost else best
            if best.chi_squared < MISFIT * like.rows.count:
                break
        assert best is not None  # there is a first start
        return best.unknowns

    def _beyond(self, fit: Fit, which: int) -> Fit:
        """The same or a better fit that starts with contact `which` on another side of the electrode next to
        it, off the rim, and then wider, if it ended beyond the outermost electrodes: what lies there is seen through
        few electrodes and mirrored in the rim, and the sheet may be bent to what a contact elsewhere
        explains."""
        operator, outline = self.operator, self.operator.layout.outline
        contact = fit.unknowns.contacts[which]
        place = contact[:2]
        centres = operator.layout.positions[operator.used]
        if self._left <= 0 or enclosed(place[None], centres, operator.layout.radius)[0]:
            return fit
        centre = centres[np.hypot(*(centres - place).T).argmin()]
        inwards = np.exp(contact[RADIUS]) * outline.depth(place[None])[1][0]
        found = fit
        for start in (place + inwards, *other_sides(place, centre)):
            if not outline.contains(start[None])[0]:
                continue
            contacts = fit.unknowns.contacts.copy()
            contacts[which, :2] = start
            tried = self._solve(replace(fit.unknowns, contacts=contacts), fit, goal=found.cost)
            found = tried if tried.cost < found.cost else found
        contacts = found.unknowns.contacts.copy()
        contacts[which, RADIUS] += np.log(_WIDENED)
        start = self._coarse(replace(found.unknowns, contacts=contacts))
        tried = solve(self.operator, start, fit.rows, fit.prior, STEPS, self._known)  # all at once
        self._left -= tried.work
        return tried if tried.cost < found.cost else found

    def _other_sizes(self, fit: Fit, which: int) -> Fit:
        """The same or a better fit that starts with contact `which` smaller or larger, if this one
        explains too little."""
        for factor in _RADII:
            if fit.chi_squared < MISFIT * fit.rows.count or self._left <= 0:
                break
            unknowns = fit.unknowns
            radius = float(np.exp(unknowns.contacts[which, RADIUS])) * factor
            keep = np.arange(len(unknowns.contacts)) != which
            start = self._added(
                chosen(unknowns, keep),
                unknowns.contacts[which, :2],
                np.exp(unknowns.contacts[which, CONDUCTANCE]),
                radius,
            )
            tried = self._begin(start, fit, 1, goal=fit.cost)
            if tried.cost < fit.cost:
                back = np.insert(np.arange(len(keep) - 1), which, len(keep) - 1)
                fit = self._solve(chosen(tried.unknowns, back), fit, 1)
        return fit

    def _added(
        self, unknowns: Unknowns, place: Iterable[float], strength: float, radius: float
    ) -> Unknowns:
        """The same with a disc at `place` (2,), m, of conductance `strength`, S, and `radius`, m, at
        the end."""
        return with_disc(unknowns, place, strength, radius, self.operator.pitch, self._changing)

    def _begun(self, start: Unknowns, like: Fit, new: int) -> Fit:
        """Where a fit of the rows of `like` begins, whose last `new` contacts were never fitted."""
        fit = Fit(self.operator, self._coarse(start), like.rows, like.prior)
        return self._wide_enough(fit, np.arange(len(start.contacts)) >= len(start.contacts) - new)

    def _wide_enough(self, fit: Fit, which: np.ndarray) -> Fit:
        """The same with contacts `which` (k,) as wide as they must be to conduct as they do.

        What a contact conducts shows well, its width hardly: of those that conduct more than most bare
        conductors of their width do, the width is wrong. Mean D falls by R_s / 2 pi with the
        logarithm of the radius.
        """
        contacts, across = fit.unknowns.contacts.copy(), list(fit.unknowns.across)
        ways = FILLED * np.exp(-contacts[:, CONDUCTANCE])
        which = which & (fit.prediction.means > ways)
        if not which.any():
            return fit
        excess = (fit.prediction.means - ways)[which] * 2 * np.pi / self.operator.resistance
        contacts[which, RADIUS] += np.minimum(excess, _WIDER)
        for i, wanted in enumerate(self._patches(replace(fit.unknowns, contacts=contacts))):
            if which[i]:
                across[i] = wanted
        wider = replace(fit.unknowns, contacts=contacts, across=tuple(across))
        begun = Fit(self.operator, wider, fit.rows, fit.prior)
        most = np.log(FILLED / np.maximum(begun.prediction.means, 1e-9))
        if not (which & (contacts[:, CONDUCTANCE] > most)).any():
            return begun
        kept = np.where(which, np.minimum(contacts[:, CONDUCTANCE], most), contacts[:, CONDUCTANCE])
        contacts[:, CONDUCTANCE] = kept
        return Fit(self.operator, replace(wider, contacts=contacts), fit.rows, fit.prior)

    def _simplified(self, fit: Fit) -> Fit:
        """As few contacts as explain the readings as well: those near each other as one, then each
        left to its neighbour; whatever is left of the budget, as long as these explain them."""
        if fit is self._simple:
            return fit
        self._go_on()
        fit = self._gathered(fit)
        tested: set[bytes] = set()
        while len(fit.unknowns.contacts) > 1:
            if fit.chi_squared < LEFT_OVER * fit.rows.count:
                self._go_on()
            order = np.argsort(self._certainties(fit))
            untested = [i for i in order if fit.unknowns.contacts[i, :2].tobytes() not in tested]
            fewer = None
            for weakest in untested:
                contacts = fit.unknowns.contacts
                tested.add(contacts[weakest, :2].tobytes())
                one = overlaps(contacts, weakest)
                if not one and (self._left <= 0 or not self._may_go(fit, int(weakest))):
                    continue
                limit = fit.cost + self._threshold * fit.doubt
                tried = self._solve(
                    merged(fit.unknowns, int(weakest), _are_bare(fit)),
                    fit,
                    goal=np.inf if one else limit,
                )
                if one or tried.cost < limit:
                    fewer = tried
                    break
            if fewer is None:
                break
            fit = fewer
        self._simple = self._without_idle(fit)
        self._simple.needed = self._simple.unknowns.contacts
        return self._simple

    def _go_on(self) -> None:
        """Leave enough for one more fit, whatever was spent."""
        self._spent = self._spent or self._left <= 0
        self._left = max(self._left, LEAST_WORK)

    def _gathered(self, fit: Fit) -> Fit:
        """The same or a fit with one wide contact in the place of several near each other."""
        contacts = fit.unknowns.contacts
        if len(contacts) < 2:
            return fit
        group = clusters(contacts, self.operator.pitch)
        for each in np.unique(group):
            of = np.flatnonzero(group == each)
            if len(of) < 2 or len(group) != len(fit.unknowns.contacts) or self._left <= 0:
                continue
            long = are_long(contacts[of]).any()
            certain = not any(self._may_go(fit, int(which)) for which in of)
            if len(of) > _FEW and certain and not long:
                continue
            limit = fit.cost + (len(of) - 1) * self._threshold * min(fit.doubt, _DOUBT)
            begun = self._begun(gathered(fit.unknowns, of, self.operator.pitch), fit, 0)
            if not long and least_after(self._after_a_step(begun), fit) > limit:
                continue
            tried = self._solve(begun.unknowns, begun, goal=limit)
            if len(of) == 2:
                tried = self._one_or_two(tried, -1, fit)
            elif tried.cost >= limit:
                continue
            if tried is not fit:
                return self._gathered(tried)
        return fit

    def _after_a_step(self, fit: Fit) -> float:
        """The cost that one whole step from a fit leads to, to first order."""
        linear = Linear(fit, self._known)
        self._known = linear.equations
        return fit.cost - linear.promise

    def _one_or_two(self, one: Fit, which: int, two: Fit) -> Fit:
        """`one`, with contact `which` as an ellipse or a bar, or a fit with `two` discs in the place of it, each more of
        their parameters at its price: that something touches there is not asked."""
        more = np.count_nonzero(two.unknowns.free) - np.count_nonzero(one.unknowns.free)
        price = more * WITHIN * two.doubt
        if one.cost < two.cost + price:
            return one
        bar = patches_of(one.unknowns.contacts[which], self.operator.pitch, bar=True)
        if bar > 0 or one.unknowns.across[which] < 0 or not one.unknowns.free[which, STRETCH]:
            return two
        across = list(one.unknowns.across)
        across[which] = bar
        goal = two.cost + price
        one = self._solve(replace(one.unknowns, across=tuple(across)), one, goal=goal)
        return one if one.cost < goal else two

    def _certainties(self, fit: Fit) -> np.ndarray:
        """(k,) conductance of each contact over its deviation, squared."""
        free = fit.unknowns.free
        at = np.cumsum(free.sum(axis=1)) - free.sum(axis=1) + free[:, :CONDUCTANCE].sum(axis=1)
        return 1 / fit.covariance.diagonal()[at]

    def _may_go(self, fit: Fit, which: int) -> bool:
        """Whether a contact may be none of its own: weak, or near a stronger one, and not certain to
        conduct whatever the others do (Wald 1943)."""
        if self._certainties(fit)[which] > _CERTAIN * self._threshold * fit.doubt:
            return False
        contacts = fit.unknowns.contacts
        others = np.delete(contacts, which, axis=0)
        apart = np.hypot(*(others[:, :2] - contacts[which, :2]).T).min()
        weak = contacts[which, CONDUCTANCE] < contacts[:, CONDUCTANCE].max() + np.log(_DOUBTFUL)
        return weak or apart < CLOSE * self.operator.pitch

    def _without_idle(self, fit: Fit) -> Fit:
        """Contacts below the dynamic range are taken out again, weakest first."""
        while len(fit.unknowns.contacts) > 1:
            strengths = fit.unknowns.contacts[:, CONDUCTANCE]
            weakest = int(strengths.argmin())
            if strengths[weakest] > strengths.max() + np.log(DYNAMIC):
                break
            keep = np.arange(len(strengths)) != weakest
            fit = self._solve(chosen(fit.unknowns, keep), fit)
        return fit


def _are_bare(fit: Fit) -> np.ndarray:
    """(k,) which contacts conduct more than the way to them."""
    return fit.prediction.means > np.exp(-fit.unknowns.contacts[:, CONDUCTANCE])


def least_after(left: float, fit: Fit) -> float:
    """The least cost of other contacts, of which one step leads to `left`, beside a fit: no less than noise."""
    least = min(left, fit.chi_squared + _AT_LEAST * (left - fit.chi_squared))
    return max(least, min(fit.chi_squared, float(fit.rows.count)))
