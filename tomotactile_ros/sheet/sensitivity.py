"""The paper's sensitivity (eq. 2) as an operator that is never stored.

    J[(l, n), k] = Z_l(n, k) / Z_l(k, k),    0 where point k lies on the grounded electrode l

One contact at a time: the potential of electrode n when point k is held at 1 V and l is grounded.
It has no unit and does not depend on the sheet resistance. Both products need one matrix product of
the size (L x E)(E x K) and elementwise weights 1 / Z_l(k, k).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.sheet.transfer import Transfer


class Sensitivity:
    """J and its adjoint for the ground conditions `grounded` (L,), by default all in turn.

    Frames are (L, E); the entry of the grounded electrode is 0 in products and ignored in adjoints.
    """

    def __init__(self, transfer: Transfer, grounded: ArrayLike | None = None):
        count = transfer.electrodes
        self.transfer = transfer
        self.grounded = np.arange(count) if grounded is None else np.asarray(grounded, int)
        impedance = transfer.self_impedance(self.grounded)
        shorted = transfer.electrode_of == self.grounded[:, None]
        with np.errstate(divide="ignore"):
            self.weight = np.where(shorted, 0.0, 1 / impedance)  # (L, K), 1/ohm
        between = transfer.electrode_electrode
        own = between[self.grounded, self.grounded]
        self._offset = own[:, None] - between[self.grounded]  # (L, E)

    @property
    def shape(self) -> tuple[int, int]:
        return len(self.grounded) * self.transfer.electrodes, self.weight.shape[1]

    def forward(self, potential: ArrayLike) -> np.ndarray:
        """J x: (K,) potential input distribution, V -> (L, E) voltages, V."""
        current = self.weight * potential
        total = current.sum(axis=1, keepdims=True)
        common = np.einsum("lk,lk->l", self.transfer.electrode_point[self.grounded], current)
        return current @ self.transfer.electrode_point.T + self._offset * total - common[:, None]

    def adjoint(self, voltages: ArrayLike) -> np.ndarray:
        """J^T v: (L, E) voltages, V -> (K,)."""
        voltages = np.array(voltages, float)
        voltages[np.arange(len(self.grounded)), self.grounded] = 0.0
        point = self.transfer.electrode_point
        inner = voltages @ point
        inner += np.einsum("le,le->l", voltages, self._offset)[:, None]
        inner -= voltages.sum(axis=1, keepdims=True) * point[self.grounded]
        return np.einsum("lk,lk->k", self.weight, inner)

    def dense(self) -> np.ndarray:
        """(L * E, K) the matrix itself, for small problems and for tests."""
        rows = [
            self.transfer.impedance(ground) * weight
            for ground, weight in zip(self.grounded, self.weight)
        ]
        return np.concatenate(rows)
