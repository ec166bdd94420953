"""One frame in, one result out: checks, tare, channels, image, contacts, pressure."""

from __future__ import annotations

import math
from collections.abc import Iterable
from copy import copy
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.estimation.changing import Changing
from tomotactile_ros.estimation.estimator import Estimator, State
from tomotactile_ros.estimation.frames_in_rows import FrameSeen
from tomotactile_ros.estimation.ground import ground_is_doubtful
from tomotactile_ros.estimation.reported import ANYWHERE, Estimate, may_be_anywhere
from tomotactile_ros.estimation.row_checks import IN_TURN
from tomotactile_ros.estimation.row_estimator import RowEstimator, RowsState
from tomotactile_ros.estimation.screening import dead_channels as unread_channels
from tomotactile_ros.estimation.screening import (
    latest_state,
    open_grounds,
    stuck_channels,
    too_many_are_bad,
    without_channels,
)
from tomotactile_ros.estimation.search import BOUNDED, SUSPECT
from tomotactile_ros.estimation.settling import with_ground
from tomotactile_ros.estimation.touch import MOST_ACROSS
from tomotactile_ros.estimation.tracks import Tracks
from tomotactile_ros.frame import DEFAULT_DRIVE, Frame
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout, check_on_sheet
from tomotactile_ros.learning.state import SensorState
from tomotactile_ros.reconstruction.estimate import (
    EVEN_DISC,
    Strength,
    contacts_and_pressure,
    described,
    disc_cells,
)
from tomotactile_ros.reconstruction.frame_checks import (
    alternates,
    check_drive_voltage,
    is_idle,
    last_of_each,
    ordered,
    ordered_row,
    rows_of,
    standing_still,
)
from tomotactile_ros.reconstruction.linear import LinearImage
from tomotactile_ros.reconstruction.mistakes import Doubts
from tomotactile_ros.reconstruction.model import Model
from tomotactile_ros.reconstruction.profiles import MEASURED, choose, median_times, trial_frame
from tomotactile_ros.reconstruction.settings import ContactEstimate, Result, Settings
from tomotactile_ros.reconstruction.unusable_electrodes import (
    broken_channels,
    dead_channels,
    is_doubtful,
    swapped_channels,
    why_left_out,
)
from tomotactile_ros.simulation import ROW_PERIOD
from tomotactile_ros.support import memory
from tomotactile_ros.support.errors import InputError, doubt

# profiles whose contacts are fitted to the readings, not read from an image: patches to the width of each
ESTIMATED = {"balanced": BOUNDED, "accurate": MOST_ACROSS}
# electrodes that an image needs: with fewer, forces were up to 3.5 times too large
FEWEST = 9
MOST_ELECTRODES = 1024  # of 32 x 32; set-up time and memory grow with the square
# of the currents into the grounded electrodes, that contacts of an image leave at most: one that is
# missed and has a twentieth of the others' strength leaves as much
_LEFT_OVER = 0.05
# of the sheet's longer side: how far electrodes on one line stray from it, and where the sheet is looked for
_STRAIGHT, _ASIDE = 1e-3, 0.05
CONTRADICTS = "its readings contradict all others"  # why a channel is left out
STILL = "a multiplexer, a converter or its supply is broken or not connected"
_TIMES = 3  # frames without times that are withheld and looked at again, as if their rows had them
_KEPT = 8  # regularised inverses for patterns of missing readings


