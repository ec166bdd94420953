"""Touches that begin, end or move while rows are scanned.

A frame in which a touch begins is that of the sheet before in its first rows and that of the sheet
after in the others: reference data serve. Touches that move come from the simulator, each row at
its own time. Scans follow each other without a pause. What touches for a part of the frame that is
judged may be reported or not (`scoring.PART`); what moves is judged by where it is in the middle of
the frame.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.bench.reference import Admittance
from tomotactile_ros.bench.sensor.readings import potentials, readings, untouched
from tomotactile_ros.bench.sensor.states import States
from tomotactile_ros.bench.sensor.trial import Trial
from tomotactile_ros.bench.trials import BITS, DRIVE, LAW, NOISE
from tomotactile_ros.evaluation.scoring import PART
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.defects import Adc, Noise
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

RADII = 0.004, 0.008  # m, from and to
PRESSURES = 10e3, 30e3  # Pa
_SEED = 26
_TRIES = 10000


def alone(case: str, states: States, end: bool) -> Trial:
    """A touch that begins, or with `end` ends, at some row of a frame; no other touches.

    The frames before and after are processed and not judged.
    """
    truths = [[contact | {PART: True} for contact in truth] for truth in states.truths]
    return _changing(case, states.layout, [None] * len(truths), states.seen, truths, end)


def beside(case: str, without: States, both: States, end: bool) -> Trial:
    """The same beside a touch that lasts: states of that one alone, and of it and of another."""
    truths = [[lasting, other | {PART: True}] for lasting, other in both.truths]
    return _changing(case, both.layout, without.seen, both.seen, truths, end)


def _changing(
    case: str,
    layout: Layout,
    without: list[Admittance | None],
    touched: list[Admittance],
    truths: list[list[dict]],
    end: bool,
) -> Trial:
    """Three frames of each state: before, while and after it becomes the other one at some row."""
    random = np.random.default_rng(_SEED)
    frames, judged = [], []
    electrodes = layout.electrodes
    for i, (one, other, truth) in enumerate(zip(without, touched, truths, strict=True)):
        before = untouched(electrodes) if one is None else potentials(one)
        after = potentials(other)
        if end:
            before, after = after, before
        late = np.arange(electrodes) >= random.integers(1, electrodes)
        within = np.where(late[:, None], after, before)
        for number, each in enumerate((before, within, after)):
            frames.append(readings(each, seed=(i, number)))
        judged += [None, truth, None]
    return Trial(case, layout, np.array(frames), judged, ROW_PERIOD)


def moving(case: str, layout: Layout, speed: float, count: int) -> Trial:
    """`count` touches that slide straight at `speed` (m/s), one after the other, a second each; the
    second of two frames is judged."""
    random = np.random.default_rng(_SEED)
    scan = layout.electrodes * ROW_PERIOD
    touches = [_touch(layout, random, i, i + 2 * scan, speed) for i in range(count)]
    middle = scan + (layout.electrodes - 1) / 2 * ROW_PERIOD
    truths = [
        each for touch in touches for each in (None, [_truth(touch.at(touch.start + middle))])
    ]
    return _simulated(case, layout, touches, range(count), 2, truths)


def _simulated(case, layout, touches, starts, count, truths):
    """`count` frames from each of the `starts`, s."""
    scene = Scene(case, DRIVE, touches, LAW, Noise(NOISE, _SEED), Adc(BITS, DRIVE))
    simulator = Simulator(layout, scene, row_period=ROW_PERIOD)
    scan = layout.electrodes * ROW_PERIOD
    times = [start + number * scan for start in starts for number in range(count)]
    frames = np.array([simulator.frame(t, number) for number, t in enumerate(times)])
    return Trial(case, layout, frames, truths, ROW_PERIOD)


def _truth(touch: Contact) -> dict:
    x, y = touch.center
    return {"x": float(x), "y": float(y), "force": float(touch.pressure * touch.area)}


def _touch(
    layout: Layout,
    random: np.random.Generator,
    start: float,
    end: float,
    speed: float,
) -> Contact:
    """A disc anywhere that stays wholly on the sheet."""
    low, size = np.array(layout.outline.bounds[:2]), np.array(layout.outline.size)
    radius, pressure = random.uniform(*RADII), random.uniform(*PRESSURES)
    for _ in range(_TRIES):
        place, angle = low + size * random.random(2), random.uniform(0, 2 * np.pi)
        velocity = speed * np.array([np.cos(angle), np.sin(angle)])
        path = place + np.linspace(0, end - start, 16)[:, None] * velocity
        fits = layout.outline.contains(path) & (layout.outline.rim_distance(path) > radius)
        if fits.all():
            return Contact(
                "disc", center=place, radius=radius, pressure=pressure, velocity=velocity,
                start=start, end=end,
            )  # fmt: skip
    raise RuntimeError(f"{layout.name} has no room for a touch at {speed:g} m/s")
