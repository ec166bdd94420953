"""The rim of an outline as smooth pieces, and where each meets circles of one radius."""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.layouts.outline import Outline


class Segment:
    """A straight piece of a rim, t in [0, 1]."""

    def __init__(self, start: np.ndarray, end: np.ndarray) -> None:
        self.start, self.way = start, end - start
        self.length = np.linalg.norm(self.way)

    def __call__(self, t: ArrayLike) -> np.ndarray:
        return self.start + np.multiply.outer(t, self.way)

    def crossings(self, centres: np.ndarray, radius: float) -> np.ndarray:
        """Where the line meets circles: |start + t way - centre| = radius."""
        to_start = self.start - centres
        half = to_start @ self.way / self.length**2
        square = half**2 - ((to_start**2).sum(axis=1) - radius**2) / self.length**2
        root = np.sqrt(square[square > 0])
        return np.concatenate([-half[square > 0] - root, -half[square > 0] + root])


class Arc:
    """A quarter of a circle around the origin, t in [0, 1]."""

    def __init__(self, radius: float, quarter: int) -> None:
        self.radius, self.first = radius, quarter * np.pi / 2
        self.length = radius * np.pi / 2

    def __call__(self, t: ArrayLike) -> np.ndarray:
        angle = self.first + np.pi / 2 * np.asarray(t)
        return self.radius * np.stack([np.cos(angle), np.sin(angle)], axis=-1)

    def crossings(self, centres: np.ndarray, radius: float) -> np.ndarray:
        """Where the arc meets circles, by the law of cosines."""
        apart = np.linalg.norm(centres, axis=1)
        centres, apart = centres[apart > 0], apart[apart > 0]
        cosine = (self.radius**2 + apart**2 - radius**2) / (2 * self.radius * apart)
        met = np.abs(cosine) < 1
        middle = np.arctan2(centres[met, 1], centres[met, 0])
        half = np.arccos(cosine[met])
        angle = np.concatenate([middle - half, middle + half]) - self.first
        return (angle + np.pi) % (2 * np.pi) / (np.pi / 2) - 2


def curves(outline: Outline) -> list[Segment | Arc]:
    """The rim of `outline` as segments and arcs, holes included."""
    polygons = list(outline.holes)
    found: list[Segment | Arc] = []
    if outline.kind == "circle":
        found = [Arc(outline.radius, quarter) for quarter in range(4)]
    else:
        polygons.append(outline.shell)
    for polygon in polygons:
        found += [Segment(p, q) for p, q in zip(polygon, np.roll(polygon, -1, axis=0))]
    return found
