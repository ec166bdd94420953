"""One frame in, one result out: checks, tare, channels, image, contacts, pressure."""

from __future__ import annotations

import math
from collections.abc import Iterable
from copy import copy
from dataclasses import replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.estimation import screening
from tomotactile_ros.estimation.arrangement import beyond
from tomotactile_ros.estimation.changing import Changing
from tomotactile_ros.estimation.estimator import Estimator, State
from tomotactile_ros.estimation.frames_in_rows import FrameSeen
from tomotactile_ros.estimation.ground import ground_is_doubtful
from tomotactile_ros.estimation.reported import ANYWHERE, Estimate, may_be_anywhere
from tomotactile_ros.estimation.row_checks import IN_TURN
from tomotactile_ros.estimation.row_estimator import RowEstimator, RowsState
from tomotactile_ros.estimation.screening import dead_channels as unread_channels
from tomotactile_ros.estimation.screening import (
    driven_channels,
    latest_state,
    open_grounds,
    stuck_channels,
    too_many_are_bad,
    without_channels,
)
from tomotactile_ros.estimation.search import BOUNDED, SUSPECT
from tomotactile_ros.estimation.settling import with_ground
from tomotactile_ros.estimation.tears import lines
from tomotactile_ros.estimation.touch import MOST_ACROSS
from tomotactile_ros.estimation.tracks import Tracks
from tomotactile_ros.frame import DEFAULT_DRIVE, Frame
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout, check_layout, check_on_sheet
from tomotactile_ros.learning.state import SensorState
from tomotactile_ros.reconstruction.deadline import Within
from tomotactile_ros.reconstruction.estimate import (
    EVEN_DISC,
    Strength,
    all_as_one,
    contacts_and_pressure,
    described,
    disc_cells,
)
from tomotactile_ros.reconstruction.frame_checks import (
    above_drive,
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
from tomotactile_ros.reconstruction.settings import ContactEstimate, Result, Settings
from tomotactile_ros.reconstruction.unusable_electrodes import (
    broken_channels,
    covered_electrodes,
    dead_channels,
    is_doubtful,
    swapped_channels,
    why_left_out,
)
from tomotactile_ros.simulation import ROW_PERIOD
from tomotactile_ros.support import checks, memory
from tomotactile_ros.support.errors import InputError, doubt

# profiles whose contacts are fitted to the readings, not read from an image: patches to the width of each
ESTIMATED = {"balanced": BOUNDED, "accurate": MOST_ACROSS, "auto": MOST_ACROSS}
# electrodes that an image needs: with fewer, forces were up to 3.5 times too large
FEWEST = 9
MOST_ELECTRODES = 1024  # of 32 x 32; set-up time and memory grow with the square
# of the currents into the grounded electrodes, that contacts of an image leave at most: one that is
# missed and has a twentieth of the others' strength leaves as much
_LEFT_OVER = 0.05
# spacings, standard deviation of places on a sheet that is unlike the layout's, as currents bend around what
# is not known: beside tears of 60 and 90 mm they are 2.3 and 3.1 mm off (p95, 28.6 mm spacing), 5 to 11 mm on 5 x 5
_UNLIKE = 0.08
# of the sheet's longer side: how far electrodes on one line stray from it, and where the sheet is looked for
_STRAIGHT, _ASIDE = 1e-3, 0.05
UNDECIDED = (
    "the deadline came before it was known what touches, if anything: a longer deadline, a lower rate or "
    "delivery:=rows helps"
)
NO_IMAGE = "something changed between the rows of the frame, or many readings are missing: no image is made"
CONTRADICTS = "its readings contradict all others"  # why a channel is left out
STILL = "a multiplexer, a converter or its supply is broken or not connected"
_OF_COVERED = screening.STUCK, screening.OPEN  # what electrodes under a conductor seem to be
_TIMES = 3  # frames without times that are withheld and looked at again, as if their rows had them
_REPEATED = 4.0  # deviations of the mean square of two frames' difference, up to which it is noise
_NO_IMAGE = np.empty((0, 0))
_KEPT = 8  # regularised inverses for patterns of missing readings


class _Given(NamedTuple):
    """A frame as it is to be reconstructed: as of `Pipeline.process`, when its first row was read, s,
    and the potentials `before` (E,) that, V: NaN where they are not known; None: if rows have times."""

    voltages: np.ndarray
    grounded: np.ndarray
    drive_voltage: float
    row_period: float
    began: float
    before: np.ndarray | None

    @property
    def lasts(self) -> float:
        """Time from the first row to the last, s."""
        return self.row_period * max(len(self.grounded) - 1, 0)

    def once(self) -> _Given:
        """The same with each electrode grounded once, the last time."""
        voltages, grounded = last_of_each(self.voltages, self.grounded)
        return self._replace(voltages=voltages, grounded=grounded)


class _Found(NamedTuple):
    """The result of a frame, the frame itself, what it tells rows, if that is known, and whether its
    contacts are those that are there, one by one, to be followed."""

    result: Any  # Result; None of a frame of which only rows are told
    given: _Given
    seen: FrameSeen | None = None
    one_by_one: bool = True

    @property
    def holds(self) -> float:
        """Time for which the result holds, s."""
        return self.given.began + self.result.holds


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
        check_layout(layout)
        checks.instance(settings, "settings", Settings)
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
        limit = "" if settings.deadline is None else f" within {1e3 * settings.deadline:.3g} ms"
        self.report = f"profile {self.profile}{limit}"
        self._model = model or Model(layout, self.grid, settings.model, settings.noise)
        self._excluded = np.zeros(layout.electrodes, bool)
        self._excluded[list(settings.excluded)] = True
        left = int(np.count_nonzero(~self._excluded))
        if left < 2:
            raise InputError(f"excluded: {left} of {self._excluded.size} electrodes left, need 2")
        self._linear: dict[bytes, LinearImage] = {}
        self._baseline: np.ndarray | None = None
        if settings.level is not None:
            self._linear_for(np.empty(0, int), settings.level)
        self._model.local(np.flatnonzero(~self._excluded))
        even = self._model.sheet.transfer(self.grid.pixels, EVEN_DISC * settings.contact_radius)
        self._disc_change = even.point_self - self._model.transfer.point_self  # of D, ohm
        self._state = State()
        self._imaged_before: _Given | None = None  # last frame, where an image explained it
        self._doubts: Doubts | None = None
        self._looked_for_times = 0  # frames
        self._explained_one = False  # the last touched frame was what the layout says
        self._exchanged = False  # wires seemed to be exchanged in the last frame that was asked
        self._within: Within[_Found] = Within()
        self._found: _Found | None = None  # of the last frame
        self._whole: _Found | None = None  # of the last one that was complete
        # what may be in the place of so many contacts as the last frame showed: rows do not tell
        self._beside: dict[int, list[ContactEstimate] | None] = {}
        self._rows: RowEstimator | None = None
        self._changing = Changing(self._row_estimator)
        self._told = -math.inf  # s, for which the last result holds, of a frame or of a row
        self._ended = 0.0  # s, when the last row of the last frame was read
        self._last_row: np.ndarray | None = None  # (E,) V, potentials in it, if rows have times
        self._tracks = Tracks(float(np.median(layout.pitches)))
        self.estimator = Estimator(
            layout,
            noise=settings.noise,
            law=settings.law,
            radius=settings.contact_radius,
            model=settings.model,
            excluded=settings.excluded,
            sensor=sensor,
            across=ESTIMATED.get(self.profile, BOUNDED),
            unknown=settings.asked,
        )

    def with_settings(self, settings: Settings) -> Pipeline:
        """The same layout with other settings; keeps the tare and what else can be kept."""
        keys = ("resolution", "model", "noise")
        same = all(getattr(settings, key) == getattr(self.settings, key) for key in keys)
        model = self._model if same else None
        other = Pipeline(self.layout, settings, model=model, sensor=self.sensor)
        other._baseline = self._baseline
        other._tracks = self._tracks
        return other

    def stop(self) -> None:
        """End a search that goes on after its deadline."""
        self._within.stop()

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
    def made_otherwise(self) -> str:
        """A line where readings show that the sheet is torn, cut or printed otherwise than drawn; else nothing."""
        made = self.estimator.made_as
        if made is None:
            return ""
        if made.tears:
            return f"{', '.join(lines(made.tears))}, it seems: look at it, or learn the sensor"
        cut = made.layout
        sizes = (1e3 * np.array(each.outline.size) for each in (cut, self.layout))
        found, drawn = (f"{width:.1f} mm x {height:.1f} mm" for width, height in sizes)
        return (
            f"the sheet seems to be {found} with electrodes of {1e3 * cut.radius:.2f} mm, not {drawn} with "
            f"{1e3 * self.layout.radius:.2f} mm: measure it, or learn the sensor"
        )

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
        self.estimator.sensor = sensor
        self._forget()

    def _forget(self) -> None:
        """Start the next frame from scratch."""
        self.stop()
        self._state.forget()
        self._changing.forget()
        self._imaged_before = self._whole = None

    def process(
        self,
        frame: Frame | ArrayLike,
        grounded: ArrayLike | None = None,
        drive_voltage: float = DEFAULT_DRIVE,
        row_period: float = 0.0,
        stamp: float | None = None,
        numbered: bool = True,
        deadline: float | None = None,
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
        deadline : s that it may take, for this frame in the place of the settings' deadline. What is
            not found by then is looked for on, and the frames after this one begin with it

        Raises InputError where the frame does not fit the layout.
        """
        if isinstance(frame, Frame):
            if grounded is not None:
                raise InputError("grounded: the frame has its own, and its times and drive voltage")
            rows = frame.voltages, frame.grounded, frame.drive_voltage, frame.row_period
            stamp = None if math.isnan(frame.stamp) else frame.stamp
        elif grounded is None:
            raise InputError("grounded: is missing; a Frame has it, voltages alone do not")
        else:
            rows = np.asarray(frame), np.asarray(grounded), drive_voltage, row_period
        given = self._given(*rows, stamp)
        mistake = self._no_ground(given)
        if mistake:
            found = self._mistaken(given, mistake)
        elif self.settings.contacts:
            found = self._imaged(given) or self._in_time(given, deadline)
        else:
            found = self._pictured(given)
        result, self._found = found.result, found
        if result.complete and found.given is given:
            self._whole = found
        self._told = found.holds
        self._beside = {len(result.contacts): result.alternative}
        if stamp is not None and numbered and found.one_by_one and not result.reason:
            result.contacts = self._numbered(found)
        if found.given is not given:  # of a frame before, whose search has ended since
            result.holds += found.given.began - given.began
            result.complete = False
        if found.one_by_one and result.contacts and _may_be_covered(result.faults):
            readings = np.fmax.reduce(self._rows_of(found.given)[0])
            result = self._without_covered(result, readings, given.drive_voltage)
        if self.settings.image == "none":
            result.pressure = result.potential = _NO_IMAGE
        if result.reason and found.given is given:
            above = above_drive(
                given.voltages, given.drive_voltage
            )  # what else is said follows from it
            result = replace(result, reason=above or result.reason)
        return self._as_known(result)

    def _given(self, voltages, grounded, drive_voltage, row_period, stamp) -> _Given:
        """A frame after the one before, of which it is remembered when it ended and how."""
        drive_voltage = check_drive_voltage(drive_voltage, self.settings.noise)
        ended, rows = self._ended, max(len(grounded) - 1, 0)
        began = ended + row_period if stamp is None else stamp
        self._ended = began + row_period * rows
        if self._ended < ended:  # the clock was set back
            self._forget()
        at_once = abs(began - ended - row_period) < row_period / 2
        before, self._last_row = self._last_row if at_once else None, None
        if row_period > 0 and len(grounded):
            self._last_row = self._row_at_end(voltages, grounded)
            if before is None:  # it is not known
                before = np.full(self.layout.electrodes, np.nan)
        return _Given(voltages, grounded, drive_voltage, row_period, began, before)

    def _without_covered(
        self, result: Result, readings: np.ndarray, drive_voltage: float
    ) -> Result:
        """The same, in which no electrode is named of which readings (E,), V, are those of what touches
        it."""
        covered = covered_electrodes(self.layout, result.contacts, readings, drive_voltage)
        pinned = {e for e, why in result.faults.items() if why in _OF_COVERED and covered[e]}
        faults = {e: why for e, why in result.faults.items() if e not in pinned}
        left_out = tuple(e for e in result.excluded if e not in pinned)
        return replace(result, faults=faults, excluded=left_out)

    def _is_news(self, found: _Found) -> bool:
        """Whether what a search has found after its deadline holds for later than what was told since."""
        return found.result is not None and found.holds > self._told

    def _numbered(self, found: _Found) -> list[ContactEstimate]:
        """Contacts that were found with the numbers of those in frames before."""
        contacts, lasts = found.result.contacts, found.given.lasts
        # not where all rows were taken for those of one state
        timed = lasts if found.result.holds == lasts else 0.0
        ends = found.result.complete
        followed = self._tracks.follow(contacts, found.holds, timed, ends=ends)
        return [
            replace(contact, id=each.number, age=each.age, velocity=each.velocity)
            for contact, each in zip(contacts, followed)
        ]

    def _doubt_at_once(self, given: _Given) -> None:
        """Say once where rows that all are said to be read at once agree if they were read in turn."""
        trial = copy(self)
        trial._state, trial._changing = State(), Changing(self._row_estimator)
        result = trial._process(given._replace(row_period=ROW_PERIOD, began=0.0)).result
        if result.contacts:  # nothing that touches would be no explanation
            self._looked_for_times = _TIMES
            doubt(
                "row_period: 0 says that all rows are read at once, and they contradict each other; read one after the "
                "other they do not: give each frame its times, Frame(..., stamp=..., row_period=...) in Python"
            )

    def _process(self, given: _Given) -> _Found:
        """What there is to say of a frame, however long it takes."""
        mistake = self._mistake(given.once() if self.fits else given)
        if mistake:
            found = self._mistaken(given, mistake)
        else:
            found = self._estimated(given) if self.fits else self._handed_over(given)
        result = found.result
        if result.contacts or result.reason:
            self._explained_one = not result.reason
        if result.reason and not given.row_period > 0 and self._looked_for_times < _TIMES:
            self._looked_for_times += 1
            self._doubt_at_once(given)
        self._settled(result)
        return found

    def _mistaken(self, given: _Given, mistake: str) -> _Found:
        """A frame that is withheld for a mistake; what frames are withheld for, rows are, too."""
        self._explained_one = False
        result = self._withheld(mistake, self._excluded, {}, math.nan, given.lasts)
        seen = FrameSeen(Estimate([], [], "withheld", mistake), None)
        return _Found(self._settled(result), given, seen)

    def _settled(self, result: Result) -> Result:
        """The same, which says what readings keep of the row before."""
        if self._state.settling is not None:
            result.settling = float(self._state.settling.part.mean())
        return result

    def _row_at_end(self, voltages, grounded) -> np.ndarray:
        """(E,) potentials in the last row of a frame, V, with the tare taken off."""
        last = rows_of(self.layout, voltages, grounded)[-1:]
        chosen = np.asarray(grounded, int)[-1:]
        return with_ground(self._expected_zero(last, chosen), chosen)[0]

    def _as_known(self, result: Result) -> Result:
        """Without forces and pressures where no contact law gives them."""
        settings = self.settings
        return result if settings.contact_law is not None else result.without_law(settings.law)

    def _no_ground(self, given: _Given) -> str:
        """What is wrong where readings do not depend on what is grounded, or whole rows on nothing."""
        return self._doubt(*self._rows_of(given), given.drive_voltage)

    def _rows_of(self, given: _Given) -> tuple[np.ndarray, np.ndarray]:
        """(L, E) readings, V, with the tare taken off, and (L,) grounded electrodes."""
        chosen = np.asarray(given.grounded, int)
        rows = rows_of(self.layout, given.voltages, given.grounded)
        return self._expected_zero(rows, chosen), chosen

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

    def _mistake(self, given: _Given) -> str:
        """What was probably done wrong where a frame is not what the layout says, looked for until
        one was explained: no search among contacts would end well."""
        if self._explained_one:
            return ""
        frame = self._expected_zero(ordered(self.layout, given.voltages, given.grounded))
        missing = np.isnan(frame)
        if is_idle(frame, missing, self._excluded, self.settings.threshold * self.settings.noise):
            return ""
        if self._doubts is None:
            transfer = self._model.sheet.transfer(self.layout.positions[:1], self.layout.radius)
            self._doubts = Doubts(self.layout, transfer, self.settings.noise)
        frame[:, self._excluded] = np.nan
        frame[self._excluded] = np.nan
        mistake = self._doubts.mistake([frame], given.drive_voltage)
        return "" if mistake and self._begins(given) else mistake

    def _begins(self, given: _Given) -> bool:
        """Whether a touch that begins, or changes from row to row, explains all readings of a frame: they need
        not agree then, as those of one state of the sheet do."""
        if not given.row_period > 0:
            return False
        self._look_before()
        rows, chosen = self._rows_of(given)
        read = rows, chosen, given.drive_voltage, given.began, given.row_period
        followed = self._changing.estimate(*read, {})
        return followed is not None and _is_sure(followed.estimate)

    def _look_before(self) -> None:
        """Ask the estimator of the last frame, where an image explained it."""
        before, self._imaged_before = self._imaged_before, None
        if before is not None:
            self._estimate(before)

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
            self._told = state.rows.time  # what a frame before it is searched for is no news
            given = [(number, age) for number, age, _ in followed.contacts]
            lasts = state.lasts(self.layout.electrodes)
            tracked = self._tracks.follow(contacts, state.rows.time, lasts, given)
            contacts = [replace(c, id=t.number, age=t.age) for c, t in zip(contacts, tracked)]
        bad = np.zeros(self.layout.electrodes, bool)
        bad[list(state.left_out)] = True
        result = Result(
            _NO_IMAGE,
            _NO_IMAGE,
            contacts,
            _numbers(bad | self._excluded),
            not followed.touched,
            0.0,
            state=followed.state,
            reason=followed.reason,
            faults=dict(state.left_out),
            alternative=self._beside.get(len(contacts)) if contacts else None,
        )
        if not contacts or not _may_be_covered(state.left_out):
            return result
        before = state.before
        return result if before is None else self._without_covered(result, before, state.drive)

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
        deadline: float | None = None,
    ) -> None:
        """Let a frame, the one that was just given to `process` if any was, correct rows that are
        followed meanwhile, maybe in another thread; or one before it whose search has ended since.

        Arguments as for `process`. Profiles that make images take as long as `accurate` for it, or the
        `deadline`, s; what is not known by then is told by the next call after it is.
        `clear` : whether rows are clear, should the state not be theirs: a frame within which
        something changes then tells nothing.
        """
        found, self._found = self._found, None
        busy = self._within.busy
        if found is None or found.seen is None:
            found = self._within.taken_late()
        if (found is None or found.seen is None) and not busy:
            clear = state.clear if clear is None else clear
            rows = np.asarray(voltages), np.asarray(grounded)
            given = _Given(*rows, drive_voltage, row_period, stamp, None)
            search = partial(self._looked, given, state.frames, clear)
            limit = self._limit(deadline)
            found = search() if limit is None else self._within.sought(search, limit)
        if found is not None and found.seen is not None:
            given = found.given
            state.tell(found.seen.at(given.began, given.row_period, len(given.grounded)))

    def _looked(self, given: _Given, frames: State, clear: bool) -> _Found:
        """What a frame tells rows, and nothing of what else there is to say of it."""
        rows = *self._rows_of(given), given.drive_voltage, given.row_period
        return _Found(None, given, self._row_estimator().look(*rows, frames, clear))

    def _in_time(self, given: _Given, deadline: float | None) -> _Found:
        """What there is to say of a frame by the deadline, s, or that of the settings."""
        search, limit = partial(self._process, given), self._limit(deadline)
        if limit is None:
            return search()
        return self._within.result(search, partial(self._glance, given), limit, self._is_news)

    def _limit(self, deadline: float | None) -> float | None:
        return self.settings.deadline if deadline is None else deadline

    def _row_estimator(self) -> RowEstimator:
        rows = self._rows
        if rows is None:
            rows = self._rows = RowEstimator(self.estimator, doubt=self._doubt)
        return rows

    def _estimated(self, given: _Given) -> _Found:
        """What the estimator says; with a regularization, beside the image of eq. 1."""
        estimate = self._as_wired(given)
        if estimate is None:
            estimate = self._estimate(given)
            # where something began or ended within the frame, its last rows contradict all others
            if not _is_sure(estimate) and not estimate.first:
                estimate = self._without_contradicting(estimate, given)
        seen = FrameSeen.of(estimate, self._state) if self.fits else None
        noise = estimate.noise or math.nan
        bad = np.zeros(self.layout.electrodes, bool)
        bad[list(estimate.left_out)] = True
        contacts = [_reported(each) for each in estimate.contacts]
        covariances = [np.reshape(each.position_covariance, (2, 2)) for each in contacts]
        anywhere = any(may_be_anywhere(each, self.layout) for each in covariances)
        reason = ANYWHERE if anywhere else estimate.reason
        # a sheet cut otherwise, torn or holed: its couplings err where it is so, its currents do not; what lies
        # within an electrode is there, wherever the fit has it
        within = reason == ANYWHERE and not self.fits
        # nor does it tell of a channel that never changes whether something pins it or it is broken
        unlike = estimate.unlike and screening.STUCK not in estimate.left_out.values()
        shown = self._shown(given, self._read(given)) if unlike or within else None
        if shown is not None:
            aside = float(np.median(self.layout.pitches)) * _UNLIKE
            contacts = [_wider(each, aside) for each in shown.contacts]
            shown = replace(shown, contacts=contacts, misfit=estimate.misfit, noise=noise)
            return _Found(shown, given, seen)
        if reason:
            why = reason, bad, estimate.left_out, estimate.misfit, given.lasts
            return _Found(replace(self._withheld(*why), noise=noise), given, seen)
        idle, other = not contacts, estimate.other
        level = self.settings.level
        if self.settings.image == "none":
            images = _NO_IMAGE, _NO_IMAGE
        else:
            pressure, conductance = self._drawn(estimate.parts)
            if level is None or idle:
                typical = self._model.local(np.flatnonzero(~bad)).typical_impedance
                potential = _potential(conductance, typical, given)
            else:
                potential = self._one_step(self._without_baseline(given.once()), bad, level)
            images = self.grid.fill(potential), self.grid.fill(pressure)
        result = Result(
            *images,
            contacts,
            _numbers(bad),
            idle,
            level or 0.0,
            misfit=estimate.misfit,
            faults=estimate.left_out,
            holds=given.lasts,
            noise=noise,
            complete=estimate.complete,
            alternative=None if other is None else [_reported(each) for each in other],
        )
        return _Found(result, given, seen)

    def _pictured(self, given: _Given) -> _Found:
        """The linear image alone; its potential by eq. 1 where that is asked for."""
        read = self._read(given, doubtful=True)
        frame, bad, local, measured = read
        faults, middle = self._faults(frame, bad), given.lasts / 2
        if local is not None and measured is None:
            return _Found(self._withheld(NO_IMAGE, bad, faults, math.nan, middle), given)
        if local is None:
            return _Found(self._idle(bad, faults, middle), given)
        values = local.image(measured).astype(float)
        level = self.settings.level
        if level is None:
            potential = _potential(values, local.typical_impedance, given)
        else:
            potential = self._one_step(frame, bad, level)
        pressure = self.settings.law.pressure(np.maximum(values, 0.0) / self.grid.cell_area)
        images = self.grid.fill(potential), self.grid.fill(np.asarray(pressure))
        kept = local.regularization(local.level(measured)) if level is None else level
        result = Result(*images, [], _numbers(bad), False, kept, faults=faults, holds=middle)
        return _Found(result, given)

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

    def _as_wired(self, given: _Given) -> Estimate | None:
        """The estimate without wires that seem to be exchanged, which is sure then; None where none do.

        Asked until a touch was explained by all, and from then on where wires were: with them, all
        that the search tries takes seconds, and leaves little over in the wrong place.
        """
        if self._explained_one and not self._exchanged:
            return None
        once = given.once()
        frame = self._expected_zero(ordered(self.layout, once.voltages, once.grounded))
        exchanged = self._exchanged_wires(frame, given.drive_voltage)
        if exchanged is not None:
            self._exchanged = bool(exchanged.any())
        if exchanged is None or not self._exchanged:
            return None
        if self._begins(given):
            self._exchanged = False
            return None
        estimate = self._without(exchanged, given)
        return estimate if _is_sure(estimate) else None

    def _exchanged_wires(self, frame, drive_voltage) -> np.ndarray | None:
        """(E,) channels of an ordered frame (E, E), V, that fit the sheet only if exchanged; None where
        it does not tell."""
        bad, idle = self._silent(frame)
        used = np.flatnonzero(~bad)
        part = frame[np.ix_(used, used)].astype(np.float32)
        if len(used) < FEWEST or idle:
            return None
        left, noise = 1 - part / drive_voltage, self.settings.noise / drive_voltage
        if latest_state(left, np.isfinite(part), noise):
            return None
        if np.count_nonzero(np.isnan(part)) > len(used):
            return None
        meter = self._model.local(used).meter
        measured = meter.read(part, drive_voltage)
        exchanged = np.zeros(len(frame), bool)
        exchanged[used] = swapped_channels(meter, part, drive_voltage, measured)
        return exchanged

    def _without_contradicting(self, estimate: Estimate, given: _Given) -> Estimate:
        """The estimate without channels whose couplings no sheet has, swapped wires for example, if
        that explains more."""
        bad = self._read(given.once())[1]
        # the reading of an electrode that is never grounded is used, as a conductor may cover it
        unread = {e for e, why in estimate.left_out.items() if why != screening.OPEN}
        if not set(_numbers(bad)) - unread:
            return estimate
        before = copy(self._state)
        again = self._without(bad, given)
        valid = again.state == "valid"
        if not valid or (estimate.state == "valid" and again.misfit > estimate.misfit / 2):
            self._state = before
            return estimate
        known = {e: why for e, why in estimate.left_out.items() if e in again.left_out}
        again.left_out.update(known)
        return again

    def _without(self, bad: np.ndarray, given: _Given) -> Estimate:
        """The estimate without the channels `bad` (E,)."""
        found = self._estimate(given, without=bad)
        found.left_out.update(dict.fromkeys(_numbers(bad), CONTRADICTS))
        return found

    def _estimate(self, given: _Given, without: np.ndarray | None = None) -> Estimate:
        rows, chosen = self._rows_of(given)
        drive_voltage, row_period, began = given.drive_voltage, given.row_period, given.began
        kept = rows if without is None else without_channels(rows, chosen, without)
        follow = partial(self._changing.estimate, kept, chosen, drive_voltage, began, row_period)
        read = rows, chosen, drive_voltage, self._state, row_period, follow
        estimate = self.estimator.estimate(*read, first=given.before, without=without)
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

    def _without_baseline(self, given: _Given) -> np.ndarray:
        """(E, E) ordered frame, V, with the tare taken off."""
        frame = ordered(self.layout, given.voltages, given.grounded)
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

    def _imaged(self, given: _Given) -> _Found | None:
        """The linear image and the contacts that its blobs show, in profiles that ask for no more; None
        for a frame that one linear step is not made for, see `_read`, or with which something is wrong."""
        if self.fits or self._mistake(given):
            return None
        shown = self._shown(given, self._read(given, named=False))
        if shown is None or any(self._asks_for_more(each) for each in shown.contacts):
            return None
        if not self._within.busy:
            self._state.forget()
        self._explained_one = self._explained_one or bool(shown.contacts)
        self._imaged_before = given  # should the next frame need what was there
        return _Found(self._settled(shown), given)

    def _asks_for_more(self, contact: ContactEstimate) -> bool:
        """Whether one linear step does not tell a contact: how hard it is pressed, as it conducts nearly as a
        bare one does, or where it is, as it covers the centre of an electrode or may be beyond the outermost
        ones."""
        if self.settings.contact_law is not None and math.isinf(contact.force_std):
            return True
        place, used = np.array([contact.x, contact.y]), np.flatnonzero(~self._excluded)
        covers = self.layout.nearest(place)[0] < contact.radius
        return bool(covers or len(beyond(place, self.layout, used)))

    def _shown(self, given: _Given, read: tuple) -> Result | None:
        """What the linear image says of a frame `read` as `_read` does; None where one step is not
        enough."""
        frame, bad, local, measured = read
        if local is None:
            if not self._rests(frame, bad):
                return None
            return self._idle(bad, self._faults(frame, bad), given.lasts / 2)
        image = None
        if measured is not None and np.count_nonzero(~bad) >= FEWEST:
            image = described(local, measured, self._disc_change, self.settings.contact_radius)
        if image is None or image.left_over > _LEFT_OVER:
            return None
        level = self.settings.level
        if level is None:
            level = local.regularization(local.level(measured))
            potential = _potential(image.values, local.typical_impedance, given)
        else:
            potential = self._one_step(frame, bad, level)
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
            holds=given.lasts / 2,
        )

    def _glance(self, given: _Given) -> _Found:
        """What was complete of a frame that this one repeats but for noise; else what one linear image
        tells: its contacts, or that something presses somewhere where they do not explain it, the image alone
        while contacts last, none of which has ended by that; nothing where the readings need more than one look."""
        whole = self._whole
        if whole is not None and _is_repeated(whole.given, given, self.settings.noise):
            return _Found(replace(whole.result, complete=False), given, None, whole.one_by_one)
        read = self._read(given, doubtful=True)
        shown = self._shown(given, read)
        if shown is not None:
            return _Found(replace(shown, complete=False), given)
        frame, bad, local, measured = read
        covered = self._may_be_under(frame, bad, given.drive_voltage)
        bad = bad & ~covered  # which of them are broken, no single look tells
        faults = self._faults(frame, bad)
        if measured is None:
            result = self._withheld(UNDECIDED, bad, faults, math.nan, given.lasts / 2)
            return _Found(replace(result, complete=False), given)
        values = local.image(measured).astype(float)
        contact, pressure = all_as_one(values, local.spacing, self.settings.law, self.grid)
        untold = self._tracks.lasting or covered.any()  # what lies there shows in no other reading
        potential = _potential(values, local.typical_impedance, given)
        result = Result(
            self.grid.fill(potential),
            self.grid.fill(pressure),
            [] if untold else [contact],
            _numbers(bad),
            False,
            local.regularization(local.level(measured)),
            state="withheld" if untold else "valid",
            reason=UNDECIDED if untold else "",
            faults=faults,
            holds=given.lasts / 2,
            complete=False,
        )
        return _Found(result, given, one_by_one=False)

    def _handed_over(self, given: _Given) -> _Found:
        """What the estimator says of a frame that no image explains; of the last that one did it is
        asked first, because a frame that changes tells little of what rests beside."""
        self._look_before()
        return self._estimated(given)

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
        rows = np.asarray(voltages), np.asarray(grounded)
        given = _Given(*rows, drive_voltage, 0.0, self._ended, None)
        estimate = self._estimate(given)
        found = [
            Strength(np.array([each.x, each.y]), each.conductance, each.area)
            for each in estimate.contacts
        ]
        return sorted(found, key=lambda strength: -strength.conductance)

    def _read(self, given: _Given, doubtful: bool = False, named: bool = True):
        """Ordered frame (E, E), channels left out (E,), `LocalImage`, `Grounded`; None for both if
        idle.

        None for the last alone where one linear step is not enough: readings are missing, the touch
        began or ended between rows, an electrode may lie under a conductor, or channels contradict
        reciprocity, and those that do are not `named`, or none is. Where `doubtful` measurements will do,
        channels are not asked for that.
        """
        voltages, grounded, drive_voltage = given[:3]
        settling = self._state.settling
        if settling is not None:
            rows, chosen = rows_of(self.layout, voltages, grounded), np.asarray(grounded, int)
            voltages = settling.taken_off(rows, chosen, given.before)
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
        covered = open_grounds(left, read, noise / drive_voltage) & read.any(axis=1)
        covered |= self._may_be_under(frame, bad, drive_voltage)
        bad = bad | covered
        changes = latest_state(left[~bad], read[~bad], noise / drive_voltage) > 0
        used = np.flatnonzero(~bad)
        if len(used) < 2:
            return frame, bad, None, None
        local, measured = self._measure(frame, bad, drive_voltage, doubtful, named)
        if changes or (covered.any() and not doubtful):
            measured = None
        return frame, bad, local, measured

    def _may_be_under(self, frame, bad, drive_voltage) -> np.ndarray:
        """(E,) channels of those that are `bad`, but not excluded, that read what electrodes under a conductor
        do."""
        silent = bad & ~self._excluded
        if not silent.any():
            return silent
        return silent & driven_channels(frame, ~np.isnan(frame), drive_voltage)

    def _silent(self, frame) -> tuple[np.ndarray, bool]:
        """(E,) channels of an ordered frame (E, E), V, that are excluded, dead or stuck, and whether the
        others are idle."""
        bad, missing, noise = self._excluded.copy(), np.isnan(frame), self.settings.noise
        if np.count_nonzero(missing) > len(frame):
            bad |= dead_channels(~missing)
        bad |= stuck_channels(frame, ~missing, noise)
        return bad, is_idle(frame, missing, bad, self.settings.threshold * noise)

    def _measure(self, frame, bad, drive_voltage, doubtful, named):
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
            if doubtful or not is_doubtful(local.meter, part, measured, noise):
                return local, measured
            if not named:
                return local, None
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

    def _one_step(self, frame, bad, level: float) -> np.ndarray:
        """(K,) image of eq. 1, V, of an ordered frame (E, E) without the channels `bad` (E,)."""
        valid = np.isfinite(frame) & ~bad & ~bad[:, None]
        missing = ~valid
        np.fill_diagonal(missing, False)
        linear = self._linear_for(np.flatnonzero(missing), level)
        return linear.image(np.where(valid, frame, 0.0).ravel()).astype(float)

    def _linear_for(self, missing, level: float) -> LinearImage:
        key = missing.tobytes()
        if key not in self._linear:
            if len(self._linear) >= _KEPT:
                self._linear.pop(next(iter(self._linear)))
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


def _wider(contact: ContactEstimate, aside: float) -> ContactEstimate:
    """The same contact whose place is `aside` m off, standard deviation in x and in y, beside what it was."""
    xx, xy, yx, yy = contact.position_covariance
    return replace(contact, position_covariance=(xx + aside**2, xy, yx, yy + aside**2))


def _may_be_covered(faults: dict[int, str]) -> bool:
    """Whether some of the electrodes {electrode: why it is left out} are as those under a conductor."""
    return any(why in _OF_COVERED for why in faults.values())


def _potential(conductance: np.ndarray, impedance: float, given: _Given) -> np.ndarray:
    """(K,) V, by which contacts of a `conductance` (K,), S, raise the potential of pixels with a typical
    `impedance`, ohm."""
    return given.drive_voltage * np.minimum(conductance * impedance, 1.0)


def _is_repeated(before: _Given, given: _Given, noise: float) -> bool:
    """Whether a frame is another one again, but for `noise` of a reading, V."""
    same = before.drive_voltage == given.drive_voltage
    if not same or not np.array_equal(before.grounded, given.grounded):
        return False
    read = np.isfinite(given.voltages)
    count = int(np.count_nonzero(read))
    if not count or not np.array_equal(read, np.isfinite(before.voltages)):
        return False
    apart = given.voltages[read] - before.voltages[read]
    squares = float(apart @ apart) / (2 * noise**2 * count)
    return squares < 1 + _REPEATED * math.sqrt(2 / count)


def _is_sure(estimate: Estimate) -> bool:
    """Whether contacts explain a frame."""
    return estimate.state == "valid" and estimate.misfit < SUSPECT


def _numbers(bad) -> tuple[int, ...]:
    return tuple(np.flatnonzero(bad).tolist())
