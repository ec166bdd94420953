"""Two searches that keep their whole state in small objects, so that they can be stopped, resumed
and sent.

`Descent` follows a gradient that jumps a little (contacts change the pixels that count): steps of
bounded size along running means of gradient and square (Kingma and Ba 2015), shrinking towards the
end. `Probing` needs only scores: COBYLA of `scipy.optimize` (Powell 1994), again from the best as
long as there are evaluations left. Both are deterministic.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

_MEMORY, _SQUARE_MEMORY = 0.8, 0.95
_LAST = 0.05  # of the first step
_FINEST = 1 / 16  # of the first radius of COBYLA: that at which it ends
_SHORTER = 0.7  # is the next first radius, and a half where nothing was gained
_LEAST = 0.1  # of its step: first radius from which on COBYLA is not begun again
_FORBIDDEN = 10.0  # score where nothing is feasible
_DIGITS = 7  # of scores and moves that count: what is beyond them decides nothing


@dataclass
class Descent:
    """Descent of `total` steps of at most about `step` (m) in each parameter.

    parameters (n,) ; best (n,) the parameters of the lowest score so far
    """

    parameters: np.ndarray
    step: float
    total: int
    done: int = 0
    score: float = np.inf

    def __post_init__(self):
        self.best = self.parameters
        self._mean = np.zeros_like(self.parameters)
        self._square = np.zeros_like(self.parameters)

    def run(self, value_and_gradient: Callable, feasible: Callable, steps: int) -> None:
        """Some more steps; `feasible` maps parameters to feasible ones, or to None."""
        for _ in range(min(steps, self.total - self.done)):
            score, gradient = value_and_gradient(self.parameters)
            if score < self.score:
                self.score, self.best = score, self.parameters
            self.done += 1
            self._mean += (1 - _MEMORY) * (gradient - self._mean)
            self._square += (1 - _SQUARE_MEMORY) * (gradient**2 - self._square)
            mean = self._mean / (1 - _MEMORY**self.done)
            square = self._square / (1 - _SQUARE_MEMORY**self.done)
            if not square.any():
                return  # flat
            length = self.step * (1 - self.done / self.total + _LAST)
            moved = feasible(self.parameters - length * mean / np.sqrt(square + 1e-300))
            if moved is None:
                self.parameters = self.best
                self.step /= 2
            else:
                self.parameters = moved


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
            key = _rounded(moves).tobytes()
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
        self._known = {_rounded(np.zeros(len(self.best))).tobytes(): float(_rounded(self.score))}


class _Enough(Exception):
    """There are no evaluations left."""


def _rounded(values):
    return np.round(values, _DIGITS) + 0.0  # no -0
