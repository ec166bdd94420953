"""The few directions in which frames differ.

The potential of a sheet is smooth, so the frames of all pixels span far fewer directions than the
L (E - 1) readings: J = W^T S with orthonormal rows W (r, L E) and S = W J (r, K). A frame is reduced once
to the r numbers W v; what is discarded are singular values below the noise.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.sheet.sensitivity import Sensitivity
from tomotactile_ros.sheet.transfer import Transfer

_SMALLEST = 1e-10  # s^2 of the last direction, in parts of the largest
_MOST_PIXELS = 1600  # that find the directions; on finer images a subset does


class FrameBasis:
    """Orthonormal directions of the frames of `transfer` under all ground conditions in turn.

    Attributes
    ----------
    analysis : (r, L * E) float32, W; entries of grounded electrodes are 0.
    sensitivity : (r, K) S = W J.
    values : (r,) singular values, largest first.
    """

    def __init__(self, transfer: Transfer):
        count = len(transfer.points)
        step = max(1, int(np.ceil(count / _MOST_PIXELS)))
        chosen = np.arange(0, count, step)
        dense = Sensitivity(transfer.at(chosen)).dense()
        squares, vectors = np.linalg.eigh(dense.T @ dense)
        kept = np.flatnonzero(squares > _SMALLEST * squares[-1])[::-1]
        self.values = np.sqrt(squares[kept])
        analysis = (vectors[:, kept] / self.values).T @ dense.T
        self.sensitivity = (vectors[:, kept] * self.values).T
        if step > 1:
            operator = Sensitivity(transfer)
            shape = transfer.electrodes, transfer.electrodes
            rows = [operator.adjoint(row.reshape(shape)) for row in analysis]
            self.sensitivity = np.array(rows)
        self.analysis = np.ascontiguousarray(analysis, np.float32)
