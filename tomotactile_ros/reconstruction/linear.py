"""One-step Tikhonov image, eq. 1 of Kojima et al. 2023, in the basis of the frames.

    f = (J^T J + lambda^2 I)^-1 J^T v = S^T (S S^T + lambda^2 I)^-1 W v,    J = W^T S

The matrix in brackets is never formed: with the QR decomposition of S^T above lambda I, whose
condition is the square root of that of the matrix,

    [S^T; lambda I] = Q R,        f = (S^T R^-1) (R^-T W) v.

Without some of the readings W^T loses rows; the QR decomposition of what is left, W'^T R', gives J
= W'^T (R' S).
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import solve_triangular

from tomotactile_ros.reconstruction.basis import LARGEST_CONDITION, FrameBasis

_SINGLE = 1e4  # condition of J^T J + lambda^2 I up to which single precision is enough


class LinearImage:
    """Regularised inverse for one lambda_J^2 and one set of readings.

    Parameters
    ----------
    basis : FrameBasis for this lambda_J^2 or a smaller one
    regularization : lambda_J^2
    missing : (n,) places of left-out readings in the flattened frame; they must be 0 in `image`.
    """

    def __init__(self, basis: FrameBasis, regularization: float, missing=()):
        level = max(regularization, basis.square / LARGEST_CONDITION)
        count = basis.needed(level)
        analysis, sensitivity = basis.analysis[:count], basis.sensitivity[:count]
        if len(missing):
            analysis = analysis.copy()
            analysis[:, missing] = 0.0
            directions, triangle = np.linalg.qr(analysis.T)
            analysis, sensitivity = directions.T, triangle @ sensitivity
        stacked = np.vstack([sensitivity.T, np.sqrt(level) * np.eye(count)])
        factor = np.linalg.qr(stacked, mode="r")
        self._type = np.float32 if basis.square <= _SINGLE * level else np.float64
        self._analysis = self._divided(factor, analysis)
        self._synthesis = np.ascontiguousarray(self._divided(factor, sensitivity).T)

    def _divided(self, factor, rows):
        return solve_triangular(factor, rows, trans="T").astype(self._type, order="C")

    def image(self, voltages: np.ndarray) -> np.ndarray:
        """(K,) potential input distribution, V, of a flattened frame (L * E,), V."""
        return self._synthesis @ (self._analysis @ voltages.astype(self._type))
