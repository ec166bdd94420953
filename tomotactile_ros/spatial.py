"""Contacts in space: from places on the flat sheet to positions, normals and forces in a frame.

Quantities on the sheet are transformed by the surface's Jacobian J (`tomotactile_ros.surfaces`): a
velocity v becomes J v, and a covariance C becomes B J C (B J)^T along the tangent and the bitangent,
which are the rows of B.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from tomotactile_ros.reconstruction.settings import ContactEstimate
from tomotactile_ros.surfaces import Surface


@dataclass(frozen=True)
class SpatialContacts:
    """N contacts on a surface, in the frame of the sensor.

    Attributes
    ----------
    positions : (N, 3) m, on the surface.
    frames : (N, 3, 3) rotations: columns tangent (where the sheet's x points), bitangent, normal.
    velocities : (N, 3) m/s, along the surface.
    covariances : (N, 2, 2) m², of the position along tangent and bitangent.
    forces : (N,) N, along the normal into the surface.
    """

    positions: np.ndarray
    frames: np.ndarray
    velocities: np.ndarray
    covariances: np.ndarray
    forces: np.ndarray

    def wrench(self) -> tuple[np.ndarray, np.ndarray]:
        """Force (3,), N, and torque (3,) about the origin, N m, of all contacts on the sensor."""
        return wrench_of(self.positions, self.frames[:, :, 2], self.forces)


def wrench_of(
    positions: np.ndarray, normals: np.ndarray, forces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Force (3,), N, and torque (3,) about the origin, N m, of forces (N,) against normals
    (N, 3)."""
    pushes = -np.asarray(forces, float).reshape(-1, 1) * np.reshape(normals, (-1, 3))
    force, torque = pushes.sum(axis=0), np.cross(np.reshape(positions, (-1, 3)), pushes).sum(axis=0)
    return force + 0.0, torque + 0.0  # no -0


def in_space(surface: Surface, contacts: Sequence[ContactEstimate]) -> SpatialContacts:
    """Contacts of a flat sheet where its surface has them, in their order."""
    points = np.array([(c.x, c.y) for c in contacts], float).reshape(-1, 2)
    covariances = np.array([c.position_covariance for c in contacts], float).reshape(-1, 2, 2)
    velocities = np.array([c.velocity for c in contacts], float).reshape(-1, 2)
    jacobians, frames = surface.jacobians(points), surface.frames(points)
    stretch = np.einsum("nki,nkj->nij", frames[:, :, :2], jacobians)
    return SpatialContacts(
        surface.to_3d(points),
        frames,
        np.einsum("nki,ni->nk", jacobians, velocities),
        np.einsum("nik,nkl,njl->nij", stretch, covariances, stretch),
        np.array([c.force for c in contacts], float),
    )


@dataclass(frozen=True)
class Pose:
    """Where one frame is in another: x = rotation x' + translation (m)."""

    translation: np.ndarray
    rotation: Rotation

    def positions(self, points: np.ndarray) -> np.ndarray:
        """Points (..., 3), m, in the other frame."""
        return self.directions(points) + self.translation

    def directions(self, vectors: np.ndarray) -> np.ndarray:
        """Vectors (..., 3) in the other frame."""
        return np.asarray(vectors, float) @ self.rotation.as_matrix().T
