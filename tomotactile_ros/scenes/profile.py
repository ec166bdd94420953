"""How pressure varies inside the outline of a disc: even, of an elastic ball, of a flat punch.

With r the distance from the centre in parts of the disc's radius a, and p the mean pressure
(Johnson, Contact Mechanics, 1985, sections 3.4 and 4.2):

    even    p                         force within r: r^2 of the whole
    hertz   1.5 p sqrt(1 - r^2)                       1 - (1 - r^2)^1.5
    punch   0.5 p / sqrt(1 - r^2)                     1 - (1 - r^2)^0.5

The punch has no finite pressure at its rim; its force within a radius is finite, and so are means
over patches, which is all that is ever used.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

PROFILES = ("even", "hertz", "punch")
_POWER = {"even": 2.0, "hertz": 3.0, "punch": 1.0}  # of sqrt(1 - r^2), in the force outside r
PEAK = {"even": 1.0, "hertz": 1.5, "punch": None}  # in mean pressures; None: no finite one
_RINGS, _STRIP_RINGS, _ANGLES = 128, 4, 256
_ON_RIM = 1 - 1e-9


def force_within(profile: str, r: np.ndarray) -> np.ndarray:
    """Part of the force inside ``r``, distances from the centre in radii, 0 to 1."""
    return 1 - np.maximum(1 - np.square(r), 0.0) ** (_POWER[profile] / 2)


def patch_means(profile: str, points: np.ndarray, areas: np.ndarray, strip: float) -> np.ndarray:
    """(Q,) mean pressure on each patch of a unit disc, in parts of the mean of the disc.

    Parameters
    ----------
    points : (Q, 2) of the patches; those at the distance 1 stand for the strip along the rim.
    areas : (Q,) of the patches; in sum, force is kept.
    strip : width of that strip.
    """
    edges = np.concatenate(
        [np.linspace(0, 1 - strip, _RINGS + 1), np.linspace(1 - strip, 1, _STRIP_RINGS + 1)[1:]]
    )
    area, force = np.diff(edges**2), np.diff(force_within(profile, edges))
    angle = 2 * np.pi * (np.arange(_ANGLES) + 0.5) / _ANGLES
    middle = (edges[1:] + edges[:-1]) / 2
    where = middle[:, None, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    on_rim = np.linalg.norm(points, axis=1) > _ON_RIM
    rim, inner = np.flatnonzero(on_rim), np.flatnonzero(~on_rim)
    owner = np.concatenate(
        [
            inner[cKDTree(points[inner]).query(where[:_RINGS].reshape(-1, 2))[1]],
            rim[cKDTree(points[rim]).query(where[_RINGS:].reshape(-1, 2))[1]],
        ]
    )
    covered = np.bincount(owner, np.repeat(area, _ANGLES), len(points))
    carried = np.bincount(owner, np.repeat(force, _ANGLES), len(points))
    means = np.interp(np.linalg.norm(points, axis=1), middle, force / area)
    np.divide(carried, covered, out=means, where=covered > 0)
    return means * (areas.sum() / (means @ areas))
