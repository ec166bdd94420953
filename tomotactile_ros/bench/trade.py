"""Speed against accuracy: one row for each profile, resolution, number of ground conditions and
layout, each on the sensor of the textbook and on a worn one.

The accuracy by which choices are compared is one that ghosts and missed contacts enter, as well as
places: the OSPA distance between reported and true contacts (`accuracy.ospa`). The width of an
image would not do: what is sharp may be wrong.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator
from dataclasses import asdict, dataclass
from functools import partial
from typing import Any

import numpy as np

from tomotactile_ros.bench import accuracy, pace, timing
from tomotactile_ros.bench.accuracy import SENSORS
from tomotactile_ros.bench.cases import DEFAULT_LAYOUT, Case, find_layout, grounded
from tomotactile_ros.bench.trials import DRIVE, SEPARATIONS, Size, Trials, make_trials
from tomotactile_ros.reconstruction import Pipeline

REFERENCE = Case(DEFAULT_LAYOUT)
_WORTH = 0.02  # least gain in accuracy for which a slower choice is on the front
_SIMULATION = 4.0  # s for the frames of a layout, roughly
_OTHER = 0.5  # s for the rest of a case, roughly


@dataclass(frozen=True)
class Effort:
    """How much is measured: contacts of a row, and of a slow one; frames of either kind that are
    timed, rounds at least, s for all of these, and s for the frames of one row at most."""

    size: Size
    few: Size
    frames: int
    rounds: int
    seconds: float
    most: float


QUICK = Effort(Size(5, 5), Size(5, 5), frames=4, rounds=15, seconds=3.0, most=2.0)
FULL = Effort(Size(6, 8), Size(5, 5), frames=2, rounds=5, seconds=3.0, most=4.0)


@dataclass(frozen=True, eq=False)
class Subject:
    """A case that is ready to be measured."""

    case: Case
    pipeline: Pipeline
    grounded: np.ndarray
    trials: Trials

    def frames(self, sensor: str, number: int) -> list[Callable[[], object]]:
        """Functions that reconstruct a recorded frame each, `number` of single contacts and of
        pairs in turn, of one of `SENSORS`."""
        recorded = self.trials.of(sensor)
        places = [np.linspace(0, len(each) - 1, number + 1).astype(int)[1:] for each in recorded]
        chosen = np.concatenate([each.frames[at] for each, at in zip(recorded, places)])
        return [
            partial(self.pipeline.process, frame[self.grounded], self.grounded, DRIVE)
            for frame in chosen
        ]


class Trade:
    """Measures cases with some `effort`; keeps the recorded frames of every layout, and the
    reference."""

    def __init__(self, effort: Effort):
        self.effort = effort
        self._trials: dict[str, Trials] = {}
        self._scanned: dict[tuple[str, int], Trials] = {}
        self._reference: Subject | None = None

    def trials(self, name: str) -> Trials:
        """Recorded frames of a layout."""
        if name not in self._trials:
            self._trials[name] = make_trials(find_layout(name), self.effort.size)
        return self._trials[name]

    def measure(self, cases: list[Case], tick: Callable[[float], None]) -> list[dict]:
        """Rows of `cases`; `tick` is told of work, s, that is done. Times in s, memory in bytes,
        lengths in m.

        setup     median, and how many times that of the reference (`fast`, 40 x 40 pixels, all
                  ground conditions, `equal-8x8`), measured in turn; the same for all profiles and
                  ground conditions
        frame     on each of `SENSORS`: median and more, and how many times that of the reference
                  on the textbook sensor
        memory    of the pipeline after a frame with all ground conditions
        contacts  how many single ones and pairs were measured
        """
        setups: defaultdict[Any, list] = defaultdict(list)
        self._add_setups(setups, cases)
        subjects = self._subjects(cases, tick)
        merits = []
        for subject in subjects:
            merits.append(_merit(subject))
            tick(self._work(subject.case))
        self._add_setups(setups, cases)
        tick(self.effort.seconds)
        frames = self._frames(subjects)
        self._add_setups(setups, cases)
        tick(1.5 * self.effort.seconds)
        setups = _compared(setups)
        memories = {
            key: self._memory(Case(*key)) for key in dict.fromkeys(map(_same_memory, cases))
        }
        return [
            asdict(case)
            | {
                "setup": setups[case.layout, case.resolution],
                "frame": frame,
                "memory": memories[_same_memory(case)],
            }
            | merit
            for case, frame, merit in zip(cases, frames, merits, strict=True)
        ]

    def work(self, cases: list[Case], new: set[str]) -> float:
        """About how long `measure` takes, s; `new`: layouts that no earlier cases had."""
        simulation = _SIMULATION * len(new)
        choice = sum(map(_choice, new & {case.layout for case in cases if case.conditions}))
        return simulation + choice + sum(map(self._work, cases)) + 3 * self.effort.seconds

    def _work(self, case):
        size = self.effort.few if case.is_slow else self.effort.size
        accuracy = len(SENSORS) * (size.side**2 + len(SEPARATIONS) * size.pairs)
        timed = 2 * self.effort.frames * self.effort.rounds
        seconds = pace.frame_seconds(case.profile)
        timed = len(SENSORS) * min(timed * seconds, self.effort.most)
        return _OTHER + accuracy * seconds + timed

    def _subjects(self, cases, tick):
        """One for each of `cases`, with what takes long made once: frames, choices of ground
        conditions, pipelines."""
        for case in cases:
            if case.layout not in self._trials:
                self.trials(case.layout)
                tick(_SIMULATION)
            grounded(case)
        if self._reference is None:
            self._reference = self._subject(REFERENCE, {})
        pipelines = {(REFERENCE.layout, REFERENCE.resolution): self._reference.pipeline}
        return [self._subject(case, pipelines) for case in cases]

    def _subject(self, case, pipelines):
        """`pipelines` by layout and resolution lend what they have in common."""
        key = case.layout, case.resolution
        if key not in pipelines:
            pipelines[key] = Pipeline(find_layout(case.layout), case.settings)
        trials = self.trials(case.layout)
        if case.conditions is not None:
            if (case.layout, case.conditions) not in self._scanned:
                scanned = trials.scanned(grounded(case))
                self._scanned[case.layout, case.conditions] = scanned
            trials = self._scanned[case.layout, case.conditions]
        return Subject(
            case,
            pipelines[key].with_settings(case.settings),
            grounded(case),
            trials.few(self.effort.few) if case.is_slow else trials,
        )

    def _add_setups(self, times, cases):
        """To `times` by layout and resolution; now and then, as a machine may be slow for long."""
        kinds = dict.fromkeys((case.layout, case.resolution) for case in [REFERENCE, *cases])
        calls = {
            (layout, cells): [
                partial(Pipeline, find_layout(layout), Case(layout, resolution=cells).settings)
            ]
            for layout, cells in kinds
        }
        seconds = self.effort.seconds / 2
        more = timing.in_turn(calls, least=1, seconds=seconds, turn=0.05, warm=False)
        for key, rounds in more.items():
            times[key] += rounds

    def _frames(self, subjects):
        """For each of `subjects`, by sensor."""
        effort = self.effort
        calls: dict = {None: self._reference.frames("textbook", effort.frames)}
        for i, subject in enumerate(subjects):
            calls |= {(i, sensor): subject.frames(sensor, effort.frames) for sensor in SENSORS}
        times = timing.in_turn(calls, least=effort.rounds, seconds=effort.seconds, most=effort.most)
        found = _compared(times)
        return [{sensor: found[i, sensor] for sensor in SENSORS} for i in range(len(subjects))]

    def _memory(self, case):
        everything, frame = grounded(case), self.trials(case.layout).singles.frames[0]

        def make():
            pipeline = Pipeline(find_layout(case.layout), case.settings)
            pipeline.process(frame, everything, DRIVE)
            return pipeline

        return timing.memory(make)[1]


def _merit(subject):
    """Accuracy, and the number of contacts that it was measured with."""
    trials = subject.trials
    found = accuracy.measure(subject.pipeline, trials, subject.grounded)
    return found | {"contacts": [len(trials.singles), len(trials.pairs)]}


def _compared(times):
    """Summaries of times in turn, with `relative` to the first."""
    first = next(iter(times.values()))
    return {
        name: timing.summary(each) | {"relative": timing.ratio(each, first)}
        for name, each in times.items()
    }


def _choice(name):
    """Time to choose the ground conditions of a layout, s, roughly."""
    return 60 * (find_layout(name).electrodes / 256) ** 2


def _same_memory(case):
    return case.layout, case.profile, case.resolution


def front(rows: list[dict], sensor: str) -> Iterator[dict]:
    """Rows that are nearer to the truth on one of `SENSORS` than all faster ones, by what is worth
    it."""
    best = np.inf
    for row in sorted(rows, key=lambda row: row["frame"][sensor]["median"]):
        if row["ospa"][sensor] < (1 - _WORTH) * best:
            best = row["ospa"][sensor]
            yield row
