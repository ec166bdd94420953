"""The same problem by other libraries, in the same run: what is not installed is skipped with a line.

The floor is the product of a dense float32 matrix of the size of the operator with the frame. pyEIT images
the conductivity of triangles between electrodes that carry currents in pairs: a contact that feeds current in
is outside its model. Its speed is that of its own Jacobian on the same mesh and number of readings; its
accuracy that of its one-step inverse given the paper's sensitivity (eq. 2) and, of several lambda^2, the one that
suits these very contacts best. scikit-fem solves the
untouched sheet for all electrodes; electrodes are nodes in both libraries.
"""

from __future__ import annotations

import contextlib
import io

import numpy as np

from tomotactile_ros.bench import accuracy, timing
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE, Trials
from tomotactile_ros.evaluation.metrics import quality
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.model import Model
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.sheet.sensitivity import Sensitivity

_CELLS = 40
_ROUNDS = 12
_LAMBDAS = (10.0, 1000.0)  # squared


def compare(trials: Trials) -> dict:
    """Peers beside `fast` on 8 x 8 electrodes and 40 x 40 pixels; durations in s, lengths in m."""
    pipeline, setup = timing.timed(lambda: Pipeline(trials.layout, _settings()))
    everything = np.arange(trials.layout.electrodes)
    frame = trials.singles.frames[0]
    readings = np.nan_to_num(frame[~np.eye(len(frame), dtype=bool)]).astype(np.float32)
    dense = np.random.default_rng(0).random((len(pipeline.grid.pixels), len(readings)), np.float32)
    calls = {
        "dense": lambda: dense @ readings,
        "fast": lambda: pipeline.process(frame, everything, DRIVE),
        "fast, image alone": _image_alone(trials.layout, pipeline.grid, frame),
    }
    peers = {"pyeit": _skip("pyeit")}
    with contextlib.suppress(ImportError):
        one_step, peers["pyeit"] = _pyeit(trials, pipeline)
        calls["pyeit"] = one_step
    times = timing.in_turn(calls, _ROUNDS)
    images = accuracy.process(pipeline, trials.singles, everything)
    images = np.array([pipeline.grid.gather(result.potential) for result in images])
    out = {
        "fast": {"setup": setup, "frame": timing.summary(times["fast"])}
        | _merit(images, trials, pipeline.grid),
        "fast, image alone": {"frame": timing.summary(times["fast, image alone"])},
        "dense": {"frame": timing.summary(times["dense"]), "shape": list(dense.shape)},
        **peers,
        "forward": _forward(trials.layout),
        "dense / fast": timing.ratio(times["dense"], times["fast"]),
        "dense / fast, image alone": timing.ratio(times["dense"], times["fast, image alone"]),
    }
    if "pyeit" in times:
        out["pyeit"]["frame"] = timing.summary(times["pyeit"])
        out["pyeit / fast"] = timing.ratio(times["pyeit"], times["fast"])
        image_alone = timing.ratio(times["pyeit"], times["fast, image alone"])
        out["pyeit / fast, image alone"] = image_alone
        out["pyeit / fast, set-up"] = out["pyeit"]["setup"] / setup
    return out


def _image_alone(layout, grid, frame):
    """From voltages to the image of `fast` and no further, which is what the dense product does."""
    local = Model(layout, grid, "auto", NOISE).local(np.arange(layout.electrodes))
    single = frame.astype(np.float32)
    return lambda: local.image(local.meter.read(single, DRIVE))


def _settings():
    return Settings(resolution=_CELLS, noise=NOISE, contact_law=LAW)


def _skip(name):
    return {"skipped": f"{name} is not installed: python3 -m pip install {name}"}


def _merit(images, trials, grid):
    found = quality(images, np.concatenate(trials.singles.positions), grid)
    return {
        "hwhm": accuracy.spread(found.hwhm),
        "position_error": accuracy.spread(found.position_error),
    }


