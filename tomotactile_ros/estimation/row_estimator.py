"""Rows in, contacts out, one estimate a row: the follower between frames, the estimator once a
frame.

Nothing about a scan needs to be complete or in order: rows are followed as they come, and whenever
as many have come as there are electrodes, they are a frame. Where rows cannot wait for the estimate
of a frame (`RowsState.waits`), somebody else makes it meanwhile and leaves it with `RowsState.tell`;
it is taken in before the next row.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.optimize import linear_sum_assignment

from tomotactile_ros.estimation.arrangement import CLOSE
from tomotactile_ros.estimation.equations import SIMILAR
from tomotactile_ros.estimation.estimator import EXCLUDED, Estimator, FollowedRows, State
from tomotactile_ros.estimation.fits import FILLED
from tomotactile_ros.estimation.follow import YOUNG, Follower
from tomotactile_ros.estimation.frames_in_rows import (
    POOR,
    Fitted,
    FrameSeen,
    carried_on,
    corrected,
    linearised,
    placed,
    sliding,
    wide_now,
)
from tomotactile_ros.estimation.ground import ALIKE, NO_GROUND, GroundWatch
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.reported import (
    FORCE_FLOOR,
    IMPEDANCE_FLOOR,
    MOST_RELATIVE,
    PLACE_FLOOR,
    Contact,
    Estimate,
    crowded,
    rim_floor,
    told,
)
from tomotactile_ros.estimation.row_checks import IN_TURN, OVERDRIVEN, RangeEnd, Turns
from tomotactile_ros.estimation.row_model import Known
from tomotactile_ros.estimation.row_state import STATE, STRENGTH, RowState, known_for
from tomotactile_ros.estimation.settling import Settling, with_ground
from tomotactile_ros.estimation.touch import PARAMETERS, Touches, conductance, patches_for
from tomotactile_ros.estimation.tracks import REACH

Doubt = Callable[[np.ndarray, np.ndarray, float], str]
# spacings that a contact may go without rows (`row_state.known_for`), 0.44 s with spacings of 25
# mm, 0.69 s with 50 mm: what was there before is not known any more. In `slide`, first row after a
# pause, all contacts were within 5 mm after 0.3 s without rows (38 times), 3 of 38 times not after
# 0.6 s, 15 of 38 after 0.8 s. With 1 s for all, single stamps 0.9 s ahead gave valid contacts 10 to
# 25 mm off
_UNSEEN = 2.0
_REMEMBERED = 2048  # rows: a frame whose estimate takes longer than they lasted is too old
# rows: kept for a frame that is told late: of 6 s, as long as one takes on a busy machine; s: from
# one of them to the next: what slides at 0.2 m/s goes 10 mm in it, less than half the distance of
# electrodes
_KEPT, _EACH = 128, 0.05
_LOOKED_AT = 0.5  # s: a sensor may break, and a frame tells by what
_NEXT = 1.5  # times the time from one row to the next: beyond it this is not the row after that one
_OFF_CENTRE = 0.15  # of the radius: how far off the middle of a wide contact rows may see it
_OTHER_NOISE = 0.2  # of its logarithm: rows go on with what frames show
_DOUBTFUL = 2  # frames one after another that nothing explains: rows are not believed either


@dataclass
class RowsState:
    """All that lasts from row to row of one sensor.

    waits : whether the row that completes a frame waits for the frame's estimate
    begun : whether a row has come; rows : of the follower, from then on; frames : of the estimator
    read, grounded, times : rows since the last frame; used : electrodes in use
    confirmed : s, time of the last frame that was valid; looked : of the last one that was told
    doubted : frames since that nothing explained; passed : whether the last one was left out, as
        something began or ended in it
    ground : whether the last rows show that an electrode is grounded
    turns : whether touches go and come as none does; end : of the converter's range
    noise : of readings, V rms, as frames have shown it; 0 before
    settling : what readings keep of the row before, as frames have shown it
    last_row : its readings, V, and the electrode that it grounded
    means : {number of a contact: where its mean D was taken, m and ln m, and `Touches`}
    past : (time, {number: (5, 4) place, m, velocity, m/s, and their covariance}) after each of the last rows
    kept : some of the rows of late, while they wait for what a frame tells
    """

    waits: bool = True
    _rows: RowState | None = None
    frames: State = field(default_factory=State)
    read: list = field(default_factory=list)
    grounded: list = field(default_factory=list)
    times: list = field(default_factory=list)
    used: tuple[int, ...] = ()
    drive: float = 0.0
    noise: float = 0.0
    settling: Settling | None = None
    last_row: tuple[np.ndarray, int] | None = None
    sensor: object = None  # what was learned of it when contacts were last looked at
    confirmed: float = -np.inf
    looked: float = -np.inf
    doubted: int = 0
    passed: bool = False
    doubt: str = ""
    means: dict = field(default_factory=dict)
    left_out: dict = field(default_factory=dict)
    ground: GroundWatch = field(default_factory=GroundWatch)
    turns: Turns = field(default_factory=Turns)
    end: RangeEnd = field(default_factory=RangeEnd)
    past: deque = field(default_factory=lambda: deque(maxlen=_REMEMBERED))
    kept: deque = field(default_factory=lambda: deque(maxlen=_KEPT))
    _told: deque = field(default_factory=lambda: deque(maxlen=1))

    @property
    def begun(self) -> bool:
        return self._rows is not None

    @property
    def rows(self) -> RowState:
        assert self._rows is not None
        return self._rows

    @property
    def before(self) -> np.ndarray | None:
        """(E,) V, potentials in the last row."""
        if self.last_row is None:
            return None
        row, grounded = self.last_row
        return with_ground(row[None], np.array([grounded]))[0]

    def lasts(self, rows: int) -> float:
        """Time that so many of the last rows took, s."""
        past = self.past
        return past[-1][0] - past[-min(rows, len(past))][0] if past else 0.0

    @property
    def confused(self) -> bool:
        """Whether rows have contradicted what was said of the sheet again and again."""
        return self.begun and bool(np.isinf(self.rows.confused))

    @property
    def asks(self) -> bool:
        """Whether a frame can tell what rows cannot: of what has just begun, of wide contacts,
        where rows are not believed, of channels that they contradict; and now and then in any
        case."""
        if self.touching is None or self.rows.wide or self.rows.distrusted.any():
            return True
        return any(self.new) or self.rows.time - self.looked > _LOOKED_AT

    @property
    def new(self) -> list[bool]:
        """Which contacts of rows no frame has confirmed yet."""
        return [begun > self.confirmed for begun in self.rows.belief.begun]

    @property
    def known(self) -> bool:
        """Whether rows know what there is, and nothing of it is wider than they can tell."""
        return self.touching is not None and not self.rows.wide

    @property
    def clear(self) -> bool:
        """Whether, besides, a frame has told of all that touches, in the last half second, and something
        slides: then rows tell more than a frame."""
        if not self.known or self.rows.time - self.looked > _LOOKED_AT:
            return False
        return bool(sliding(self.rows.belief)) and not any(self.new)

    @property
    def larger(self) -> bool:
        """Whether something conducts more than a bare contact of the size that rows took it for."""
        return any(grown > 0 for *_, grown in self.means.values())

    @property
    def touching(self) -> tuple[int, ...] | None:
        """Numbers of what touches; None where that is not known."""
        if not self.begun or self.confused or self.rows.unexplained or self.doubted >= _DOUBTFUL:
            return None
        return (*(number for number, *_ in self.rows.wide), *self.rows.belief.numbers)

    def rows_since_change(self, begun: float, ended: float) -> int | None:
        """How many rows of a frame from `begun` to `ended`, s, came after the last beginning or end
        that rows saw in it; None: it is of one state, or rows may not be believed. From any thread."""
        if not self.begun or self.confused:
            return None
        within = [places.keys() for at, places in list(self.past) if begun <= at <= ended]
        change = [i for i in range(1, len(within)) if within[i] != within[i - 1]]
        return len(within) - change[-1] if change else None

    def tell(self, seen: FrameSeen) -> None:
        """Leave what a frame said to the next row; from any thread. Of several the last one
        counts."""
        self._told.append(seen)

    def told(self) -> FrameSeen | None:
        """What was left since the row before, if anything."""
        return self._told.pop() if self._told else None


@dataclass(frozen=True)
class Followed:
    """What is known after a row: contacts, strongest first, each with its number and the time since
    it began, s; `touched` : whether something touches, or that is not known."""

    contacts: list[tuple[int, float, Contact]]
    state: str = "valid"
    reason: str = ""
    touched: bool = True


class RowEstimator:
    """Contacts from rows of one layout.

    Parameters
    ----------
    estimator : of whole frames
    frames : whether whole frames are estimated, too; without, there are no wide contacts
    doubt : says of rows (L, E), V, the electrodes grounded and the drive voltage why no frame is
        made of them; empty where one is
    """

    def __init__(self, estimator: Estimator, frames: bool = True, doubt: Doubt | None = None):
        self.estimator, self._frames, self._doubt = estimator, frames, doubt
        self._followers: dict[tuple[int, ...], Follower] = {}
        self._pause = known_for(_UNSEEN * float(np.median(estimator.layout.pitches)))  # s

    def estimate(
        self,
        voltages: np.ndarray,
        grounded: int,
        drive_voltage: float,
        time: float,
        state: RowsState,
    ) -> Followed:
        """Contacts at the time of a row, s, with its readings `voltages` (E,), V, NaN: not read."""
        self.follow(voltages, grounded, drive_voltage, time, state)
        return self.report(state)

    def follow(
        self,
        voltages: np.ndarray,
        grounded: int,
        drive_voltage: float,
        time: float,
        state: RowsState,
    ) -> None:
        """Takes a row into `state`; arguments as for `estimate`."""
        read = np.array(voltages, float)
        read[grounded] = np.nan
        if not state.begun or drive_voltage != state.drive or self._is_broken(state, time):
            self._begin(state, drive_voltage)
        elif (
            state.sensor is not self.estimator.sensor
            or state.rows.model.operator is not self.estimator.operator_of(state.used)
        ):
            self._learned(state)
        seen = state.told()
        if seen is not None:
            self._take(seen, state)
        voltages = known = read
        before = None if state.settling is None else state.before
        if state.settling is not None and before is not None:
            if state.lasts(2) and time - state.past[-1][0] > _NEXT * state.lasts(2):
                before = np.full(len(read), np.nan)  # rows between were lost
            voltages = state.settling.less(read, before)
            known = np.where(np.isnan(voltages), read, voltages)
        state.last_row = known, grounded
        driven = voltages
        if len(state.used) < len(voltages) or self.estimator.sensor is not None:
            used = list(state.used)
            driven = np.full(len(voltages), np.nan)  # electrodes that are used may change
            driven[used] = voltages[used] - self.estimator.offsets(state.used)
        noise = max(self.estimator.noise, state.noise)
        places = self.estimator.layout.positions
        ended = state.end.take(read, drive_voltage)
        state.ground.take(driven, places[grounded], places, drive_voltage, noise)
        if state.ground.doubt:  # it tells nothing, and a search for what it says would be long
            state.read, state.grounded, state.times = [], [], []
            return
        follower = self._follower(state.used, drive_voltage)
        at = int(follower.operator.position[grounded])
        valid = (np.isfinite(voltages) & ~ended)[follower.operator.used]
        # where the wire of a channel that rows contradict leads is not known: its row tells nothing
        tells = valid.any() and not (state.end.most or state.ground.unseen)
        if at >= 0 and tells and not state.rows.distrusted[at]:
            readings = voltages[follower.operator.used] / drive_voltage
            touched = state.rows.touched
            self._follow(state, follower, readings, valid, at, time)
            after, untouched = state.rows.touched, state.rows.untouched
            if state.turns.take(touched, after, untouched, time):
                state.rows.confused = np.inf
        elif at >= 0:
            state.rows.distrusted = np.maximum(state.rows.distrusted - 1, 0)
        state.past.append((time, state.rows.belief.places))
        if not (state.waits and self._frames):
            return
        state.read.append(read)
        state.grounded.append(grounded)
        state.times.append(time)
        if len(state.read) >= self.estimator.layout.electrodes:
            self._frame(state)
            state.read, state.grounded, state.times = [], [], []

    def _follow(
        self,
        state: RowsState,
        follower: Follower,
        readings: np.ndarray,
        valid: np.ndarray,
        at: int,
        time: float,
    ) -> None:
        """Lets a row tell, or keeps it for when a frame has told what rows began with."""
        try:
            if self._frames and (state.confused or not state.rows.read):
                follower.wait(state.rows, readings, valid, time)
                if not state.kept or time - state.kept[-1][-1] >= _EACH:
                    state.kept.append((readings, valid, at, time))
            else:
                carried_on(follower, state.rows, time)
                follower.follow(state.rows, readings, valid, at, time)
        except np.linalg.LinAlgError:  # numbers that no voltages between conductors have
            self._begin(state, state.drive)
            state.rows.time, state.rows.unexplained = time, 1

    def go_on(self, state: RowsState, seen: FrameSeen, drive_voltage: float) -> None:
        """Begin with what a frame said of which no row was followed."""
        self._begin(state, drive_voltage)
        state.rows.time, state.rows.confused = seen.ended, np.inf  # all is as the frame says
        state.past.append((seen.ended, {}))
        self._take(seen, state)

    def look(
        self,
        voltages: np.ndarray,
        grounded: np.ndarray,
        drive_voltage: float,
        period: float,
        frames: State,
        clear: bool = False,
    ) -> FrameSeen | None:
        """What a frame (L, E), V, with `period` s from row to row says; `frames` lasts from frame
        to frame. None where something changes within it and rows are `clear`: they tell more."""
        follow = _leave_to_rows if clear else None
        given = voltages, grounded, drive_voltage, frames, period, follow
        try:
            estimate = self.estimator.estimate(*given)
        except _Changes:
            return None
        return FrameSeen.of(estimate, frames)

    def _is_broken(self, state: RowsState, time: float) -> bool:
        """Whether a row at `time` does not follow those before: after a pause, or a clock set back."""
        before = state.rows.time
        return np.isfinite(before) and not -self._pause <= time - before <= self._pause

    def _begin(self, state: RowsState, drive_voltage: float) -> None:
        excluded = self.estimator.excluded
        electrodes = range(self.estimator.layout.electrodes)
        used = tuple(e for e in electrodes if e not in excluded and e not in state.left_out)
        known = self._known(state, used, drive_voltage)
        last = state.rows.last if state.begun else 0
        state.used, state.drive = used, drive_voltage
        state._rows = self._follower(used, drive_voltage).begin(known)
        state.rows.last = last
        state.sensor = self.estimator.sensor
        state.past.clear()
        state.kept.clear()
        state.turns.begin()

    def _learned(self, state: RowsState) -> None:
        """Goes on with the same contacts and what is known of the sensor by now."""
        follower, rows = self._follower(state.used, state.drive), state.rows
        known = self._known(state, state.used, state.drive)
        known = replace(known, wide=rows.model.known.wide)
        state.sensor = self.estimator.sensor
        linearised(follower, rows, known, rows.belief.unlearned(known.shift_deviation))

    def _known(self, state: RowsState, used: tuple[int, ...], drive_voltage: float) -> Known:
        """What is expected of the sensor, with as much noise as frames have shown."""
        noise = max(self.estimator.noise, state.noise)
        _, prior = self.estimator.sensor_of(used, drive_voltage, noise)
        return Known.before(prior, (noise / drive_voltage) ** 2)

    def _follower(self, used: tuple[int, ...], drive_voltage: float) -> Follower:
        known = self._followers.get(used)
        # the sheet may be found to be cut otherwise, or learned
        if known is None or known.operator is not self.estimator.operator_of(used):
            operator, prior = self.estimator.sensor_of(used, drive_voltage)
            self._followers = {used: Follower(operator, self.estimator.radius, prior.spread)}
        return self._followers[used]

    def _frame(self, state: RowsState) -> None:
        """A complete frame corrects what rows have told."""
        begun, ended = state.times[0], state.times[-1]
        if begun <= state.turns.latest:  # some of its rows were not read
            return
        period = max((ended - begun) / max(len(state.times) - 1, 1), 0.0)
        rows = np.array(state.read), np.array(state.grounded)
        why = "" if self._doubt is None else self._doubt(*rows, state.drive)
        if why:
            seen: FrameSeen | None = FrameSeen(Estimate([], [], "withheld", why), None)
        else:
            seen = self.look(*rows, state.drive, period, state.frames, state.clear)
        if seen is not None:
            self._take(replace(seen, begun=begun, ended=ended), state)

    def _take(self, seen: FrameSeen, state: RowsState) -> None:
        """What a frame said corrects what rows have told."""
        if seen.begun <= state.turns.latest:
            return
        estimate, fit = seen.estimate, seen.fit
        state.settling = seen.settling or state.settling
        before = max(self.estimator.noise, state.noise)
        if estimate.noise and abs(np.log(estimate.noise / before)) > _OTHER_NOISE:
            state.noise = estimate.noise
            self._learned(state)
        if not state.passed and _is_mixed(state, seen):
            state.passed = True
            return
        state.looked, state.passed = seen.ended, False
        left_out = {e: why for e, why in estimate.left_out.items() if why != EXCLUDED}
        left = len(self.estimator.layout.positions) - len({*left_out, *self.estimator.excluded})
        if left < 2:  # nothing to follow with; the estimate says so, and the next one may find more
            left_out = state.left_out
        if set(left_out) != set(state.left_out):  # other electrodes: what rows told was of others
            state.left_out = left_out
            now = state.rows.time
            self._begin(state, state.drive)
            state.rows.time = now
        if estimate.state != "valid":
            state.doubted, state.doubt = state.doubted + 1, estimate.reason
            return
        state.doubted = 0
        had = (
            placed(each, seen.ended - at) for at, each in reversed(state.past) if at <= seen.ended
        )
        then = next(had, None)
        if fit is None:  # what moves within a frame has none, but places
            reach = REACH * float(np.median(self.estimator.layout.pitches))
            if then is not None and _are_those(then, estimate.contacts, reach):
                state.confirmed = seen.ended
            return
        if fit.used != tuple(state.used):
            return
        if state.confused:
            self._catch_up(seen, fit, state, then or {})
            return
        if then is None:  # it took too long
            return
        since = 2 * seen.begun - seen.ended  # the frame before, with which its estimate began
        within = [places for at, places in state.past if since <= at <= seen.ended]
        ended = any(places.keys() - then.keys() for places in within)
        corrected(self._follower(state.used, state.drive), state.rows, seen, fit, then, ended)
        state.confirmed = seen.ended

    def _catch_up(
        self, seen: FrameSeen, fit: Fitted, state: RowsState, then: Mapping[int, np.ndarray]
    ) -> None:
        """Goes on from what a frame said where rows were not believed: those kept since tell again."""
        kept = [row for row in state.kept if row[-1] > seen.ended]
        after = [*(row[-1] for row in kept), state.rows.time]
        if after[0] - seen.ended > self._pause and fit.unknowns.rates[:, :2].any():
            return  # what slides has gone nobody knows where
        follower = self._follower(state.used, state.drive)
        times = [at for at, _ in state.past if at >= seen.begun]
        state.kept.clear()
        state.past.clear()
        if kept:
            state.rows.time = seen.ended
        corrected(follower, state.rows, seen, fit, then)
        state.confirmed = seen.ended
        for row, until in zip([None, *kept], [*after[: len(kept)], np.inf]):
            if row is not None:
                self._follow(state, follower, *row)
            places, since = state.rows.belief.places, -np.inf if row is None else row[-1]
            state.past.extend((at, places) for at in times if since <= at < until)

    def report(self, state: RowsState) -> Followed:
        """Contacts at the time of the last row."""
        rows = state.rows
        if state.ground.doubt:
            return Followed([], "withheld", state.ground.doubt)
        if state.ground.unseen and not state.touching:  # what does not touch lies on no electrode
            return Followed([], "withheld", NO_GROUND)
        if state.turns.doubtful(len(self.estimator.layout.positions)):
            return Followed([], "withheld", IN_TURN)
        if state.end.doubtful(len(self.estimator.layout.positions)):
            return Followed([], "withheld", OVERDRIVEN)
        if state.doubted >= _DOUBTFUL:
            return Followed([], "withheld", state.doubt)
        if rows.unexplained:
            return Followed([], "withheld", "no contacts explain the last row")
        if not rows.read:
            return Followed(
                [],
                "withheld",
                "rows have begun anew with other electrodes: contacts follow with the next row",
            )
        if self._frames and state.confused:
            begun = "something already touched when rows began" if rows.touched_at_once else ""
            said = begun or "rows contradict each other"
            return Followed([], "withheld", f"{said}: contacts follow with the next whole frame")
        if self._frames and self._may_be_one(state):
            reason = (
                "one wide contact or several near each other have begun: which of them, the next whole "
                "frame tells"
            )
            return Followed([], "withheld", reason)
        wide = wide_now(rows)
        found = [(number, max(rows.time - begun, 0.0), each) for number, begun, each in wide]
        belief, contacts = rows.belief, rows.belief.contacts
        if state.means.keys() - belief.numbers:
            state.means = {n: each for n, each in state.means.items() if n in belief.numbers}
        for i, number in enumerate(belief.numbers):
            own = slice(STATE * i, STATE * (i + 1))
            mean, covariance = belief.mean[own], belief.covariance[own, own]
            touches, grown = self._touches(state, number, contacts[i])
            contacts[i, 3] += grown
            if grown:  # of a wide one the middle is not known either
                off = _OFF_CENTRE * float(np.exp(contacts[i, 3]))
                covariance = covariance + np.diag([off**2, off**2, 0.0, 0.0, 0.0])
            size = belief.sizes[i, 1] + grown**2
            about = touches, contacts[i], size, mean, covariance, rows.uneven
            operator = self._follower(state.used, state.drive).operator
            reported = self._contact(operator, *about)
            found.append((number, max(rows.time - belief.begun[i], 0.0), reported))
        if found and state.ground.alike:
            return Followed([], "withheld", ALIKE)
        found.sort(key=lambda each: -each[2].force)
        return Followed(found, touched=bool(found))

    def _may_be_one(self, state: RowsState) -> bool:
        """Whether a contact that no frame has confirmed yet is near another one."""
        belief = state.rows.belief
        if belief.count < 2:
            return False
        new = state.new
        if not any(new):
            return False
        places = belief.contacts[:, :2]
        apart = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
        near = apart < CLOSE * self._follower(state.used, state.drive).operator.pitch
        np.fill_diagonal(near, False)
        return bool(near[new].any())

    def _touches(self, state: RowsState, number: int, contact: np.ndarray) -> tuple[Touches, float]:
        """The contact (4,) x, y, ln c, ln a on the sheet, taken anew only where it has moved; and
        how much larger ln a is, as one that conducts more than a bare one of its size is wider."""
        follower = self._follower(state.used, state.drive)
        x, y, strength, size = contact.tolist()
        pitch = follower.operator.pitch
        here = x / pitch, y / pitch, strength / 10, size / 10
        kept = state.means.get(number)
        if kept is None or any(abs(a - b) > SIMILAR for a, b in zip(kept[0], here)):
            sheet, grown = state.rows.model.known.sheet, 0.0
            touches = _on_sheet(follower.operator, contact, sheet)
            lacks = touches.mean[0] - FILLED * float(np.exp(-contact[2]))
            if lacks > 0:  # D falls with ln a by R / 2 pi
                grown = float(2 * np.pi * lacks / follower.operator.resistance)
                touches = _on_sheet(follower.operator, contact + [0, 0, 0, grown], sheet)
            kept = here, touches, grown
            state.means[number] = kept
        return kept[1], kept[2]

    def _contact(
        self,
        operator: SheetOperator,
        touches: Touches,
        contact: np.ndarray,
        size_variance: float,
        mean: np.ndarray,
        covariance: np.ndarray,
        uneven: float,
    ) -> Contact:
        way, covered = float(touches.mean[0]), float(touches.covered[0])
        g, by_strength, by_mean = conductance(contact[2], way)
        g, bare = told(g, way, operator.resistance)
        if bare:  # known from below alone: as one that is wider by two deviations
            wider = 2 * math.sqrt(size_variance) * operator.resistance / (2 * math.pi)
            g = min(g, conductance(contact[2], max(way - wider, 0.0))[0])
        law = self.estimator.law
        area = math.pi * math.exp(2 * contact[3]) * covered
        pressure = float(law.pressure(g * covered / area))
        force, m = pressure * area, law.exponent
        by_size = 2 * (1 - 1 / m) - by_mean * operator.resistance / (2 * math.pi) / m
        strength = float(covariance[STRENGTH, STRENGTH])
        relative = by_strength**2 * strength / m**2 + by_size**2 * size_variance
        relative += FORCE_FLOOR**2 + (IMPEDANCE_FLOOR * by_mean * way / m) ** 2
        relative += crowded(g, operator.resistance) ** 2
        relative = math.inf if bare else min(math.sqrt(relative), MOST_RELATIVE)
        floor = (PLACE_FLOOR * operator.pitch * uneven) ** 2
        (xx, xy), (yx, yy) = covariance[:2, :2].tolist()
        x, y, vx, vy = mean[:4].tolist()
        radius = math.sqrt(area / math.pi)
        if bare:
            floor += rim_floor(operator, (x, y), radius) ** 2
        return Contact(
            x,
            y,
            force,
            pressure,
            area,
            radius,
            g * covered,
            (xx + floor, xy, yx, yy + floor),
            force * relative,
            radius * math.sqrt(size_variance),
            1 - math.exp(-0.5 / max(strength, 1e-12)),
            (vx, vy),
        )


class _Changes(Exception):
    """Something changes within a frame, and rows tell."""


def _leave_to_rows(left_out: dict[int, str]) -> FollowedRows | None:
    raise _Changes


def _are_those(places: dict[int, np.ndarray], contacts: list[Contact], reach: float) -> bool:
    """Whether `contacts` of a frame are those that rows have at `places` (`placed`), each within `reach`,
    m."""
    if len(places) != len(contacts):
        return False
    way = [[np.hypot(x - c.x, y - c.y) for c in contacts] for (x, y), *_ in places.values()]
    cost = np.minimum(np.reshape(way, (len(contacts), len(contacts))) / reach, 1.0)
    return bool((cost[linear_sum_assignment(cost)] < 1).all())


def _is_mixed(state: RowsState, seen: FrameSeen) -> bool:
    """Whether rows saw something begin or end in a frame so that it tells them nothing: in its last
    few rows, of which they know as much, or where it does not explain its rows well."""
    since, fit = state.rows_since_change(seen.begun, seen.ended), seen.fit
    if since is None:  # of a press that grows or fades, a part of the rows tells no more than each
        return bool(seen.estimate.first) and not state.confused
    poor = fit is not None and fit.chi_squared > POOR * fit.count
    return poor or since < YOUNG


def _on_sheet(operator: SheetOperator, contact: np.ndarray, sheet: np.ndarray) -> Touches:
    full = np.zeros((1, PARAMETERS))
    full[0, :4] = contact
    across = (patches_for(float(np.exp(contact[3])), operator.pitch),)
    return Touches(operator, full, across, sheet)
