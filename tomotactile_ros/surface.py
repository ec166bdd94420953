"""Curved mounting: where the points of the flat sheet lie in space. For display only."""

from dataclasses import dataclass

import numpy as np

from tomotactile_ros import checks
from tomotactile_ros.errors import InputError


@dataclass(frozen=True)
class Surface:
    """A sheet wrapped around a cylinder whose axis runs along y; its centre is the origin.

    Bending without stretching changes no resistance, so the physics stays that of the flat sheet.

    Parameters
    ----------
    radius : radius of the cylinder, m.
    """

    radius: float

    def __post_init__(self):
        checks.length(self.radius, "cylinder.radius")

    def check(self, width: float) -> None:
        """Refuse a sheet of this width (m) that would go around the cylinder more than once."""
        if width > 2 * np.pi * self.radius:
            raise InputError(
                f"surface.cylinder.radius: {self.radius:g} is too small for a sheet {width:g} m "
                f"wide, it must be at least {width / (2 * np.pi):.4g} m"
            )

    def to_3d(self, points: np.ndarray) -> np.ndarray:
        """(P, 3) positions in space, m, of (P, 2) points of the sheet."""
        points = np.asarray(points, dtype=np.float64)
        angle = points[:, 0] / self.radius
        x = self.radius * np.sin(angle)
        z = -2 * self.radius * np.sin(angle / 2) ** 2
        return np.column_stack([x, points[:, 1], z])

    def normals(self, points: np.ndarray) -> np.ndarray:
        """(P, 3) unit vectors out of the surface at (P, 2) points of the sheet."""
        angle = np.asarray(points, dtype=np.float64)[:, 0] / self.radius
        return np.column_stack([np.sin(angle), np.zeros_like(angle), np.cos(angle)])
