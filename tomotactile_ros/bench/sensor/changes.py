"""Touches that begin, end or move while rows are scanned.

A frame in which a touch begins is that of the sheet before in its first rows and that of the sheet
after in the others: reference data of either serve. Rows of touches that slide have been solved at
their own times (`bench.reference_slides`). Scans follow each other without a pause. What touches
for a part of the frame that is judged may be reported or not (`scoring.PART`).
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.bench.reference_slides import SlideData
from tomotactile_ros.bench.sensor.readings import potentials, readings, untouched
from tomotactile_ros.bench.sensor.states import States
from tomotactile_ros.bench.sensor.trial import VELOCITY, Trial
from tomotactile_ros.bench.trials import DRIVE
from tomotactile_ros.evaluation.scoring import PART
from tomotactile_ros.simulation import ROW_PERIOD

_SEED = 26


def changing(case: str, states: States, end: bool, without: States | None = None) -> Trial:
    """The last touch of each state begins, or with `end` ends, at some row of a frame.

    The frames before and after are processed and not judged. `without` has the states without that
    touch, beside others that last; None: nothing else touches.
    """
    random, electrodes = np.random.default_rng(_SEED), states.layout.electrodes
    nothing = untouched(electrodes)
    frames, truths = [], []
    for i, (seen, (*lasting, last)) in enumerate(zip(states.seen, states.truths, strict=True)):
        both = [potentials(without.seen[i]) if without else nothing, potentials(seen)]
        before, after = both[::-1] if end else both
        late = np.arange(electrodes) >= random.integers(1, electrodes)
        within = np.where(late[:, None], after, before)
        frames += [readings(each, seed=(i, k)) for k, each in enumerate((before, within, after))]
        truths += [None, [*lasting, last | {PART: True}], None]
    return Trial(case, states.layout, np.array(frames), truths, ROW_PERIOD)


def sliding(case: str, data: SlideData, speed: float, step: int = 1) -> Trial:
    """Every `step`-th touch that slides straight at one of the speeds (m/s), after an untouched
    scan."""
    electrodes, period = data.layout.electrodes, data.made["row_period"]
    frames = []
    truths: list[list[dict] | None] = []
    for i, slide in list(enumerate(data.slides))[::step]:
        rows = DRIVE * data.rows[i, data.speeds.index(speed)].astype(float)
        scans = rows.reshape(-1, electrodes, electrodes)
        velocity = speed * np.array(slide["direction"])
        start = np.array([slide["contact"]["x"], slide["contact"]["y"]])
        frames.append(readings(untouched(electrodes), seed=(i, 0)))
        truths.append(None)
        for number, scan in enumerate(scans):
            x, y = start + number * electrodes * period * velocity
            frames.append(readings(scan, seed=(i, number + 1)))
            truths.append([slide["contact"] | {"x": x, "y": y, VELOCITY: velocity}])
    return Trial(case, data.layout, np.array(frames), truths, period)
