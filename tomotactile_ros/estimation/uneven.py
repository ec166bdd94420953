"""What an uneven sheet does to the electrodes beyond first order, by finite elements.

`SheetOperator` knows an uneven sheet to first order in its coefficients m. Where they are large and
known, as of a sensor that was learned, two solutions on one mesh, of the even sheet and of that
with m, give what is left: of Y0 as a factor, of H as a sum, of D as a sum times the local
conductance. Their errors of discretisation are alike and cancel.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.scenes.sheet_field import Anisotropy
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.sheet.mesh import Mesh

_RADIUS = 1 / 6  # spacings: of the disc whose D stands for that of contacts
_ISOTROPIC = 1e-6  # half the logarithm of a ratio: below, there is no direction


@dataclass(frozen=True)
class Solution:
    """What contacts and electrodes see of one sheet: Y0 (n, n), S; H (M, n) and D (M,), ohm, at
    places."""

    admittance: np.ndarray
    share: np.ndarray
    own: np.ndarray


@dataclass(frozen=True)
class Rest:
    """What first order leaves: of ln Y0 (n, n), of Y0 (n, n), S, where that has none, of H (M, n),
    of D (M,), ohm of an even sheet, at the points of the operator's lattice."""

    factor: np.ndarray
    term: np.ndarray
    share: np.ndarray
    own: np.ndarray


def uneven(
    layout: Layout,
    mesh: Mesh,
    conductance: Callable[[np.ndarray], np.ndarray],
    anisotropy: np.ndarray,
) -> FemSheet:
    """The sheet on the `mesh` of the even one, with the logarithm of `conductance`, a function of points
    (n, 2) -> (n,), and `anisotropy` (2,), p and q as `field` has them."""

    def resistance(points: np.ndarray) -> np.ndarray:
        return layout.sheet_resistance * np.exp(-conductance(points))

    half = float(np.hypot(*anisotropy))
    direction = np.degrees(np.arctan2(anisotropy[1], anisotropy[0])) / 2
    turned = Anisotropy(float(np.exp(2 * half)), float(direction)) if half > _ISOTROPIC else None
    return FemSheet(layout, resistance=resistance, anisotropy=turned, mesh=mesh)


def solution(sheet: FemSheet, used: np.ndarray, places: np.ndarray, pitch: float) -> Solution:
    """What is seen of a sheet by the electrodes `used` (n,), `pitch`, m, apart, and at `places` (M, 2), m."""
    transfer = sheet.transfer(places, np.full(len(places), _RADIUS * pitch))
    fed = np.vstack([transfer.electrode_point[used], np.ones(len(places))])
    inverse = bordered_inverse(transfer.electrode_electrode, used)
    share = inverse @ fed
    own = np.maximum(transfer.point_self - np.einsum("ek,ek->k", fed, share), 0.0)
    return Solution(inverse[:-1, :-1], share[:-1].T, own)


def bordered_inverse(between: np.ndarray, used: np.ndarray) -> np.ndarray:
    """(n + 1, n + 1) inverse of [G 1; 1^T 0]."""
    system = np.ones((len(used) + 1, len(used) + 1))
    system[:-1, :-1] = between[np.ix_(used, used)]
    system[-1, -1] = 0.0
    inverse = np.linalg.inv(system)
    return (inverse + inverse.T) / 2
