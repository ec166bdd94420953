"""Speed against accuracy: one row for each profile, resolution, number of ground conditions and
layout, each on the sensor of the textbook and on a worn one.

The accuracy by which choices are compared is one that ghosts and missed contacts enter, as well as
places: the OSPA distance between reported and true contacts (`accuracy.ospa`). The width of an
image would not do: what is sharp may be wrong.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial

import numpy as np

from tomotactile_ros.bench import accuracy, timing
from tomotactile_ros.bench.accuracy import SENSORS
from tomotactile_ros.bench.cases import Case, find_layout, grounded
from tomotactile_ros.bench.trials import DRIVE, Size, Trials, make_trials
from tomotactile_ros.reconstruction import Pipeline

_WORTH = 0.02  # least gain in accuracy for which a slower choice is on the front


@dataclass(frozen=True)
class Effort:
    """How much is measured: contacts of a row; frames of either kind that are timed, rounds at least,
    s for all of these, and s for the frames of one row at most."""

    size: Size
    frames: int
    rounds: int
    seconds: float
    most: float


EFFORT = Effort(Size(5, 5), frames=4, rounds=15, seconds=3.0, most=2.0)


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


@cache
def recorded(name: str, size: Size) -> Trials:
    """Recorded frames of a layout."""
    return make_trials(find_layout(name), size)


def measure(
    cases: Sequence[Case], effort: Effort, tick: Callable[[float], None] = lambda fraction: None
) -> list[dict]:
    """Rows of `cases`; `tick` is told which fraction is done. Times in s, memory in bytes, lengths
    in m.

    setup     median, and how many times that of the first case, measured in turn; the same for all
              profiles and ground conditions
    frame     on each of `SENSORS`: median and more, and how many times that of the first case on the
              textbook sensor
    memory    of the pipeline after a frame with all ground conditions
    contacts  how many single ones and pairs were measured
    """
    setups: defaultdict[tuple[str, int], list] = defaultdict(list)
    _add_setups(setups, cases, effort.seconds / 2)
    subjects, merits = _subjects(cases, effort.size), []
    for subject in subjects:
        merits.append(_merit(subject))
        tick(0.8 * len(merits) / len(subjects))
    _add_setups(setups, cases, effort.seconds / 2)
    calls = {
        (case, sensor): subject.frames(sensor, effort.frames)
        for case, subject in zip(cases, subjects, strict=True)
        for sensor in SENSORS
    }
    frames = _compared(
        timing.in_turn(calls, least=effort.rounds, seconds=effort.seconds, most=effort.most)
    )
    _add_setups(setups, cases, effort.seconds / 2)
    compared = _compared(setups)
    return [
        asdict(case)
        | {
            "setup": compared[case.layout, case.resolution],
            "frame": {sensor: frames[case, sensor] for sensor in SENSORS},
            "memory": _memory(case.layout, case.profile, case.resolution, effort.size),
        }
        | merit
        for case, merit in zip(cases, merits, strict=True)
    ]


def _subjects(cases, size):
    """One for each of `cases`; those of one layout and resolution have in common what they can."""
    pipelines: dict[tuple[str, int], Pipeline] = {}
    found = []
    for case in cases:
        key = case.layout, case.resolution
        if key not in pipelines:
            pipelines[key] = Pipeline(find_layout(case.layout), case.settings)
        trials = recorded(case.layout, size)
        if case.conditions is not None:
            trials = trials.scanned(grounded(case))
        pipeline = pipelines[key].with_settings(case.settings)
        found.append(Subject(case, pipeline, grounded(case), trials))
    return found


def _add_setups(times, cases, seconds):
    """To `times` by layout and resolution; now and then, as a machine may be slow for long."""
    calls = {
        (layout, cells): [
            partial(
                timing.afresh,
                partial(Pipeline, find_layout(layout), Case(layout, resolution=cells).settings),
            )
        ]
        for layout, cells in dict.fromkeys((case.layout, case.resolution) for case in cases)
    }
    more = timing.in_turn(calls, least=1, seconds=seconds, turn=0.05, warm=False)
    for key, rounds in more.items():
        times[key] += rounds


@cache
def _memory(layout, profile, resolution, size):
    case, frame = Case(layout, profile, resolution), recorded(layout, size).singles.frames[0]

    def make():
        pipeline = Pipeline(find_layout(layout), case.settings)
        pipeline.process(frame, grounded(case), DRIVE)
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


def front(rows: list[dict], sensor: str) -> Iterator[dict]:
    """Rows that are nearer to the truth on one of `SENSORS` than all faster ones, by what is worth
    it."""
    best = np.inf
    for row in sorted(rows, key=lambda row: row["frame"][sensor]["median"]):
        if row["ospa"][sensor] < (1 - _WORTH) * best:
            best = row["ospa"][sensor]
            yield row
