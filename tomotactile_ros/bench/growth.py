"""How cost grows with electrodes and pixels: exponents fitted to undisturbed times in doubly
logarithmic scales."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from tomotactile_ros.bench import timing
from tomotactile_ros.bench.cases import Case, find_layout
from tomotactile_ros.bench.trials import DRIVE, make_scene, record
from tomotactile_ros.reconstruction import Pipeline

ELECTRODES = (4, 6, 8, 10, 12, 16)  # to a side
RESOLUTIONS = (20, 40, 80, 160)
QUANTITIES = ("setup", "frame", "memory")
_DEFAULT = 8, 40
_PLACE = 0.13, 0.07  # of the contact, in parts of the sides
_SECONDS = 1.0  # for all set-ups, and for all frames


def measure(
    electrodes: Sequence[int], resolutions: Sequence[int], tick: Callable[[float], None]
) -> dict:
    """Cost of the profile `fast` for n x n electrodes and for m x m pixels, each with fitted
    exponents.

    `tick` is told of work, s, that is done. Durations in s, all measured in turn, memory in bytes;
    exponents count electrodes n^2 and pixels m^2.
    """
    sizes = _sizes(electrodes, resolutions)
    makers, frames, memories = {}, {}, {}
    for size in sizes:
        makers[size] = _maker(*size)
        pipeline, memories[size] = timing.memory(makers[size])
        frames[size] = _frame(pipeline)
        tick(_work(size))
    setups = timing.in_turn(
        {size: [make] for size, make in makers.items()}, least=3, seconds=_SECONDS, warm=False
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
            "memory": memories[size]["held"],
        }
        for size in sizes
    }
    return {
        "electrodes": _fitted("electrodes", [points[n, _DEFAULT[1]] for n in electrodes]),
        "pixels": _fitted("pixels", [points[_DEFAULT[0], m] for m in resolutions]),
    }


def work(electrodes: Sequence[int], resolutions: Sequence[int]) -> float:
    """About how long `measure` takes, s."""
    return sum(map(_work, _sizes(electrodes, resolutions)))


def exponent(sizes, values) -> float:
    """p of the line log value = p log size + const that fits best."""
    return float(np.polyfit(np.log(sizes), np.log(values), 1)[0])


def exponents(by: str, points: Sequence[dict]) -> dict[str, float]:
    """Of all QUANTITIES, with the number of what `by` names."""
    sizes = [point[by] for point in points]
    return {key: exponent(sizes, [point[key] for point in points]) for key in QUANTITIES}


def _sizes(electrodes, resolutions):
    """Each once."""
    each = [(n, _DEFAULT[1]) for n in electrodes] + [(_DEFAULT[0], m) for m in resolutions]
    return list(dict.fromkeys(each))


def _work(size):
    return 1.0 + 12 * (size[0] / 16) ** 2 * (size[1] / 40) ** 2


def _fitted(by, points):
    return {"points": points, "exponents": exponents(by, points)}


def _maker(side, resolution):
    case = Case(f"equal-{side}x{side}", resolution=resolution)
    return lambda: Pipeline(find_layout(case.layout), case.settings)


def _frame(pipeline):
    """A function that reconstructs a frame of one contact."""
    layout = pipeline.layout
    place = np.array(layout.outline.size) * _PLACE
    (frame,) = record(layout, make_scene(layout), [place[None]]).frames
    everything = np.arange(layout.electrodes)
    return lambda: pipeline.process(frame, everything, DRIVE)
