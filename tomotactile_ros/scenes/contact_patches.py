"""Patches of a contact: points on its rim and inside, each as good as a disc around it.

A good conductor feeds the sheet from its rim, a poor one evenly: with both, the same patches serve
every conductance. Points on the rim at the distance d stand for a line, and a line of charge d long
for a disc of radius d / (2 pi). A cell inside stands for the disc whose mean ln |x| to its centre
is the cell's.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

_CELL_RADIUS = math.exp(-0.5) / math.sqrt(math.pi)  # of a cell's disc, times sqrt(area)
STRIP = 1 / 16  # width of the strip that the points on a rim stand for, in parts of their spacing
_CORNER = 0.2  # rad, turns of a rim that patches keep apart


def disc_rim(spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (P, 2) on the unit circle, symmetric, and the length (P,) of each."""
    count = 4 * math.ceil(2 * np.pi / spacing / 4)
    angle = 2 * np.pi * (np.arange(count) + 0.5) / count
    return np.column_stack([np.cos(angle), np.sin(angle)]), np.full(count, 2 * np.pi / count)


def rim_of(vertices: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Points (P, 2) along a closed line, even between corners, and the length (P,) of each, m."""
    into, out = vertices - np.roll(vertices, 1, axis=0), np.roll(vertices, -1, axis=0) - vertices
    turn = np.abs(np.arctan2(into[:, 0] * out[:, 1] - into[:, 1] * out[:, 0], (into * out).sum(1)))
    corners = np.flatnonzero(turn > _CORNER)
    if not len(corners):
        corners = np.array([0])
    points, lengths = [], []
    for start, end in zip(corners, np.roll(corners, -1)):
        count = (end - start) % len(vertices) or len(vertices)
        piece = vertices[(start + np.arange(count + 1)) % len(vertices)]
        at = np.concatenate([[0], np.cumsum(np.linalg.norm(np.diff(piece, axis=0), axis=1))])
        parts = max(1, math.ceil(at[-1] / spacing))
        middle = (np.arange(parts) + 0.5) * at[-1] / parts
        points.append(np.column_stack([np.interp(middle, at, piece[:, i]) for i in range(2)]))
        lengths.append(np.full(parts, at[-1] / parts))
    return np.concatenate(points), np.concatenate(lengths)


def join(
    rim: np.ndarray, lengths: np.ndarray, cells: np.ndarray, areas: np.ndarray, spacing: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Patches of a rim (P, 2) and of cells (C, 2): what a strip along the rim covers is its own.

    Parameters
    ----------
    lengths : (P,) of the rim that each point stands for, m.
    areas : (C,) of the cells, m².
    spacing : between the points of the rim, m.

    Returns
    -------
    points : (P + C, 2) m; areas : (P + C,) m², with the sum of ``areas``; radii : (P + C,) m.
    """
    strips = lengths * spacing * STRIP
    taken = np.bincount(cKDTree(cells).query(rim)[1], strips, len(cells))
    weights = np.concatenate([strips, np.maximum(areas - taken, 0.0)])
    radii = np.concatenate([lengths / (2 * np.pi), _CELL_RADIUS * np.sqrt(areas)])
    return np.concatenate([rim, cells]), weights * (areas.sum() / weights.sum()), radii
