"""Contacts one by one, each as long as the readings ask for it.

The matched filter says where one more contact would explain most; the fit then moves all of them. A contact is there
if it lowers the cost (minus twice the logarithm of the posterior) by more than noise does anywhere on the sheet
but with the stated probability, a chi-squared test with its four parameters for as many places as can be told apart
(Wilks 1938; look-elsewhere by Bonferroni). What the model cannot explain is no white noise: readings of one electrode err
together, so the threshold grows with the excess of chi-squared for each electrode (`Fit.doubt`).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from tomotactile_ros.estimation.detection import Detector
from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.solver import STEPS, Fit, Prior, Rows, solve
from tomotactile_ros.estimation.touch import CONDUCTANCE, RADIUS, patches_for, touches

FALSE_ALARMS = 1e-7  # contacts a frame that noise alone may show
_FORM = 4  # parameters of a disc
_RADII = (0.5, 2.0, 4.0)  # times the radius at which a fit ended that explains too little
_FILLED = 0.6  # largest part of the conductance of a bare conductor at which a fit starts
_DYNAMIC = 0.02  # of the strongest contact: what the form of a contact is not known to
_OFFSETS = 5.0  # standard deviations of offsets: larger readings come from contacts
_OVERLAP = 0.9  # of the larger radius: contacts nearer to each other are one
_DOUBTFUL = 0.2  # of the strongest: weaker contacts are tried without
_CLOSE = 1.5  # spacings: contacts nearer to each other are tried as one
_MISFIT = 3.0  # chi-squared per reading above which other starts are tried
MOST = 12  # discs
BUDGET = 200  # Gauss-Newton steps times discs for one frame: what no few discs explain is given up


class Search:
    """Finds contacts in rows of a sensor."""

    def __init__(self, operator: SheetOperator):
        self.operator = operator
        self.detector = Detector(operator)
        self._left = 0  # of the budget for the frame at hand
        self._threshold = chi2.isf(FALSE_ALARMS / len(self.detector.pixels), _FORM)

    def contacts(
        self, rows: Rows, prior: Prior, start: Unknowns | None = None, budget: int = BUDGET
    ) -> Fit:
        """The fit with as many contacts as the readings ask for, from those of `start` on."""
        operator, self._left = self.operator, budget
        unknowns = start or resting(operator, prior)
        quiet = self.untouched(rows, prior)
        if quiet is not None:
            return quiet
        fit = Fit(operator, unknowns, rows, prior)
        if not len(unknowns.contacts):
            fit = self._first(fit)
        else:
            fit = self._without_idle(self._solve(unknowns, fit))
        before = len(fit.unknowns.contacts)
        while len(fit.unknowns.contacts) < MOST and self._left > 0:
            more = self._one_more(fit)
            if more is None:
                break
            fit = more
        return self._simplified(fit) if len(fit.unknowns.contacts) > before else fit

    def _solve(self, start: Unknowns, like: Fit, steps: int = STEPS) -> Fit:
        """The best fit from `start` of the rows that `like` is a fit of."""
        fit = solve(self.operator, start, like.rows, like.prior, steps)
        self._left -= fit.steps * len(start.contacts)
        return fit

    def untouched(self, rows: Rows, prior: Prior) -> Fit | None:
        """The fit without contacts, where offsets of the channels may be all there is, and are; else None."""
        rest = Fit(self.operator, resting(self.operator, prior), rows, prior)
        largest = (_OFFSETS * prior.deviations[1]) ** 2
        if rest.chi_squared > (rows.weights * largest).sum() + 2.0 * rows.count:
            return None
        rest = solve(self.operator, rest.unknowns, rows, prior)
        return None if self.sees_more(rest) else rest

    def sees_more(self, fit: Fit) -> bool:
        """Whether one more contact somewhere would explain more than noise does."""
        gains, _ = self.detector.gains(fit.prediction, fit.rows, fit.misfit)
        return bool(gains.max() > self._threshold)

    def _first(self, fit: Fit) -> Fit:
        """The fit of what a first look at the frame shows."""
        gains, _ = self.detector.gains(fit.prediction, fit.rows, fit.misfit)
        if gains.max() < self._threshold:
            return fit
        seen = self.detector.first_look(fit.rows)[:MOST]
        unknowns = fit.unknowns
        for place, strength in seen:
            unknowns = self._added(unknowns, place, strength, fit.prior.radius)
        found = self._simplified(self._solve(unknowns, fit))
        for which in range(len(found.unknowns.contacts)):
            found = self._other_sizes(found, which)
        return found

    def _one_more(self, fit: Fit) -> Fit | None:
        gains, strengths = self.detector.gains(fit.prediction, fit.rows, fit.misfit)
        contacts = fit.unknowns.contacts
        for contact in contacts:
            apart = np.hypot(*(self.detector.pixels - contact[:2]).T)
            gains[apart < 1.3 * np.exp(contact[3]) + self.detector.side] = 0.0
        best = int(gains.argmax())
        if gains[best] < self._threshold:
            return None
        found = self._started(fit, self.detector.pixels[best], strengths[best])
        if fit.cost - found.cost < self._threshold * found.doubt:
            return None
        contacts = found.unknowns.contacts
        if contacts[-1, CONDUCTANCE] < contacts[:, CONDUCTANCE].max() + np.log(_DYNAMIC):
            return None
        if overlaps(contacts, len(contacts) - 1):
            return None
        return found

    def _started(self, fit: Fit, place, strength) -> Fit:
        """The best fit with one more contact at `place` (2,) of conductance `strength` (S)."""
        start = self._added(fit.unknowns, place, strength, fit.prior.radius)
        found = self._solve(start, fit)
        return self._other_sizes(found, len(found.unknowns.contacts) - 1)

    def _other_sizes(self, fit: Fit, which: int) -> Fit:
        """The same or a better fit that starts with contact `which` smaller or larger, if this one explains too little."""
        for factor in _RADII:
            if fit.chi_squared < _MISFIT * fit.rows.count or self._left <= 0:
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
            tried = self._solve(start, fit)
            if tried.cost < fit.cost:
                back = np.insert(np.arange(len(keep) - 1), which, len(keep) - 1)
                fit = self._solve(chosen(tried.unknowns, back), fit, 1)
        return fit

    def _added(self, unknowns, place, strength, radius) -> Unknowns:
        across = patches_for(radius, self.operator.pitch)
        contact = np.array([*place, 0.0, np.log(radius), 0.0, 0.0])
        (touch,), _ = touches(
            self.operator,
            contact[None],
            [across],
            np.zeros((1, 6), bool),
            np.zeros(self.operator.modes),
        )
        contact[2] = np.log(min(strength, _FILLED / max(touch.mean, 1e-9)))
        free = np.array([True] * _FORM + [False] * 2)
        return unknowns.with_contacts(
            np.vstack([unknowns.contacts, contact]),
            (*unknowns.across, across),
            np.vstack([unknowns.free, free]),
        )

    def _simplified(self, fit: Fit) -> Fit:
        """As few contacts as explain the readings as well: weakest first, each is left to its nearest neighbour."""
        tested: set[bytes] = set()
        while len(fit.unknowns.contacts) > 1 and self._left > 0:
            order = np.argsort(fit.unknowns.contacts[:, CONDUCTANCE])
            untested = [i for i in order if fit.unknowns.contacts[i, :2].tobytes() not in tested]
            fewer = None
            for weakest in untested:
                contacts = fit.unknowns.contacts
                tested.add(contacts[weakest, :2].tobytes())
                one = overlaps(contacts, weakest)
                if not one and not self._may_go(contacts, weakest):
                    continue
                tried = self._solve(merged(fit.unknowns, weakest), fit)
                if one or tried.cost < fit.cost + self._threshold * fit.doubt:
                    fewer = tried
                    break
            if fewer is None:
                break
            fit = fewer
        return self._without_idle(fit)

    def _may_go(self, contacts, which) -> bool:
        """Whether a contact is so weak, or so near a stronger one, that it may be none of its own."""
        others = np.delete(contacts, which, axis=0)
        apart = np.hypot(*(others[:, :2] - contacts[which, :2]).T).min()
        weak = contacts[which, CONDUCTANCE] < contacts[:, CONDUCTANCE].max() + np.log(_DOUBTFUL)
        return weak or apart < _CLOSE * self.operator.pitch

    def _without_idle(self, fit: Fit) -> Fit:
        """Contacts below the dynamic range are taken out again, weakest first."""
        while len(fit.unknowns.contacts) > 1:
            strengths = fit.unknowns.contacts[:, CONDUCTANCE]
            weakest = int(strengths.argmin())
            if strengths[weakest] > strengths.max() + np.log(_DYNAMIC):
                break
            keep = np.arange(len(strengths)) != weakest
            fit = self._solve(chosen(fit.unknowns, keep), fit)
        return fit


def overlaps(contacts: np.ndarray, which: int) -> bool:
    """Whether a contact and another one lie on each other, so that they are one thing that presses."""
    others = np.delete(contacts, which, axis=0)
    apart = np.hypot(*(others[:, :2] - contacts[which, :2]).T)
    reach = np.exp(np.maximum(others[:, RADIUS], contacts[which, RADIUS]))
    return bool((apart < _OVERLAP * reach).any())


def merged(unknowns: Unknowns, which: int) -> Unknowns:
    """The same without contact `which`, whose conductance its nearest neighbour takes over."""
    contacts = unknowns.contacts.copy()
    apart = np.hypot(*(contacts[:, :2] - contacts[which, :2]).T)
    apart[which] = np.inf
    nearest = int(apart.argmin())
    own, other = np.exp(contacts[[which, nearest], CONDUCTANCE])
    if own > 0.1 * other:
        part = own / (own + other)
        contacts[nearest, :2] += part * (contacts[which, :2] - contacts[nearest, :2])
    keep = np.arange(len(contacts)) != which
    return chosen(replace(unknowns, contacts=contacts), keep)


def chosen(unknowns: Unknowns, keep) -> Unknowns:
    """The same with only the contacts `keep` (mask or indices)."""
    across = tuple(np.array(unknowns.across, int)[keep].tolist())
    return unknowns.with_contacts(unknowns.contacts[keep], across, unknowns.free[keep])


def resting(operator: SheetOperator, prior: Prior) -> Unknowns:
    """No contact; sheet and channels as expected."""
    return replace(
        Unknowns.at_rest(operator),
        sheet=prior.sheet,
        gain=prior.gain,
        offset=prior.offset,
        resistance=prior.resistance,
    )
