"""Electrode positions as few free parameters: whole orbits of a symmetry group move together.

An electrode that no symmetry maps onto itself has two parameters; one on an axis or a diagonal has
one and stays on it; one in the centre has none. Positions are linear in the parameters.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.layouts.region import Region

MIRRORS = np.array([[[1, 0], [0, 1]], [[-1, 0], [0, 1]], [[1, 0], [0, -1]], [[-1, 0], [0, -1]]])
SWAP = np.array([[0, 1], [1, 0]])
_CLOSE = 1e-6  # of the outline's size


@dataclass(frozen=True, eq=False)
class Orbits:
    """positions = (matrix @ parameters) as (E, 2); matrix (2 E, n)."""

    matrix: np.ndarray

    def positions(self, parameters) -> np.ndarray:
        """(E, 2), m."""
        return (self.matrix @ parameters).reshape(-1, 2)

    def parameters(self, positions) -> np.ndarray:
        """(n,) of positions that have the symmetry."""
        return np.linalg.lstsq(self.matrix, np.ravel(positions), rcond=None)[0]


def shared_group(
    outline: Outline, positions: np.ndarray, zones: Sequence[Region] = ()
) -> np.ndarray:
    """(g, 2, 2) mirrors of x and y, and swaps, that outline, electrodes (E, 2) and zones share."""

    sets = [np.asarray(positions, float)]  # of points, of zones the corners
    if zones:
        sets.append(np.concatenate([zone.shell for zone in zones]))

    def shared(element):
        near = _CLOSE * max(outline.size)
        return all(maps_onto(each, element, near) for each in sets) and _rim_stays(outline, element)

    group = [each for each in MIRRORS if shared(each)]
    if len(group) == 4 and shared(SWAP):
        group += [SWAP @ each for each in group]
    return np.array(group)


def find_orbits(positions, group) -> Orbits:
    """Orbits of electrodes at `positions` (E, 2) under `group` (g, 2, 2).

    Raises ValueError where the positions do not have the symmetry.
    """
    positions = np.asarray(positions, float)
    close = _CLOSE * np.abs(positions).max()
    count = len(positions)
    images = np.einsum("gij,ej->gei", group, positions)
    distance = np.linalg.norm(images[:, :, None] - positions, axis=3)  # (g, E, E)
    target = distance.argmin(axis=2)
    if np.take_along_axis(distance, target[..., None], 2).max() > close:
        raise ValueError("positions do not have the symmetry")
    columns = []
    left = np.full(count, True)
    for electrode in range(count):
        if not left[electrode]:
            continue
        stays = group[target[:, electrode] == electrode].mean(axis=0)  # projector on what is free
        left[target[:, electrode]] = False
        values, vectors = np.linalg.eigh((stays + stays.T) / 2)
        for direction in vectors[:, values > 0.5].T:
            column = np.zeros((count, 2))
            column[target[:, electrode]] = group @ direction
            columns.append(column.ravel())
    return Orbits(np.array(columns).reshape(-1, 2 * count).T)


def maps_onto(points: np.ndarray, element: np.ndarray, close: float) -> bool:
    """Whether an element maps `points` (n, 2) onto each other, within `close` (m)."""
    away = cKDTree(points).query(points @ element.T)[0] if len(points) else np.zeros(1)
    return bool(away.max() < close)


def _rim_stays(outline, element):
    rings = [outline.shell, *outline.holes]
    points = np.concatenate([*rings, *((ring + np.roll(ring, 1, axis=0)) / 2 for ring in rings)])
    moved = outline.rim_distance(points @ element.T)
    return np.abs(moved - outline.rim_distance(points)).max() < _CLOSE * max(outline.size)
