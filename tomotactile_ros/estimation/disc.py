"""A disc of radius 1, and a square of its area, cut into patches that a contact stretches."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from tomotactile_ros.scenes.contact import Contact

MOST_PATCHES = 24  # to the width of a disc


@lru_cache(maxsize=32)
def unit_patches(across: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Patches of the disc of radius 1: points (P, 2), shares of its area (P,), radii (P,)."""
    points, areas, radii = Contact("disc", center=(0.0, 0.0), radius=1.0).patches(across)
    return points, areas / np.pi, radii


# radius of the disc that acts like a square, in sides: its mean log distance to itself
PATCH = 0.447


# patches to the width of a bar: with 2 to 9 lines leave the same (0.92 to 0.97 times the noise)
_OVER = 3


def cut(across: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Patches of what a contact stretches: `across` to the width of a disc; below 0, so many to the length
    of a square, which may become a rectangle."""
    return unit_patches(across) if across > 0 else square_patches(-across)


@lru_cache(maxsize=64)
def square_patches(along: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same as `unit_patches` of the square whose area is that of the disc, sides along the axes,
    `along` patches by three, or by as many if they are fewer."""
    side, over = np.sqrt(np.pi), min(along, _OVER)
    steps = [side * ((np.arange(n) + 0.5) / n - 0.5) for n in (along, over)]
    points = np.stack(np.meshgrid(*steps), axis=-1).reshape(-1, 2)
    radius = PATCH * side / np.sqrt(len(points))
    return points, np.full(len(points), 1 / len(points)), np.full(len(points), radius)