class Pipeline:
    """Reconstruction for one layout.

    Attributes
    ----------
    layout, settings, grid : what it was made for
    sensor : what was learned of this sensor (`learning.state.SensorState`), or None
    profile : the profile in use
    report : one line for the log
    """

    def __init__(
        self,
        layout: Layout,
        settings: Settings,
        *,
        model: Model | None = None,
        sensor: SensorState | None = None,
    ):
        self.layout, self.settings, self.sensor = layout, settings, sensor
        if max(settings.excluded, default=0) >= layout.electrodes:
            raise InputError(
                f"excluded: electrode {max(settings.excluded)} does not exist, "
                f"{layout.name} has 0 to {layout.electrodes - 1}"
            )
        _check_size(layout, settings)
        _check_sides(layout)
        self.grid = Grid.for_outline(layout.outline, settings.resolution)
        self.profile = settings.profile
        self._model = model or Model(layout, self.grid, settings.model, settings.noise)
        self._excluded = np.zeros(layout.electrodes, bool)
        self._excluded[list(settings.excluded)] = True
        left = int(np.count_nonzero(~self._excluded))
        if left < 2:
            raise InputError(f"excluded: {left} of {self._excluded.size} electrodes left, need 2")
        self._linear: dict[bytes, LinearImage] = {}
        self._baseline: np.ndarray | None = None
        if settings.level is not None:
            self._linear_for(np.empty(0, int))
        self._model.local(np.flatnonzero(~self._excluded))
        self.report = f"profile {self.profile}"
        if settings.profile == "auto":
            self.profile, self.report = self._measure_profiles()
        even = self._model.sheet.transfer(self.grid.pixels, EVEN_DISC * settings.contact_radius)
        self._disc_change = even.point_self - self._model.transfer.point_self  # of D, ohm
        self._estimator, self._state = None, State()
        self._imaged_before: tuple | None = None  # last frame, where an image explained it
        self._doubts: Doubts | None = None
        self._looked_for_times = 0  # frames
        self._explained_one = False  # the last touched frame was what the layout says
        self._exchanged = False  # wires seemed to be exchanged in the last frame that was asked
        self._estimate_of_frame: FrameSeen | None = None
        self._rows: RowEstimator | None = None
        self._changing = Changing(self._row_estimator)
        self._began = self._ended = 0.0  # s, of the rows of the last frame
        # (E,) V, potentials in the row before this frame and in its last one, if rows have times
        self._row_before: np.ndarray | None = None
        self._last_row: np.ndarray | None = None
        self._tracks = Tracks(float(np.median(layout.pitches)))
        if self.profile in ESTIMATED or left < FEWEST or layout.scan:
            self._estimator = self._make_estimator()

    def _make_estimator(self) -> Estimator:
        settings = self.settings
        return Estimator(
            self.layout,
            noise=settings.noise,
            law=settings.law,
            radius=settings.contact_radius,
            model=settings.model,
            excluded=settings.excluded,
            sensor=self.sensor,
            across=ESTIMATED.get(self.profile, BOUNDED),
        )

    def _estimates(self) -> Estimator:
        if self._estimator is None:
            self._estimator = self._make_estimator()
        return self._estimator

    def with_settings(self, settings: Settings) -> Pipeline:
        """The same layout with other settings; keeps the tare and what else can be kept."""
        keys = ("resolution", "model", "noise")
        same = all(getattr(settings, key) == getattr(self.settings, key) for key in keys)
        model = self._model if same else None
        other = Pipeline(self.layout, settings, model=model, sensor=self.sensor)
        other._baseline = self._baseline
        other._tracks = self._tracks
        return other

    def tare(self, frames: Iterable[Frame | tuple[np.ndarray, np.ndarray]]) -> None:
        """Take the mean of untouched `frames`, or pairs (voltages, grounded), off all that follow."""
        pairs = (
            (each.voltages, each.grounded) if isinstance(each, Frame) else each for each in frames
        )
        stack = np.array([ordered(self.layout, *pair) for pair in pairs])
        if not len(stack):
            raise InputError("tare: needs at least one frame")
        valid = np.isfinite(stack)
        total = np.where(valid, stack, 0.0).sum(axis=0)
        self._baseline = total / np.maximum(np.count_nonzero(valid, axis=0), 1)
        self._forget()

    def untare(self) -> None:
        """Forget the tare."""
        self._baseline = None
        self._forget()

    @property
    def follows(self) -> bool:
        """Whether rows can be followed at once; otherwise the first `rows` takes seconds."""
        return self._rows is not None or self._estimator is not None

    @property
    def fits(self) -> bool:
        """Whether the profile fits contacts to readings, and draws them for an image."""
        return self.profile in ESTIMATED

    @property
    def baseline(self) -> np.ndarray | None:
        """(E, E) V that the tare takes off every frame, row i with electrode i grounded; None
        without."""
        return self._baseline

    def use_baseline(self, baseline: np.ndarray) -> None:
        """Take up the tare of another pipeline of this layout."""
        self._baseline = baseline
        self._forget()

    def use_sensor(self, sensor: SensorState | None) -> None:
        """Go on with what is known about the sensor by now."""
        self.sensor = sensor
        if self._estimator is not None:
            self._estimator.sensor = sensor
        if self._rows is not None:
            self._rows.estimator.sensor = sensor
        self._forget()

    def _forget(self) -> None:
        """Start the next frame from scratch."""
        self._state.forget()
        self._changing.forget()
        self._imaged_before = None

    def process(
        self,
        frame: Frame | ArrayLike,
        grounded: ArrayLike | None = None,
        drive_voltage: float = DEFAULT_DRIVE,
        row_period: float = 0.0,
        stamp: float | None = None,
        numbered: bool = True,
    ) -> Result:
        """Reconstruct one frame.

        Parameters
        ----------
        frame : a `Frame`, which has all of the following, or its voltages alone: (L, E) V, NaN where
            there is no valid reading
        grounded : (L,) grounded electrode of each row, any subset in any order; in profiles that
            fit contacts also more than once
        drive_voltage : V
        row_period : s between rows, which are in the order of time; 0: all at once. Where the rows
            contradict that, it is said once, as a `Doubt`
        stamp : s, time of the first row; with it contacts are followed from frame to frame
        numbered : whether they are to be; not where rows are, whose contacts have the numbers

        Raises InputError where the frame does not fit the layout.
        """
        if isinstance(frame, Frame):
            if grounded is not None:
                raise InputError("grounded: the frame has its own, and its times and drive voltage")
            given = frame.voltages, frame.grounded, frame.drive_voltage, frame.row_period
            stamp = None if math.isnan(frame.stamp) else frame.stamp
        elif grounded is None:
            raise InputError("grounded: is missing; a Frame has it, voltages alone do not")
        else:
            given = np.asarray(frame), np.asarray(grounded), drive_voltage, row_period
        result = self._process(*given, stamp, numbered)
        if result.reason and not given[-1] > 0 and self._looked_for_times < _TIMES:
            self._looked_for_times += 1
            self._doubt_at_once(*given[:-1])
        return result

    def _doubt_at_once(self, voltages, grounded, drive_voltage) -> None:
        """Say once where rows that all are said to be read at once agree if they were read in turn."""
        settings = replace(self.settings, profile=self.profile)
        trial = Pipeline(self.layout, settings, model=self._model, sensor=self.sensor)
        trial._baseline, trial._estimator = self._baseline, self._estimator
        result = trial._process(voltages, grounded, drive_voltage, ROW_PERIOD, 0.0)
        if result.contacts:  # nothing that touches would be no explanation
            self._looked_for_times = _TIMES
            doubt(
                "row_period: 0 says that all rows are read at once, and they contradict each other; read one after the "
                "other they do not: give each frame its times, Frame(..., stamp=..., row_period=...) in Python"
            )

    def _process(
        self,
        voltages: np.ndarray,
        grounded: np.ndarray,
        drive_voltage: float,
        row_period: float,
        stamp: float | None,
        numbered: bool = True,
    ) -> Result:
        """The same, of arrays."""
        drive_voltage = check_drive_voltage(drive_voltage, self.settings.noise)
        self._estimate_of_frame = None
        before = self._ended
        self._began = before + row_period if stamp is None else stamp
        self._ended = self._began + row_period * max(len(grounded) - 1, 0)
        at_once = abs(self._began - before - row_period) < row_period / 2
        self._row_before, self._last_row = self._last_row if at_once else None, None
        if row_period > 0 and len(grounded):
            self._last_row = self._row_at_end(voltages, grounded)
            if self._row_before is None:  # it is not known
                self._row_before = np.full(self.layout.electrodes, np.nan)
        once = last_of_each(voltages, grounded) if self.fits else (voltages, grounded)
        mistake = self._no_ground(voltages, grounded, drive_voltage)
        mistake = mistake or self._mistake(*once, drive_voltage)
        if mistake:  # what a frame is withheld for, rows are, too
            self._estimate_of_frame = FrameSeen(Estimate([], [], "withheld", mistake), None)
            lasts = row_period * max(len(grounded) - 1, 0)
            result = self._withheld(mistake, self._excluded, {}, math.nan, lasts)
        elif self.profile in ESTIMATED:
            result = self._estimated(voltages, grounded, drive_voltage, row_period)
        else:
            result = self._imaged(voltages, grounded, drive_voltage, row_period)
        if result.contacts or result.reason:
            self._explained_one = not result.reason
        if self._state.settling is not None:
            result.settling = float(self._state.settling.part.mean())
        if stamp is not None and numbered and not result.reason:
            lasts = row_period * max(len(grounded) - 1, 0)
            timed = (
                lasts if result.holds == lasts else 0.0
            )  # not where all were taken for one state
            followed = self._tracks.follow(result.contacts, stamp + result.holds, timed)
            result.contacts = [
                replace(contact, id=each.number, age=each.age, velocity=each.velocity)
                for contact, each in zip(result.contacts, followed)
            ]
        return self._as_known(result)

    def _row_at_end(self, voltages, grounded) -> np.ndarray:
        """(E,) potentials in the last row of a frame, V, with the tare taken off."""
        last = rows_of(self.layout, voltages, grounded)[-1:]
        chosen = np.asarray(grounded, int)[-1:]
        return with_ground(self._expected_zero(last, chosen), chosen)[0]

    def _as_known(self, result: Result) -> Result:
        """Without forces and pressures where no contact law gives them."""
        settings = self.settings
        return result if settings.contact_law is not None else result.without_law(settings.law)

    def _no_ground(self, voltages, grounded, drive_voltage) -> str:
        """What is wrong where readings do not depend on what is grounded, or whole rows on nothing."""
        chosen = np.asarray(grounded, int)
        rows = self._expected_zero(rows_of(self.layout, voltages, grounded), chosen)
        return self._doubt(rows, chosen, drive_voltage)

    def _doubt(self, rows: np.ndarray, chosen: np.ndarray, drive_voltage: float) -> str:
        """The same of rows (L, E), V, with the tare taken off."""
        rows = rows.copy()
        rows[:, self._excluded] = np.nan
        if self.sensor is not None:
            rows -= self.sensor["offset"]
        if still := standing_still(rows, self.settings.noise):
            return f"{still} of {rows.shape[1]} channels never change while others do: {STILL}"
        read = ~np.isnan(rows)
        stuck = stuck_channels(rows, read, self.settings.noise)
        read[np.arange(len(rows)), chosen] = True
        bad = (stuck | unread_channels(read)) & ~self._excluded
        rows[:, stuck] = np.nan
        if alternates(rows, self.settings.noise):
            return IN_TURN
        places = self.layout.positions
        doubt = ground_is_doubtful(rows, places[chosen], places, drive_voltage, self.settings.noise)
        several = int(np.count_nonzero(bad)), int(np.count_nonzero(~self._excluded))
        return doubt or too_many_are_bad(*several)

    def _mistake(self, voltages, grounded, drive_voltage) -> str:
        """What was probably done wrong where a frame is not what the layout says, looked for until
        one was explained: no search among contacts would end well."""
        if self._explained_one:
            return ""
        frame = self._expected_zero(ordered(self.layout, voltages, grounded))
        missing = np.isnan(frame)
        if is_idle(frame, missing, self._excluded, self.settings.threshold * self.settings.noise):
            return ""
        if self._doubts is None:
            transfer = self._model.sheet.transfer(self.layout.positions[:1], self.layout.radius)
            self._doubts = Doubts(self.layout, transfer, self.settings.noise)
        frame[:, self._excluded] = np.nan
        frame[self._excluded] = np.nan
        return self._doubts.mistake([frame], drive_voltage)

    def rows(self, waits: bool = True) -> RowsState:
        """The state of a sensor whose rows are followed, before the first of them (`process_row`).

        The row that completes a frame waits for the frame's estimate; not so without `waits`: then
        frames are given to `correct`. Contacts that frames and rows before had keep their numbers.
        """
        self._row_estimator()
        self._tracks.begin()
        return RowsState(waits=waits)

    def process_row(
        self,
        voltages: ArrayLike,
        grounded: int,
        drive_voltage: float,
        time: float,
        state: RowsState,
    ) -> Result:
        """Contacts at the time of one row, s, whatever the profile; without images.

        Parameters
        ----------
        voltages : (E,) V; NaN where there is no valid reading
        grounded : electrode that was grounded
        drive_voltage : V
        state : of `rows`, changed in place; rows of one sensor in the order of their times

        Raises InputError where the row does not fit the layout.
        """
        self.follow_row(voltages, grounded, drive_voltage, time, state)
        return self.after_row(state)

    def follow_row(
        self,
        voltages: ArrayLike,
        grounded: int,
        drive_voltage: float,
        time: float,
        state: RowsState,
    ) -> None:
        """Take a row into `state` and ask for nothing; see `process_row`."""
        drive_voltage = check_drive_voltage(drive_voltage, self.settings.noise)
        row = ordered_row(self.layout, voltages, int(grounded))
        row = self._expected_zero(row, int(grounded))
        self._row_estimator().follow(row, int(grounded), drive_voltage, float(time), state)

    def after_row(self, state: RowsState) -> Result:
        """Contacts at the time of the last row that `state` was given."""
        return self._as_known(self._after_row(state))

    def _after_row(self, state: RowsState) -> Result:
        followed = self._row_estimator().report(state)
        contacts = [_reported(contact) for *_, contact in followed.contacts]
        if followed.state == "valid":
            given = [(number, age) for number, age, _ in followed.contacts]
            lasts = state.lasts(self.layout.electrodes)
            tracked = self._tracks.follow(contacts, state.rows.time, lasts, given)
            contacts = [replace(c, id=t.number, age=t.age) for c, t in zip(contacts, tracked)]
        none = np.empty((0, 0))
        bad = np.zeros(self.layout.electrodes, bool)
        bad[list(state.left_out)] = True
        return Result(
            none,
            none,
            contacts,
            _numbers(bad | self._excluded),
            not followed.touched,
            0.0,
            state=followed.state,
            reason=followed.reason,
            faults=dict(state.left_out),
        )

    def image_after_row(self, state: RowsState) -> Result:
        """`after_row` with an image of its contacts: what profiles that fit contacts show of a
        frame, without looking at one."""
        result = self._after_row(state)
        discs = [contact for _, _, contact in self._row_estimator().report(state).contacts]
        pressure = self.grid.fill(self._drawn(discs)[0])
        return self._as_known(replace(result, pressure=pressure))

    def correct(
        self,
        state: RowsState,
        voltages: ArrayLike,
        grounded: ArrayLike,
        drive_voltage: float,
        row_period: float,
        stamp: float,
        clear: bool | None = None,
    ) -> None:
        """Let a frame, the one that was just given to `process` if any was, correct rows that are
        followed meanwhile, maybe in another thread.

        Arguments as for `process`. Profiles that make images take as long as `accurate` for it.
        `clear` : whether rows are clear, should the state not be theirs: a frame within which
        something changes then tells nothing.
        """
        seen, self._estimate_of_frame = self._estimate_of_frame, None
        if seen is not None:
            state.tell(seen.at(stamp, row_period, len(grounded)))
            return
        chosen = np.asarray(grounded, int)
        rows = self._expected_zero(rows_of(self.layout, voltages, grounded), chosen)
        clear = state.clear if clear is None else clear
        given = rows, chosen, drive_voltage, row_period, state.frames, clear
        seen = self._row_estimator().look(*given)
        if seen is not None:
            state.tell(seen.at(stamp, row_period, len(chosen)))

    def _row_estimator(self) -> RowEstimator:
        rows = self._rows
        if rows is None:
            rows = self._rows = RowEstimator(self._estimates(), doubt=self._doubt)
        return rows

    def _estimated(self, voltages, grounded, drive_voltage, row_period) -> Result:
        """What the estimator says; with a regularization, beside the image of eq. 1."""
        frame = voltages, grounded, drive_voltage, row_period
        estimate = self._as_wired(*frame)
        if estimate is None:
            estimate = self._estimate(*frame)
            # where something began or ended within the frame, its last rows contradict all others
            if not _is_sure(estimate) and not estimate.first:
                estimate = self._without_contradicting(estimate, *frame)
        lasts = row_period * max(len(grounded) - 1, 0)
        if self.fits:
            self._estimate_of_frame = FrameSeen.of(estimate, self._state)
        noise = estimate.noise or math.nan
        bad = np.zeros(self.layout.electrodes, bool)
        bad[list(estimate.left_out)] = True
        if estimate.state != "valid":
            why = estimate.reason, bad, estimate.left_out, estimate.misfit, lasts
            return replace(self._withheld(*why), noise=noise)
        idle = not estimate.contacts
        contacts = [_reported(each) for each in estimate.contacts]
        covariances = [np.reshape(each.position_covariance, (2, 2)) for each in contacts]
        if any(may_be_anywhere(each, self.layout) for each in covariances):
            why = ANYWHERE, bad, estimate.left_out, estimate.misfit, lasts
            return replace(self._withheld(*why), noise=noise)
        pressure, conductance = self._drawn(estimate.parts)
        level = self.settings.level
        if level is None or idle:
            typical = self._model.local(np.flatnonzero(~bad)).typical_impedance
            potential = drive_voltage * np.minimum(conductance * typical, 1.0)
        else:
            once = last_of_each(voltages, grounded)
            potential = self._one_step(self._without_baseline(*once), bad)
        return Result(
            self.grid.fill(potential),
            self.grid.fill(pressure),
            contacts,
            _numbers(bad),
            idle,
            level or 0.0,
            misfit=estimate.misfit,
            faults=estimate.left_out,
            holds=lasts,
            noise=noise,
        )

    def _drawn(self, discs) -> tuple[np.ndarray, np.ndarray]:
        """(K,) pressure, Pa, and conductance, S, of contacts of the estimator."""
        pressure = np.zeros(len(self.grid.pixels))
        conductance = np.zeros_like(pressure)
        for each in discs:
            pixels, covered = disc_cells(np.array([each.x, each.y]), each.radius, self.grid)
            covered = covered / covered.sum()
            pressure[pixels] += each.force * covered / self.grid.cell_area
            conductance[pixels] += each.conductance * covered
        return pressure, conductance

    def _as_wired(self, voltages, grounded, drive_voltage, row_period) -> Estimate | None:
        """The estimate without wires that seem to be exchanged, which is sure then; None where none do.

        Asked until a touch was explained by all, and from then on where wires were: with them, all
        that the search tries takes seconds, and leaves little over in the wrong place.
        """
        if self._explained_one and not self._exchanged:
            return None
        frame = self._expected_zero(ordered(self.layout, *last_of_each(voltages, grounded)))
        exchanged = self._exchanged_wires(frame, drive_voltage)
        if exchanged is not None:
            self._exchanged = bool(exchanged.any())
        if exchanged is None or not self._exchanged:
            return None
        given = voltages, grounded, drive_voltage, row_period
        estimate = self._without(exchanged, *given)
        return estimate if _is_sure(estimate) else None

    def _exchanged_wires(self, frame, drive_voltage) -> np.ndarray | None:
        """(E,) channels of an ordered frame (E, E), V, that fit the sheet only if exchanged; None where
        it does not tell."""
        bad, idle = self._silent(frame)
        used = np.flatnonzero(~bad)
        part = frame[np.ix_(used, used)].astype(np.float32)
        if len(used) < FEWEST or idle:
            return None
        if np.count_nonzero(np.isnan(part)) > len(used):
            return None
        meter = self._model.local(used).meter
        measured = meter.read(part, drive_voltage)
        exchanged = np.zeros(len(frame), bool)
        exchanged[used] = swapped_channels(meter, part, drive_voltage, measured)
        return exchanged

    def _without_contradicting(self, estimate, voltages, grounded, drive_voltage, row_period):
        """The estimate without channels whose couplings no sheet has, swapped wires for example, if
        that explains more."""
        bad = self._read(*last_of_each(voltages, grounded), drive_voltage)[1]
        if not set(_numbers(bad)) - set(estimate.left_out):
            return estimate
        before = copy(self._state)
        again = self._without(bad, voltages, grounded, drive_voltage, row_period)
        valid = again.state == "valid"
        if not valid or (estimate.state == "valid" and again.misfit > estimate.misfit / 2):
            self._state = before
            return estimate
        known = {e: why for e, why in estimate.left_out.items() if e in again.left_out}
        again.left_out.update(known)
        return again

    def _without(self, bad, voltages, grounded, drive_voltage, row_period) -> Estimate:
        """The estimate without the channels `bad` (E,)."""
        found = self._estimate(voltages, grounded, drive_voltage, row_period, without=bad)
        found.left_out.update(dict.fromkeys(_numbers(bad), CONTRADICTS))
        return found

    def _estimate(
        self, voltages, grounded, drive_voltage, row_period=0.0, began=None, without=None
    ):
        chosen = np.asarray(grounded, int)
        rows = self._expected_zero(rows_of(self.layout, voltages, grounded), chosen)
        began, first = (self._began, self._row_before) if began is None else (began, None)
        given = rows, chosen, drive_voltage
        kept = rows if without is None else without_channels(rows, chosen, without)
        follow = partial(self._changing.estimate, kept, *given[1:], began, row_period)
        how = {"first": first, "without": without}
        estimate = self._estimates().estimate(*given, self._state, row_period, follow, **how)
        if row_period > 0 and self._state.fit is not None:
            seen = FrameSeen.of(estimate, self._state)
            self._changing.saw(seen.at(began, row_period, len(chosen)))
        return estimate

    def _expected_zero(self, readings, grounded=slice(None)):
        """(..., E) ordered readings, V, with the tare taken off, but for offsets that are known:
        the estimator expects these, and they are in the baseline."""
        if self._baseline is None:
            return readings
        readings = readings - self._baseline[grounded]
        return readings if self.sensor is None else readings + self.sensor["offset"]

    def _without_baseline(self, voltages, grounded):
        """(E, E) ordered frame, V, with the tare taken off."""
        frame = ordered(self.layout, voltages, grounded)
        return frame if self._baseline is None else frame - self._baseline

    def _withheld(self, reason, bad, faults, misfit, holds) -> Result:
        unknown = self.grid.fill(np.full(len(self.grid.pixels), np.nan))
        return Result(
            unknown,
            unknown.copy(),
            [],
            _numbers(bad),
            False,
            0.0,
            state="withheld",
            reason=reason,
            misfit=misfit,
            faults=faults,
            holds=holds,
        )

    def _imaged(self, voltages, grounded, drive_voltage, row_period) -> Result:
        """The linear image and the contacts that its blobs show; what the estimator says where a
        frame is none that one linear step is made for, see `_read`."""
        given = voltages, grounded, drive_voltage, row_period
        frame, bad, local, measured = self._read(voltages, grounded, drive_voltage)
        middle = row_period * max(len(grounded) - 1, 0) / 2
        if local is None:
            if not self._rests(frame, bad):
                return self._handed_over(*given)
            self._explained(*given)
            return self._idle(bad, self._faults(frame, bad), middle)
        image = None
        if measured is not None and np.count_nonzero(~bad) >= FEWEST:
            image = described(local, measured, self._disc_change, self.settings.contact_radius)
        if image is None or image.left_over > _LEFT_OVER:
            return self._handed_over(*given)
        self._explained(*given)
        level = self.settings.level
        if level is None:
            level = local.regularization(local.level(measured))
            potential = drive_voltage * np.minimum(image.values * local.typical_impedance, 1.0)
        else:
            potential = self._one_step(frame, bad)
        contacts, pressure = contacts_and_pressure(
            image.blobs, image.values, image.strengths, self.settings.law, self.grid
        )
        return Result(
            self.grid.fill(potential),
            self.grid.fill(pressure),
            contacts,
            _numbers(bad),
            False,
            level,
            faults=self._faults(frame, bad),
            holds=middle,
        )

    def _explained(self, voltages, grounded, drive_voltage, row_period) -> None:
        """Remember a frame that needed no estimate, should the next one need what was there."""
        self._state.forget()
        before = np.array(voltages, float), np.array(grounded), drive_voltage, row_period
        self._imaged_before = *before, self._began

    def _handed_over(self, voltages, grounded, drive_voltage, row_period) -> Result:
        """What the estimator says of a frame that no image explains; of the last that one did it is
        asked first, because a frame that changes tells little of what rests beside."""
        if self._imaged_before is not None:
            self._estimate(*self._imaged_before)
            self._imaged_before = None
        return self._estimated(voltages, grounded, drive_voltage, row_period)

    def _rests(self, frame, bad) -> bool:
        """Whether a frame without a contact is one of an untouched sheet: it was read, and nothing is
        as far below 0 V as a contact is above."""
        read = frame[np.ix_(~bad, ~bad)]
        read = read[np.isfinite(read)]
        most = self.settings.threshold * self.settings.noise
        return len(read) >= FEWEST and bool(read.min() > -most)

    def _faults(self, frame, bad) -> dict[int, str]:
        if not bad.any():
            return {}
        return why_left_out(frame, bad, self._excluded, self.settings.noise)

    def strengths(
        self, voltages: ArrayLike, grounded: ArrayLike, drive_voltage: float
    ) -> list[Strength]:
        """How strongly each contact of a frame conducts, strongest first, by the estimator; arguments
        as for `process`."""
        drive_voltage = check_drive_voltage(drive_voltage, self.settings.noise)
        estimate = self._estimate(voltages, grounded, drive_voltage)
        found = [
            Strength(np.array([each.x, each.y]), each.conductance, each.area)
            for each in estimate.contacts
        ]
        return sorted(found, key=lambda strength: -strength.conductance)

    def _read(self, voltages, grounded, drive_voltage):
        """Ordered frame (E, E), channels left out (E,), `LocalImage`, `Grounded`; None for both if
        idle.

        None for the last alone where one linear step is not enough: readings are missing, the touch
        began or ended between rows, or channels contradict reciprocity and none of them is broken.
        """
        if self._state.settling is not None:
            rows, chosen = rows_of(self.layout, voltages, grounded), np.asarray(grounded, int)
            voltages = self._state.settling.taken_off(rows, chosen, self._row_before)
        frame = ordered(self.layout, voltages, grounded)
        if self._baseline is not None:
            frame -= self._baseline
        if self.sensor is not None:
            frame = self.sensor.corrected(frame, tared=self._baseline is not None)
        bad, idle = self._silent(frame)
        if idle:
            return frame, bad, None, None
        noise = self.settings.noise
        read = ~np.isnan(frame) & ~bad & ~bad[:, None]
        left = 1 - np.where(read, frame, drive_voltage) / drive_voltage
        bad |= open_grounds(left, read, noise / drive_voltage) & read.any(axis=1)
        changes = latest_state(left[~bad], read[~bad], noise / drive_voltage) > 0
        used = np.flatnonzero(~bad)
        if len(used) < 2:
            return frame, bad, None, None
        local, measured = self._measure(frame, bad, drive_voltage)
        return frame, bad, local, None if changes else measured

    def _silent(self, frame) -> tuple[np.ndarray, bool]:
        """(E,) channels of an ordered frame (E, E), V, that are excluded, dead or stuck, and whether the
        others are idle."""
        bad, missing, noise = self._excluded.copy(), np.isnan(frame), self.settings.noise
        if np.count_nonzero(missing) > len(frame):
            bad |= dead_channels(~missing)
        bad |= stuck_channels(frame, ~missing, noise)
        return bad, is_idle(frame, missing, bad, self.settings.threshold * noise)

    def _measure_profiles(self):
        """The profile to use, and a line for the log."""
        trial = trial_frame(self._model.transfer, self.layout.sheet_resistance, self.settings.noise)
        grounded, works = np.arange(self.layout.electrodes), {}
        for profile in MEASURED:
            settings = replace(self.settings, profile=profile)
            other = Pipeline(self.layout, settings, model=self._model)
            works[profile] = partial(other._process_anew, trial, grounded, 3.3)
        return choose(median_times(works), self.settings.deadline)

    def _process_anew(self, *frame):
        self._forget()
        return self._process(*frame, 0.0, None)

    def _measure(self, frame, bad, drive_voltage):
        """`LocalImage` and `Grounded` of the good channels, see `_read`; broken ones are added to
        `bad` (E,)."""
        noise = self.settings.noise
        while True:
            used = np.flatnonzero(~bad)
            if len(used) < 2:
                return None, None
            local = self._model.local(used)
            part = frame if len(used) == len(frame) else frame[np.ix_(used, used)]
            part = part.astype(np.float32)
            if np.count_nonzero(np.isnan(part)) > len(used):
                return local, None
            measured = local.meter.read(part, drive_voltage)
            if not is_doubtful(local.meter, part, measured, noise):
                return local, measured
            broken = broken_channels(part, drive_voltage, noise)
            if not broken.any():
                broken = swapped_channels(local.meter, part, drive_voltage, measured)
            if not broken.any():
                return local, None
            bad[used[broken]] = True

    def _idle(self, bad, faults, holds) -> Result:
        zero = self.grid.fill(np.zeros(len(self.grid.pixels)))
        level = self.settings.level or 0.0
        return Result(zero, zero.copy(), [], _numbers(bad), True, level, faults=faults, holds=holds)

    def _one_step(self, frame, bad):
        """(K,) image of eq. 1, V, of an ordered frame (E, E) without the channels `bad` (E,)."""
        valid = np.isfinite(frame) & ~bad & ~bad[:, None]
        missing = ~valid
        np.fill_diagonal(missing, False)
        linear = self._linear_for(np.flatnonzero(missing))
        return linear.image(np.where(valid, frame, 0.0).ravel()).astype(float)

    def _linear_for(self, missing) -> LinearImage:
        key = missing.tobytes()
        if key not in self._linear:
            if len(self._linear) >= _KEPT:
                self._linear.pop(next(iter(self._linear)))
            level = self.settings.level
            self._linear[key] = LinearImage(self._model.basis(level), level, missing)
        return self._linear[key]


