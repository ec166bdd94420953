"""A sheet that was not cut as drawn: what a displaced rim does to electrodes and contacts.

The cut outline is the drawn one under a bilinear map: each side of its bounding box lies farther out
by some way and is askew by another, all between follow. That is a sheet too large, shifted against
the electrodes, turned, stretched or cut askew. Where the rim moves outwards by d it gains a strip of
sheet, along which the potentials of the sheet drive a current (Hadamard's formula for a boundary
without flow through it):

    dY0_nk = int sigma d (t . grad H_n) (t . grad H_k) ds
    dH_n(x) = - int sigma d (t . grad D_x) (t . grad H_n) ds

with t along the rim, H, Y0 and D as in `operator`. Rims of holes move with the map.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.layouts.outline import Outline

SIDES = "left", "right", "bottom", "top"
WAYS = 2 * len(SIDES)  # how far out each side lies, and how far askew
# of the deviation of how far out each side lies: of its ends against its middle
_ASKEW = 0.5


class Rim:
    """The rim of a mesh of the sheet, in edges.

    ends : (2, R) nodes of each edge
    ways : (8, R) how far each edge goes outwards where one of `SIDES` lies farther out by one, then
        where it is askew by one at its end in the direction of the other axis
    deviation : (8,) standard deviation of these ways, m; `cut` that of how far out each side lies
    """

    def __init__(self, outline: Outline, cut: float, points: np.ndarray, triangles: np.ndarray):
        sides = triangles[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)
        _, first, count = np.unique(
            np.sort(sides, axis=1), axis=0, return_index=True, return_counts=True
        )
        at_rim = first[count == 1]
        self.ends = sides[at_rim].T
        along = points[self.ends[1]] - points[self.ends[0]]
        self._length = np.linalg.norm(along, axis=1)
        middle = points[self.ends].mean(axis=0)
        outwards = along[:, ::-1] * [1, -1] / self._length[:, None]
        opposite = points[triangles[:, [2, 0, 1]].ravel()[at_rim]]
        outwards[((opposite - middle) * outwards).sum(axis=1) > 0] *= -1
        part = (middle / (np.array(outline.size) / 2)).T
        moved = np.array(
            [s * (1 + s * part[i]) / 2 * outwards.T[i] for i in range(2) for s in (-1, 1)]
        )
        self.ways = np.concatenate([moved, moved * np.repeat(part[::-1], 2, axis=0)])
        self.deviation = np.repeat([cut, _ASKEW * cut], len(SIDES))

    def changes(self, shares: np.ndarray, resistance: float) -> tuple[np.ndarray, np.ndarray]:
        """(8, R, n) currents along the strips per way, A/m, and (8, n, n) dY0, S/m, of
        potentials `shares` (P, n) at the nodes."""
        slope = (shares[self.ends[1]] - shares[self.ends[0]]) / self._length[:, None]
        currents = self.ways[:, :, None] / resistance * slope
        return currents, np.einsum("grn,rk,r->gnk", currents, slope, self._length, optimize=True)
