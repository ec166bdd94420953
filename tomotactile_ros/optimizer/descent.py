"""Two searches that keep their whole state in small objects, so that they can be stopped, resumed
and sent.

`Descent` follows a gradient that jumps a little (contacts change the pixels that count): steps of
bounded size along running means of gradient and square (Kingma and Ba 2015), shrinking towards the
end. `Evolution` needs only scores and samples around a mean with an adapted covariance (Hansen
2016, rank-one and rank-mu updates, step size by its path). Both are deterministic.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

_MEMORY, _SQUARE_MEMORY = 0.8, 0.95
_LAST = 0.05  # of the first step


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


class Evolution:
    """Evolution around `mean` (n,) with standard deviation `step` (m) in each parameter."""

    def __init__(self, mean, step: float, seed: int = 0):
        self.best, self.score = np.array(mean, float), np.inf
        self._mean, self._step = self.best, float(step)
        count = max(len(self._mean), 1)
        self.population = 4 + int(3 * np.log(count))
        self._random = np.random.default_rng(seed)
        weights = np.log(self.population // 2 + 0.5) - np.log(1 + np.arange(self.population // 2))
        self._weights = weights / weights.sum()
        mass = 1 / (self._weights**2).sum()
        self._rates = _rates(count, mass)
        self._mass = mass
        self._covariance = np.eye(count)[: len(self._mean), : len(self._mean)]
        self._path = np.zeros_like(self._mean)
        self._step_path = np.zeros_like(self._mean)

    def ask(self) -> np.ndarray:
        """(population, n) candidates."""
        variances, axes = np.linalg.eigh(self._covariance)
        self._scale, self._axes = np.sqrt(np.maximum(variances, 1e-20)), axes
        normal = self._random.standard_normal((self.population, len(self._mean)))
        self._moves = normal * self._scale @ axes.T
        return self._mean + self._step * self._moves

    def tell(self, candidates: np.ndarray, scores: Iterable[float]) -> None:
        """The scores of what `ask` gave; infinite where a candidate is not feasible."""
        scores = np.array(list(scores))
        order = np.argsort(scores, kind="stable")
        if scores[order[0]] < self.score:
            self.score, self.best = float(scores[order[0]]), candidates[order[0]]
        count = len(self._mean)
        if not count or not np.isfinite(scores[order[len(self._weights) - 1]]):
            self._step /= 2
            return
        step_rate, damping, path_rate, one, mu, expected = self._rates
        chosen = self._moves[order[: len(self._weights)]]
        move = self._weights @ chosen
        self._mean = self._mean + self._step * move
        white = self._axes @ ((self._axes.T @ move) / self._scale)
        self._step_path *= 1 - step_rate
        self._step_path += np.sqrt(step_rate * (2 - step_rate) * self._mass) * white
        length = np.linalg.norm(self._step_path) / expected
        self._path *= 1 - path_rate
        if length < 1.4 + 2 / (count + 1):
            self._path += np.sqrt(path_rate * (2 - path_rate) * self._mass) * move
        self._covariance = (
            (1 - one - mu) * self._covariance
            + one * np.outer(self._path, self._path)
            + mu * (chosen.T * self._weights) @ chosen
        )
        self._step *= np.exp(step_rate / damping * (length - 1))


def _rates(count, mass):
    """Learning rates for `count` parameters and the effective number `mass` of parents."""
    step_rate = (mass + 2) / (count + mass + 5)
    damping = 1 + step_rate + 2 * max(0.0, np.sqrt((mass - 1) / (count + 1)) - 1)
    path_rate = (4 + mass / count) / (count + 4 + 2 * mass / count)
    one = 2 / ((count + 1.3) ** 2 + mass)
    mu = min(1 - one, 2 * (mass - 2 + 1 / mass) / ((count + 2) ** 2 + mass))
    expected = np.sqrt(count) * (1 - 1 / (4 * count) + 1 / (21 * count**2))
    return step_rate, damping, path_rate, one, mu, expected
