"""A sensor that learns while it is used: which frames are worth it, and what comes out of them.

Most frames say what another one has said. `offer` looks at each and keeps those of a touch that
rests, and is not like one that was kept before (`_NEW`); `work` learns from what was kept. The
first touches are fitted together each time there are more of them (`recorded.learn`, which begins
with reciprocity: with gains far off single frames show no contacts), all that follow one after the
other (`Learner`). A load that rests is one frame, and its share in the contacts is free in the fit:
it is no property of the sheet.
"""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.operator import operator_for
from tomotactile_ros.estimation.screening import clipped, dead_channels
from tomotactile_ros.estimation.settling import Settling, rows_before
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.learning.health import Finding, Health
from tomotactile_ros.learning.learner import Learner, surprise
from tomotactile_ros.learning.readings import (
    are_offsets,
    is_untouched,
    offsets,
    rows_of,
    square,
)
from tomotactile_ros.learning.recorded import kept_of_rows_before, learn, moves, torn
from tomotactile_ros.learning.state import SensorState

OFF, CHANNELS, ALL = KINDS = "off", "channels", "all"
TOGETHER = (3, 6, 12)  # touches that are fitted together; those that follow, one by one
_KEPT = 60  # frames that a new one is compared with
_NEW = 0.03  # rms difference of two touches in parts of the readings
_STEADY = 0.015  # the same of two frames that follow each other while a touch rests
_NOISE = 1.5  # times what noise makes of a difference
_IDLE = 16  # untouched frames that are averaged
_IDLE_EVERY = 900.0  # s from one such mean to the next: drift is the same in all its frames
_ODD = 4.0  # surprise of a touch that does not fit to the sensor as it is known
_CHANGED = 3  # such touches in turn: the sensor has changed
_BETTER = 0.5  # of the misfit of most of them is left if it has
_UNEXPLAINED = 0.5  # of the touches: with more the sensor is not what the model knows


@dataclass(frozen=True, eq=False)
class _Frame:
    """One frame (E, E), V, row l with electrode l grounded, NaN where not read; `before` : potentials in
    the row before each, V; drive, V; time, s."""

    voltages: np.ndarray
    before: np.ndarray
    drive: float
    time: float

    @property
    def rows(self) -> np.ndarray:
        """Electrodes that were grounded."""
        return np.flatnonzero(np.isfinite(self.voltages).any(axis=1))


@dataclass(frozen=True, eq=False)
class _Frames:
    """Frames that others are compared with: readings (K, E E), V, 0 where there is none; their squares;
    1 where there is one."""

    values: np.ndarray
    squares: np.ndarray
    read: np.ndarray

    @classmethod
    def none(cls, electrodes: int) -> _Frames:
        """No frame of so many electrodes."""
        return cls(*np.zeros((3, 0, electrodes**2)))

    def joined_by(self, frame: np.ndarray) -> _Frames:
        """The latest of these and `frame` (E, E), `_KEPT` at the most."""
        values, read = _filled(frame)
        known, new = (self.values, self.squares, self.read), (values, values**2, read)
        return _Frames(
            *(np.vstack([old[-_KEPT + 1 :], one]) for old, one in zip(known, new, strict=True))
        )

    def like(self, frame: np.ndarray, part: float, noise: float) -> bool:
        """Whether `frame` (E, E) differs from one of these by no more than `part` of the readings, or
        by noise."""
        values, read = _filled(frame)
        size = self.squares @ read
        apart = size - 2 * (self.values @ values) + self.read @ values**2
        count = self.read @ read
        return bool((apart < np.maximum(2 * (_NOISE * noise) ** 2 * count, part**2 * size)).any())


def _filled(frame):
    """(E E,) readings, 0 where there is none, and 1 where there is one."""
    read = np.isfinite(frame).ravel()
    return np.where(read, frame.ravel(), 0.0), read.astype(float)