def lattice(layout, cells: int):
    """Nodes ((cells + 1)^2, 2) and triangles (2 cells^2, 3) of a square lattice, two to a pixel of the image.

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


def electrode_nodes(layout, nodes):
    """(E,) the node next to each electrode."""
    return np.linalg.norm(nodes - layout.positions[:, None], axis=2).argmin(axis=1)


def _pyeit(trials, pipeline):
    """Its one-step frame as a function, and its figures."""
    from pyeit.eit.jac import JAC
    from pyeit.eit.protocol import PyEITProtocol
    from pyeit.mesh.wrapper import PyEITMesh

    layout = trials.layout
    nodes, triangles = lattice(layout, _CELLS)
    electrodes = electrode_nodes(layout, nodes)
    count = layout.electrodes
    others = np.array([np.delete(np.arange(count), ground) for ground in range(count)])
    sources = np.column_stack([others[:, 0], np.arange(count)])
    pairs = np.stack([others, np.repeat(np.arange(count)[:, None], count - 1, 1)], axis=-1)
    keep = np.ones(pairs.shape[:2], bool).ravel()
    free = int(np.setdiff1d(np.arange(len(nodes)), electrodes)[0])

    def make():
        mesh = PyEITMesh(nodes, triangles, 1.0, electrodes, free)
        solver = JAC(mesh, PyEITProtocol(sources, pairs, keep))
        solver.setup(lamb=1e-3, method="dgn")
        return solver

    with contextlib.redirect_stdout(io.StringIO()):
        solver, setup = timing.timed(make)
        held = sum(array.nbytes for array in (solver.H, solver.J))
        forward = timing.timed(lambda: solver.fwd.solve_eit())[1]
    frames = trials.singles.frames[:, ~np.eye(count, dtype=bool)]
    zero = np.zeros(frames.shape[1])
    transfer = make_sheet(layout, shunting=False).transfer(
        pipeline.grid.pixels, 0.5 * np.sqrt(pipeline.grid.cell_area)
    )
    dense = Sensitivity(transfer).dense()[~np.eye(count, dtype=bool).ravel()]
    merits = []
    for level in _LAMBDAS:
        inverse = solver._compute_h(dense, 0.0, level, "dgn")
        merits.append(_merit(frames @ inverse.T, trials, pipeline.grid) | {"regularization": level})
    figures = {
        "setup": setup,
        "held": held,
        "forward_frame": forward,
        "elements": len(triangles),
    } | min(merits, key=lambda merit: merit["position_error"]["mean"])
    return (lambda: solver.solve(frames[0], zero)), figures


def scikit_fem_solver(layout, cells: int):
    """A function that assembles, factorises and solves the sheet for all electrodes; None if not installed."""
    try:
        from skfem import Basis, ElementTriP1, MeshTri, asm
        from skfem.models.poisson import laplace
    except ImportError:
        return None
    from scipy.sparse.linalg import splu

    nodes, triangles = lattice(layout, cells)
    mesh = MeshTri(nodes.T.copy(), triangles.T.copy())
    feed = np.zeros((len(nodes), layout.electrodes))
    feed[electrode_nodes(layout, nodes), np.arange(layout.electrodes)] = 1.0

    def solve():
        matrix = asm(laplace, Basis(mesh, ElementTriP1())).tocsc()[1:, 1:]
        return splu(matrix, permc_spec="MMD_AT_PLUS_A").solve(feed[1:])

    return solve


def _forward(layout):
    """Durations of the untouched sheet, solved for all electrodes: both models here, and scikit-fem."""
    longest = max(layout.outline.size)
    calls = {
        "fem": lambda: FemSheet(layout, h=longest / _CELLS),
        "closed_form": lambda: make_sheet(layout),
    }
    solve = scikit_fem_solver(layout, _CELLS)
    if solve is not None:
        calls["scikit-fem"] = solve
    out = {name: timing.summary(each) for name, each in timing.in_turn(calls, 3, 2).items()}
    return out if solve is not None else out | {"scikit-fem": _skip("scikit-fem")}
