"""The sheet with all its electrodes grounded at once: there contacts hardly see each other.

Take the driving layer as the reference. Electrodes at the potentials u then draw the currents Y u,
and with electrode l grounded and the others floating (Z = Y^-1)

    v_n = V0 (1 - Z_nl / Z_ll)                                                            (a)

A frame therefore holds the whole symmetric E x E matrix Z but for a common factor: all ground
conditions together say what all electrodes, grounded at once, would have measured. There the sheet
is short-circuited between electrodes, and contacts add up almost independently:

    Y = Y0 + H (diag(1/g) + D)^-1 H^T                                                     (b)

with Y0 of the untouched sheet, H (E, K) the share of a current fed in at point k that leaves
through electrode n, and D the impedance between points. (a) and (b) are exact. They follow from the
Neumann Green function G of the transfer object by eliminating the electrodes:

    [Y0 ; .] = [G_EE 1; 1^T 0]^-1 [1 ; 0],    [H ; s] = [G_EE 1; 1^T 0]^-1 [G_EK ; 1],
    D = G_KK - G_KE H - s.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.sheet.transfer import Transfer


class GroundedSheet:
    """The electrodes `used` (n,) of a transfer, all of them grounded; the others float and are not
    there.

    Attributes
    ----------
    admittance : (n, n) Y0, S; its rows sum to 0.
    rest_share : (n,) shares of a current that is fed in evenly all over the sheet, as G has its
        reference.
    share : (n, K) H; columns sum to 1.
    impedance : (K,) diagonal of D, ohm, 0 on a grounded electrode.
    """

    def __init__(self, transfer: Transfer, used=None):
        self.transfer = transfer
        self.used = np.arange(transfer.electrodes) if used is None else np.asarray(used, int)
        count = len(self.used)
        self._point = np.vstack(
            [transfer.electrode_point[self.used], np.ones(len(transfer.points))]
        )
        system = np.ones((count + 1, count + 1))
        system[:-1, :-1] = transfer.electrode_electrode[np.ix_(self.used, self.used)]
        system[-1, -1] = 0.0
        inverse = np.linalg.inv(system)
        self.admittance = (inverse[:-1, :-1] + inverse[:-1, :-1].T) / 2
        self.rest_share = inverse[:-1, -1]
        self._solved = inverse @ self._point
        self.share = self._solved[:-1]
        own = np.einsum("ek,ek->k", self._point, self._solved)
        self.impedance = np.maximum(transfer.point_self - own, 0.0)

    def at(self, transfer: Transfer) -> GroundedSheet:
        """The same electrodes with the points of another `transfer` of the same sheet."""
        return GroundedSheet(transfer, self.used)

    def between(self, rows, columns) -> np.ndarray:
        """(len(rows), len(columns)) block of D between points, without self terms, ohm."""
        block = np.array(self.transfer.green(rows, columns))
        return block - self._point[:, rows].T @ self._solved[:, columns]

    def among(self, chosen) -> np.ndarray:
        """(n, n) D between `chosen` points with self terms, ohm."""
        block = self.between(chosen, chosen)
        block = (block + block.T) / 2
        np.fill_diagonal(block, self.impedance[chosen])
        return block

    def readings(self, conductances: np.ndarray) -> np.ndarray:
        """(n, n) v / V0 by (a) and (b) where the points have `conductances` (K,), S; row l with
        electrode l grounded."""
        touching = np.flatnonzero(conductances > 0)
        share = self.share[:, touching]
        block = self.among(touching) + np.diag(1 / conductances[touching])
        admittance = self.admittance + share @ np.linalg.solve(block, share.T)
        impedance = np.linalg.inv(admittance)
        return 1 - impedance / impedance.diagonal()[:, None]
