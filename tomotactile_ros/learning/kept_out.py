"""Whether what was learned predicts touches that it was not learned from, better than the layout does.

About the sensor that all touches show, each touch j has its information L_j, v_j and chi-squared x_j
(`estimation.information`). What the others say is a normal distribution of theta again, d away from there
and with covariance C; how well it predicts touch j is the evidence for that, contacts marginal:

    -2 ln p = x_j + d^T C^-1 d - (v_j + C^-1 d)^T (L_j + C^-1)^-1 (v_j + C^-1 d) + ln det(1 + C L_j)

Touches are kept out a fifth at a time (cross-validation), each with all of its frames: what the model lacks is
the same in these, and they would predict each other whatever was learned. Each part of what was learned is judged
against what was expected of it before: where the touches kept out are likelier without it, it is left out.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tomotactile_ros.estimation.information import Information
from tomotactile_ros.learning.state import SensorState

FOLDS = 5  # of all touches a fifth is kept out at a time: four fifths are learned from, nearly all
LEAST = 5  # touches: one can be kept out then
# what can be left out, as people call it, and what it is made of
GROUPS = {
    "gains": ("gain",),
    "offsets": ("offset",),
    "resistances to ground": ("resistance",),
    "places of electrodes": ("aside_x", "aside_y"),
    "outline and radius": ("cut",),
    "unevenness of the sheet": ("uneven",),
}


@dataclass(frozen=True)
class KeptOut:
    """What touches that were kept out say.

    touches : that were predicted
    gained : by how much the logarithm of their evidence is larger than with the layout, a touch
    found, predicted, layout : standard deviation of their readings from the prediction, in parts of the
        noise: as found, as the learned sensor says, and with the layout
    left_out : of `GROUPS`, without which they are likelier
    """

    touches: int
    gained: float
    found: float
    predicted: float
    layout: float
    left_out: tuple[str, ...]


class Predicted:
    """Touches, each predicted from the others.

    Parameters
    ----------
    parts : (information, weight) of each frame, at theta `at` (D,); `where` (d,) of theta it is
    touches : the touch that each of `parts` is of, from 0 on
    learned : state that follows from some of the parts
    start : state before any of them; `vary` (d,) variances from one touch to the next
    """

    def __init__(
        self,
        parts: Sequence[tuple[Information, float]],
        touches: Sequence[int],
        at: np.ndarray,
        where: np.ndarray,
        learned: Callable[[Sequence[tuple[Information, float]]], SensorState],
        start: SensorState,
        vary: np.ndarray,
    ):
        self._parts, self._at, self._where, self._vary = parts, at, where, vary
        self._start = start
        self._touches = len(set(touches))
        of = [touch % FOLDS for touch in touches]
        self._folds = [
            (
                learned([part for part, its in zip(parts, of) if its != fold]),
                [part for part, its in zip(parts, of) if its == fold],
            )
            for fold in range(FOLDS)
        ]

    def without(self, left_out: Sequence[str]) -> tuple[float, float, float]:
        """Logarithm of the evidence of all touches with `left_out` of `GROUPS`; chi-squared of their readings,
        and what was predicted of it."""
        total = np.zeros(3)
        for state, kept in self._folds:
            told = forgotten(state, self._start, left_out)
            apart = (told.mean - self._at)[self._where]
            covariance = told.covariance[np.ix_(self._where, self._where)] + np.diag(self._vary)
            expected = _Expected(apart, covariance)
            for found, _ in kept:
                total += expected.of(found)
        evidence, chi_squared, predicted = total.tolist()
        return evidence, chi_squared, predicted

    def judged(self) -> KeptOut:
        """What to leave out, and how well the rest predicts."""
        left_out: tuple[str, ...] = ()
        best = self.without(left_out)
        while len(left_out) < len(GROUPS):
            tried = {
                name: self.without((*left_out, name)) for name in GROUPS if name not in left_out
            }
            name = max(tried, key=lambda each: tried[each][0])
            if tried[name][0] <= best[0]:
                break
            left_out, best = (*left_out, name), tried[name]
        layout = self.without(tuple(GROUPS))
        if layout[0] > best[0]:
            left_out, best = tuple(GROUPS), layout
        count = max(sum(found.readings for found, _ in self._parts), 1)
        found, predicted, drawn = np.sqrt(np.maximum([*best[1:], layout[1]], 0.0) / count).tolist()
        gained = (best[0] - layout[0]) / self._touches
        return KeptOut(self._touches, gained, found, predicted, drawn, left_out)


class _Expected:
    """What is expected of theta `apart` (d,) from where touches were taken, with `covariance` (d, d)."""

    def __init__(self, apart: np.ndarray, covariance: np.ndarray):
        self._scale = np.sqrt(covariance.diagonal())
        self._apart = apart / self._scale
        self._correlation = covariance / self._scale[:, None] / self._scale
        self._inverse = np.linalg.inv(self._correlation)
        self._pulled = self._inverse @ self._apart
        self._logarithm = np.linalg.slogdet(self._correlation)[1]

    def of(self, found: Information) -> np.ndarray:
        """(3,) logarithm of the evidence of a touch, its chi-squared and what is expected of it."""
        matrix = found.matrix * self._scale[:, None] * self._scale
        vector, apart, pulled = found.vector * self._scale, self._apart, self._pulled
        factor = cho_factor(matrix + self._inverse)
        right = vector + pulled
        least = found.chi_squared + apart @ pulled - right @ cho_solve(factor, right)
        logarithm = 2 * np.log(factor[0].diagonal()).sum() + self._logarithm
        chi_squared = found.chi_squared - 2 * vector @ apart + apart @ matrix @ apart
        predicted = found.readings + (self._correlation * matrix).sum()
        return np.array([-(least + logarithm) / 2, chi_squared, predicted])


def forgotten(state: SensorState, start: SensorState, left_out: Sequence[str]) -> SensorState:
    """The `state` with `left_out` of `GROUPS` as they were expected at the `start`, independent of the rest."""
    mean, covariance = state.mean.copy(), state.covariance.copy()
    which = np.zeros(len(mean), bool)
    for name in left_out:
        for part in GROUPS[name]:
            which[state.slice(part)] = True
    mean[which] = start.mean[which]
    covariance[which] = covariance[:, which] = 0.0
    covariance[np.ix_(which, which)] = start.covariance[np.ix_(which, which)]
    return state.learned(mean, covariance)
