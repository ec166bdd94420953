"""How cost grows with electrodes and pixels: exponents fitted to undisturbed times in doubly
logarithmic scales."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from tomotactile_ros.bench import timing
from tomotactile_ros.bench.trials import DRIVE, make_pipeline, make_scene, record
from tomotactile_ros.layouts.layout import equal_grid

ELECTRODES, RESOLUTIONS = (4, 8, 12), (20, 40, 80)  # to a side
QUANTITIES = {"set-up": "setup", "frame": "frame", "memory": "memory"}  # by their words
_DEFAULT = 8, 40
_SHEET = 0.2  # m, its side
_PLACE = 0.026, 0.014  # m, of the contact
_SECONDS = 1.0  # for all set-ups, and for all frames


def measure(tick: Callable[[float], None]) -> dict:
    """Cost of the profile `fast` for n x n electrodes and for m x m pixels, each with fitted
    exponents.

    `tick` is told which fraction is done. Durations in s, all measured in turn, memory in bytes;
    exponents count electrodes n^2 and pixels m^2.
    """
    pipelines: dict = {}
    frames: dict = {}
    memories: dict = {}
    groups = {
        "electrodes": [(n, _DEFAULT[1]) for n in ELECTRODES],
        "pixels": [(_DEFAULT[0], m) for m in RESOLUTIONS],
    }
    sizes = list(dict.fromkeys(size for group in groups.values() for size in group))
    for side, resolution in sizes:
        layout = equal_grid(side, side, (_SHEET, _SHEET), 0.1 * _SHEET / side, 1e4)
        make = partial(make_pipeline, layout, "fast", resolution=resolution)
        pipeline, memories[side, resolution] = timing.memory(make)
        (frame,) = record(layout, make_scene(), [np.array([_PLACE])]).frames
        pipelines[side, resolution] = [partial(timing.afresh, make)]
        frames[side, resolution] = [partial(pipeline.process, frame, layout.grounded, DRIVE)]
        tick(len(frames) / len(sizes))
    setups = timing.in_turn(pipelines, least=3, seconds=_SECONDS, warm=False)
    times = timing.in_turn(frames, least=20, seconds=_SECONDS, turn=0.01)
    points = {
        size: {
            "electrodes": size[0] ** 2,
            "pixels": size[1] ** 2,
            "setup": timing.undisturbed(setups[size]),
            "frame": timing.undisturbed(times[size]),
            "memory": memories[size],
        }
        for size in sizes
    }
    return {by: _fitted(by, [points[size] for size in group]) for by, group in groups.items()}


def exponent(sizes, values) -> float:
    """p of the line log value = p log size + const that fits best."""
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def _fitted(by, points):
    sizes = [point[by] for point in points]
    values = {words: [point[key] for point in points] for words, key in QUANTITIES.items()}
    return {"points": points, "exponents": {w: exponent(sizes, v) for w, v in values.items()}}
