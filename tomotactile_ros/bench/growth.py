"""How cost grows with electrodes and pixels: exponents fitted to medians in doubly logarithmic scales."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from tomotactile_ros.bench import timing
from tomotactile_ros.bench.trade import find_layout
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE, make_scene, record
from tomotactile_ros.reconstruction import Pipeline, Settings

ELECTRODES = (4, 6, 8, 10, 12, 16)  # to a side
RESOLUTIONS = (20, 40, 80, 160)
QUANTITIES = ("setup", "frame", "memory")
_DEFAULT = 8, 40
_SETUPS, _FRAMES = 3, 30


def measure(
    electrodes: Iterable[int], resolutions: Iterable[int], tick: Callable[[], None]
) -> dict:
    """Cost of the profile `fast` for n x n electrodes and for m x m pixels, each with fitted exponents.

    `tick` is called after every point. Durations in s, memory in bytes; exponents count electrodes n^2 and
    pixels m^2.
    """
    by_electrodes = [_point(n, _DEFAULT[1], tick) for n in electrodes]
    by_pixels = [_point(_DEFAULT[0], m, tick) for m in resolutions]
    return {
        "electrodes": _fitted([n["electrodes"] for n in by_electrodes], by_electrodes),
        "pixels": _fitted([n["pixels"] for n in by_pixels], by_pixels),
    }


def exponent(sizes, values) -> float:
    """p of the line log value = p log size + const that fits best."""
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def _fitted(sizes, points):
    exponents = {key: exponent(sizes, [point[key] for point in points]) for key in QUANTITIES}
    return {"points": points, "exponents": exponents}


def _point(side, resolution, tick):
    layout = find_layout(f"equal-{side}x{side}")
    settings = Settings(resolution=resolution, noise=NOISE, contact_law=LAW)
    pipelines = [timing.timed(lambda: Pipeline(layout, settings)) for _ in range(_SETUPS)]
    pipeline = pipelines[-1][0]
    everything = np.arange(layout.electrodes)
    place = np.array(layout.outline.size) * [0.13, 0.07]
    frames = record(layout, make_scene(layout), [place[None]]).frames
    calls = [lambda: pipeline.process(frames[0], everything, DRIVE)]
    tick()
    return {
        "electrodes": side**2,
        "pixels": resolution**2,
        "setup": float(np.median([seconds for _, seconds in pipelines])),
        "frame": timing.summary(timing.durations(calls, _FRAMES, 0.0))["median"],
        "memory": timing.memory(lambda: Pipeline(layout, settings))["held"],
    }
