"""A disc of radius 1 cut into patches."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from tomotactile_ros.scenes.contact import Contact


@lru_cache(maxsize=32)
def unit_patches(across: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Patches of the disc of radius 1: points (P, 2), shares of its area (P,), radii (P,)."""
    points, areas, radii = Contact("disc", center=(0.0, 0.0), radius=1.0).patches(across)
    return points, areas / np.pi, radii