class LiveLearner:
    """Learns one sensor from the frames that it gives.

    Parameters
    ----------
    layout; noise : of a reading, V rms; radius : typical of a contact, m; model : of the sheet
    excluded : electrodes that are never used
    kind : `off`, `channels` (the sheet stays as it is known) or `all`
    state : what is known already, None for nothing

    Attributes
    ----------
    operator : `SheetOperator` of all electrodes in use; state : what is known
    settling : what readings keep of the row before, None where they keep nothing
    """

    def __init__(
        self,
        layout: Layout,
        *,
        noise: float,
        radius: float = 0.005,
        model: str = "auto",
        excluded=(),
        kind: str = ALL,
        state: SensorState | None = None,
    ):
        self.layout, self._noise, self._radius, self._model = layout, noise, radius, model
        self._excluded, self._kind = list(excluded), kind
        self.operator = operator_for(layout, model)
        self.state = self._start = state or SensorState.unknown(self.operator)
        self._lock = threading.Lock()  # guards what `offer` leaves for `work`
        self._working = threading.Lock()
        self._touched: list[_Frame] = []  # that are waiting, oldest first
        self._idle: list[_Frame] = []
        self._seen = _Frames.none(layout.electrodes)
        self._last: _Frames | None = None
        self._idle_time = -np.inf
        self._first: list[_Frame] = []  # touches of the time in which all are fitted together
        self._first_idle: list[_Frame] = []
        self._together = 0 if self.state.touches < TOGETHER[0] else len(TOGETHER)
        self._learners: dict[tuple[int, ...], Learner] = {}
        self.settling: Settling | None = None
        self._odd: list[tuple[_Frame, Fit]] = []  # do not fit
        self.health = Health(self.operator)
        if self.state.touches:
            self.health.update(self.state)
        self.unexplained = 0  # touches that no contacts explained
        self.moved = 0  # touches that moved while rows were read

    def offer(self, voltages, grounded, drive: float, time: float = 0.0) -> bool:
        """Look at a frame (L, E), V, as it was read, of `time` s; whether there is something for
        `work`.

        Takes a fraction of a millisecond.
        """
        if self._kind == OFF:
            return False
        frame = square(voltages, grounded, np.zeros(np.shape(voltages), bool))
        frame[:, self._excluded] = np.nan
        frame[self._excluded] = np.nan
        before = np.full(frame.shape, np.nan)
        before[grounded] = rows_before(np.asarray(voltages, float), np.asarray(grounded))
        found = _Frame(frame, before, float(drive), float(time))
        with self._lock:
            if is_untouched(frame, np.arange(len(frame)), self._noise):
                self._last = None
                return self._are_offsets(frame) and self._offer_idle(found)
            steady = self._last is not None and self._last.like(frame, _STEADY, self._noise)
            self._last = _Frames.none(len(frame)).joined_by(frame)
            if not steady or self._seen.like(frame, _NEW, self._noise):
                return False
            self._seen = self._seen.joined_by(frame)
            self._touched.append(found)
            return True

    def work(self) -> SensorState | None:
        """Learn from what was kept; what is known then, None where nothing new is. May take
        seconds."""
        with self._working:
            with self._lock:
                touched, self._touched = self._touched, []
                together = self._together < len(TOGETHER)
                idle = list(self._idle) if together or len(self._idle) >= _IDLE else []
                if len(self._idle) >= _IDLE:
                    self._idle = []
            before = self.state
            self._learn(touched, idle)
            if together and self._together == len(TOGETHER):
                with self._lock:
                    self._idle = []
            return None if self.state is before else self.state

    @property
    def findings(self) -> list[Finding]:
        """What is broken, as far as is known."""
        return self.health.findings

    def stop(self) -> None:
        """Learn no more."""

    def _learn(self, touched: list[_Frame], idle: list[_Frame]) -> None:
        if self._together < len(TOGETHER):
            self._first += touched
            self._first_idle = idle or self._first_idle
            self._learn_together()
            return
        if idle:
            self._learn_offsets(idle)
        for frame in touched:
            try:
                self._learn_one(frame)
            except np.linalg.LinAlgError:  # numbers that no sheet has; what is known stays
                self._learners = {}
                self.unexplained += 1

    def _are_offsets(self, frame) -> bool:
        """Whether untouched readings are those of channels, not those of a drive that nothing
        grounds."""
        where, state = self.state.slice("offset"), self.state
        return are_offsets(frame, np.arange(len(frame)), state.mean[where], state.expected[where])

    def _offer_idle(self, frame) -> bool:
        if 0.0 <= frame.time - self._idle_time < _IDLE_EVERY:  # a clock may be set back
            return False
        self._idle.append(frame)
        if len(self._idle) < _IDLE:
            return False
        self._idle_time = frame.time
        return True

    def _learn_together(self) -> None:
        """All touches so far, whenever there are enough more of them."""
        if len(self._first) < TOGETHER[self._together]:
            return
        while self._together < len(TOGETHER) and len(self._first) >= TOGETHER[self._together]:
            self._together += 1
        last = self._first[-1]
        drive, rows = last.drive, last.rows
        frames = [
            f
            for f in (*self._first_idle, *self._first)
            if f.drive == drive and np.array_equal(f.rows, rows)
        ]
        try:
            learned = learn(
                self.layout,
                np.array([f.voltages[rows] for f in frames]),
                rows,
                drive,
                noise=self._noise,
                radius=self._radius,
                model=self._model,
                state=self._start,
                before=np.array([f.before[rows] for f in frames]),
            )
        except np.linalg.LinAlgError:
            self.unexplained = len(self._first)
            self._together, self._first = 0, []  # begin anew, with other touches
            return
        self.unexplained = learned.unexplained
        self.settling = learned.settling
        if learned.exchanged is None:
            self.health.exchanged(None)
        else:
            self.health.exchanged(
                learned.exchanged.pair, self._first[0].time, learned.exchanged.sure
            )
        if learned.unexplained + learned.moved > _UNEXPLAINED * len(self._first):
            if self._together == len(TOGETHER):  # begin anew, with other touches
                self.moved += learned.moved
                self._together, self._first = 0, []
            return
        self._adopt(learned.state.at(frames[-1].time))
        if self._together == len(TOGETHER):
            self._first, self._first_idle = [], []

    def _learn_offsets(self, idle) -> None:
        learner = self._learner(idle[-1])
        if learner is None:
            return
        rows = idle[-1].rows
        frames = np.array([f.voltages[rows] for f in idle if np.array_equal(f.rows, rows)])
        state = learner.state
        found = offsets(frames, rows, self._noise, state["offset"], state.std("offset"))
        learner.untouched(found, len(idle))
        self._adopt(learner.state.at(idle[-1].time))

    def _learn_one(self, frame) -> None:
        learner = self._learner(frame)
        if learner is None:
            return
        read = frame.voltages[frame.rows]
        frames = read[None], frame.before[frame.rows][None], clipped(read, frame.drive)[None]
        given = learner, *frames, frame.rows, self._noise
        self.settling = kept_of_rows_before(*given, self.settling)
        if moves(learner, self._settled(frame), frame.rows, self._noise):
            self.moved += 1
            return
        fit = learner.look(self._rows(learner, frame))
        if surprise(fit) > _ODD:
            self._odd.append((frame, fit))
            if len(self._odd) == _CHANGED:
                self._learn_change(learner)
            return
        self.unexplained += len(self._odd)
        self._odd = []
        self.health.exchanged(None)
        if learner.learn(fit, frame.time):
            misfit = fit.chi_squared / fit.rows.count
            self._adopt(learner.state.at(frame.time), misfits=(misfit,))

    def _learn_change(self, learner) -> None:
        """Touches in turn do not fit to what is known: learned anew, if that explains them."""
        odd, before = [list(each) for each in zip(*self._odd)]
        self._odd = []
        rows = [self._rows(learner, frame) for frame in odd]
        same = [np.array_equal(then.operator.used, learner.operator.used) for then in before]
        exchanged = learner.exchanged_in(
            [then if own else learner.look(each) for then, own, each in zip(before, same, rows)]
        )
        if exchanged is not None:
            self.health.exchanged(exchanged.pair, odd[0].time, exchanged.sure)
            self.unexplained += len(odd)
            return
        squares = [
            square(self._settled(f), f.rows, clipped(f.voltages[f.rows], f.drive)) for f in odd
        ]
        known = learner.state
        if not torn(learner, rows, squares):
            learner.set(known.widened())
        for each, frame in zip(rows, odd):
            learner.learn(learner.look(each), frame.time)
        after = [learner.look(each) for each in rows]
        pairs = zip(after, before)
        explained = sum(surprise(now) < _BETTER * surprise(then) for now, then in pairs)
        if explained <= len(odd) / 2:
            learner.set(known)
            learner.about()
            self.unexplained += len(odd)
            return
        misfits = tuple(now.chi_squared / now.rows.count for now in after)
        self._adopt(learner.state.at(odd[-1].time), odd[0].time, misfits)

    def _rows(self, learner, frame):
        ends = clipped(frame.voltages[frame.rows], frame.drive)
        given = self._settled(frame), frame.rows, frame.drive, self._noise
        return rows_of(learner.operator, *given, ends)

    def _settled(self, frame) -> np.ndarray:
        """(L, E) readings, V, without what they keep of the row before."""
        read = frame.voltages[frame.rows]
        return read if self.settling is None else self.settling.less(read, frame.before[frame.rows])

    def _learner(self, frame) -> Learner | None:
        """That of the electrodes that `frame` has readings of, with what is known by then."""
        rows = frame.rows
        read = np.isfinite(frame.voltages[rows])
        read[np.arange(len(rows)), rows] = True
        used = tuple(np.flatnonzero(~dead_channels(read)).tolist())
        if len(used) < 2:
            return None
        learner = self._learners.get(used)
        elapsed = max(frame.time - self.state.time, 0.0) if self.state.time else 0.0
        state = self.state.walked(elapsed)
        if learner is None:
            operator = operator_for(self.layout, self._model, np.array(used))
            learner = Learner(operator, self._radius, frame.drive, state)
            self._learners = {used: learner}
        else:
            learner.drive = frame.drive
            learner.set(state)
            learner.about()
        return learner

    def _adopt(self, state: SensorState, since: float | None = None, misfits=()) -> None:
        """Go on with `state`; `since`, s, and `misfits` as `Health.update` takes them."""
        self.state = state if self._kind == ALL else state.with_sheet_of(self._start)
        self.health.update(self.state, since, misfits)
