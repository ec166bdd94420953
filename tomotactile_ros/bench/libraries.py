"""How pyEIT is applied to the same problem. Electrodes are nodes.

It images the conductivity of triangles between electrodes that carry currents in pairs: a
contact that feeds current in is outside its model. Its speed is that of its own Jacobian on the
same mesh and number of readings; its accuracy that of its one-step inverse given the paper's
sensitivity (eq. 2).
"""

from __future__ import annotations

import contextlib
import io

import numpy as np

from tomotactile_ros.bench import timing
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.sensitivity import Sensitivity

LAMBDAS = (10.0, 1000.0)  # squared


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


def electrode_nodes(layout, nodes):
    """(E,) the node next to each electrode."""
    return np.linalg.norm(nodes - layout.positions[:, None], axis=2).argmin(axis=1)


class PyeitOneStep:
    """pyEIT's one-step solver on a lattice of `cells` x `cells` squares; ImportError if not
    installed.

    setup : s that it took to make
    """

    def __init__(self, layout, grid, cells: int):
        from pyeit.eit.jac import JAC
        from pyeit.eit.protocol import PyEITProtocol
        from pyeit.mesh.wrapper import PyEITMesh

        nodes, triangles = lattice(layout, cells)
        electrodes = electrode_nodes(layout, nodes)
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
