"""Distances as currents see them: in coordinates in which an anisotropic sheet is isotropic.

A disc is an ellipse there, with semi-axes a > b. Alone on a sheet it has the field of a disc of
radius (a + b) / 2: its equipotentials are confocal ellipses, on which ln((alpha + beta) / 2) is
constant (alpha, beta their semi-axes).
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.scenes.sheet_field import Anisotropy


class Metric:
    """Stretched coordinates of a sheet with electrodes of one radius, m.

    mean           radius as which a disc of radius 1 acts
    least          as which length 1 acts where it acts as the shortest
    radius         as which an electrode acts, m
    """

    def __init__(self, anisotropy: Anisotropy | None, electrode_radius: float):
        self.isotropic = anisotropy is None or anisotropy.ratio == 1
        self._stretch = np.eye(2)
        if anisotropy is not None and not self.isotropic:
            self._stretch = anisotropy.stretch
        sizes, directions = np.linalg.eigh(self._stretch)
        self.mean = 1.0 if self.isotropic else float(sizes.mean())
        self.least = float(sizes[0])
        self.radius = self.mean * electrode_radius
        self._focus = electrode_radius * np.sqrt(sizes[1] ** 2 - sizes[0] ** 2) * directions[:, 1]

    def at(self, points: np.ndarray) -> np.ndarray:
        """(..., 2) stretched coordinates of points (..., 2), m."""
        return points if self.isotropic else points @ self._stretch

    def reach(self, offsets: np.ndarray) -> np.ndarray:
        """(...) m, the distance as which each of `offsets` (..., 2) from an electrode acts.

        The mean semi-axis of the ellipse through the point that is confocal with the electrode.
        """
        if self.isotropic:
            return np.linalg.norm(offsets, axis=-1)
        seen = offsets @ self._stretch
        long = np.linalg.norm(seen - self._focus, axis=-1)
        long = (long + np.linalg.norm(seen + self._focus, axis=-1)) / 2
        return (long + np.sqrt(np.maximum(long**2 - self._focus @ self._focus, 0.0))) / 2
