"""How cost grows with electrodes and pixels: exponents fitted to undisturbed times in doubly
logarithmic scales."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import numpy as np

from tomotactile_ros.bench import timing
from tomotactile_ros.bench.cases import find_layout
from tomotactile_ros.bench.trials import DRIVE, make_pipeline, make_scene, record

ELECTRODES, RESOLUTIONS = (4, 8, 12), (20, 40, 80)  # to a side
QUANTITIES = ("setup", "frame", "memory")
_DEFAULT = 8, 40
_PLACE = 0.13, 0.07  # of the contact, in parts of the sides
_SECONDS = 1.0  # for all set-ups, and for all frames


def measure(tick: Callable[[float], None]) -> dict:
    """Cost of the profile `fast` for n x n electrodes and for m x m pixels, each with fitted
    exponents.

    `tick` is told which fraction is done. Durations in s, all measured in turn, memory in bytes;
    exponents count electrodes n^2 and pixels m^2.
    """
    sizes = [(n, _DEFAULT[1]) for n in ELECTRODES] + [(_DEFAULT[0], m) for m in RESOLUTIONS]
    sizes = list(dict.fromkeys(sizes))
    makers, frames, memories = {}, {}, {}
    for size in sizes:
        makers[size] = _maker(*size)
        pipeline, memories[size] = timing.memory(makers[size])
        frames[size] = _frame(pipeline)
        tick(len(frames) / len(sizes))
    setups = timing.in_turn(
        {size: [partial(timing.afresh, make)] for size, make in makers.items()},
        least=3,
        seconds=_SECONDS,
        warm=False,
    )
    frames = timing.in_turn(
        {size: [call] for size, call in frames.items()}, least=20, seconds=_SECONDS, turn=0.01
    )
    points = {
        size: {
            "electrodes": size[0] ** 2,
            "pixels": size[1] ** 2,
            "setup": timing.undisturbed(setups[size]),
            "frame": timing.undisturbed(frames[size]),
            "memory": memories[size],
        }
        for size in sizes
    }
    return {
        "electrodes": _fitted("electrodes", [points[n, _DEFAULT[1]] for n in ELECTRODES]),
        "pixels": _fitted("pixels", [points[_DEFAULT[0], m] for m in RESOLUTIONS]),
    }


def exponent(sizes, values) -> float:
    """p of the line log value = p log size + const that fits best."""
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def _fitted(by, points):
    sizes = [point[by] for point in points]
    powers = {key: exponent(sizes, [point[key] for point in points]) for key in QUANTITIES}
    return {"points": points, "exponents": powers}


def _maker(side, resolution):
    layout = find_layout(f"equal-{side}x{side}")
    return lambda: make_pipeline(layout, "fast", resolution=resolution)


def _frame(pipeline):
    """A function that reconstructs a frame of one contact."""
    layout = pipeline.layout
    place = np.array(layout.outline.size) * _PLACE
    (frame,) = record(layout, make_scene(), [place[None]]).frames
    everything = np.arange(layout.electrodes)
    return lambda: pipeline.process(frame, everything, DRIVE)
