"""Symmetries of a sheet with its electrodes, and the bases in which symmetric matrices fall apart.

The elements are the mirrors of x and of y (or only both together: the half turn) and, on a square,
the swap of x and y. A matrix over the pixels that commutes with them is block diagonal in the basis
of images that are even or odd under each mirror (even-even, even-odd, odd-even, odd-odd). Where the
swap is a symmetry too, even-even and odd-odd split again into images that are even or odd under it,
and odd-even repeats the block of even-odd.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from tomotactile_ros.grid import Grid

_CLOSE = 1e-9  # of the outline's size: positions that coincide


@dataclass(frozen=True, eq=False)
class Block:
    """One block: orthonormal `bases` (K, d), as many as it occurs, and the `rows` it is taken from.

    A block of A is A[rows] @ bases[0] / scale[:, None].
    """

    bases: tuple[sparse.csr_matrix, ...]
    rows: np.ndarray
    scale: np.ndarray


@dataclass(frozen=True, eq=False)
class Symmetry:
    """Symmetries that a set of pixels and a set of electrodes have in common.

    pixels      (g, K) where each element of the group sends each pixel, the identity first
    electrodes  (g, E) the same for the electrodes
    first       (n,) pixels that stand for all others
    orbit       (K,) index into `first` of the pixel that stands for each
    quarter     (m,) pixels that stand for all others under the mirrors alone
    blocks      of matrices over the pixels that have the symmetry
    """

    pixels: np.ndarray
    electrodes: np.ndarray
    first: np.ndarray
    orbit: np.ndarray
    quarter: np.ndarray
    blocks: tuple[Block, ...]

    @property
    def sizes(self) -> np.ndarray:
        """(n,) how many pixels each of `first` stands for."""
        return np.bincount(self.orbit)

    @property
    def kinds(self) -> np.ndarray:
        """(m,) electrodes that stand for all others."""
        return np.unique(self.electrodes.min(axis=0))

    def spread(self, values, moved) -> np.ndarray:
        """(E, n) rows of all electrodes from those of `kinds` (m, n).

        moved : (g, n) where each element sends each column
        """
        out = np.empty((self.electrodes.shape[1], values.shape[1]))
        for electrodes, columns in zip(self.electrodes, moved):
            out[np.ix_(electrodes[self.kinds], columns)] = values
        return out

    def quarter_rows(self, rows) -> np.ndarray:
        """(m, K) rows `quarter` of a symmetric matrix from its rows `first` (n, K)."""
        out = np.empty((len(self.quarter), rows.shape[1]))
        left = np.full(len(self.quarter), True)
        for element in self.pixels:
            here = np.flatnonzero(left & np.isin(self.quarter, element[self.first]))
            source = np.empty(len(element), int)
            source[element] = np.arange(len(element))  # inverse
            out[here] = rows[self.orbit[self.quarter[here]]][:, source]
            left[here] = False
        return out

    def split(self, rows) -> list[np.ndarray]:
        """Blocks (d, d) of a symmetric matrix from its rows `quarter` (m, K)."""
        place = {pixel: i for i, pixel in enumerate(self.quarter)}
        return [
            (block.bases[0].T @ rows[[place[row] for row in block.rows]].T).T / block.scale[:, None]
            for block in self.blocks
        ]

    def join(self, blocks, columns) -> np.ndarray:
        """(K, n) the `columns` of the matrix that has these `blocks`."""
        out = np.zeros((len(self.orbit), len(columns)))
        for block, values in zip(self.blocks, blocks):
            for basis in block.bases:
                out += basis @ (basis[columns] @ values.T).T
        return out


def find_symmetry(grid: Grid, positions) -> Symmetry:
    """The symmetries that the cells inside the outline share with the `positions` (E, 2)."""
    number = np.full(grid.shape, -1)
    number[grid.inside] = np.arange(np.count_nonzero(grid.inside))
    positions = np.asarray(positions, float)
    moved = [
        _move(grid, number[view], number, positions, positions * sign)
        for sign, view in (
            ((-1, 1), np.s_[:, ::-1]),
            ((1, -1), np.s_[::-1]),
            ((-1, -1), np.s_[::-1, ::-1]),
        )
    ]
    identity = (np.arange(np.count_nonzero(grid.inside)), np.arange(len(positions)))
    swap = None
    if moved[0] and moved[1]:
        if grid.height == grid.width and np.ptp(grid.outline.size) < _CLOSE:
            swap = _move(grid, number.T[::-1, ::-1], number, positions, positions[:, ::-1])
    elif moved[2]:
        return _build(identity, moved[2], identity, None)
    return _build(identity, moved[0] or identity, moved[1] or identity, swap)


def _move(grid, moved, number, positions, images):
    """Permutations of the pixels and the electrodes, or None where there are none."""
    if not np.array_equal(moved >= 0, number >= 0):
        return None
    distance, electrode = cKDTree(positions).query(images)
    if distance.max() > _CLOSE * max(grid.outline.size):
        return None
    return moved[number >= 0], electrode


def _build(identity, mirror_x, mirror_y, swap):
    def after(one, other):
        return one[0][other[0]], one[1][other[1]]

    four = [identity, mirror_x, mirror_y, after(mirror_x, mirror_y)]
    group = four + ([after(swap, each) for each in four] if swap else [])
    pixels = np.array([each[0] for each in group])
    first, orbit = np.unique(pixels.min(axis=0), return_inverse=True)
    quarter = np.unique(pixels[:4].min(axis=0))
    blocks = []
    characters = {}
    for x in (1, -1):
        for y in (1, -1):
            sign = np.array([1, x, y, x * y])
            characters[x, y] = _basis(pixels[:4], sign, quarter)
    if not swap:
        for basis, rows in characters.values():
            blocks.append(_block(rows, basis))
        return _symmetry(group, pixels, first, orbit, quarter, blocks)
    for x in (1, -1):
        for s in (1, -1):
            sign = np.array([1, x, x, 1, s, s * x, s * x, s])
            blocks.append(_block(*_basis(pixels, sign, first)[::-1]))
    basis, rows = characters[1, -1]
    blocks.append(_block(rows, basis, basis[swap[0]]))
    return _symmetry(group, pixels, first, orbit, quarter, blocks)


def _symmetry(group, pixels, first, orbit, quarter, blocks):
    electrodes = np.array([each[1] for each in group])
    kept = tuple(block for block in blocks if len(block.rows))
    return Symmetry(pixels, electrodes, first, orbit, quarter, kept)


def _basis(pixels, sign, first):
    """Orthonormal images with these characters, from those pixels `first` that have one."""
    count = pixels.shape[1]
    columns = np.tile(np.arange(len(first)), len(pixels))
    values = np.repeat(sign, len(first)).astype(float)
    basis = sparse.csr_matrix((values, (pixels[:, first].ravel(), columns)), (count, len(first)))
    norm = np.sqrt(np.asarray(basis.multiply(basis).sum(axis=0)).ravel())
    kept = np.flatnonzero(norm > 0)
    basis = (basis[:, kept] @ sparse.diags(1 / norm[kept])).tocsr()
    basis.eliminate_zeros()
    return basis, first[kept]


def _block(rows, *bases):
    scale = np.asarray(bases[0][rows, np.arange(len(rows))]).ravel()
    return Block(tuple(bases), rows, scale)
