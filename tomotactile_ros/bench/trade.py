"""Speed against accuracy: one row for each profile and layout, on the sensor of the textbook and on a worn one.

The accuracy by which choices are compared is one that ghosts and missed contacts enter, as well as
places: the OSPA distance between reported and true contacts (`accuracy.ospa`). The width of an
image would not do: what is sharp may be wrong.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass, replace
from functools import cache, partial

import numpy as np

from tomotactile_ros.bench import accuracy, timing
from tomotactile_ros.bench.accuracy import SENSORS
from tomotactile_ros.bench.cases import Case, find_layout
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
              profiles
    frame     on each of `SENSORS`: median and more, and how many times that of the first case on the
              textbook sensor
    memory    of the pipeline after a frame
    contacts  how many single ones and pairs were measured
    """
    setups: defaultdict[str, list] = defaultdict(list)
    _add_setups(setups, cases, effort.seconds / 2)
    pipelines, merits = _pipelines(cases), []
    for case, pipeline in zip(cases, pipelines, strict=True):
        trials = recorded(case.layout, effort.size)
        contacts = [len(trials.singles), len(trials.pairs)]
        merits.append(accuracy.measure(pipeline, trials) | {"contacts": contacts})
        tick(0.8 * len(merits) / len(cases))
    _add_setups(setups, cases, effort.seconds / 2)
    calls = {
        (case, sensor): _calls(pipeline, recorded(case.layout, effort.size).of(sensor), effort)
        for case, pipeline in zip(cases, pipelines, strict=True)
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
            "setup": compared[case.layout],
            "frame": {sensor: frames[case, sensor] for sensor in SENSORS},
            "memory": _memory(case, effort.size),
        }
        | merit
        for case, merit in zip(cases, merits, strict=True)
    ]


def _pipelines(cases):
    """One for each of `cases`; those of one layout have in common what they can."""
    first: dict[str, Pipeline] = {}
    for case in cases:
        if case.layout not in first:
            first[case.layout] = case.pipeline()
    pipelines = [first[case.layout] for case in cases]
    return [
        each.with_settings(replace(each.settings, profile=case.profile))
        for each, case in zip(pipelines, cases)
    ]


def _calls(pipeline, recordings, effort):
    """Functions that reconstruct a recorded frame each, some of single contacts and as many of pairs."""
    everything = np.arange(pipeline.layout.electrodes)
    places = [
        np.linspace(0, len(each) - 1, effort.frames + 1).astype(int)[1:] for each in recordings
    ]
    chosen = np.concatenate([each.frames[at] for each, at in zip(recordings, places)])
    return [partial(pipeline.process, frame, everything, DRIVE) for frame in chosen]


def _add_setups(times, cases, seconds):
    """To `times` by layout; now and then, as a machine may be slow for long."""
    calls = {
        name: [partial(timing.afresh, Case(name).pipeline)]
        for name in dict.fromkeys(case.layout for case in cases)
    }
    more = timing.in_turn(calls, least=1, seconds=seconds, turn=0.05, warm=False)
    for name, rounds in more.items():
        times[name] += rounds


def _memory(case, size):
    frame = recorded(case.layout, size).singles.frames[0]

    def make():
        pipeline = case.pipeline()
        pipeline.process(frame, np.arange(len(frame)), DRIVE)
        return pipeline

    return timing.memory(make)[1]


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
