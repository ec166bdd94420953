"""Factorisation of a sparse symmetric positive definite matrix by levels.

Breadth-first levels of the matrix graph couple only to their neighbours: the matrix is block
tridiagonal, with blocks about as large as the mesh is wide. Block elimination keeps the dense
inverse X of each level's Schur complement; couplings C to the next level stay sparse. The rest is
products of whole blocks: many right-hand sides at once, and, which a general sparse solver does not
offer, the entries of the inverse between coupled unknowns (block form of Takahashi, Fagan and Chin
1973), or between any few.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.linalg.lapack import dpotrf, dpotri
from scipy.sparse.csgraph import dijkstra

from tomotactile_ros.support.errors import InputError


class LevelFactor:
    """Factorisation of `matrix` (CSR, positive definite), levels starting at `start` (indices).

    Raises InputError where some unknowns are not connected to `start`, LinAlgError where the matrix
    is not positive definite.
    """

    def __init__(self, matrix: sparse.csr_matrix, start: ArrayLike):
        level = _levels(matrix, start)
        self._order = np.argsort(level, kind="stable")
        self._place = np.empty(len(level), int)  # of an unknown in this order
        self._place[self._order] = np.arange(len(level))
        edges = np.searchsorted(level[self._order], np.arange(level.max() + 2))
        self._level = level
        self._parts = [slice(*ends) for ends in pairwise(edges)]
        ordered = matrix[self._order][:, self._order]
        self._coupling = [
            ordered[own, after] for own, after in zip(self._parts, self._parts[1:])
        ]  # C of each level
        self._inverse = _own_blocks(ordered, level[self._order], edges)  # X of each level
        for i, block in enumerate(self._inverse):
            if i:
                coupling = self._coupling[i - 1].T
                block -= coupling @ (coupling @ self._inverse[i - 1]).T
            _invert(block)
        self._diagonal: list[np.ndarray] | None = None  # blocks of the inverse, when asked for

    def solve(self, right: np.ndarray) -> np.ndarray:
        """(N, n) solutions for right-hand sides (N, n)."""
        found = right[self._order].astype(float, copy=False)
        parts = [found[part] for part in self._parts]
        steps = list(zip(parts, parts[1:], self._coupling, self._inverse))
        for own, after, coupling, inverse in steps:
            after -= coupling.T @ (inverse @ own)
        parts[-1][:] = self._inverse[-1] @ parts[-1]
        for own, after, coupling, inverse in reversed(steps):
            own[:] = inverse @ (own - coupling @ after)
        return found[self._place]

    def inverse_among(self, unknowns: ArrayLike) -> np.ndarray:
        """(n, n) entries of the inverse between `unknowns` (n,).

        With G the inverse, G_ik = -X_i C_i G_(i+1)k for a level i in front of that of k: from the
        last level to the first, columns of those that have been met.
        """
        unknowns = np.asarray(unknowns)
        out = np.zeros((len(unknowns), len(unknowns)))
        level = self._level[unknowns]
        if self._diagonal is None:
            self._diagonal = list(self._own_inverses())[::-1]
        met, columns = np.empty(0, int), np.empty((0, 0))
        for i in range(level.max(initial=-1), level.min(initial=0) - 1, -1):
            if len(met):
                columns = -self._inverse[i] @ (self._coupling[i] @ columns)
            here = np.flatnonzero(level == i)
            if len(here):
                place = self._place[unknowns[here]] - self._parts[i].start
                own = self._diagonal[i][:, place]
                columns = np.hstack([columns, own]) if len(met) else own
                met = np.concatenate([met, here])
                out[here[:, None], met] = columns[place]
        return np.where(level[:, None] <= level, out, out.T)

    def _own_inverses(self) -> Iterator[np.ndarray]:
        """Block (n, n) of the inverse of each level, from the last to the first."""
        block = self._inverse[-1]
        yield block
        for coupling, inverse in zip(reversed(self._coupling), self._inverse[-2::-1]):
            across = inverse @ (coupling @ block)
            block = inverse + inverse @ (coupling @ across.T)
            yield block

    def inverse_entries(self, rows: ArrayLike, columns: ArrayLike) -> np.ndarray:
        """(n,) entries of the inverse at (rows, columns), in the same or neighbouring levels."""
        rows, columns = np.asarray(rows), np.asarray(columns)
        swap = self._level[rows] < self._level[columns]
        rows, columns = np.where(swap, columns, rows), np.where(swap, rows, columns)
        level = self._level[columns]
        step = self._level[rows] - level
        if step.size and step.max() > 1:
            raise ValueError("entries of the inverse between levels that are not neighbours")
        order = np.lexsort((step, level))
        edges = np.searchsorted(2 * level[order] + step[order], np.arange(2 * len(self._parts) + 1))
        rows, columns = self._place[rows[order]], self._place[columns[order]]
        out = np.empty(len(rows))
        after = None
        for i, block in zip(reversed(range(len(self._parts))), self._own_inverses()):
            first = self._parts[i].start
            own, next_ = (slice(edges[k], edges[k + 1]) for k in (2 * i, 2 * i + 1))
            out[order[own]] = block[rows[own] - first, columns[own] - first]
            if after is not None:
                across = -(self._coupling[i] @ after).T @ self._inverse[i]
                out[order[next_]] = across[
                    rows[next_] - self._parts[i].stop, columns[next_] - first
                ]
            after = block
        return out


def _own_blocks(
    ordered: sparse.csr_matrix, level: np.ndarray, edges: np.ndarray
) -> list[np.ndarray]:
    """The dense block (n, n) of each level, in one piece of memory."""
    entries = ordered.tocoo()
    kept = level[entries.row] == level[entries.col]
    row, column = entries.row[kept], entries.col[kept]
    size, first = np.diff(edges), edges[level[row]]
    starts = np.concatenate([[0], np.cumsum(size**2)])
    memory = np.zeros(starts[-1])
    at = starts[level[row]] + (row - first) * size[level[row]] + column - first
    memory[at] = entries.data[kept]
    return [memory[a:b].reshape(n, n) for (a, b), n in zip(pairwise(starts), size)]


def _invert(block: np.ndarray) -> None:
    """Invert a symmetric positive definite matrix in place; the result is exactly symmetric."""
    lower, failed = dpotrf(block, lower=True)
    if failed:
        raise np.linalg.LinAlgError("the stiffness matrix is not positive definite")
    lower = dpotri(lower, lower=True, overwrite_c=True)[0]
    np.add(lower, lower.T, out=block)
    np.fill_diagonal(block, lower.diagonal())


def _levels(matrix: sparse.csr_matrix, start: ArrayLike) -> np.ndarray:
    """(N,) breadth-first level of each unknown in the matrix graph, that of `start` being 0."""
    steps = dijkstra(abs(matrix), indices=np.unique(start), unweighted=True, min_only=True)
    lost = np.count_nonzero(np.isinf(steps))
    if lost:
        raise InputError(f"outline: {lost} mesh nodes are not connected to the rest")
    return steps.astype(int)
