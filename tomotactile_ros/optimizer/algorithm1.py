"""Electrode positions from the areas of the regions between them.

On a square with as many rows as columns: Algorithm 1 of Kojima et al. 2023, which places the
electrodes of an even N ring by ring from the centre outward. For an odd N the middle row and column
lie on the axes and x(0, j) = 0 takes the place of the mirrored neighbour; everything else is the
same.

For all other grids of R x C electrodes: the smallest displacement of the electrodes that gives the
regions the wanted areas. Those at the corners stay, those on the sides move along the line between
their neighbours there, so that straight sides stay as they are; symmetries of grid and areas are
kept, because the smallest displacement has them.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.evaluation.regions import quadrilaterals

_ITERATIONS = 50
_EXACT = 1e-10  # relative error of the areas


def place_in_rings(areas) -> np.ndarray:
    """Algorithm 1.

    Parameters
    ----------
    areas : (N - 1, N - 1) wanted areas of the regions, m^2; symmetric under the symmetries of the
        square

    Returns
    -------
    (N, N, 2) positions, m, row by row from the lower left. Not checked: a region that is far too
    large for its ring makes electrodes cross.
    """
    count = len(areas) + 1
    half, odd = count // 2, count % 2

    def area(i, j):
        """S(i, j): the region whose upper right corner is electrode (i, j), from the centre."""
        return areas[half + j - 2 + odd, half + i - 2 + odd]

    x, h = np.zeros((half + 1, half + 1)), np.zeros(half + 1)
    for j in range(1, half + 1):
        edge = half - j
        h[j] = np.sqrt(areas[edge : count - 1 - edge, edge : count - 1 - edge].sum()) / 2
        step = h[j] - h[j - 1]
        for i in range(1, j):
            whole = 1 if i == 1 and not odd else 2
            x[i, j] = whole * area(i, j) / step - x[i, j - 1]
            if whole == 2:
                x[i, j] += x[i - 1, j - 1] + x[i - 1, j]
        x[j, j] = h[j]
    return _unfold(x, h, count)


def _unfold(x, h, count):
    """All (N, N, 2) electrodes from x(i, j), i <= j, of one eighth."""
    half, odd = count // 2, count % 2
    steps = np.arange(count) - half + (0 if odd else (np.arange(count) >= half))
    column, row = np.meshgrid(steps, steps)
    i, j = np.abs(column), np.abs(row)
    low, high = np.minimum(i, j), np.maximum(i, j)
    along = x[low, high]
    return np.stack(
        [
            np.sign(column) * np.where(i <= j, along, h[i]),
            np.sign(row) * np.where(i <= j, h[j], along),
        ],
        axis=2,
    )


def place_by_displacement(positions, areas) -> np.ndarray:
    """Move electrodes as little as possible so that the regions get `areas`.

    Parameters
    ----------
    positions : (R, C, 2) grid, m; areas : (R - 1, C - 1), m^2, in proportion to the wanted ones

    Returns
    -------
    (R, C, 2) positions, m: Newton steps of least norm, as many as the areas need. Not checked.
    """
    rows, cols = positions.shape[:2]
    scale = np.sqrt(areas.sum())
    p, wanted = positions / scale, areas.ravel() / areas.sum()
    for _ in range(_ITERATIONS):
        found = quadrilaterals(p, rows, cols).areas
        lack = wanted * found.sum() - found
        if np.abs(lack / wanted).max() < _EXACT or not np.isfinite(lack).all():
            break
        ways = _ways(p)
        gain = _area_derivative(p).reshape(len(lack), -1) @ ways
        p = p + (ways @ np.linalg.lstsq(gain, lack, rcond=1e-9)[0]).reshape(p.shape)
    return p * scale


def _ways(p):
    """(2 R C, n) unit displacements of single electrodes: both axes inside, along the sides there."""
    rows, cols = p.shape[:2]
    ways = []
    for i in range(rows):
        for j in range(cols):
            if 0 < i < rows - 1 and 0 < j < cols - 1:
                directions = np.eye(2)
            elif 0 < j < cols - 1:
                directions = (p[i, j + 1] - p[i, j - 1])[None]
            elif 0 < i < rows - 1:
                directions = (p[i + 1, j] - p[i - 1, j])[None]
            else:
                continue
            for direction in directions:
                way = np.zeros(p.shape)
                way[i, j] = direction / np.linalg.norm(direction)
                ways.append(way.ravel())
    return np.array(ways).reshape(-1, p.size).T


def _area_derivative(p):
    """(M, R, C, 2) derivative of each region's area by each coordinate."""
    rows, cols = p.shape[:2]
    number = np.arange(rows * cols).reshape(rows, cols)
    corners = np.stack([number[:-1, :-1], number[:-1, 1:], number[1:, 1:], number[1:, :-1]], axis=2)
    corners = corners.reshape(-1, 4)
    flat = p.reshape(-1, 2)
    out = np.zeros((len(corners), rows * cols, 2))
    for i in range(4):
        across = flat[corners[:, (i + 1) % 4]] - flat[corners[:, i - 1]]
        out[np.arange(len(corners)), corners[:, i]] = (
            np.column_stack([across[:, 1], -across[:, 0]]) / 2
        )
    return out.reshape(len(corners), rows, cols, 2)
