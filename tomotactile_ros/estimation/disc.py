"""A disc of radius 1, and a square of its area, cut into patches."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from tomotactile_ros.scenes.contact import Contact


@lru_cache(maxsize=32)
def unit_patches(across: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Patches of the disc of radius 1: points (P, 2), shares of its area (P,), radii (P,)."""
    points, areas, radii = Contact("disc", center=(0.0, 0.0), radius=1.0).patches(across)
    return points, areas / np.pi, radii


# radius of the disc that acts like a square, in sides: its mean log distance to itself
PATCH = 0.447


@lru_cache(maxsize=8)
def square_patches(across: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same of the square whose area is that of the disc, sides along the axes, cut into
    `across` squared patches."""
    side = np.sqrt(np.pi)
    steps = side * ((np.arange(across) + 0.5) / across - 0.5)
    points = np.stack(np.meshgrid(steps, steps), axis=-1).reshape(-1, 2)
    share, radius = 1 / len(points), PATCH * side / across
    return points, np.full(len(points), share), np.full(len(points), radius)
