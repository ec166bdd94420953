"""Surfaces with a formula: flat, and wrapped around a cylinder."""

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.surfaces.base import Surface


@dataclass(frozen=True)
class Flat(Surface):
    """A flat sheet in the plane z = 0."""

    kind = "flat"

    def to_3d(self, points: np.ndarray) -> np.ndarray:
        """(P, 3) positions in space, m, of (P, 2) points of the sheet."""
        points = np.asarray(points, dtype=float).reshape(-1, 2)
        return np.column_stack([points, np.zeros(len(points))])

    def jacobians(self, points: np.ndarray) -> np.ndarray:
        """(P, 3, 2) derivatives by x and y."""
        return np.tile(np.eye(3, 2), (len(points), 1, 1))

    def frames(self, points: np.ndarray) -> np.ndarray:
        """(P, 3, 3) rotations: none."""
        return np.tile(np.eye(3), (len(points), 1, 1))

    def nearest(self, places: np.ndarray, size: tuple[float, float]) -> np.ndarray:
        """(P, 2) x and y of (P, 3) places, on the sheet or beside it."""
        return np.array(places, dtype=float).reshape(-1, 3)[:, :2]

    def to_dict(self, folder: Path) -> dict:
        """The surface as in a layout file."""
        return {"flat": {}}


@dataclass(frozen=True)
class Cylinder(Surface):
    """A sheet wrapped around a cylinder whose axis runs along y; its centre is the origin.

    Parameters
    ----------
    radius : radius of the cylinder, m.
    """

    radius: float

    kind = "cylinder"

    def __post_init__(self):
        checks.length(self.radius, "cylinder.radius")

    def check(self, size: tuple[float, float]) -> None:
        """Refuse a sheet that would go around the cylinder more than once."""
        width = size[0]
        if width > 2 * np.pi * self.radius:
            raise InputError(
                f"cylinder.radius: {self.radius:g} is too small for a sheet {width:g} m "
                f"wide, it must be at least {width / (2 * np.pi):.4g} m"
            )

    def to_3d(self, points: np.ndarray) -> np.ndarray:
        """(P, 3) positions in space, m, of (P, 2) points of the sheet."""
        points = np.asarray(points, dtype=float).reshape(-1, 2)
        angle = points[:, 0] / self.radius
        x = self.radius * np.sin(angle)
        z = -2 * self.radius * np.sin(angle / 2) ** 2
        return np.column_stack([x, points[:, 1], z])

    def jacobians(self, points: np.ndarray) -> np.ndarray:
        """(P, 3, 2) derivatives by x and y."""
        angle = np.asarray(points, dtype=float).reshape(-1, 2)[:, 0] / self.radius
        result = np.zeros((len(angle), 3, 2))
        result[:, 0, 0], result[:, 2, 0] = np.cos(angle), -np.sin(angle)
        result[:, 1, 1] = 1.0
        return result

    def to_dict(self, folder: Path) -> dict:
        """The surface as in a layout file."""
        return {"cylinder": {"radius": float(self.radius)}}
