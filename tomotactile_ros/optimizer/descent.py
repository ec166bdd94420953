"""Two searches that keep their whole state in small objects, so that they can be sent and kept.

`Descending` follows a gradient that jumps a little (contacts change the pixels that count): L-BFGS-B
of `scipy.optimize` (Byrd, Lu, Nocedal and Zhu 1995) in a box about the best. `Probing` needs only
scores: COBYLA (Powell 1994). Both begin again from the best as long as there are evaluations left,
and both are deterministic.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

_BOX = 8.0  # steps to each side: the first box of L-BFGS-B
_SMALLEST = 0.1  # steps: boxes below it are not searched
_FINEST = 1 / 16  # of the first radius of COBYLA: that at which it ends
_SHORTER = 0.7  # is the next first radius, and a half where nothing was gained
_LEAST = 0.1  # of its step: first radius from which on COBYLA is not begun again
_FORBIDDEN = 10.0  # score where nothing is feasible
_DIGITS = 7  # of scores and moves that count: what is beyond them decides nothing


class Descending:
    """Search by scores and gradients, from parameters (n,).

    L-BFGS-B ends where a jump leaves its line search nothing better, and sees no jump beyond. It is
    then begun again from the best, in half the box where nothing was gained.

    step : m, unit of lengths
    best, score : (n,) the parameters of the lowest score so far
    """

    def __init__(self, parameters, step: float):
        self.best, self.score = np.array(parameters, float), np.inf
        self._gradient = np.zeros_like(self.best)
        self._box = _BOX * step
        self._smallest = _SMALLEST * step

    def run(self, value_and_gradient: Callable, feasible: Callable, evaluations: int) -> None:
        """So many more evaluations, or fewer where the search is at its end.

        feasible : parameters to feasible ones nearby, or to None
        """
        left = evaluations

        def look(parameters):
            nonlocal left
            if not left:
                raise _Enough
            left -= 1
            score, gradient = value_and_gradient(parameters)
            if score < self.score:
                self.score, self.best, self._gradient = float(score), parameters, gradient
            return score, gradient

        if left and not np.isfinite(self.score):
            look(self.best)
        while left and self._box >= self._smallest:
            first = self.score
            try:
                self._in_box(look, feasible)
            except _Enough:
                return
            if not self.score < first:
                self._box /= 2

    def _in_box(self, look, feasible):
        """L-BFGS-B once; its first move is as long as the box is wide to one side."""
        start, first, gradient, box = self.best, self.score, self._gradient, self._box
        unit = box * np.linalg.norm(gradient)  # of scores
        if _rounded(unit) == 0:
            return  # flat

        def value(moves):
            if not moves.any():
                score, slope = first, gradient
            elif (moved := feasible(start + box * moves)) is None:
                score, slope = _FORBIDDEN, np.zeros_like(start)
            else:
                score, slope = look(moved)
            return float(_rounded(score)) / unit, _rounded(box * slope / unit)

        here = np.zeros(len(start))
        bounds = [(-1, 1)] * len(start)
        minimize(value, here, jac=True, method="L-BFGS-B", bounds=bounds)


class Probing:
    """Search by scores alone, from parameters (n,) whose `score` is known.

    COBYLA calls for scores and cannot be left in the midst of it. A part of the search therefore
    begins where COBYLA began, with the scores that are known since; they cost next to nothing.

    step : m, unit of lengths
    reach : first radius, in steps
    seed : for the order and the directions in which parameters are first tried
    best, score : (n,) the parameters of the lowest score so far
    """

    def __init__(self, parameters, score: float, step: float, reach: float, seed=0):
        self.best, self.score = np.array(parameters, float), float(score)
        self._step, self._reach = step, reach
        random = np.random.default_rng(seed)
        self._order = random.permutation(len(self.best))
        self._signs = random.choice([-1.0, 1.0], len(self.best))
        self._begin()

    def run(self, attempt: Callable, evaluations: int) -> None:
        """So many more evaluations, or fewer where the search is at its end.

        attempt : parameters to feasible ones nearby and their score, infinite where there are none
        """
        left = evaluations if len(self.best) else 0

        def score(moves):
            nonlocal left
            key = tuple(_rounded(moves).tolist())
            if key not in self._known:
                if not left:
                    raise _Enough
                left -= 1
                changes = self._step * self._reach * (self._signs * moves)[self._order]
                moved, found = attempt(self._start + changes)
                if found < self.score:
                    self.best, self.score = moved, float(found)
                self._known[key] = float(_rounded(min(found, _FORBIDDEN)))
            return self._known[key]

        while left and self._reach >= _LEAST:
            how = {"rhobeg": 1.0, "maxiter": 10**6}
            nowhere = np.zeros(len(self.best))
            try:
                minimize(score, nowhere, method="COBYLA", tol=_FINEST, options=how)
            except _Enough:
                return
            self._reach *= _SHORTER if self.score < self._first else 0.5
            self._begin()

    def _begin(self):
        """COBYLA once more, from the best."""
        self._start, self._first = self.best, self.score
        self._known = {(0.0,) * len(self.best): float(_rounded(self.score))}


class _Enough(Exception):
    """There are no evaluations left."""


def _rounded(values):
    return np.round(values, _DIGITS) + 0.0  # no -0
