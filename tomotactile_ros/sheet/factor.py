"""Cholesky factorisation of a sparse symmetric positive definite matrix by levels.

Breadth-first levels of the matrix graph couple only to their neighbours: the matrix is block tridiagonal,
with dense blocks about as large as the mesh is wide. Everything is then done by LAPACK on whole blocks:
factorisation, many right-hand sides at once, and, which a general sparse solver does not offer, the entries
of the inverse between coupled unknowns (block form of Takahashi, Fagan and Chin 1973) at the price of one
more factorisation.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cholesky, solve_triangular
from scipy.linalg.lapack import dpotri
from scipy.sparse.csgraph import dijkstra

from tomotactile_ros.errors import InputError


class LevelCholesky:
    """Factorisation of `matrix` (CSR, symmetric positive definite), levels starting at `start` (indices).

    Raises InputError where some unknowns are not connected to `start`.
    """

    def __init__(self, matrix, start):
        self.size = matrix.shape[0]
        self.level = _levels(matrix, start)
        order = np.argsort(self.level, kind="stable")
        edges = np.searchsorted(self.level[order], np.arange(1, self.level.max() + 1))
        self.levels = np.split(order, edges)
        self.place = np.empty(self.size, int)
        self.place[order] = np.arange(self.size) - np.repeat(
            [0, *edges], list(map(len, self.levels))
        )
        self._corner = []  # Cholesky factor of each level's block
        self._down = []  # its coupling to the next level, times the inverse transposed factor
        schur = None
        for block, coupling in self._blocks(matrix):
            if schur is not None:
                block -= schur
            corner = cholesky(block, lower=True, check_finite=False, overwrite_a=True)
            self._corner.append(corner)
            if coupling is not None:
                down = solve_triangular(corner, coupling, lower=True, check_finite=False).T
                self._down.append(down)
                schur = down @ down.T

    def _blocks(self, matrix):
        """For each level the dense block of its own and the one to the next level, None for the last."""
        entries = matrix.tocoo()
        first, second = self.level[entries.row], self.level[entries.col]
        sizes = [len(nodes) for nodes in self.levels]
        for step in 0, 1:
            kept = np.flatnonzero(second - first == step)
            kept = kept[np.argsort(first[kept], kind="stable")]
            parts = np.split(kept, np.searchsorted(first[kept], np.arange(1, len(sizes))))
            blocks = []
            for height, width, part in zip(sizes, sizes[step:], parts):
                block = np.zeros((height, width))
                block[self.place[entries.row[part]], self.place[entries.col[part]]] = entries.data[
                    part
                ]
                blocks.append(block)
            if step == 0:
                own = blocks
        return zip(own, [*blocks, None], strict=True)

    def solve(self, right) -> np.ndarray:
        """(N, n) solutions for right-hand sides (N, n)."""
        parts = []
        for i, nodes in enumerate(self.levels):
            part = right[nodes]
            if i:
                part = part - self._down[i - 1] @ parts[-1]
            parts.append(solve_triangular(self._corner[i], part, lower=True, check_finite=False))
        out = np.empty_like(right, dtype=float)
        for i in reversed(range(len(self.levels))):
            part = parts[i]
            if i + 1 < len(self.levels):
                part = part - self._down[i].T @ out[self.levels[i + 1]]
            out[self.levels[i]] = solve_triangular(
                self._corner[i], part, lower=True, trans="T", check_finite=False
            )
        return out

    def inverse_entries(self, rows, columns) -> np.ndarray:
        """(n,) entries of the inverse at (rows, columns), pairs in the same or in neighbouring levels."""
        rows, columns = np.asarray(rows), np.asarray(columns)
        swap = self.level[rows] < self.level[columns]
        rows, columns = np.where(swap, columns, rows), np.where(swap, rows, columns)
        step = self.level[rows] - self.level[columns]
        if step.size and step.max() > 1:
            raise ValueError("entries of the inverse between levels that are not neighbours")
        out = np.empty(len(rows))
        order = np.argsort(self.level[columns], kind="stable")
        edges = np.searchsorted(self.level[columns][order], np.arange(len(self.levels) + 1))
        block = None
        for i in reversed(range(len(self.levels))):
            corner = self._corner[i]
            half = np.tril(dpotri(corner, lower=True)[0])
            inner = half + np.tril(half, -1).T
            if block is not None:
                gain = solve_triangular(
                    corner, self._down[i].T, lower=True, trans="T", check_finite=False
                ).T
                across = -block @ gain
                inner -= gain.T @ across
            wanted = order[edges[i] : edges[i + 1]]
            own, other = wanted[step[wanted] == 0], wanted[step[wanted] == 1]
            out[own] = inner[self.place[rows[own]], self.place[columns[own]]]
            if len(other):
                out[other] = across[self.place[rows[other]], self.place[columns[other]]]
            block = inner
        return out


def _levels(matrix, start):
    """(N,) breadth-first level of each unknown in the matrix graph, counted from those of `start`."""
    steps = dijkstra(abs(matrix), indices=np.unique(start), unweighted=True, min_only=True)
    lost = np.count_nonzero(np.isinf(steps))
    if lost:
        raise InputError(f"outline: {lost} mesh nodes are not connected to the rest")
    return steps.astype(int)