def _check_size(layout: Layout, settings: Settings) -> None:
    """Refuse what takes minutes or more memory than there is, and contacts wider than the sheet.

    Measured: 18 arrays of electrodes x cells and 100 of electrodes x electrodes.
    """
    count, resolution = layout.electrodes, settings.resolution
    if count > MOST_ELECTRODES:
        raise InputError(
            f"layout: {layout.name} has {count} electrodes, at most {MOST_ELECTRODES} are reconstructed"
        )
    check_on_sheet(layout, settings.contact_radius, "contact_radius")
    needed = 8.0 * count * (18.0 * resolution**2 + 100.0 * count)
    memory.check(needed, f"layout: {count} electrodes at resolution {resolution}")


def _check_sides(layout: Layout) -> None:
    """Refuse electrodes on one line with sheet on both sides of it: readings are the same for a
    contact on the other side."""
    centre = layout.positions.mean(axis=0)
    _, spread, axes = np.linalg.svd(layout.positions - centre)
    aside = _ASIDE * max(layout.outline.size) * axes[1]
    if len(spread) > 1 and spread[1] > _STRAIGHT * max(layout.outline.size):
        return
    if all(layout.outline.contains(layout.positions + side).any() for side in (aside, -aside)):
        raise InputError(
            f"layout: all electrodes of {layout.name} lie on one line: on which side of it something "
            "presses cannot be told"
        )


def _reported(contact) -> ContactEstimate:
    """The estimator's contact as a result shows it, without a number."""
    return ContactEstimate(
        contact.x,
        contact.y,
        contact.force,
        contact.pressure,
        contact.area,
        contact.radius,
        contact.covariance,
        contact.force_std,
        contact.probability,
        velocity=contact.velocity,
        conductance=contact.conductance,
    )


def _is_sure(estimate: Estimate) -> bool:
    """Whether contacts explain a frame."""
    return estimate.state == "valid" and estimate.misfit < SUSPECT


def _numbers(bad) -> tuple[int, ...]:
    return tuple(np.flatnonzero(bad).tolist())
