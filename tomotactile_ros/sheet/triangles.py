"""Linear triangles: what they conduct between their nodes, and the stiffness matrix of it all.

A triangle of conductance s conducts s cot(a) / 2 siemens between two of its nodes, a being its
angle at the third. All of it, triangle by triangle, is the list of *links* of a mesh.
"""

from __future__ import annotations

import numpy as np
from scipy import sparse


def corner_angles(points: np.ndarray, triangles: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Cotangents and angles (T, 3) at the corners of each triangle."""
    x, y = points[triangles, 0], points[triangles, 1]
    ux, uy = x[:, [1, 2, 0]] - x, y[:, [1, 2, 0]] - y
    vx, vy = x[:, [2, 0, 1]] - x, y[:, [2, 0, 1]] - y
    along, across = ux * vx + uy * vy, ux * vy - uy * vx
    return along / across, np.arctan2(across, along)


def links(
    triangles: np.ndarray, cotangents: np.ndarray, conductance: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Nodes at both ends (2, n) and S (n,) of all links; `conductance` (T,) is S per square."""
    ends = np.stack([triangles[:, [1, 2, 0]].ravel(), triangles[:, [2, 0, 1]].ravel()])
    return ends, (conductance[:, None] / 2 * cotangents).ravel()


def at_ends(ends: np.ndarray, values: np.ndarray, count: int) -> np.ndarray:
    """(count,) sum of the `values` (n,) of the links that end at each node."""
    return np.bincount(ends.ravel(), np.tile(values, 2), count)


def stiffness(ends: np.ndarray, conductance: np.ndarray, count: int) -> sparse.csr_matrix:
    """(count, count) matrix of links, with an entry even where one conducts nothing."""
    apart = ends[0] != ends[1]
    (first, second), conductance = ends[:, apart], conductance[apart]
    own = np.arange(count)
    rows, columns = np.concatenate([first, second, own]), np.concatenate([second, first, own])
    diagonal = at_ends(ends[:, apart], conductance, count)
    values = np.concatenate([-conductance, -conductance, diagonal])
    return sparse.coo_matrix((values, (rows, columns)), (count, count)).tocsr()
