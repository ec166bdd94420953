"""Frames in, contacts with their uncertainty out.

What is left out, and why, is part of the answer: channels that contradict all others, rows from
before a change, frames that no contacts explain.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from contextlib import suppress
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from scipy.special import chdtri

from tomotactile_ros.estimation.arrangement import CLOSE, as_known, with_disc
from tomotactile_ros.estimation.as_cut import COUNT, AsCut, Tears
from tomotactile_ros.estimation.channels import SENSOR, UNKNOWN, ChannelPrior
from tomotactile_ros.estimation.equations import SAME, Equations, similar
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.fits import MISFIT
from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.ground import (
    ALIKE,
    DISTURBED,
    OR_HUM,
    OR_MANY,
    UNLIKE,
    ground_is_doubtful,
    rows_are_alike,
)
from tomotactile_ros.estimation.information import information
from tomotactile_ros.estimation.joining import groups
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.one_state import (
    TORN,
    Reciprocity,
    channels_alone,
    reciprocity,
    without_contradicting,
)
from tomotactile_ros.estimation.operator import SheetOperator, operator_for
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.reported import (
    ANYWHERE,
    Contact,
    Estimate,
    contacts_of,
    joined,
    may_be_anywhere,
    meets_rims,
    unmatched,
)
from tomotactile_ros.estimation.reported_shape import contacts_of_shape
from tomotactile_ros.estimation.scatter import scatter
from tomotactile_ros.estimation.screening import (
    AT_DRIVE,
    OPEN,
    STUCK,
    clipped,
    dead_channels,
    driven_channels,
    latest_state,
    open_grounds,
    stuck_channels,
    too_many_are_bad,
    without_channels,
)
from tomotactile_ros.estimation.search import (
    BUDGET,
    CUT_OFF,
    FALSE_ALARMS,
    FIRST_LOOK,
    SUSPECT,
    TOLD,
    Misplaced,
    Search,
    further_aside,
    is_misplaced,
    tells_speeds,
)
from tomotactile_ros.estimation.settling import Settling, rows_before, unsettled
from tomotactile_ros.estimation.tears import EXPLAIN, couplings, find_tears, refined
from tomotactile_ros.estimation.touch import CONDUCTANCE, MOST_ACROSS, RADIUS
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.scenes.contact import ContactLaw
from tomotactile_ros.support.errors import InputError

# why an electrode is left out
EXCLUDED, CONTRADICTS = "excluded by the settings", "its readings contradict all others"
AT_END = "most readings are at the end of the converter's range: too much presses to say how much"
CHANGED = "something changed in the last rows of the frame, which alone are too few to say what"
# resistances to ground below 0, in deviations of what is expected of them, and rows that tell of them:
# unevenness and errors of a coarse mesh made up to 1.7, electrodes of 3.5 mm for 2.5 make 2.3, hum of 20 mV 2.6
_IMPOSSIBLE, _FEWEST_JUDGED = 2.4, 8
# chi^2 a reading, from which on a fit is of another sheet if rows obey reciprocity: no frame of the frozen set
# leaves 2, those of torn sheets 28 and more, and contacts were 6 mm off
_OTHER_SHEET = 20.0
_KEPT = 4  # operators for sets of electrodes in use
# the same from which on nothing is said; errors of 8 standard deviations everywhere
_REFUSED = 60.0
# chi^2: the least from which on nothing is said where the noise is what readings showed: `_REFUSED`
# is of the noise that was said, in V the same with more. Twice what `_MOST_OF_IT` leaves. With an
# open ground, swapped wires and 10 mV of noise, 41 was a ghost 20 mm off
_BESIDE_NOISE = 4.0
# variance in parts of what was expected, from which on noise is larger; and the part of chi-squared that
# it then is: what the model lacks is not noise
_NOISIER, _MOST_OF_IT = 1.5, 0.5
# of V0 of the mean of all readings, 13 mV with 16 electrodes and 52 mV with 64 at 3.3 V: frames
# that scatter more are withheld. Without it, of random frames of 16 electrodes with one to three
# contacts, a contact was missed or beyond 3.7 of its deviations in 1 of 60 at 10 mV, 4 of 60 at 12
# mV, 8 of 90 at 15 mV, 11 of 60 at 30 mV
_MOST_NOISE = 2.5e-4
_FEWEST = 2  # rows that contacts are found from
_FEWEST_READINGS = 8  # a contact has four unknowns
# last rows of a frame that are looked at alone where it changes: of half as many where these contradict
# each other, else of twice as many, again and again
_WINDOW = 4
_SAME_TIME = 1e-6  # s
# chi^2 a reading that contacts which go on leave over, from which on it is asked whether readings
# have settled: with 3 %, contacts 1.3 mm off went on
_UNEXPLAINED = 1.3
# chi^2 a reading up to which a fit says how its sheet was cut: 220 mm in place of 200 leaves 1.0, electrodes
# of 3.5 mm in place of 2.5 leave 0.9 to 1.1, a tear 1.5 and more
_WELL = 1.2
# how often the sheet of a sensor is solved anew: it does not change, and three steps of Gauss-Newton bring 220 mm
# to 0.1 mm; sheets that are something else than cut otherwise would ask for it in every frame
_RECUTS = 3
_MORE = 1.2  # times as many rows are worth another fit
# times the way to it: a contact that conducts so much better brings what it touches to two thirds of the drive voltage
_GOOD = 2.0
# spacings: contacts of which all are wider lie where they do whatever a row or two say
_WIDE = 1.0
_CHANGING = 2.0  # chi-squared per reading from which on contacts may be moving
# of the readings: at an end of the converter's range: nothing is told unless the others are
# explained. With 400 N on a sheet of 200 mm, 0.69 of them are, and 1 of 5 frames said 263 ± 17 N;
# with 200 N 0.54, and forces are right to 2 %; chi^2: what those others leave at the most: with 200
# N 1.3
_MOSTLY_AT_END, _LEFT_AT_END = 0.6, 1.5
# spacings that what rested has moved by what rows say, from which on the search is asked: on 4 x 4
# electrodes, a soft touch beside looks like motion
_DRIFTED = 0.05
# steps and patches of a fit of contacts that go on moving: if these do not do, the motion has changed,
# which rows show
_GOES_ON = 2, 300
# chi^2 a reading of those that did, in parts of what the last explained frame left, the sensor's
# share included: 1.0 to 1.2 where they are right. With twice the last frame's, two fingers that
# were taken for one crept on as one
_MOVED = 1.25
SLIDING = 0.02  # m/s: the way within a frame is a part of a contact's width
RESTING = 0.005  # m/s: slower contacts are taken for resting ones at first
# ln c in a second: what changes faster in one frame is fitted with its rates in the next from the
# start: at rest, a finger pressed 0.16 N harder in each frame was taken for one with another, 37 mm
# away
_STEADY = 1.0
_MOST_LEFT_OUT = 3  # channels that are only known by what they contradict
# of V0: error of the model in one reading; without it a sensor whose noise is said to be below 0.1
# mV is withheld (part `stability`, row noise)
READING_FLOOR = 3e-5
_ROUND = 1e-3  # standard deviation of p and q where contacts are discs: nothing shows


@dataclass(frozen=True)
class FollowedRows:
    """What rows say of a frame within which something changes: its `estimate`, and `contacts` (k, 4)
    at its end, x, y, m, ln c, ln a, with their `velocities` (k, 2), m/s; `lasts` : s to its last
    row from the first one after the last beginning or end; `slides` : whether some surely move."""

    estimate: Estimate
    contacts: np.ndarray
    velocities: np.ndarray
    lasts: float
    slides: bool


# what readings show, and of their noise: its variance, and the number of readings
_Looked = tuple[Estimate, tuple[float, int] | None]
# asked with the channels that are left out and why
ByRows = Callable[[dict[int, str]], FollowedRows | None]


@dataclass(frozen=True, eq=False)
class Joined:
    """Discs, parts that their cells are of, the contact that each disc and cell is part of, and as far as asked, what
    the cost grows by without a contact, and what is not known of a disc that may be elsewhere."""

    discs: np.ndarray
    cells: np.ndarray
    of: np.ndarray
    lost: dict[int, float]
    aside: dict[int, np.ndarray]


@dataclass
class State:
    """What lasts from frame to frame: where the last fit ended, its equations, and
    of which electrodes; `noise` of readings, V rms, where they scatter more than was expected."""

    unknowns: Unknowns | None = None
    sensor: Fit | None = (
        None  # of the last whole frame that was touched: what it tells of the sensor
    )
    equations: Equations | None = None
    used: tuple[int, ...] = ()
    misfit: float = 1.0  # chi-squared per reading that it left, at least 1
    refused: float = 0.0  # what one more contact promised and did not keep
    needed: np.ndarray | None = None  # `Fit.needed` of the last fit
    fit: Fit | None = None  # of the last valid frame, for who follows rows from there on
    joined: Joined | None = None
    noise: float = 0.0
    settling: Settling | None = None  # what readings keep of the row before, where they do
    # channels that contradicted the others in the last frame that was asked, or rows of another state did
    doubted: frozenset[int] = frozenset()
    # (E,) electrodes that lie under a conductor or beside one, as found in the last frame
    covered: np.ndarray | None = None
    other: Unknowns | None = None  # what was nearly as likely as the last fit

    def become(self, other: State) -> None:
        """Go on as another one."""
        vars(self).update(vars(other))

    def forget(self) -> None:
        self.unknowns = self.sensor = self.equations = self.fit = self.joined = self.other = None
        self.misfit, self.refused, self.needed = 1.0, 0.0, None


class Estimator:
    """Contacts from frames of one layout.

    Parameters
    ----------
    noise : of a reading, V rms; law : `ContactLaw`; radius : typical of a contact, m
    model : of the sheet; excluded : electrodes never used; channels : what is expected of them
    sensor : what was learned of this one (`learning.state.SensorState`), in the place of `channels`
    across : patches to the width of a contact, at most
    spread : standard deviation of the logarithm of contacts' radii; None: what fingers have
    unknown : of `UNKNOWN`; the others are taken as expected or learned
    """

    def __init__(
        self,
        layout: Layout,
        *,
        noise: float,
        law: ContactLaw,
        radius: float,
        model: str = "auto",
        excluded: Iterable[int] = (),
        channels: ChannelPrior | None = None,
        sensor: Any = None,
        across: int = MOST_ACROSS,
        spread: float | None = None,
        unknown: Iterable[str] = UNKNOWN,
    ):
        self.layout, self.noise, self.law, self.radius = layout, noise, law, radius
        self.model, self.excluded, self.across = model, frozenset(excluded), across
        self.channels, self.sensor = channels or ChannelPrior().for_layout(layout), sensor
        self.spread, self.unknown = spread, frozenset(unknown)
        self._recuts = _RECUTS
        self._as_told, self._sought = self.channels, _RECUTS  # times that tears are looked for
        self._cut: np.ndarray | None = None  # as readings have shown it, and its tears
        self._tears: Tears = ()
        self._searches: dict[tuple[int, ...], Search] = {}
        self._expected: tuple[tuple, Prior] | None = (
            None  # of the sensor, and what that was made of
        )
        self._search(tuple(e for e in range(layout.electrodes) if e not in self.excluded))

    def offsets(self, used: tuple[int, ...]) -> np.ndarray | float:
        """(n,) V that channels read where nothing drives them, as far as that was learned."""
        return 0.0 if self.sensor is None else self.sensor["offset"][list(used)]

    def estimate(
        self,
        voltages: np.ndarray,
        grounded: np.ndarray,
        drive_voltage: float,
        state: State,
        row_period: float = 0.0,
        follow: ByRows | None = None,
        *,
        first: np.ndarray | None = None,
        without: np.ndarray | None = None,
    ) -> Estimate:
        """Contacts of rows `voltages` (L, E), V (NaN: not read), with electrodes `grounded` (L,) in
        turn, but the channels `without` (E,) bool.

        Rows are `row_period` s apart, 0 if all were read at once; contacts are those at the time of
        the last row. Of rows within which something changes, `follow` is asked first. Readings that
        scatter more than they were said to are looked at again as what they are, and the next ones
        from the beginning. `first` (E,) are the potentials in the row before the first one, V, NaN where
        they are not known; None: if rows have times, none is known, else those of the last row.
        """
        if "motion" not in self.unknown:
            row_period = 0.0
        if first is None and row_period > 0:
            first = np.full(self.layout.electrodes, np.nan)
        scan = _Scan(np.asarray(voltages, float), np.asarray(grounded, int), first, without)
        frame = scan.taken_off(state.settling), scan.grounded, drive_voltage
        noise = max(self.noise, state.noise)
        asked = _Asked(row_period, noise, follow, scan, "settling" in self.unknown)
        try:
            estimate, seen = self._look(*frame, state, asked)
        except _Unsettled as what:
            state.forget()
            state.settling = what.settling
            frame = scan.taken_off(state.settling), scan.grounded, drive_voltage
            asked = asked._replace(settling=False)
            estimate, seen = self._look(*frame, state, asked)
        if seen is None:
            return estimate
        variance, readings = seen
        as_seen = noise * float(np.sqrt(variance))
        noisier = variance > _NOISIER and variance > _MOST_OF_IT * estimate.misfit
        most = _MOST_NOISE * drive_voltage * np.sqrt(readings)
        if as_seen > most and (noisier or estimate.contacts):
            state.forget()
            reason = _too_noisy(as_seen, readings)
            withheld = replace(estimate, contacts=[], parts=[], state="withheld", reason=reason)
            return replace(withheld, noise=as_seen)
        if noisier:
            state.forget()
            state.noise = as_seen
            estimate, _ = self._look(*frame, state, asked._replace(noise=as_seen, settling=False))
        elif variance < 1 / _NOISIER and estimate.contacts:  # untouched, a part of it is cut off
            state.noise = as_seen
        return replace(estimate, noise=max(self.noise, state.noise))

    def _look(
        self,
        voltages: np.ndarray,
        grounded: np.ndarray,
        drive_voltage: float,
        state: State,
        asked: _Asked,
    ) -> _Looked:
        """`estimate` of readings, and what they show of their noise: its variance in parts of what was `asked`,
        and the number of readings; None where they do not. `_Unsettled` where they keep a part of the row
        before, if that is asked.

        A channel that is driven and never changes lies under a conductor, or is broken: what the readings of
        all others contradict is not so. One that is driven and at whose rim that of a good conductor is found,
        or whose own row contradicts what explains all others, may be one whose rows tell nothing of the sheet,
        either.
        """
        read = np.isfinite(voltages)
        read[np.arange(len(grounded)), grounded] = False
        without = voltages - self.offsets(tuple(range(self.layout.electrodes)))
        # by the noise that was said: what channels have more, one that is stuck does not show
        stuck = stuck_channels(without, read, self.noise)
        driven = driven_channels(voltages, read, drive_voltage)
        given = voltages, grounded, drive_voltage

        def under(covered: np.ndarray, begun: State) -> tuple[_Looked, State] | None:
            """What is seen with electrodes `covered`, or with those that are by it, and the state that leads to, from
            where `begun` has contacts on."""
            while covered.any():
                trial = replace(begun, covered=covered)
                seen = read & ~covered[grounded][:, None]
                others = stuck_channels(without, seen, self.noise) & ~covered
                found = self._look_without(*given, trial, asked, others, covered)
                if trial.fit is None or not found[0].contacts or found[0].misfit > MISFIT:
                    break
                broken = covered & ~_are_driven(trial.fit)
                if not broken.any():
                    return found, trial
                covered = covered & ~broken
            return None

        none = np.zeros_like(stuck)
        known = none if state.covered is None else state.covered
        covered = driven & (stuck | known)
        seen = under(covered, state)
        if seen is None:
            trial = replace(state, covered=None)
            seen = self._look_without(*given, trial, asked, stuck, none), trial
        more = driven & ~covered & self._meets(seen[0][0], seen[1].fit)
        if more.any():
            begun = replace(seen[1], needed=None)
            radii = [each.radius for each in seen[0][0].contacts]
            wide = min(radii, default=0.0) > _WIDE * self.operator_of(begun.used).pitch
            seen = under(covered | more, begun if wide else state) or seen
        found, last = seen
        state.become(last)
        return found

    def _meets(self, found: Estimate, fit: Fit | None) -> np.ndarray:
        """(E,) electrodes whose rims those of good conductors meet, or whose rows contradict the contacts of a `fit` as
        others do not; any where there is no fit, as no contacts explain the rows."""
        meets = np.full(self.layout.electrodes, found.unlike)
        if fit is None:
            return meets
        if found.contacts:
            meets[fit.operator.used[fit.rows.grounded[_contradict_others(fit)]]] = True
        good = fit.prediction.conductances * fit.prediction.means > _GOOD
        good[fit.unknowns.alone :] = False  # rims of cells are none of a contact
        for each in fit.unknowns.contacts[good]:
            meets |= meets_rims(self.layout, each[:2], np.exp(each[RADIUS]))
        return meets

    def _look_without(
        self,
        voltages: np.ndarray,
        grounded: np.ndarray,
        drive_voltage: float,
        state: State,
        asked: _Asked,
        stuck: np.ndarray,
        covered: np.ndarray,
    ) -> _Looked:
        """The same where channels `stuck` (E,) are broken, and electrodes `covered` (E,) lie under a conductor,
        whose currents into them say nothing of the sheet."""
        row_period, noise, follow, scan, settling = asked
        anew = state, asked._replace(settling=False), stuck, covered
        again = partial(self._look_without, voltages, grounded, drive_voltage, *anew)
        left_out = {e: EXCLUDED for e in self.excluded}
        if not len(grounded):
            return Estimate([], [], "withheld", "no row was read", left_out), None
        valid = np.isfinite(voltages)
        own = np.arange(len(grounded)), grounded
        read = valid.copy()
        read[own] = True
        valid[own] = False
        valid[covered[grounded]] = False
        for electrode in np.flatnonzero(dead_channels(read)):
            left_out.setdefault(int(electrode), "no readings")
        for electrode in np.flatnonzero(stuck):
            left_out.setdefault(int(electrode), STUCK)
        used = tuple(e for e in range(self.layout.electrodes) if e not in left_out)
        if len(used) < 2:
            return Estimate(
                [], [], "withheld", "fewer than two electrodes can be read", left_out
            ), None
        several = len(left_out) - len(self.excluded), self.layout.electrodes - len(self.excluded)
        if bad := too_many_are_bad(*several):
            state.forget()
            return Estimate([], [], "withheld", bad, left_out), None
        driven = np.where(valid, voltages, np.nan)[:, list(used)] - self.offsets(used)
        places = self.layout.positions
        doubt = ground_is_doubtful(
            driven, places[grounded], places[list(used)], drive_voltage, noise
        )
        if doubt:
            state.forget()
            return Estimate([], [], "withheld", doubt, left_out), None
        search = self._search(used)
        times = row_period * np.arange(len(grounded)) if row_period > 0 else None
        prior = self._prior(search.operator, drive_voltage, noise)
        ended = valid & self._ended(scan.voltages, drive_voltage, used, prior)
        at_end = np.count_nonzero(ended) > _MOSTLY_AT_END * np.count_nonzero(valid)
        valid &= ~ended
        rows, silent = self._rows(search, voltages, valid, grounded, drive_voltage, times, noise)
        for electrode in silent:
            left_out.setdefault(int(electrode), OPEN)
        if rows.count < _FEWEST_READINGS:
            return Estimate([], [], "withheld", "too little was read", left_out), None
        begun = latest_state(1 - rows.readings, rows.weights > 0, noise / drive_voltage)
        rows = rows.part(slice(begun, None))
        few = begun and len(rows.grounded) < _FEWEST
        if few and search.untouched(rows, prior):
            state.forget()
            return Estimate([], [], "valid", "", left_out, 0.0, begun), None
        ahead = row_period * (len(grounded) + 1) / 2
        followed = None if times is None or follow is None else partial(follow, left_out)
        if few and followed is not None and (by_rows := followed()) is not None:
            return self._went_on(by_rows, state, search, prior, used, ahead), None
        if rows.count < _FEWEST_READINGS or few:
            reason = f"a touch began or ended within the last {len(rows.grounded)} rows"
            return Estimate([], [], "withheld", reason, left_out, first=begun), None
        if state.used != used:
            state.unknowns = state.sensor = state.other = None
        start = state.unknowns
        if start is not None and times is None:
            start = start.in_motion(False)
        if start is not None and begun:
            start = start.with_contacts(np.empty((0, 6)), (), np.empty((0, 6), bool))
        try:
            before = partial(scan.before, voltages, drive_voltage) if settling else None
            begins = partial(
                self._begins, search, prior=prior, noise=noise, before=before, state=state
            )
            judge = partial(
                self._consistent, search, prior=prior, noise=noise, left_out=left_out, state=state
            )
            fit, first, torn = self._fit(
                search, rows, prior, start, state, begun > 0, begins, judge, followed
            )
        except _Followed as what:
            return self._went_on(what.by_rows, state, search, prior, used, ahead), None
        except _Contradiction as what:
            state.forget()
            known = left_out, what.found.misfit, begun
            scattered = (what.scatter, what.found.rows.count) if what.scatter else None
            return Estimate([], [], "withheld", what.reason, *known), scattered
        except Misplaced as what:
            self._expect_places(what.fit)
            state.forget()
            return again()
        except np.linalg.LinAlgError:  # numbers that no voltages between conductors have
            state.forget()
            reason = "no contacts on any sheet give such readings: wires, channels or the order of electrodes are wrong"
            return Estimate([], [], "withheld", reason, left_out, np.nan, begun), None
        if not torn and self._recut(fit, used, len(rows.grounded)):
            state.forget()
            state.unknowns, state.used = fit.unknowns, used
            return again()
        first += begun
        # the next frame begins where this one ends, and is estimated for its middle
        ahead = 0.0 if times is None else fit.rows.last + (times[-1] + row_period) / 2
        unknowns = _ahead(fit.lasting.unknowns, ahead)
        if len(fit.rows.grounded) < len(rows.grounded):
            # few rows do not tell
            unknowns = as_known(unknowns, prior if state.sensor is None else state.sensor.unknowns)
        elif len(unknowns.contacts):
            state.sensor = fit
        state.unknowns, state.equations, state.used = unknowns, fit.equations, used
        state.misfit = max(1.0, fit.chi_squared / fit.rows.count)
        state.needed = fit.needed
        state.refused = fit.promised if len(fit.rows.grounded) == len(rows.grounded) else 0.0
        gave_up = search.gave_up(fit)
        many = gave_up or fit.unknowns.bond is not None
        reason = self._refusal(fit, torn, noise, OR_MANY if many else "")
        misfit = fit.chi_squared / fit.rows.count
        if at_end and misfit > _LEFT_AT_END:
            reason = AT_END
        variance = scatter(fit)
        scattered = None if variance is None else (variance, fit.rows.count)
        if reason.startswith(UNLIKE):
            seen = self._if_torn(fit, state, again)
            if seen is not None:
                return seen
        if reason:
            state.forget()
            unlike = reason not in (AT_END, CHANGED)
            known = left_out, misfit, first
            return Estimate([], [], "withheld", reason, *known, unlike=unlike), scattered
        state.fit = fit
        contacts, parts = self._reported(search, fit, state)
        if parts and rows_are_alike(driven, places[grounded], places[list(used)], noise):
            state.forget()
            return Estimate([], [], "withheld", ALIKE, left_out, misfit, first), scattered
        if not parts and len(fit.unknowns.contacts) and search.untouched(fit.rows, prior) is None:
            reason = "something touches, too weakly or too widely to say where"
            if _may_be_anywhere(fit):
                reason = ANYWHERE
            return Estimate([], [], "withheld", reason, left_out, misfit, first), scattered
        known = left_out, misfit, first
        beside = self._other(search, fit, state, contacts)
        state.other = None if beside is None else beside.unknowns
        if beside is not None and beside.likely < TOLD:  # by the next frame it may be
            beside = None
        other = None if beside is None else beside.contacts
        if beside is not None:
            left = 1.0 - beside.likely * unmatched(contacts, beside.contacts)
            contacts = [
                replace(each, probability=min(each.probability, most))
                for each, most in zip(contacts, left.tolist())
            ]
        estimate = Estimate(contacts, parts, "valid", "", *known, complete=not gave_up, other=other)
        return estimate, scattered

    def _other(
        self, search: Search, fit: Fit, state: State, contacts: list[Contact]
    ) -> _Other | None:
        """Other contacts that are nearly as likely as those of a fit: of other fits, or of discs that are one contact
        as something may press between them."""
        for tried, likely in search.others(fit):
            found, _ = self._reported(search, tried, State())
            if len(found) != len(contacts) or unmatched(found, contacts).any():
                return _Other(found, likely, tried.unknowns.in_motion(False))
        discs = fit.unknowns.contacts
        if fit.unknowns.bond is None and len(contacts) < len(discs):
            apart = groups(fit, None)
            known = state.joined
            assert known is not None  # contacts were reported
            parted = State(joined=replace(known, of=apart, lost={}))
            found, _ = self._reported(search, fit, parted)
            if len(found) > len(contacts):
                return _Other(found, TOLD, None)
        return None

    def _recut(self, fit: Fit, used: tuple[int, ...], rows: int) -> bool:
        """Whether the sheet is now another one: that which a fit of so many `rows` with the electrodes
        `used` found to be cut and printed far from how it was solved, if it was not learned; or whether something
        else is now expected of the places of its electrodes."""
        if self.sensor is not None or not len(fit.unknowns.contacts):
            return False
        if fit.unknowns.bond is not None or len(fit.rows.grounded) < rows:
            return False
        if is_misplaced(fit):
            self._expect_places(fit)
            return True
        if "sheet" not in self.unknown or not self._recuts:
            return False
        found, operator = fit.unknowns.sheet, fit.operator
        if fit.chi_squared > _WELL * fit.rows.count or not operator.is_far(found):
            return False
        self._recuts -= 1
        self._cut = found[operator.of_cut]
        self._searches = {used: self._made(operator.cut_as(self._cut, self._tears))}
        return True

    def _expect_places(self, fit: Fit) -> None:
        """Expect of the places of all electrodes what a fit found of them in the mean: whoever placed some by hand,
        did all."""
        self.channels = replace(self.channels, aside=further_aside(fit) * self.channels.aside)
        self._expected = None

    def _if_torn(self, fit: Fit, state: State, again: Callable[[], _Looked]) -> _Looked | None:
        """What is seen `again` with a sheet that is torn, as rows show it that no contacts explain; None where
        they do not, or where tears explain nothing either. Asked for whoever did not learn the sheet, and not
        often: it takes seconds."""
        operator, rows = fit.operator, fit.rows
        if self.sensor is not None or not self._sought or operator.tears:
            return None
        self._sought -= 1
        read = np.full((1, operator.count, operator.count), np.nan)
        read[0, rows.grounded] = np.where(rows.weights > 0, rows.readings, np.nan)
        if np.count_nonzero(np.isnan(read)) > operator.count:  # those of the grounded ones
            return None
        channels = channels_alone(reciprocity(rows, fit.prior), fit.prior)[0]
        tears = find_tears(operator, couplings(operator, read, channels.gain, channels.offset))
        if not tears:
            return None
        known = self._cut, self._tears, self._searches, self.channels
        self._tears, self._searches = tears, {}
        self.channels, self._expected = self._as_told, None
        state.forget()
        with suppress(InputError):  # they leave the sheet in pieces
            found = again()
            left = fit.chi_squared / rows.count
            if found[0].misfit - 1 < EXPLAIN * (left - 1):
                if state.fit is None or state.fit.unknowns.bond is not None:
                    return found
                cut = np.zeros(COUNT) if self._cut is None else self._cut
                self._tears, _ = refined([state.fit], partial(operator.cut_as, cut))
                self._searches = {}
                state.forget()
                return again()
        self._cut, self._tears, self._searches, self.channels = known
        self._expected = None
        return None

    @property
    def made_as(self) -> AsCut | None:
        """The layout as readings have shown that it was made; None: as drawn, or as learned."""
        if self.sensor is not None or (self._cut is None and not self._tears):
            return None
        cut = np.zeros(COUNT) if self._cut is None else self._cut
        return AsCut(self.layout, cut, self._tears)

    def _made(self, operator: SheetOperator) -> Search:
        return Search(
            operator, self.across, "shape" not in self.unknown, lambda: self.sensor is not None
        )

    def _ended(
        self, voltages: np.ndarray, drive_voltage: float, used: tuple[int, ...], prior: Prior
    ) -> np.ndarray:
        """(L, E) readings at an end of the converter's range: 0 V is one where the offset is known
        to lie below."""
        below = np.zeros(self.layout.electrodes, bool)
        below[list(used)] = prior.offset < 0
        return clipped(voltages, drive_voltage) & (below | (voltages > 0))

    def _prior(self, operator: SheetOperator, drive_voltage: float, noise: float) -> Prior:
        given = operator, drive_voltage, noise, self.sensor
        if self._expected is None or self._expected[0] != given:
            self._expected = given, self._new_prior(operator, drive_voltage, noise)
        return self._expected[1]

    def _new_prior(self, operator: SheetOperator, drive_voltage: float, noise: float) -> Prior:
        held = set(SENSOR) - self.unknown
        own = 0.0 if "offsets" in held else self.channels.offset
        channels = replace(self.channels, offset=float(np.hypot(own, CUT_OFF * noise)))
        prior = Prior.unknown(operator, channels, self.radius, drive_voltage)
        if self.spread is not None:
            prior = replace(prior, spread=self.spread)
        if self.sensor is not None:
            prior = self.sensor.prior(operator, drive_voltage, prior)
        else:
            held -= {"offsets"}  # of which what is cut off at 0 V is left
        if "shape" not in self.unknown:
            prior = replace(prior, stretch=_ROUND)
        return prior.held(held) if held else prior

    def operator_of(self, used: tuple[int, ...]) -> SheetOperator:
        """The operator of the electrodes `used`, about the sheet as it is known by now."""
        return self._search(used).operator

    def sensor_of(
        self, used: tuple[int, ...], drive_voltage: float, noise: float = 0.0
    ) -> tuple[SheetOperator, Prior]:
        """The operator of the electrodes `used`, and what is expected of the sensor before any row;
        `noise` of its readings, V rms, where more is known of it."""
        operator = self.operator_of(used)
        return operator, self._prior(operator, drive_voltage, max(self.noise, noise))

    def _search(self, used: tuple[int, ...]) -> Search:
        if used not in self._searches:
            if len(self._searches) >= _KEPT:
                self._searches.pop(next(iter(self._searches)))
            operator = operator_for(self.layout, self.model, used)
            made = self.made_as
            if made is not None:
                operator = operator.cut_as(made.coefficients, made.tears)
            self._searches[used] = self._made(operator)
        search = self._searches[used]
        if self.sensor is not None:
            operator = search.operator.near(self.sensor["sheet"], self.sensor.tears)
            if operator is not search.operator:
                search = self._searches[used] = self._made(operator)
        return search

    def _rows(
        self,
        search: Search,
        voltages: np.ndarray,
        valid: np.ndarray,
        grounded: np.ndarray,
        drive_voltage: float,
        times: np.ndarray | None,
        noise: float,
    ) -> tuple[Rows, np.ndarray]:
        """`Rows` of the electrodes in use, and electrodes that were never grounded."""
        operator = search.operator
        used = operator.used
        variance = (noise / drive_voltage) ** 2 + READING_FLOOR**2
        at = operator.position[grounded]
        readings = np.where(valid, voltages, 0.0)[:, used] / drive_voltage
        weights = valid[:, used] / variance
        silent = open_grounds(1 - readings, weights > 0, noise / drive_voltage)
        kept = (at >= 0) & ~silent & (weights > 0).any(axis=1)
        rows = Rows(readings, weights, at, times).part(np.flatnonzero(kept))
        return rows, grounded[silent & (at >= 0)]

    def _fit(
        self,
        search: Search,
        rows: Rows,
        prior: Prior,
        start: Unknowns | None,
        state: State,
        begun: bool,
        begins: Callable[..., None],
        judge: Callable[[Rows, bool], Rows],
        followed: Callable[[], FollowedRows | None] | None,
    ) -> tuple[Fit, int, bool]:
        """The fit of all rows, or of those since the last change where they contradict each
        other, its first row, and whether they do and no few of the last are explained.

        begins : `_begins`, asked of rows that show another touch than the last frame
        judge : `_consistent` of rows that are not the last frame's contacts still
        followed : what else tells of rows of several states, raised as `_Followed`
        """
        timed = rows.times is not None
        moves = timed and start is not None and bool(start.moving.any())
        if start is not None and moves and search.untouched(rows, prior) is None:
            fit = search.moved(start, rows, prior, *_GOES_ON)
            if fit.chi_squared + fit.of_sensor < _MOVED * state.misfit * rows.count:
                return search.one_more(fit), 0, False
            _ask(followed)
            followed = None
        there = None if start is None else self._there(search, start, rows, prior, state)
        whole = len(rows.grounded)
        touched = search.untouched(rows, prior) is None
        ended = not (touched or start is None) and len(start.contacts) > 0
        goes_on = not (begun or there is None or ended) and search.goes_on(
            there, state.misfit, state.equations
        )
        if touched and not goes_on:
            try:
                begins(rows)
            except _Contradiction:
                _ask(followed, SUSPECT)  # rows of several states contradict each other, too
                raise
        elif touched and state.misfit > _UNEXPLAINED:
            begins(rows, goes_on=True)
        alike = search.of_one_state(rows, prior) if timed and not goes_on else whole
        late = None
        if timed and (begun or alike < whole):
            least = _FEWEST if begun else _WINDOW
            late = self._late(search, rows, prior, start, state.sensor, alike, least, followed)
        if late is None:
            quick = timed and there is not None
            refused = 0.0 if start is None else state.refused
            budget = FIRST_LOOK if quick else BUDGET
            if not goes_on:
                kept = judge(rows, timed and (begun or alike < whole))
                if kept is not rows and there is not None:
                    there = Fit(search.operator, there.unknowns, kept, prior)
                rows = kept
            fit = search.contacts(
                rows,
                prior,
                there,
                budget,
                state.equations,
                refused,
                state.misfit,
                state.needed,
                state.other,
            )
            if timed and goes_on and _is_suspect(fit):
                alike = search.of_one_state(rows, prior)
                if alike < whole:
                    known = start, state.sensor
                    late = self._late(search, rows, prior, *known, alike, _WINDOW, followed)
        if late is not None:
            return late, whole - len(late.rows.grounded), False
        if fit.chi_squared > _CHANGING * state.misfit * rows.count:
            fit = search.in_motion(fit)
        if _is_suspect(fit) and start is not None and len(start.contacts) and alike == whole:
            rows = judge(rows, False) if goes_on else rows
            again = search.contacts(rows, prior)
            fit = _better(fit, again) if rows is fit.rows else again
        return fit, 0, timed and (begun or alike < whole)

    def _late(
        self,
        search: Search,
        rows: Rows,
        prior: Prior,
        start: Unknowns | None,
        known: Fit | None,
        alike: int,
        least: int,
        followed: Callable[[], FollowedRows | None] | None,
    ) -> Fit | None:
        """The fit of the last rows of several states, since something began or ended. `_Followed` where
        rows one by one tell of it, and what rests since then does not explain them.

        Arguments as for `_grown` and `_fit`
        """
        by_rows = None if followed is None else followed()
        if by_rows is None or self._drifts(search, start, by_rows):
            late = self._grown(search, rows, prior, start, known, alike, least)
            if late is not None or by_rows is None:
                return late
            raise _Followed(by_rows)
        assert rows.times is not None
        since = rows.times[-1] - by_rows.lasts - _SAME_TIME
        part = rows.part(np.flatnonzero(rows.times >= since))
        if len(part.grounded) < _WINDOW or by_rows.slides or not len(by_rows.contacts):
            raise _Followed(by_rows)
        expected = prior if known is None else _after(known)
        there = self._by_rows(search, expected, by_rows).in_motion(False)
        fit = search.of_any_size(there, part, expected, *_GOES_ON)
        if _explains(fit):
            return fit
        raise _Followed(by_rows)

    def _drifts(self, search: Search, start: Unknowns | None, by_rows: FollowedRows) -> bool:
        """Whether what rested in the frame before has moved by what rows say: of a few electrodes, they
        may take a soft touch elsewhere for that."""
        if start is None or start.moving.any() or start.bond is not None:
            return False
        before, now = start.contacts[:, :2], by_rows.contacts[:, :2]
        apart = np.hypot(*(before[:, None] - now).transpose(2, 0, 1)) / search.operator.pitch
        return bool(((apart > _DRIFTED) & (apart < CLOSE)).any())

    def _by_rows(self, search: Search, known: Prior | Unknowns, by_rows: FollowedRows) -> Unknowns:
        """What rows say at the end of a frame, the sensor being as `known`."""
        there, pitch = as_known(Unknowns.at_rest(search.operator), known), search.operator.pitch
        for x, y, strength, size in by_rows.contacts:
            there = with_disc(there, (x, y), np.exp(strength), np.exp(size), pitch)
        rates = np.column_stack([by_rows.velocities, np.zeros(len(by_rows.velocities))])
        return replace(there, rates=rates, moving=np.ones(len(rates), bool))

    def _went_on(
        self,
        by_rows: FollowedRows,
        state: State,
        search: Search,
        prior: Prior,
        used: tuple[int, ...],
        ahead: float,
    ) -> Estimate:
        """What rows said, with which the next frame begins, whose middle is `ahead`, s."""
        known = prior if state.sensor is None or state.used != used else state.sensor.unknowns
        there = self._by_rows(search, known, by_rows)
        moves = (np.hypot(*by_rows.velocities.T) > SLIDING).any()
        there = there.after(ahead) if moves else there.in_motion(False)
        state.unknowns, state.used, state.equations, state.fit = there, used, None, None
        state.refused, state.needed, state.other = 0.0, None, None
        return by_rows.estimate

    def _there(
        self, search: Search, start: Unknowns, rows: Rows, prior: Prior, state: State
    ) -> Fit:
        """Where the last frame ended, as a fit of the rows."""
        if state.fit is None or state.fit.operator is not search.operator:
            return Fit(search.operator, start, rows, prior)
        return state.fit.lasting.of(start, rows, prior)

    def _grown(
        self,
        search: Search,
        rows: Rows,
        prior: Prior,
        start: Unknowns | None,
        known: Fit | None,
        alike: int,
        least: int,
    ) -> Fit | None:
        """The fit of the last rows alone, of as many as one state of motion explains; None where
        that are too few.

        A few rows cannot tell a way from a place: contacts move until the readings say that they
        rest.

        known : the last frame that was touched, which tells of the sensor
        alike : number of the last rows that may be of one state
        least : rows that tell a change; of fewer, gains that are a little off explain whatever a
            broken sensor reads
        """
        if known is not None:
            prior = _after(known)
        count = len(rows.grounded)
        size, explained, best = min(max(alike, _WINDOW), count), 0, None
        while size > _MORE * explained:
            part, middle = rows.part(slice(count - size, None)), _middle(rows, size)
            if best is None:
                here = None if start is None else start.after(middle)
                late = search.moving(part, prior, here)
            else:
                ahead = middle - _middle(rows, explained)
                late = search.moved(best.unknowns.after(ahead), part, prior)
            if not _explains(late) and (best is None or not search.is_torn(late)):
                late = search.one_more(late)
            if _explains(late):
                best, explained = late, size
                size = min(2 * size, count)
                if tells_speeds(best):
                    size = _alike(best, rows, size)
            elif best is None and size > least:
                size = min(_WINDOW, max(least, size // 2))
            else:
                break
        return None if best is None else search.at_rest(best)

    def _begins(
        self,
        search: Search,
        rows: Rows,
        *,
        prior: Prior,
        noise: float,
        before: Callable[[], np.ndarray] | None,
        state: State,
        goes_on: bool = False,
    ) -> None:
        """What rows say of how they were read, before contacts are looked for: `_Unsettled` where
        readings keep a part of the row before, if `before` says what that was; `_Contradiction` where they
        contradict each other as more noise than was said lets them, if their contacts do not go on."""
        operator, found = search.operator, search.reciprocity(rows, prior)
        if before is not None:
            settling = unsettled(found, before(), operator.used, prior, state.settling)
            if settling is not None:
                raise _Unsettled(settling)
        if goes_on or found.misfit < TORN:
            return
        variance = found.scatter(operator.layout.positions[operator.used])
        if variance is not None and variance > _MOST_OF_IT * found.misfit:
            variance = min(variance, found.misfit)  # which is of all of them
            reason = _too_noisy(noise * float(np.sqrt(variance)), rows.count)
            raise _Contradiction(reason, found, variance)

    def _consistent(
        self,
        search: Search,
        rows: Rows,
        torn: bool,
        *,
        prior: Prior,
        noise: float,
        left_out: dict[int, str],
        state: State,
    ) -> Rows:
        """Rows without the channels that contradict all others; `_Contradiction` where no contacts can
        explain them.

        torn : whether rows that do not agree may be of several states: then channels are named by two frames
            in turn, as what begins or ends contradicts all others in the rows after it
        """
        quiet = search.untouched(rows, prior)
        if quiet is not None:
            rows, bad = _without_restless(quiet)
        else:
            found = search.reciprocity(rows, prior)
            if found.misfit < TORN:
                return rows
            found, bad = without_contradicting(found, prior, _MOST_LEFT_OUT)
            rows = found.rows
            if torn and found.misfit > TORN:
                raise _Contradiction(CHANGED, found)
            if found.chi_squared > self._most_left(noise) * rows.count:
                raise _Contradiction(_unexplained(found.chi_squared, rows), found)
        named = frozenset(int(search.operator.used[each]) for each in bad)
        left_out.update(dict.fromkeys(named & state.doubted if torn else named, CONTRADICTS))
        state.doubted = named
        return rows

    def _refusal(self, fit: Fit, torn: bool, noise: float, or_many: str) -> str:
        """Why a fit is not told; empty: it is. `or_many` : what may be as well, where many things may touch."""
        expected = self.channels.covariance_of_resistances(fit.operator)
        disturbed = _below_zero(fit, expected) > _IMPOSSIBLE
        if disturbed and fit.chi_squared < _CHANGING * fit.rows.count:
            return DISTURBED + or_many
        if torn and not _explains(fit):
            return CHANGED
        left = fit.chi_squared / fit.rows.count
        if not disturbed and left <= min(self._most_left(noise), _OTHER_SHEET):
            return ""
        if reciprocity(fit.rows, fit.prior).misfit < TORN:  # whatever electronics do contradicts it
            return UNLIKE + OR_HUM if disturbed else UNLIKE
        if disturbed:
            return DISTURBED + or_many
        if left > self._most_left(noise):
            return _unexplained(fit.chi_squared, fit.rows) + or_many
        return ""

    def _most_left(self, noise: float) -> float:
        """Chi-squared per reading with `noise`, V rms, beyond which nothing is said; more noise than was
        said is no reason for more that is left over beside it."""
        if noise > self.noise:
            return max(_REFUSED * (self.noise / noise) ** 2, _BESIDE_NOISE)
        return _REFUSED

    def _reported(
        self, search: Search, fit: Fit, state: State
    ) -> tuple[list[Contact], list[Contact]]:
        """Contacts of a fit, strongest first, and the discs or cells that they consist of."""
        u, known = fit.unknowns, state.joined
        discs, shaped = u.contacts[: u.alone], u.bond is not None
        cells = search.parts(fit) if shaped else np.arange(u.alone)
        same = known is not None and np.array_equal(cells, known.cells)
        if known is None or not same or not similar(discs, known.discs, fit.operator.pitch, SAME):
            of = groups(fit, search.allows, cells if shaped else None)
            known = state.joined = Joined(discs, cells, of, {}, {})
        if shaped:
            return contacts_of_shape(fit, self.law, known.of)

        def needed(each: int) -> float:
            if each not in known.lost:
                known.lost[each] = search.lost_without(fit, known.of == each)
            return known.lost[each]

        def elsewhere(which: int) -> np.ndarray:
            if which not in known.aside:
                known.aside[which] = search.elsewhere(fit, which)
            return known.aside[which]

        parts, group = contacts_of(fit, known.of, self.law, needed, elsewhere)
        return joined(parts, group), parts


class _Followed(Exception):
    """Rows of several states, of which who follows them knows `by_rows`."""

    def __init__(self, by_rows: FollowedRows):
        super().__init__("rows were followed")
        self.by_rows = by_rows


def _ask(followed: Callable[[], FollowedRows | None] | None, most: float = np.inf) -> None:
    """`_Followed` where rows tell, with a misfit below `most`."""
    by_rows = None if followed is None else followed()
    if by_rows is not None and by_rows.estimate.misfit < most:
        raise _Followed(by_rows)


@dataclass(frozen=True)
class _Scan:
    """Rows as they were read: `voltages` (L, E), V, electrodes `grounded` (L,), potentials (E,) in the row
    before the `first`, as for `rows_before`; `without` (E,) bool, channels that are not to be used."""

    voltages: np.ndarray
    grounded: np.ndarray
    first: np.ndarray | None
    without: np.ndarray | None

    def taken_off(self, settling: Settling | None) -> np.ndarray:
        """(L, E) V, what is used, without what readings keep of the row before."""
        out = self.voltages
        if settling is not None:
            out = settling.taken_off(out, self.grounded, self.first)
        if self.without is not None:
            out = without_channels(out, self.grounded, self.without)
        return out

    def before(self, voltages: np.ndarray, drive_voltage: float) -> np.ndarray:
        """(E, E) potentials in the row before the one in which each electrode is grounded, in parts of
        the drive, by what rows read `voltages` (L, E), V, without that; NaN: not known."""
        electrodes = self.voltages.shape[1]
        out = np.full((electrodes, electrodes), np.nan)
        whole = np.where(np.isnan(voltages), self.voltages, voltages)
        out[self.grounded] = rows_before(whole, self.grounded, self.first) / drive_voltage
        return out


class _Asked(NamedTuple):
    """Of rows `row_period` s apart with `noise`, V rms: `follow` says what is asked of those within which
    something changes; `scan` : as they were read; `settling` : whether they may keep a part of the row before."""

    row_period: float
    noise: float
    follow: ByRows | None
    scan: _Scan
    settling: bool


class _Other(NamedTuple):
    """Contacts that are nearly as likely as others, how likely, in parts of both, and where that is if that is
    another fit."""

    contacts: list[Contact]
    likely: float
    unknowns: Unknowns | None


class _Unsettled(Exception):
    """Readings keep a part of the row before: `settling`."""

    def __init__(self, settling: Settling):
        super().__init__("readings keep a part of the row before")
        self.settling = settling


class _Contradiction(Exception):
    """Rows that no contacts explain, whatever the sensor is: `found` says so; `scatter` : the variance of
    noise in parts of what was said, if that is all that is wrong."""

    def __init__(self, reason: str, found: Reciprocity, scatter: float | None = None):
        super().__init__(reason)
        self.reason, self.found, self.scatter = reason, found, scatter


def _too_noisy(noise: float, readings: int) -> str:
    return (
        f"readings scatter by {1e3 * noise:.3g} mV: {readings} of them cannot tell contacts apart"
    )


def _unexplained(chi_squared: float, rows: Rows) -> str:
    """That so much is left over: the part of the readings that neither a model nor noise explains."""
    signal = float((rows.weights * rows.readings**2).sum())
    left = np.sqrt(max(chi_squared - 1.5 * rows.count, 0.0) / max(signal, 1e-300))
    return f"no contacts explain the readings ({left:.1%} of them is left over), or something changed in the last rows"


def _contradict_others(fit: Fit) -> np.ndarray:
    """(L,) rows that leave more over than chance lets any of them, in parts of what half of the rows leave."""
    read = np.maximum(np.count_nonzero(fit.rows.weights, axis=1), 1)
    left = (fit.rows.weights * fit.misfit**2).sum(axis=1) / read
    return left > np.median(left) * chdtri(read, FALSE_ALARMS) / read


def _are_driven(fit: Fit) -> np.ndarray:
    """(E,) electrodes that read the drive voltage by what a fit has found to touch them."""
    driven = np.zeros(fit.operator.layout.electrodes, bool)
    predicted = fit.rows.readings - fit.misfit
    driven[fit.operator.used] = np.median(predicted, axis=0) > AT_DRIVE
    return driven


def _explains(fit: Fit) -> bool:
    """Whether contacts explain rows with a sensor that is likely."""
    return fit.chi_squared + fit.of_sensor < _CHANGING * fit.rows.count


def _may_be_anywhere(fit: Fit) -> bool:
    """Whether that is so of one of its discs."""
    free = fit.unknowns.free
    variances = np.zeros(free.shape)
    variances[free] = fit.covariance.diagonal()[: np.count_nonzero(free)]
    places = (np.diag(each) for each in variances[:, :CONDUCTANCE])
    return any(may_be_anywhere(each, fit.operator.layout) for each in places)


def _below_zero(fit: Fit, expected: np.ndarray) -> float:
    """How far resistances to ground of a fit are below 0 ohm, and below what was known of them, in
    deviations of what is `expected` of a new sensor, covariance (n, n), ohm²: root mean square over
    the rows without the two that are lowest.

    An offset that all readings of a row have in common is the same to the fit as such a resistance,
    or nearly; so is a wider radius of all electrodes. One or two electrodes under a contact may take what the model lacks there.
    """
    u, prior, operator = fit.unknowns, fit.prior, fit.operator
    rows = np.unique(fit.rows.grounded)
    if len(rows) < _FEWEST_JUDGED:
        return 0.0
    solved = u.resistance, u.sheet[-1]
    own, known = (
        resistance - operator.by_radius[operator.used] * radius
        for resistance, radius in (solved, (prior.resistance, operator.mean[-1]))
    )
    below = np.minimum(own - np.minimum(known, 0.0), 0.0)
    below /= np.sqrt(
        expected.diagonal() + (operator.deviation[-1] * operator.by_radius[operator.used]) ** 2
    )
    return float(np.sqrt(np.mean(np.sort(below[rows] ** 2)[:-2])))


def _middle(rows: Rows, size: int) -> float:
    """Time, s, for which contacts of the last `size` rows are estimated."""
    assert rows.times is not None
    return float(rows.times[-size] + rows.times[-1]) / 2


def _alike(fit: Fit, rows: Rows, most: int) -> int:
    """How many of the last rows, `most` at most, may be of the contacts of a fit of the last of
    them."""
    ahead = _middle(rows, most) - _middle(rows, len(fit.rows.grounded))
    part = rows.part(slice(len(rows.grounded) - most, None))
    there = Fit(fit.operator, fit.unknowns.after(ahead), part, fit.prior)
    by_row = (part.weights * there.misfit**2).sum(axis=1)
    others = np.flatnonzero(by_row > _REFUSED * (part.weights > 0).sum(axis=1))
    return most - 1 - int(others[-1]) if len(others) else most


def _ahead(unknowns: Unknowns, lasts: float) -> Unknowns:
    """What is expected `lasts` s later: contacts that move or change go on, slow ones rest."""
    speeds, growth = np.abs(unknowns.rates[:, :2]), np.abs(unknowns.rates[:, 2])
    if not ((speeds > RESTING).any() or (growth > _STEADY).any()):
        return unknowns.in_motion(False)
    later = unknowns.after(lasts)
    strengths = unknowns.contacts[:, CONDUCTANCE]  # a press does not go on growing
    later.contacts[:, CONDUCTANCE] = strengths
    return replace(later, rates=later.rates * [1.0, 1.0, 0.0])


def _after(seen: Fit) -> Prior:
    """What is expected of the sensor once a frame has been explained: its posterior, contacts
    marginal."""
    told = information(seen.operator, seen.unknowns, seen.rows, seen.prior, 1.0)
    return seen.prior.told(seen.unknowns, told.matrix / seen.doubt)


def _without_restless(quiet: Fit) -> tuple[Rows, list[int]]:
    """Rows of an untouched sheet without the few channels that do not rest, if all others do, and
    these."""
    rows = quiet.rows
    by_column = (rows.weights * quiet.misfit**2).sum(axis=0)
    restless = by_column > SUSPECT * np.maximum(np.count_nonzero(rows.weights, axis=0), 1)
    if not 0 < np.count_nonzero(restless) <= _MOST_LEFT_OUT:
        return rows, []
    weights = np.where(restless, 0.0, rows.weights)
    return replace(rows, weights=weights), [int(each) for each in np.flatnonzero(restless)]


def _is_suspect(fit: Fit) -> bool:
    return fit.chi_squared > SUSPECT * fit.rows.count


def _better(first: Fit, second: Fit) -> Fit:
    return first if first.cost <= second.cost else second
