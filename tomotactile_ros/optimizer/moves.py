"""Smooth moves of all electrodes together, from coarse to fine.

A move is a field of displacements at the electrodes. The coarsest are polynomials of low degree in
x and y: the scale of the whole, then how it is drawn outward or inward in the middle, near the rim,
along the diagonals. They are symmetrised, made orthogonal to all before them, and sorted by degree,
so that the first few serve a quick search for any number of electrodes on any outline, and all of
them together are every move that keeps the symmetries.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tomotactile_ros.optimizer.orbits import find_orbits, maps_onto

_DEGREE = 20  # polynomials of higher degree are alike at the electrodes
_NEW = 1e-4  # part of a field that the moves before it do not have


def keeps_fixed(group: np.ndarray, positions: np.ndarray, fixed: Sequence[int]) -> np.ndarray:
    """Those of `group` (g, 2, 2) that map the fixed electrodes of `positions` (E, 2) onto fixed
    ones: others would ask for mirror images of what cannot move."""
    held, close = positions[list(fixed)], 1e-6 * np.abs(positions).max()
    return np.array([each for each in group if maps_onto(held, each, close)])


def smooth_moves(
    positions: np.ndarray,
    group: np.ndarray,
    most: int,
    fixed: Sequence[int] = (),
) -> np.ndarray:
    """(K, E, 2) at most `most` moves, each of root mean square 1 over the electrodes.

    Parameters
    ----------
    positions : (E, 2), m, with the symmetries `group` (g, 2, 2)
    fixed : electrodes that do not move
    """
    matrix = find_orbits(positions, group).matrix
    held = np.zeros(2 * len(positions), bool)
    for electrode in fixed:
        held[2 * electrode : 2 * electrode + 2] = True
    matrix = matrix[:, ~(matrix[held] != 0).any(axis=0)]
    if not matrix.shape[1]:
        return np.empty((0, len(positions), 2))
    allowed, _ = np.linalg.qr(matrix)
    x, y = (positions / np.abs(positions).max()).T
    found: list[np.ndarray] = []
    for degree in range(_DEGREE + 1):
        for power in range(degree + 1):
            for axis in range(2):
                field = np.zeros((len(positions), 2))
                field[:, axis] = x ** (degree - power) * y**power
                whole = field.ravel()
                move = allowed @ (allowed.T @ whole)
                for before in found:
                    move = move - (before @ move) * before
                length = np.linalg.norm(move)
                if length > _NEW * np.linalg.norm(whole):
                    found.append(move / length)
                if len(found) == min(most, allowed.shape[1]):
                    return _shaped(found, positions)
    return _shaped(found, positions)


def _shaped(moves, positions):
    return np.sqrt(len(positions)) * np.array(moves).reshape(-1, *positions.shape)
