"""The same problem by other methods in the same run: GREIT (`reconstruction.comparison`), and pyEIT,
skipped with a line where it is missing.

The floor is the product of a dense float32 matrix of the size of the operator with the frame.
Methods that end with an image are given the peaks of the image as contacts, found as profile
`paper` finds them, and are scored as the profiles are: on the sensor of the textbook and on a worn
one, without the readings of its broken electrode.

Times are those of eight sensors, each method at a stretch with the caches to itself. One dense
matrix alone fits into the last cache or not, which changes from minute to minute where others share
it; eight do not.
"""

from __future__ import annotations

import contextlib
import io
from functools import partial
from typing import Any

import numpy as np

from tomotactile_ros.bench import accuracy, timing
from tomotactile_ros.bench.trials import DRIVE, NOISE, Trials, make_pipeline
from tomotactile_ros.reconstruction.comparison import Greit
from tomotactile_ros.reconstruction.model import Model
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.sensitivity import Sensitivity

_CELLS = 40  # as in the settings
_MERIT = "hwhm", "position_error", "blur"
_SECONDS = 3.0  # for times that are taken in turn
_LAMBDAS = 10.0, 1000.0  # squared
_WEIGHTS = 1.0, 10.0, 100.0  # of the noise in the training of GREIT
_SENSORS = 8  # with a pipeline or a dense matrix each


def compare(trials: Trials) -> dict:
    """Peers beside `fast` on 8 x 8 electrodes and 40 x 40 pixels; durations in s, lengths in m.

    problem : figures of each
    ratios : of times in turn
    """
    layout, frame = trials.layout, trials.singles.frames[0]
    made = [timing.timed(lambda: make_pipeline(layout, "fast")) for _ in range(2 * _SENSORS)]
    pipelines, setup = [each for each, _ in made[:_SENSORS]], min(seconds for _, seconds in made)
    grid = pipelines[0].grid
    calls = _calls(pipelines, frame)
    found: dict[str, dict[str, Any]] = {name: {} for name in calls}
    try:
        peer = PyeitOneStep(layout, grid, _CELLS)
    except ImportError:
        found["pyeit"] = {"skipped": "pyeit is not installed: python3 -m pip install pyeit"}
    else:
        calls["pyeit"] = [peer.solver(frame)]
        found["pyeit"] = {"setup": peer.setup} | _best(peer, _LAMBDAS, trials, grid)
    greit, trained = timing.timed(lambda: Greit(layout, grid))
    inverse, inverted = timing.timed(lambda: greit.matrix(greit.read, _WEIGHTS[0]))
    inverse = inverse.astype(np.float32)
    calls["greit"] = [lambda: inverse @ frame[greit.read].astype(np.float32)]
    found["greit"] = {"setup": trained + inverted} | _best(greit, _WEIGHTS, trials, grid)
    own = accuracy.measure(pipelines[0], trials)
    found["fast"] = {"setup": setup} | {key: own[key] for key in (*_MERIT, "ospa")}
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
        ratios["pyeit / fast, set-up"] = found["pyeit"]["setup"] / setup
    return {"problem": found, "ratios": ratios}


def _calls(pipelines, frame):
    """What is timed for `frame`, by name: a function for each sensor."""
    layout, grid = pipelines[0].layout, pipelines[0].grid
    return {
        "fast": [partial(each.process, frame, layout.grounded, DRIVE) for each in pipelines],
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


def _best(peer, levels, trials, grid):
    """Merit and OSPA of the peer with that of `levels`, lambda^2 or the like, which suits these
    very contacts best."""
    found = []
    for level in levels:
        images = peer.images(trials.singles.frames, level)
        found.append(
            accuracy.merit(images, trials.singles.truths, grid) | {"regularization": level}
        )
    best = min(found, key=lambda merit: merit["position_error"]["mean"])
    scores = {
        sensor: [
            accuracy.image_scores(
                peer.images(each.frames, best["regularization"]), each.truths, grid
            )
            for each in trials.of[sensor]
        ]
        for sensor in accuracy.SENSORS
    }
    return best | {"ospa": {sensor: accuracy.ospa(each) for sensor, each in scores.items()}}


def lattice(layout, cells: int):
    """Nodes ((cells + 1)^2, 2) and triangles (2 cells^2, 3) of a square lattice, two to a pixel of
    the image.

    Triangles are in the order of pixels: first all lower ones, then all upper ones.
    """
    xmin, ymin, xmax, ymax = layout.outline.bounds
    x, y = np.linspace(xmin, xmax, cells + 1), np.linspace(ymax, ymin, cells + 1)
    nodes = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    corner = (np.arange(cells)[:, None] * (cells + 1) + np.arange(cells)).ravel()
    right, below = corner + 1, corner + cells + 1
    lower = np.column_stack([corner, below, below + 1])
    upper = np.column_stack([corner, below + 1, right])
    return nodes, np.concatenate([lower, upper])


class PyeitOneStep:
    """pyEIT's one-step solver on a lattice of `cells` x `cells` squares; ImportError if not
    installed.

    It images the conductivity of triangles between electrodes, which are nodes, that carry currents
    in pairs: a contact that feeds current in is outside its model. Its speed is that of its own
    Jacobian on the same mesh and number of readings; its accuracy that of its one-step inverse given
    the paper's sensitivity (eq. 2).

    setup : s that it took to make
    """

    def __init__(self, layout, grid, cells: int):
        from pyeit.eit.jac import JAC
        from pyeit.eit.protocol import PyEITProtocol
        from pyeit.mesh.wrapper import PyEITMesh

        nodes, triangles = lattice(layout, cells)
        electrodes = np.linalg.norm(nodes - layout.positions[:, None], axis=2).argmin(axis=1)
        everything = np.arange(layout.electrodes)
        others = np.array([np.delete(everything, ground) for ground in everything])
        sources = np.column_stack([others[:, 0], everything])
        pairs = np.stack(np.broadcast_arrays(others, everything[:, None]), axis=-1)
        keep = np.ones(others.size, bool)
        free = int(np.setdiff1d(np.arange(len(nodes)), electrodes)[0])

        def make():
            mesh = PyEITMesh(nodes, triangles, 1.0, electrodes, free)
            solver = JAC(mesh, PyEITProtocol(sources, pairs, keep))
            solver.setup(lamb=1e-3, method="dgn")
            return solver

        with contextlib.redirect_stdout(io.StringIO()):
            self._solver, self.setup = timing.timed(make)
        self._read = ~np.eye(layout.electrodes, dtype=bool)
        self._zero = np.zeros(others.size)
        transfer = make_sheet(layout, shunting=False).transfer(
            grid.pixels, 0.5 * np.sqrt(grid.cell_area)
        )
        self._sensitivity = Sensitivity(transfer).dense()[self._read.ravel()]

    def solver(self, frame):
        """A function that does its one step for `frame` (E, E), V."""
        readings = frame[self._read]
        return lambda: self._solver.solve(readings, self._zero)

    def images(self, frames, level: float) -> np.ndarray:
        """(N, K) images of `frames` (N, E, E), V, by its inverse of the paper's sensitivity,
        lambda^2 = `level`; readings that any of them lacks are left out."""
        read = self._read & ~np.isnan(frames).any(axis=0)
        inverse = self._solver._compute_h(self._sensitivity[read[self._read]], 0.0, level, "dgn")
        return frames[:, read] @ inverse.T
