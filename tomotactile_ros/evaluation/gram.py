"""J'J of the paper's sensitivity, and its derivative, without J.

J[(l, n), k] = Z_l(n, k) / Z_l(k, k) (Kojima et al. 2023, eq. 2). With g_n(k) = G(n, k),
w_l(k) = 1 / Z_l(k, k), u_l = w_l g_l and c_ln = G(l, l) - G(l, n), the sum over n of
Z_l(n, k) Z_l(n, k') can be done on paper:

    J'J = (g'g) * (w'w) + z't + t'z,     z = [w; u],     t = [(q - C g_l + D / 2) w; u E / 2 - s w]
    q_l(k) = sum_n c_ln g_n(k),   C_l = sum_n c_ln,   D_l = sum_n c_ln^2,   s(k) = sum_n g_n(k)

where * is elementwise and all others are products of thin matrices.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.sheet.sensitivity import Sensitivity
from tomotactile_ros.sheet.transfer import Transfer


class Gram:
    """J'J of all K points of `transfer`, for the ground conditions `grounded` (all without it)."""

    def __init__(self, transfer: Transfer, grounded=None):
        operator = Sensitivity(transfer, grounded)
        self.grounded = operator.grounded
        self._point = transfer.electrode_point  # g
        self._weight = operator.weight  # w
        between = transfer.electrode_electrode
        own = between[self.grounded, self.grounded]
        self._offset = own[:, None] - between[self.grounded]  # c
        self._mixed = self._offset @ self._point  # q
        self._sum = self._point.sum(axis=0)  # s
        ground = self._point[self.grounded]
        weighted = self._weight * ground  # u
        first = self._mixed - self._offset.sum(axis=1)[:, None] * ground
        first += (self._offset**2).sum(axis=1)[:, None] / 2
        electrodes = len(self._point)
        self._z = np.concatenate([self._weight, weighted])
        self._t = np.concatenate(
            [first * self._weight, electrodes / 2 * weighted - self._sum * self._weight]
        )

    def rows(self, chosen) -> np.ndarray:
        """(n, K) rows `chosen` of J'J."""
        out = self._point[:, chosen].T @ self._point
        out *= self._weight[:, chosen].T @ self._weight
        out += np.concatenate([self._z[:, chosen], self._t[:, chosen]]).T @ np.concatenate(
            [self._t, self._z]
        )
        return out

    def adjoint(self, chosen, seed) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives of sum(seed * rows(chosen)) with respect to G.

        Parameters
        ----------
        chosen : (n,) rows; seed : (n, K)

        Returns
        -------
        (E, K) derivative by `electrode_point`, (E, E) by `electrode_electrode`; `point_self` is
        held.
        """
        g, w, z, t = self._point, self._weight, self._z, self._t
        g_product = g[:, chosen].T @ g
        w_product = w[:, chosen].T @ w
        seed_g, seed_w = seed * w_product, seed * g_product
        d_point = g[:, chosen] @ seed_g
        d_point[:, chosen] += g @ seed_g.T
        d_weight = w[:, chosen] @ seed_w
        d_weight[:, chosen] += w @ seed_w.T
        both = np.concatenate([t[:, chosen], z[:, chosen]]) @ seed
        both[:, chosen] += np.concatenate([t, z]) @ seed.T
        count = len(self.grounded)
        d_weight += both[:count]
        d_weighted, d_first, d_second = (
            both[count : 2 * count],
            both[2 * count : 3 * count],
            both[3 * count :],
        )
        return self._back(d_point, d_weight, d_weighted, d_first, d_second)

    def _back(self, d_point, d_weight, d_weighted, d_first, d_second):
        """From derivatives by g, w, u and the two halves of t to those by G."""
        g, w, c, ground = self._point, self._weight, self._offset, self.grounded
        total, square = c.sum(axis=1)[:, None], (c**2).sum(axis=1)[:, None]
        inner = d_first * w
        d_weight = d_weight + d_first * (self._mixed + square / 2) - d_second * self._sum
        d_weighted = d_weighted - total * d_first + len(g) / 2 * d_second
        d_weight += d_weighted * g[ground]
        d_offset = inner @ g.T - (inner * g[ground]).sum(axis=1)[:, None]
        d_offset += inner.sum(axis=1)[:, None] * c
        d_point += c.T @ inner - (d_second * w).sum(axis=0)
        d_impedance = -d_weight * w**2
        np.add.at(d_point, ground, d_weighted * w - 2 * d_impedance)
        d_between = np.zeros((len(g), len(g)))
        np.add.at(d_between, (ground, ground), d_impedance.sum(axis=1) + d_offset.sum(axis=1))
        np.add.at(d_between, ground, -d_offset)
        return d_point, d_between
