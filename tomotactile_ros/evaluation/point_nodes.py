"""The finite elements that Kojima et al. (2023) describe: electrodes and contacts are single nodes.

"The detection area was divided into a 40 x 40 triangular mesh" by Delaunay triangulation with the
electrodes among the nodes; their size "is negligible". The article leaves open where the other
nodes are. Here they are the centres of the cells of an image, where contacts are put (eq. 2: a
potential for each node), and points of the rim as far from each other. Everything is at 1 ohm/sq,
which J does not depend on.

A current that enters at one node of linear triangles meets the resistance of the mesh there, not of
a disc: contacts and electrodes act as large as elements are.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import Delaunay

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.sheet.transfer import Transfer, make_transfer
from tomotactile_ros.sheet.triangles import corner_angles, links, stiffness

_SAME = 1e-6  # of a cell: nodes as close as this are one
_FLAT = 1e-6  # of a cell's area: triangles between nodes on a straight rim


def point_nodes_transfer(layout: Layout, grid: Grid) -> Transfer:
    """`Transfer` to contacts at the pixels of `grid`, all of them nodes of one mesh.

    A contact at the place of an electrode is that electrode.
    """
    cell = min(grid.cell_size)
    nodes, electrodes = _nodes(layout, grid, cell)
    triangles = _triangles(layout, nodes, cell)
    cotangents, _ = corner_angles(nodes, triangles)
    ends, conductance = links(triangles, cotangents, np.ones(len(triangles)))
    matrix = stiffness(ends, conductance, len(nodes)).toarray()
    green = np.zeros(matrix.shape)
    green[1:, 1:] = np.linalg.inv(matrix[1:, 1:])  # node 0 is held at 0 V, see `transfer`
    pixels = np.arange(len(grid.pixels))
    owner = np.full(len(pixels), -1)
    covered = electrodes < len(pixels)
    owner[electrodes[covered]] = np.flatnonzero(covered)
    return make_transfer(
        "point_nodes",
        grid.pixels,
        owner,
        green[np.ix_(electrodes, electrodes)],
        green[np.ix_(electrodes, pixels)],
        np.diagonal(green)[pixels].copy(),
        lambda i, j: green[np.ix_(np.asarray(i), np.asarray(j))],
    )


def _nodes(layout, grid, cell):
    """All nodes (M, 2), first the pixels, and which of them are the electrodes (E,)."""
    rim = [grid.pixels]
    for ring in (layout.outline.shell, *layout.outline.holes):
        for start, end in zip(ring, np.roll(ring, -1, axis=0)):
            pieces = max(1, round(np.linalg.norm(end - start) / cell))
            rim.append(start + (end - start) * np.arange(pieces)[:, None] / pieces)
    nodes = np.concatenate(rim)
    apart = np.linalg.norm(nodes[:, None] - layout.positions, axis=2)
    nearest = apart.argmin(axis=0)
    new = apart.min(axis=0) > _SAME * cell
    electrodes = np.where(new, len(nodes) + np.cumsum(new) - 1, nearest)
    return np.concatenate([nodes, layout.positions[new]]), electrodes


def _triangles(layout, nodes, cell):
    """(T, 3) counter-clockwise triangles on the sheet."""
    triangles = Delaunay(nodes).simplices
    a, b, c = nodes[triangles].transpose(1, 0, 2)
    area = ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]) / 2
    triangles[area < 0] = triangles[area < 0][:, ::-1]
    inside = layout.outline.contains(nodes[triangles].mean(axis=1))
    return triangles[inside & (np.abs(area) > _FLAT * cell**2)]
