"""Touches that move: frames row by row from the simulator, judged by their place at mid-frame."""

from __future__ import annotations

import numpy as np

from tomotactile_ros.bench.sensor import presses
from tomotactile_ros.bench.sensor.trial import Trial
from tomotactile_ros.bench.trials import BITS, DRIVE, LAW, NOISE
from tomotactile_ros.contact import Contact
from tomotactile_ros.defects import Adc, Noise
from tomotactile_ros.layout import Layout
from tomotactile_ros.scene import Scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

_FRAMES = 2  # of each touch; the last one is judged
_SEED = 26
_TRIES = 10000


def moving(case: str, layout: Layout, speed: float, count: int) -> Trial:
    """`count` discs that slide straight at `speed` (m/s), one after the other, a second each."""
    random = np.random.default_rng(_SEED)
    length = _FRAMES * layout.electrodes * ROW_PERIOD  # s
    touches = [_touch(layout, speed, length, float(i), random) for i in range(count)]
    scene = Scene("moving", DRIVE, touches, LAW, Noise(NOISE, _SEED), Adc(BITS, DRIVE))
    simulator = Simulator(layout, scene, row_period=ROW_PERIOD)
    frames, truths = [], []
    for touch in touches:
        for number in range(_FRAMES):
            start = touch.start + number * layout.electrodes * ROW_PERIOD
            frames.append(simulator.frame(start, len(frames)))
        middle = touch.at(start + (layout.electrodes - 1) / 2 * ROW_PERIOD)
        truths += [None] * (_FRAMES - 1) + [presses.truth([middle])]
    return Trial(case, layout, np.array(frames), truths, ROW_PERIOD)


def _touch(layout, speed, length, start, random):
    """A disc that stays wholly on the sheet while it slides for `length` (s)."""
    low, size = np.array(layout.outline.bounds[:2]), np.array(layout.outline.size)
    radius, pressure = random.uniform(*presses.RADII), random.uniform(*presses.PRESSURES)
    for _ in range(_TRIES):
        place, angle = low + size * random.random(2), random.uniform(0, 2 * np.pi)
        velocity = speed * np.array([np.cos(angle), np.sin(angle)])
        path = place + np.linspace(0, length, 16)[:, None] * velocity
        outline = layout.outline
        if (outline.contains(path) & (outline.rim_distance(path) > radius)).all():
            return Contact(
                "disc", center=place, radius=radius, pressure=pressure, velocity=velocity,
                start=start, end=start + length + ROW_PERIOD,
            )  # fmt: skip
    raise RuntimeError(f"no path of {speed:g} m/s on {layout.name}")
