"""One-step Tikhonov image, eq. 1 of Kojima et al. 2023, in the basis of the frames.

    f = (J^T J + lambda^2 I)^-1 J^T v = S^T (S S^T + lambda^2 I)^-1 W v,    J = W^T S

Without some of the readings (mask m) W^T loses rows and stays exact:

    f = S^T (M S S^T + lambda^2 I)^-1 W m v,    M = W m W^T
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.reconstruction.basis import FrameBasis


class LinearImage:
    """Regularised inverse for one lambda_J^2 and one set of readings.

    Parameters
    ----------
    basis : FrameBasis
    regularization : lambda_J^2
    missing : (n,) places of left-out readings in the flattened frame; they must be 0 in `image`.
    """

    def __init__(self, basis: FrameBasis, regularization: float, missing=()):
        self.basis = basis
        self.regularization = regularization
        sensitivity = basis.sensitivity
        gram = sensitivity @ sensitivity.T
        missing = np.asarray(missing, int)
        if len(missing):
            lost = basis.analysis[:, missing].astype(float)
            gram = gram - lost @ (lost.T @ gram)
        floor = 1e-12 * np.trace(gram) / len(gram)
        system = gram + max(regularization, floor) * np.eye(len(gram))
        inverse = np.linalg.solve(system, np.eye(len(gram)))
        self._synthesis = np.ascontiguousarray(sensitivity.T @ inverse, np.float32)

    def image(self, voltages: np.ndarray) -> np.ndarray:
        """(K,) potential input distribution, V, of a flattened frame (L * E,) float32, V."""
        return self._synthesis @ (self.basis.analysis @ voltages)
