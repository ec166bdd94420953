"""The directions in which frames differ.

The potential of a sheet is smooth, so the frames of all pixels span far fewer directions than the L
(E - 1) readings: J = W^T S with orthonormal rows W (r, L E), strongest first, and S = W J (r, K).
The eigenvectors V of J^T J only order the directions; W comes from the QR decomposition of J V.
Squares lose what is below 1e-8 of the largest singular value, J V does not. Eq. 1 does not see
directions with singular values far below lambda_J.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.sheet.sensitivity import Sensitivity
from tomotactile_ros.sheet.transfer import Transfer

LARGEST_CONDITION = 1e16  # of J^T J + lambda_J^2 I: a smaller lambda_J^2 counts as larger
_NEGLIGIBLE = 3e-4  # of lambda_J, or a tenth of the largest singular value
_RESOLVED = 1e-7  # least singular value that J^T J tells, in parts of the largest
_MOST_PIXELS = 1600  # that find the directions; on finer images a subset does


class FrameBasis:
    """Orthonormal directions of the frames of `transfer` under all ground conditions in turn.

    Parameters
    ----------
    regularization : the least lambda_J^2 that it is for

    Attributes
    ----------
    analysis : (r, L * E) W; entries of grounded electrodes are 0.
    sensitivity : (r, K) S = W J.
    """

    def __init__(self, transfer: Transfer, regularization: float = 0.0):
        self.regularization = regularization
        count = len(transfer.points)
        step = max(1, int(np.ceil(count / _MOST_PIXELS)))
        dense = Sensitivity(transfer.at(np.arange(0, count, step))).dense()
        squares, vectors = np.linalg.eigh(dense.T @ dense)
        self._values = np.sqrt(step * np.maximum(squares[::-1], 0.0))[: len(dense)]
        directions = vectors[:, ::-1][:, : self.needed(regularization)]
        self.analysis = np.linalg.qr(dense @ directions)[0].T
        if step == 1:
            self.sensitivity = self.analysis @ dense
        else:
            operator = Sensitivity(transfer)
            shape = transfer.electrodes, transfer.electrodes
            self.sensitivity = np.array(
                [operator.adjoint(row.reshape(shape)) for row in self.analysis]
            )

    @property
    def square(self) -> float:
        """Square of the largest singular value of J."""
        return float(self._values[0]) ** 2

    def needed(self, regularization: float) -> int:
        """Number of directions that eq. 1 needs, the first ones."""
        least = max(regularization, self.square / LARGEST_CONDITION)
        smallest = _NEGLIGIBLE * min(np.sqrt(least), 0.1 * self._values[0])
        if smallest < _RESOLVED * self._values[0]:
            return len(self._values)
        return int(np.count_nonzero(self._values > smallest))
