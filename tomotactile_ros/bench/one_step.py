"""Eq. 1 of Kojima et al. 2023, f = (J'J + lambda^2 I)^-1 J'v, on a noisy frame: how exactly it is
solved.

The reference is the singular value decomposition of J in float64. Compared with it are the normal
equations in either precision, and what a pipeline with a fixed lambda^2 shows. Errors are in parts
of the norm of the image.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from tomotactile_ros.bench.extremes import CELLS, grid, voltages
from tomotactile_ros.bench.trials import DRIVE, NOISE
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.estimate import PATCH
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.sensitivity import Sensitivity
from tomotactile_ros.support.errors import InputError


class OneStep:
    """A frame v (E^2,), V, its J (E^2, K), and the reference."""

    def __init__(self):
        self.layout = grid()
        frame = np.nan_to_num(voltages(self.layout, np.inf, "fem")) * DRIVE
        frame += NOISE * np.random.default_rng(2).standard_normal(frame.shape)
        np.fill_diagonal(frame, 0.0)
        self.frame = frame.ravel()
        cells = Pipeline(self.layout, Settings(resolution=CELLS)).grid
        transfer = make_sheet(self.layout).transfer(cells.pixels, PATCH * np.sqrt(cells.cell_area))
        self.matrix = Sensitivity(transfer).dense()
        self._left, self.values, self._right = np.linalg.svd(self.matrix, full_matrices=False)

    def error(self, image: np.ndarray, level: float) -> float:
        """Of an `image` (K,), V, at lambda^2 = `level`."""
        filtered = self.values / (self.values**2 + level) if level else 1 / self.values
        exact = self._right.T @ (filtered * (self._left.T @ self.frame))
        return float(np.linalg.norm(image - exact) / np.linalg.norm(exact))

    def level(self, condition: float) -> float:
        """lambda^2 with which J'J + lambda^2 I has this condition number."""
        largest = self.values[0] ** 2
        return largest / (condition - 1) if condition > 1 else 1e6 * largest


_problem = cache(OneStep)


def as_used(level: float) -> float:
    """By a pipeline with lambda^2 = `level`."""
    problem = _problem()
    count = problem.layout.electrodes
    pipeline = Pipeline(problem.layout, Settings(resolution=CELLS, regularization=level))
    frame = problem.frame.reshape(count, count)
    result = pipeline.process(frame, np.arange(count), DRIVE)
    return problem.error(pipeline.grid.gather(result.potential), level)


def as_used_by_condition(condition: float) -> float:
    return as_used(_problem().level(condition))


def in_single_precision(condition: float) -> float:
    return _normal_equations(condition, np.float32)


def in_double_precision(condition: float) -> float:
    return _normal_equations(condition, np.float64)


def _normal_equations(condition, dtype):
    problem = _problem()
    level = problem.level(condition)
    matrix = problem.matrix.astype(dtype)
    gram = matrix.T @ matrix + dtype(level) * np.eye(matrix.shape[1], dtype=dtype)
    try:
        image = np.linalg.solve(gram, matrix.T @ problem.frame.astype(dtype))
    except np.linalg.LinAlgError:
        raise InputError("the matrix is singular") from None
    return problem.error(image, level)
