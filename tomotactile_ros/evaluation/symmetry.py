"""Symmetries of a sheet with its electrodes, and the bases in which symmetric matrices fall apart.

The elements are the mirrors of x and of y (or only both together: the half turn) and, on a square,
the swap of x and y. A matrix over the pixels that commutes with them is block diagonal in the basis
of images that are even or odd under each mirror (even-even, even-odd, odd-even, odd-odd). Where the
swap is a symmetry too, even-even and odd-odd split again into images that are even or odd under it,
and odd-even repeats the block of even-odd.

An image of such a basis belongs to one pixel: it is +1 or -1 at every pixel where the elements send
that one, over the root of their number. Blocks are therefore sums of parts of the matrix.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial import cKDTree

from tomotactile_ros.layouts.grid import Grid

_CLOSE = 1e-9  # of the outline's size: positions that coincide
_PAIR = np.array([1, 1, -1, -1])  # signs under the mirrors: even in x, odd in y
_SIGNS = {  # of the blocks that occur once, by the number of elements
    1: np.array([[1]]),
    2: np.array([[1, 1], [1, -1]]),
    4: np.array([[1, 1, 1, 1], _PAIR, [1, -1, 1, -1], [1, -1, -1, 1]]),
    8: np.array([[1, x, x, 1, s, s * x, s * x, s] for x in (1, -1) for s in (1, -1)]),
}


@dataclass(frozen=True, eq=False)
class Symmetry:
    """Symmetries that a set of pixels and a set of electrodes have in common.

    pixels      (g, K) where each element of the group sends each pixel, the identity first
    electrodes  (g, E) the same for the electrodes
    """

    pixels: np.ndarray
    electrodes: np.ndarray

    @cached_property
    def first(self) -> np.ndarray:
        """(n,) pixels that stand for all others."""
        return np.unique(self.pixels.min(axis=0))

    @cached_property
    def orbit(self) -> np.ndarray:
        """(K,) index into `first` of the pixel that stands for each."""
        return np.searchsorted(self.first, self.pixels.min(axis=0))

    @cached_property
    def sizes(self) -> np.ndarray:
        """(n,) how many pixels each of `first` stands for."""
        return np.bincount(self.orbit)

    @cached_property
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

    @cached_property
    def multiplicities(self) -> list[int]:
        """How often each block occurs."""
        return [1] * len(self._single) + [2] * (self._pair is not None)

    def split(self, rows) -> list[np.ndarray]:
        """Blocks (d, d) of a symmetric matrix from its rows `first` (n, K)."""
        parts = [rows[:, element[self.first]] for element in self.pixels]
        out = []
        for signs, kept, root in self._single:
            block = sum(sign * part for sign, part in zip(signs, parts))
            out.append(block[np.ix_(kept, kept)] / (root[:, None] * root))
        return out if self._pair is None else [*out, self._pair.split(rows)]

    def join(self, blocks) -> np.ndarray:
        """(K, n) columns `first` of the matrix that has these `blocks`."""
        parts = np.zeros((len(self._single), len(self.first), len(self.first)))
        for part, (_, kept, root), block in zip(parts, self._single, blocks):
            part[np.ix_(kept, kept)] = block * (root[:, None] * root / len(self.pixels))
        out = np.empty((self.pixels.shape[1], len(self.first)))
        for i, element in enumerate(self.pixels):
            out[element[self.first]] = sum(
                signs[i] * part for part, (signs, _, _) in zip(parts, self._single)
            )
        if self._pair is not None:
            self._pair.add(blocks[-1], out)
        return out

    @cached_property
    def _single(self):
        """Signs (g,), indices (d,) into `first`, and roots (d,) of the stabilizers, of each
        block."""
        found = [
            (signs, *_basis(self.pixels, signs, self.first)) for signs in _SIGNS[len(self.pixels)]
        ]
        return [each for each in found if len(each[1])]

    @cached_property
    def _pair(self):
        return _Pair(self) if len(self.pixels) == 8 else None


class _Pair:
    """The block of images even in x and odd in y, which occurs again with x and y swapped."""

    def __init__(self, symmetry: Symmetry):
        pixels, first = symmetry.pixels, symmetry.first
        mirrors, swap = pixels[:4], pixels[4]
        representative = mirrors.min(axis=0)
        rows = np.unique(representative)
        kept, self._root = _basis(mirrors, _PAIR, rows)
        rows = rows[kept]
        self._sources = []  # places, the rows `first` they come from, and columns for each mirror
        source = symmetry.orbit[rows]
        left = np.full(len(rows), True)
        for element in pixels:
            place = np.flatnonzero(left & (element[first[source]] == rows))
            left[place] = False
            self._sources.append((place, source[place], np.argsort(element)[mirrors[:, rows]]))
        self._copies = []  # rows for each mirror, and for each column its place and sign
        for moved in (pixels[0], swap):
            column = moved[first]
            place = np.searchsorted(rows, representative[column]).clip(max=len(rows) - 1)
            sign = np.where(mirrors[:, rows[place]] == column, _PAIR[:, None], 0)
            self._copies.append((moved[mirrors[:, rows]], place, np.sign(sign.sum(axis=0))))

    def split(self, rows):
        """The block (d, d) of a symmetric matrix from its rows `first` (n, K)."""
        out = np.empty((len(self._root), len(self._root)))
        for place, source, columns in self._sources:
            values = rows[source]
            out[place] = sum(sign * values[:, column] for sign, column in zip(_PAIR, columns))
        return out / (self._root[:, None] * self._root)

    def add(self, block, out):
        """Add what the block gives to the columns `first` (K, n)."""
        block = block * (self._root / self._root[:, None] / 4)
        for rows, place, sign in self._copies:
            part = block[:, place] * sign
            for even, row in zip(_PAIR, rows):
                out[row] += even * part


def find_symmetry(grid: Grid, positions) -> Symmetry:
    """The symmetries that the cells inside the outline share with the `positions` (E, 2)."""
    number = np.full(grid.shape, -1)
    number[grid.inside] = np.arange(np.count_nonzero(grid.inside))
    positions = np.asarray(positions, float)
    group = [(np.arange(np.count_nonzero(grid.inside)), np.arange(len(positions)))]
    for sign, view in (
        ((-1, 1), np.s_[:, ::-1]),
        ((1, -1), np.s_[::-1]),
        ((-1, -1), np.s_[::-1, ::-1]),
    ):
        moved = _move(grid, number[view], number, positions, positions * sign)
        group += [moved] if moved else []
    if len(group) == 4 and grid.height == grid.width and np.ptp(grid.outline.size) < _CLOSE:
        swap = _move(grid, number.T[::-1, ::-1], number, positions, positions[:, ::-1])
        if swap:
            group += [(swap[0][pixels], swap[1][electrodes]) for pixels, electrodes in group]
    return Symmetry(*(np.array(each) for each in zip(*group)))


def _move(grid, moved, number, positions, images):
    """Permutations of the pixels and the electrodes, or None where there are none."""
    if not np.array_equal(moved >= 0, number >= 0):
        return None
    distance, electrode = cKDTree(positions).query(images)
    if distance.max() > _CLOSE * max(grid.outline.size):
        return None
    return moved[number >= 0], electrode


def _basis(pixels, signs, rows):
    """Which of `rows` have an image with these signs, and the root of their stabilizers' size."""
    stays = pixels[:, rows] == rows
    total = signs @ stays
    kept = np.flatnonzero(total)
    return kept, np.sqrt(stays.sum(axis=0)[kept])
