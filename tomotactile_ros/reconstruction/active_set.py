"""Non-negative least squares by active sets that start from a guess.

    min over x >= 0 of  x^T Q x / 2 - q^T x

The pixels that carry something (the passive set) are found by exchange, and the fewer are wrong at
the start, the fewer linear systems are solved: the solution of the last frame is a good start for
contacts that move slowly. The minimum does not depend on it.

`exchange` swaps all pixels at once that are on the wrong side (block principal pivoting, Portugal,
Judice and Vicente 1994): a few steps for wide contacts, but it may cycle where Q is nearly
singular. `descend` (Lawson and Hanson 1974) adds one pixel at a time, never leaves x >= 0 and
always ends.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import lapack

_EXACT = 1e-9  # of the largest gradient: what is below is zero
_REGULAR = 1e-11  # of the mean of Q's diagonal, added to it
_PATIENCE = 3  # exchanges in a row that may bring no gain
_MOST_STEPS = 3  # of `descend`, times the number of unknowns


@dataclass
class Memory:
    """Solution (K,) of the last frame, None before the first, and the linear systems that
    `minimise` solved for it."""

    values: np.ndarray | None = None
    steps: int = 0

    def recall(self, active: np.ndarray) -> np.ndarray | None:
        """(n,) the solution at the pixels `active`, None where most of it lay elsewhere."""
        if self.values is None:
            return None
        start = self.values[active]
        return start if 2 * start.sum() >= self.values.sum() else None


def minimise(
    gram: np.ndarray, right: np.ndarray, start: np.ndarray, blocks: bool
) -> tuple[np.ndarray, int]:
    """x (n,) >= 0, and the number of linear systems solved for it.

    Parameters
    ----------
    gram, right : Q (n, n) and q (n,)
    start : (n,) >= 0
    blocks : try exchanges of many at once first; for wide contacts
    """
    gram = gram + _REGULAR * gram.trace() / len(gram) * np.eye(len(gram))
    exchanges = 0
    if blocks:
        values, exchanges = exchange(gram, right, start > 0)
        if values is not None:
            return values, exchanges
    values, steps = descend(gram, right, start)
    return values, exchanges + steps


def exchange(gram, right, passive) -> tuple[np.ndarray | None, int]:
    """x (n,), None where exchanges bring no gain, from the set `passive` (n,) bool; the number of
    steps."""
    least = _EXACT * float(np.abs(right).max(initial=0.0))
    best, patience, steps = len(right) + 1, _PATIENCE, 0
    while patience:
        steps += 1
        values = _solved(gram, right, np.flatnonzero(passive))
        if values is None:
            break
        wrong = np.where(passive, values < 0, right - gram @ values > least)
        count = np.count_nonzero(wrong)
        if not count:
            return values, steps
        patience = _PATIENCE if count < best else patience - 1
        best = min(best, count)
        passive = passive ^ wrong
    return None, steps


def descend(gram, right, start) -> tuple[np.ndarray, int]:
    """x (n,) from a feasible `start` (n,), and the number of steps."""
    least = _EXACT * float(np.abs(right).max(initial=0.0))
    values, passive = np.array(start, float), start > 0
    steps = 0
    while steps < _MOST_STEPS * len(right):
        while passive.any():
            steps += 1
            wanted = _solved(gram, right, np.flatnonzero(passive))
            if wanted is None:
                return values, steps
            below = passive & (wanted <= 0)
            if not below.any():
                values = wanted
                break
            way = values[below] / np.maximum(values[below] - wanted[below], 1e-300)
            values = np.maximum(values + way.min() * (wanted - values), 0.0)
            values[np.flatnonzero(below)[way <= way.min()]] = 0.0
            passive = values > 0
        upwards = np.where(passive, -np.inf, right - gram @ values)
        added = int(upwards.argmax()) if len(upwards) else 0
        if not len(upwards) or upwards[added] <= least:
            break
        passive[added] = True
    return values, steps


def _solved(gram, right, chosen):
    """(n,) minimum in the unknowns `chosen` (m,), 0 elsewhere; None where Q is singular there."""
    values = np.zeros(len(right))
    if len(chosen):
        found = lapack.dposv(gram[np.ix_(chosen, chosen)], right[chosen], lower=1)
        if found[2]:
            return None
        values[chosen] = found[1].ravel()
    return values
