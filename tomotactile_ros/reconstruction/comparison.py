"""One-step images as other software makes them, to compare with: GREIT and JAC.

**GREIT** is trained (Adler et al. 2009: GREIT, a unified approach to 2D linear EIT reconstruction of lung
images, Physiol. Meas. 30):

    R = X Y^T (Y Y^T + K w sigma^2 1)^-1 = X (Y^T Y + K w sigma^2 1)^-1 Y^T

is the matrix that maps readings to images with the least mean squared error over K training contacts,
readings Y (M, K) and desired images X (P, K), and over noise sigma of the readings, w times as much as
there is (w takes the place of its noise figure). The desired image falls smoothly from 1 to 0 about a
circle around the true place; the circle is as wide as electrodes are apart. Every pair is divided by
the size of its readings, so that weak contacts count as much as strong ones. Training contacts are
discs on every second pixel, of three strengths; electrodes are equipotential discs.

**JAC** is eq. 1 of Kojima et al. 2023 with the regularisation that pyEIT's class of this name has with
method "lm", in proportion to the sensitivity of each pixel (NOSER, Cheney et al. 1990):

    R = (J^T J + lambda diag(J^T J))^-1 J^T
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
from scipy.spatial import cKDTree

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout, check_layout
from tomotactile_ros.reconstruction.frame_checks import above_drive, check_drive_voltage, ordered
from tomotactile_ros.reconstruction.settings import DEFAULT_LAW
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.sensitivity import Sensitivity
from tomotactile_ros.sheet.voltages import frame
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

WEIGHT = 10.0  # of the noise, w
DAMPING = 0.1  # lambda of JAC
_NOISE = 3e-4  # of a reading, in parts of the drive voltage: 1 mV of 3.3 V
_RADIUS = 0.025  # of a training contact, in parts of the longer side: 5 mm on 200 mm
_PRESSURES = 5e3, 1.5e4, 5e4  # Pa, of training contacts
_STEP = 2  # pixels between training contacts
_EDGE = 0.5  # the desired image falls within so many radii on either side of its circle


def greit(
    voltages: np.ndarray,
    layout: Layout,
    drive_voltage: float,
    resolution: int = 40,
    weight: float = WEIGHT,
) -> np.ndarray:
    """(H, W) image of `voltages` (E, E), V, row l with electrode l grounded, NaN outside the outline. It has
    no unit: its peak grows with the conductance of a contact. The first image of a layout takes seconds:
    the training."""
    parts = _in_parts(voltages, layout, drive_voltage)
    checks.not_negative(weight, "weight", "number")
    trained = _greit(layout, checks.integer(resolution, "resolution", 2, 200))
    return trained.grid.fill(trained.images(parts, weight)[0])


def jac(
    voltages: np.ndarray,
    layout: Layout,
    drive_voltage: float,
    resolution: int = 40,
    damping: float = DAMPING,
) -> np.ndarray:
    """(H, W) potential input distribution, in parts of the drive voltage, of `voltages` (E, E), V, row l
    with electrode l grounded; NaN outside the outline. `damping` is lambda. Its peak is no measure of force:
    it can fall where a contact conducts better."""
    parts = _in_parts(voltages, layout, drive_voltage)
    checks.positive(damping, "damping", "number")
    step = _jac(layout, checks.integer(resolution, "resolution", 2, 200))
    return step.grid.fill(step.images(parts, damping)[0])


def _in_parts(voltages: np.ndarray, layout: Layout, drive_voltage: float) -> np.ndarray:
    """(1, E, E) `voltages` in parts of the drive voltage; InputError where they are no frame of `layout`."""
    check_layout(layout)
    drive = check_drive_voltage(drive_voltage, 0.0)
    frame = ordered(layout, voltages, np.arange(len(np.atleast_1d(voltages))))
    if np.isnan(frame).all():
        raise InputError("voltages: no reading is valid")
    if wrong := above_drive(frame, drive):
        raise InputError(f"voltages: {wrong}")
    return frame[None] / drive


@lru_cache(maxsize=4)
def _greit(layout: Layout, resolution: int) -> Greit:
    return Greit(layout, Grid.for_outline(layout.outline, resolution))


@lru_cache(maxsize=4)
def _jac(layout: Layout, resolution: int) -> Jac:
    return Jac(layout, Grid.for_outline(layout.outline, resolution))


class _OneStep:
    """A matrix from readings to the pixels of `grid`, for the readings that there are."""

    def __init__(self, layout: Layout, grid: Grid):
        self.grid = grid
        self.read = ~np.eye(layout.electrodes, dtype=bool)  # (E, E)

    def images(self, frames: np.ndarray, level: float) -> np.ndarray:
        """(N, P) images of `frames` (N, E, E) in parts of the drive voltage; readings that any of them
        lacks are left out."""
        read = self.read & ~np.isnan(frames).any(axis=0)
        return frames[:, read] @ self.matrix(read, level).T

    def matrix(self, read: np.ndarray, level: float) -> np.ndarray:
        """(P, M) R for the readings `read` (E, E)."""
        raise NotImplementedError


class Jac(_OneStep):
    """JAC for `layout` and the pixels of `grid`; `level` of its methods is lambda."""

    def __init__(self, layout: Layout, grid: Grid):
        super().__init__(layout, grid)
        transfer = make_sheet(layout).transfer(grid.pixels, 0.5 * min(grid.cell_size))
        self._sensitivity = Sensitivity(transfer).dense().reshape(*self.read.shape, -1)

    def matrix(self, read: np.ndarray, level: float) -> np.ndarray:
        """(P, M) R for the readings `read` (E, E)."""
        sensitivity = self._sensitivity[read]
        gram = sensitivity.T @ sensitivity
        gram[np.diag_indices_from(gram)] *= 1 + level
        return np.linalg.solve(gram, sensitivity.T)


class Greit(_OneStep):
    """GREIT, trained for `layout` and the pixels of `grid`; `level` of its methods is w."""

    def __init__(self, layout: Layout, grid: Grid):
        super().__init__(layout, grid)
        self._readings, self._wanted = _training(layout, grid)

    def matrix(self, read: np.ndarray, level: float) -> np.ndarray:
        """(P, M) R for the readings `read` (E, E)."""
        readings = self._readings[read]
        size = np.sqrt(np.mean(readings**2, axis=0))
        readings = readings / size
        noise = len(size) * level * _NOISE**2 * np.mean(size**-2)
        gram = readings.T @ readings
        gram[np.diag_indices_from(gram)] += noise
        return self._wanted @ np.linalg.solve(gram, readings.T)


def _training(layout, grid):
    """Readings (E, E, K) in parts of the drive, desired images (P, K)."""
    radius = _RADIUS * max(layout.outline.size)
    rows, columns = np.divmod(np.flatnonzero(grid.inside), grid.shape[1])
    places = grid.pixels[(rows % _STEP == 0) & (columns % _STEP == 0)]
    transfer = make_sheet(layout).transfer(places, radius)
    resistances = 1 / (DEFAULT_LAW.conductance(np.array(_PRESSURES)) * np.pi * radius**2)
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
