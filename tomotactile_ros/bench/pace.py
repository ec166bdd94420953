"""How long a frame takes on this machine; from it the remaining time of a benchmark is estimated."""

from __future__ import annotations

from functools import cache, partial

import numpy as np

from tomotactile_ros.bench import timing
from tomotactile_ros.bench.cases import DEFAULT_LAYOUT, Case, find_layout
from tomotactile_ros.bench.trials import DRIVE, make_scene, record, worn_scene
from tomotactile_ros.reconstruction import Pipeline

# of one contact, of two, in parts of the sides
_PLACES = [(0.13, 0.07)], [(0.23, -0.09), (-0.31, 0.11)]


@cache
def frame_seconds(profile: str) -> float:
    """s of processor time that a frame with new contacts takes, mean of two on the sensor of the
    textbook and two on a worn one, measured once."""
    pipeline = Pipeline(find_layout(DEFAULT_LAYOUT), Case(DEFAULT_LAYOUT, profile).settings)
    everything = np.arange(pipeline.layout.electrodes)
    times = [
        timing.timed(partial(pipeline.process, frame, everything, DRIVE))[1] for frame in _frames()
    ]
    return float(np.mean(times))


@cache
def _frames():
    """(4, E, E) V."""
    layout = find_layout(DEFAULT_LAYOUT)
    places = [np.array(each) * layout.outline.size for each in _PLACES]
    scenes = make_scene(layout), worn_scene(layout)
    return np.concatenate([record(layout, scene, places).frames for scene in scenes])
