"""GREIT, the linear image that is trained, with electrodes that are discs: a peer of the profiles.

    R = X Y^T (Y Y^T + K w sigma^2 1)^-1 = X (Y^T Y + K w sigma^2 1)^-1 Y^T

is the matrix that maps readings to images with the least mean squared error over K training contacts,
readings Y (M, K) and desired images X (P, K), and over noise sigma of the readings, w times as much as
there is (Adler et al. 2009: GREIT, a unified approach to 2D linear EIT reconstruction of lung images,
Physiol. Meas. 30; w takes the place of its noise figure). The desired image falls smoothly from 1 to
0 about a circle around the true place; the circle is as wide as electrodes are apart. Every pair is
divided by the size of its readings, so that weak contacts count as much as strong ones.

Training contacts are discs on every second pixel, of three strengths, on the sheet model that the
profiles use: electrodes are equipotential discs. Libraries train on changes of conductivity with
electrodes that are points; a contact that feeds current in needs its own training.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tomotactile_ros.bench import timing
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE, RADIUS
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.voltages import frame

WEIGHTS = 1.0, 10.0, 100.0  # of the noise, w
_PRESSURES = 5e3, 1.5e4, 5e4  # Pa, of training contacts
_STEP = 2  # pixels between training contacts
_EDGE = 0.5  # the desired image falls within so many radii on either side of its circle


class Greit:
    """Trained for `layout` and the pixels of `grid`.

    setup : s that it took to simulate the training and to invert it
    """

    def __init__(self, layout: Layout, grid: Grid):
        self._read = ~np.eye(layout.electrodes, dtype=bool)
        (self._readings, self._wanted), trained = timing.timed(lambda: _training(layout, grid))
        self._inverse, inverted = timing.timed(lambda: self._matrix(self._read, WEIGHTS[0]))
        self.setup = trained + inverted

    def solver(self, voltages: np.ndarray):
        """A function that images `voltages` (E, E), V."""
        inverse = self._inverse.astype(np.float32)
        return lambda: inverse @ voltages[self._read].astype(np.float32)

    def images(self, frames: np.ndarray, weight: float) -> np.ndarray:
        """(N, P) images of `frames` (N, E, E), V; readings that any of them lacks are left out."""
        read = self._read & ~np.isnan(frames).any(axis=0)
        return frames[:, read] @ self._matrix(read, weight).T

    def _matrix(self, read, weight):
        """(P, M) R for the readings `read` (E, E), per V."""
        readings = self._readings[read]
        size = np.sqrt(np.mean(readings**2, axis=0))
        readings = readings / size
        noise = len(size) * weight * (NOISE / DRIVE) ** 2 * np.mean(size**-2)
        gram = readings.T @ readings
        gram[np.diag_indices_from(gram)] += noise
        return self._wanted @ np.linalg.solve(gram, readings.T) / DRIVE


def _training(layout, grid):
    """Readings (E, E, K) in parts of the drive, desired images (P, K)."""
    radius = RADIUS * max(layout.outline.size)
    rows, columns = np.divmod(np.flatnonzero(grid.inside), grid.shape[1])
    places = grid.pixels[(rows % _STEP == 0) & (columns % _STEP == 0)]
    transfer = make_sheet(layout).transfer(places, radius)
    resistances = 1 / (LAW.conductance(np.array(_PRESSURES)) * np.pi * radius**2)
    readings = np.stack(
        [frame(transfer.at([k]), [r], 1.0) for r in resistances for k in range(len(places))],
        axis=-1,
    )
    electrodes = layout.positions
    spacing = np.median(cKDTree(electrodes).query(electrodes, k=2)[0][:, 1])
    away = np.linalg.norm(grid.pixels[:, None] - places, axis=2) / (spacing / 2)
    fallen = np.clip((away - (1 - _EDGE)) / (2 * _EDGE), 0, 1)
    wanted = 0.5 + 0.5 * np.cos(np.pi * fallen)
    return readings, np.tile(wanted, len(resistances))
