"""The same problem by other methods in the same run: GREIT (`reconstruction.comparison`), and by libraries, of which
those that are missing are skipped with a line (`libraries`).

The floor is the product of a dense float32 matrix of the size of the operator with the frame.
Methods that end with an image are given the peaks of the image as contacts, found as profile
`paper` finds them, and are scored as the profiles are: on the sensor of the textbook and on a worn
one, without the readings of its broken electrode.

Times are those of eight sensors, each method at a stretch with the caches to itself. One dense
matrix alone fits into the last cache or not, which changes from minute to minute where others share
it; eight do not.
"""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from tomotactile_ros.bench import accuracy, libraries, timing
from tomotactile_ros.bench.trials import DRIVE, NOISE, Trials, make_pipeline
from tomotactile_ros.reconstruction.comparison import Greit
from tomotactile_ros.reconstruction.model import Model

_CELLS = 40  # as in the settings
_MERIT = "hwhm", "position_error", "blur"
_SECONDS = 3.0  # for times that are taken in turn
_WEIGHTS = 1.0, 10.0, 100.0  # of the noise in the training of GREIT
_SENSORS = 8  # with a pipeline or a dense matrix each


def compare(trials: Trials) -> dict:
    """Peers beside `fast` on 8 x 8 electrodes and 40 x 40 pixels; durations in s, lengths in m.

    problem : figures of each
    ratios : of times in turn
    """
    layout, frame = trials.layout, trials.singles.frames[0]
    pipelines, setups = _pipelines(layout)
    grid = pipelines[0].grid
    calls = _calls(pipelines, frame)
    found: dict[str, dict[str, Any]] = {name: {} for name in calls}
    try:
        peer = libraries.PyeitOneStep(layout, grid, _CELLS)
    except ImportError:
        found["pyeit"] = _skip("pyeit")
    else:
        calls["pyeit"] = [peer.solver(frame)]
        found["pyeit"] = {"setup": peer.setup} | _best(peer, libraries.LAMBDAS, trials, grid)
    greit, trained = timing.timed(lambda: Greit(layout, grid))
    inverse, inverted = timing.timed(lambda: greit.matrix(greit.read, _WEIGHTS[0]))
    inverse = inverse.astype(np.float32)
    calls["greit"] = [lambda: inverse @ frame[greit.read].astype(np.float32)]
    found["greit"] = {"setup": trained + inverted} | _best(greit, _WEIGHTS, trials, grid)
    setups += _pipelines(layout)[1]
    own = accuracy.measure(pipelines[0], trials)
    kept = {key: own[key] for key in (*_MERIT, "ospa")}
    found["fast"] = {"setup": min(setups)} | kept
    times = timing.in_turn(calls, least=20, seconds=_SECONDS, turn=0.01)
    for name, each in times.items():
        found[name]["frame"] = timing.summary(each)
    ratios = {
        f"{one} / {other}": timing.ratio(times[one], times[other])
        for one in ("dense", "greit", "pyeit")
        for other in ("fast", "fast, image alone")
        if one in times
    }
    if "setup" in found["pyeit"]:
        ratios["pyeit / fast, set-up"] = found["pyeit"]["setup"] / min(setups)
    return {"problem": found, "ratios": ratios}


def _pipelines(layout):
    """One for each sensor, and the seconds that each took."""
    made = [timing.timed(lambda: make_pipeline(layout, "fast")) for _ in range(_SENSORS)]
    return [list(each) for each in zip(*made)]


def _calls(pipelines, frame):
    """What is timed for `frame`, by name: a function for each sensor."""
    layout, grid = pipelines[0].layout, pipelines[0].grid
    everything = np.arange(layout.electrodes)
    return {
        "fast": [partial(each.process, frame, everything, DRIVE) for each in pipelines],
        "fast, image alone": [_image_alone(layout, grid, frame) for _ in pipelines],
        "dense": _products(frame, len(grid.pixels)),
    }


def _products(frame, pixels):
    """Products of float32 matrices (`pixels`, readings) with the readings of `frame`."""
    readings = np.nan_to_num(frame[~np.eye(len(frame), dtype=bool)]).astype(np.float32)
    matrix = np.random.default_rng(0).random((pixels, len(readings)), np.float32)
    return [partial(np.matmul, matrix.copy(), readings) for _ in range(_SENSORS)]


def _image_alone(layout, grid, frame):
    """From voltages to the image of `fast` and no further, which is what the dense product does."""
    local = Model(layout, grid, "auto", NOISE).local(np.arange(layout.electrodes))
    single = frame.astype(np.float32)
    return lambda: local.image(local.meter.read(single, DRIVE))


def _skip(name):
    return {"skipped": f"{name} is not installed: python3 -m pip install {name}"}


def _best(peer, levels, trials, grid):
    """Merit and OSPA of the peer with that of `levels`, lambda^2 or the like, which suits these
    very contacts best."""
    found = []
    for level in levels:
        images = peer.images(trials.singles.frames, level)
        merit = accuracy.merit(images, trials.singles, grid)
        found.append(merit | {"regularization": level})
    best = min(found, key=lambda merit: merit["position_error"]["mean"])
    scores = {
        sensor: [
            accuracy.image_scores(peer.images(each.frames, best["regularization"]), each, grid)
            for each in trials.of(sensor)
        ]
        for sensor in accuracy.SENSORS
    }
    return best | {"ospa": {sensor: accuracy.ospa(each) for sensor, each in scores.items()}}
