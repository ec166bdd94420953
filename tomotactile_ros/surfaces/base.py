"""What every surface can say of points of the sheet.

A surface is a map p(x, y) from the flat sheet into space. Its Jacobian J = [dp/dx, dp/dy] takes
velocities and covariances along; the tangent, the bitangent and the normal are the first
fundamental frame of differential geometry, made orthonormal (Gram-Schmidt, x first).
"""

from abc import ABC, abstractmethod
from pathlib import Path
from typing import ClassVar

import numpy as np
from scipy.spatial import cKDTree

from tomotactile_ros.support.errors import InputError

MOST_STRETCH = 2.0  # no sheet survives more, and wrong units are far beyond
_LATTICE = 129  # points a side from which the nearest one is refined
_STEPS = 8  # of Gauss-Newton, each squares the distance from the lattice's point


class Surface(ABC):
    """A sheet in space, in the frame of the sensor; lengths in m."""

    kind: ClassVar[str]

    @abstractmethod
    def to_3d(self, points: np.ndarray) -> np.ndarray:
        """(P, 3) positions in space, m, of (P, 2) points of the sheet, m."""

    @abstractmethod
    def jacobians(self, points: np.ndarray) -> np.ndarray:
        """(P, 3, 2) derivatives of the positions by x and y at (P, 2) points of the sheet."""

    @abstractmethod
    def to_dict(self, folder: Path) -> dict:
        """The surface as in a layout file that is in this folder."""

    def check(self, size: tuple[float, float]) -> None:
        """Refuse, as InputError, a sheet of this width and height (m) that does not fit."""

    def frames(self, points: np.ndarray) -> np.ndarray:
        """(P, 3, 3) rotations at (P, 2) points of the sheet: columns tangent, bitangent, normal.

        The tangent points where the sheet's x points, the bitangent is normal x tangent.
        """
        along_x, along_y = np.moveaxis(self.jacobians(points), 2, 0)
        normal = _unit(np.cross(along_x, along_y))
        tangent = _unit(along_x)
        return np.stack([tangent, np.cross(normal, tangent), normal], axis=2)

    def normals(self, points: np.ndarray) -> np.ndarray:
        """(P, 3) unit vectors out of the surface at (P, 2) points of the sheet."""
        return self.frames(points)[:, :, 2]

    def nearest(self, places: np.ndarray, size: tuple[float, float]) -> np.ndarray:
        """(P, 2) points of a sheet of this size (m) nearest to (P, 3) places in space; NaN for
        NaN."""
        places = np.asarray(places, dtype=float).reshape(-1, 3)
        found = np.full((len(places), 2), np.nan)
        known = np.isfinite(places).all(axis=1)
        if known.any():
            found[known] = self._nearest(places[known], size)
        return found

    def _nearest(self, places: np.ndarray, size: tuple[float, float]) -> np.ndarray:
        half = np.array(size) / 2
        steps = np.linspace(-1.0, 1.0, _LATTICE)
        lattice = np.stack(np.meshgrid(*(h * steps for h in half)), axis=-1).reshape(-1, 2)
        points = lattice[cKDTree(self.to_3d(lattice)).query(places)[1]]
        for _ in range(_STEPS):
            jacobians = self.jacobians(points)
            left = places - self.to_3d(points)
            normal = np.einsum("pki,pkj->pij", jacobians, jacobians)
            step = np.linalg.solve(normal, np.einsum("pki,pk->pi", jacobians, left)[..., None])
            points = np.clip(points + step[..., 0], -half, half)
        return points


def check_stretch(surface: Surface, size: tuple[float, float], key: str) -> None:
    """Refuse a surface that stretches a sheet of this size (m) anywhere beyond what one stands."""
    steps = (np.arange(16) + 0.5) / 16 - 0.5
    points = np.stack(np.meshgrid(size[0] * steps, size[1] * steps), axis=-1).reshape(-1, 2)
    stretch = np.linalg.svd(surface.jacobians(points), compute_uv=False)
    factor = np.where(stretch > 0, np.maximum(stretch, 1 / np.maximum(stretch, 1e-300)), np.inf)
    worst = int(np.argmax(factor.max(axis=1)))
    if not factor[worst].max() <= MOST_STRETCH:
        x, y = points[worst]
        raise InputError(
            f"{key}: at [{x:.3g}, {y:.3g}] of the sheet its lengths become {stretch[worst, 1]:.3g} "
            f"to {stretch[worst, 0]:.3g} times as long, up to {MOST_STRETCH:g} times works; "
            "are all lengths in m?"
        )


def _unit(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) of length 1."""
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)
