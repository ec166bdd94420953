"""Frames with their truth, and any reconstruction scored on them.

A reconstruction is whatever has `process(voltages, grounded, drive_voltage)` and returns something
with `contacts`, see `evaluation.scoring`. One that has a parameter `row_period` is told that, too.
Contacts that move are judged by where they are `holds` s after the frame's first row, an attribute
of what is returned; in the middle of the frame where it has none.
Several are compared side by side: a function of a layout makes all of them by their names.
"""

from __future__ import annotations

import contextlib
import inspect
import time
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from functools import partial
from importlib import import_module
from typing import Any

import numpy as np

from tomotactile_ros.bench.bound import Bounds
from tomotactile_ros.bench.cases import PROFILES
from tomotactile_ros.bench.sensor.readings import IDEAL, Wiring, potentials, readings, untouched
from tomotactile_ros.bench.sensor.states import States
from tomotactile_ros.bench.trials import DRIVE, make_pipeline
from tomotactile_ros.evaluation.scoring import FrameScore, score_frame, summary
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.reconstruction import Pipeline
from tomotactile_ros.support.errors import InputError

VELOCITY = "velocity"  # key of a true contact that moves: (2,) m/s
Methods = Callable[[Layout], dict[str, Any]]


@dataclass(frozen=True, eq=False)
class Trial:
    """Frames of one case, in the order in which they are taken.

    case : for people
    frames : (N, L, E) V, row i with electrode i grounded
    truths : of each frame, see `evaluation.scoring`; None for frames that only lead up to others.
        What moves has a `VELOCITY` and is at x, y at the time of the first row
    row_period : s
    """

    case: str
    layout: Layout
    frames: np.ndarray
    truths: list[list[dict] | None]
    row_period: float = 0.0


def presses(case: str, states: States, wiring: Wiring = IDEAL) -> Trial:
    """Every press in one frame, each after a frame without any contact."""
    frames, truths = [], []
    electrodes = states.layout.electrodes
    for i, (seen, truth) in enumerate(zip(states.seen, states.truths, strict=True)):
        frames.append(readings(untouched(electrodes), wiring, (i, 0)))
        frames.append(readings(potentials(seen, wiring), wiring, (i, 1)))
        truths += [None, truth]
    return Trial(case, states.layout, np.array(frames), truths)


def profiles(layout: Layout) -> dict[str, Pipeline]:
    """The three profiles, told the noise and the contact law and nothing of what is wrong."""
    first = make_pipeline(layout)
    settings = {name: replace(first.settings, profile=name) for name in PROFILES}
    return {name: first.with_settings(each) for name, each in settings.items()}


def find_methods(name: str) -> Methods:
    """The function that `name`, module:function, says; InputError where there is none."""
    module, _, function = name.partition(":")
    try:
        return getattr(import_module(module), function)
    except (ImportError, AttributeError, ValueError) as error:
        raise InputError(f"methods: {name!r} is no module:function: {error}") from None


def measure(trials: Iterable[Trial], methods: Methods = profiles) -> Iterator[dict]:
    """A row of plain data for each trial and method: case, method, what `scoring.summary` says, and
    `bound`, the median of `least_error`, m. Each trial is another sensor: what was found out about
    the one before does not help."""
    bounds: dict[str, Bounds] = {}
    for trial in trials:
        name = trial.layout.name
        if name not in bounds:
            bounds[name] = Bounds(trial.layout)
        least = least_error(trial, bounds[name])
        bound = float(np.median(least)) if len(least) else None
        for method, pipeline in methods(trial.layout).items():
            yield {"case": trial.case, "method": method, **judge(pipeline, trial), "bound": bound}


def least_error(trial: Trial, bounds: Bounds) -> np.ndarray:
    """(n,) m, the Cramer-Rao bound of the places of all true contacts; of discs in frames that show
    one state of the sheet, others have none."""
    if trial.row_period:
        return np.empty(0)
    judged = [truth for truth in trial.truths if truth]
    if any(each.get("shape") != "disc" for truth in judged for each in truth):
        return np.empty(0)
    return np.concatenate([np.empty(0), *map(bounds.places, judged)])


@dataclass(frozen=True, eq=False)
class Judged:
    """One frame: what the method returned (None where the frame was refused), its score (None where
    contacts were withheld), and the processor time that it took, s."""

    result: Any
    score: FrameScore | None
    seconds: float


def judged(pipeline: Any, trial: Trial) -> Iterator[Judged]:
    """What one method makes of each frame that has a truth, after those that have none."""
    grounded = np.arange(trial.layout.electrodes)
    process = pipeline.process
    if "row_period" in inspect.signature(process).parameters:
        process = partial(process, row_period=trial.row_period)
    for frame, truth in zip(trial.frames, trial.truths, strict=True):
        result, score, begun = None, None, time.process_time()
        with contextlib.suppress(InputError):
            result = process(frame, grounded, DRIVE)
        seconds = time.process_time() - begun
        if truth is None:
            continue
        if result is not None and getattr(result, "state", "valid") == "valid":
            middle = trial.row_period * (len(grounded) - 1) / 2
            holds = getattr(result, "holds", middle)
            score = score_frame(result.contacts, [_moved(contact, holds) for contact in truth])
        yield Judged(result, score, seconds)


def judge(pipeline: Any, trial: Trial) -> dict:
    """What `scoring.summary` says of one method; a frame that is refused counts as withheld."""
    scores = [each.score for each in judged(pipeline, trial)]
    told = [score for score in scores if score is not None]
    return summary(told, len(scores) - len(told))


def _moved(contact, seconds):
    """A true contact where it is `seconds` after the first row."""
    if VELOCITY not in contact:
        return contact
    x, y = np.add((contact["x"], contact["y"]), np.multiply(seconds, contact[VELOCITY]))
    return contact | {"x": float(x), "y": float(y)}
