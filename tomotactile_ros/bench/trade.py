"""Speed against accuracy: one row for each profile and layout, on the sensor of the textbook and on a worn one.

The accuracy by which choices are compared is one that ghosts and missed contacts enter, as well as
places: the OSPA distance between reported and true contacts (`accuracy.ospa`). The width of an
image would not do: what is sharp may be wrong.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from functools import cache, partial

import numpy as np

from tomotactile_ros.bench import accuracy, timing
from tomotactile_ros.bench.accuracy import SENSORS
from tomotactile_ros.bench.cases import Case
from tomotactile_ros.bench.trials import DRIVE, Size, Trials, make_trials
from tomotactile_ros.layouts.layout import load_layout

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
    return make_trials(load_layout(name), size)


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
    """
    makers: dict = {
        case.layout: [partial(timing.afresh, Case(case.layout).pipeline)] for case in cases
    }
    setups = _compared(
        timing.in_turn(makers, least=3, seconds=effort.seconds, turn=0.05, warm=False)
    )
    pipelines, merits = [case.pipeline() for case in cases], []
    for case, pipeline in zip(cases, pipelines, strict=True):
        merits.append(accuracy.measure(pipeline, recorded(case.layout, effort.size)))
        tick(0.8 * len(merits) / len(cases))
    calls = {
        (case, sensor): _calls(pipeline, recorded(case.layout, effort.size).of[sensor], effort)
        for case, pipeline in zip(cases, pipelines, strict=True)
        for sensor in SENSORS
    }
    frames = _compared(
        timing.in_turn(calls, least=effort.rounds, seconds=effort.seconds, most=effort.most)
    )
    return [
        asdict(case)
        | {
            "setup": setups[case.layout],
            "frame": {sensor: frames[case, sensor] for sensor in SENSORS},
            "memory": _memory(case, effort.size),
        }
        | merit
        for case, merit in zip(cases, merits, strict=True)
    ]


def _calls(pipeline, recordings, effort):
    """Functions that reconstruct a recorded frame each, some of single contacts and as many of pairs."""
    everything = np.arange(pipeline.layout.electrodes)
    return [
        partial(pipeline.process, each.frames[at], everything, DRIVE)
        for each in recordings
        for at in np.linspace(0, len(each.frames) - 1, effort.frames + 1).astype(int)[1:]
    ]


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
