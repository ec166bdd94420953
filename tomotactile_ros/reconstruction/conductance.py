"""The nonlinear inverse: conductances g >= 0 of the pixels, their mutual effect exact.

Contacts take current from each other. By equation (b) of `grounded`, with W = (diag(1/g) + D)^-1,

    y = H W 1,        Y_nl - Y0_nl = (H W H^T)_nl,        d W / d g_k = u_k u_k^T,   u_k = (I - W D)
    e_k,

so with the shares H~ = H (I - W D) that remain while all contacts are grounded too, the derivatives
have the form of the linear problem: H~_nk s_k and H~_nk H~_lk, s_k = sum_n H~_nk. Each Gauss-Newton
step is a non-negative least-squares problem; a step that does not lower the misfit is halved.

A small weight on g^2 keeps wide contacts even: frames do not tell how a current is shared out among
pixels much closer than electrodes.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tomotactile_ros.reconstruction.active_set import Memory, minimise
from tomotactile_ros.reconstruction.admittance import Grounded
from tomotactile_ros.reconstruction.grounded import RecentBlock
from tomotactile_ros.reconstruction.local import LocalImage
from tomotactile_ros.reconstruction.nonnegative import typical_pixel, weighted_data

_STEPS = 8
_HALVINGS = 4
_SUPPORT = 0.03  # of the start's maximum
_MOST, _PER_DATUM = 450, 10  # pixels that take part: in all, and for each datum
_COMPACT = 0.2  # see `nonnegative`
_ENOUGH = 1e-3  # relative gain of the misfit below which it ends


class ConductanceProblem:
    """Data of one frame as a function of the conductances of n points.

    Parameters
    ----------
    local, measured : of the frame
    share, impedance : H (E, n) and D (n, n) of the points, self terms on the diagonal
    compact : how much compact contacts are preferred, see `nonnegative`

    Attributes
    ----------
    data, weight : (D,) what was measured, and 1 / sigma.
    """

    def __init__(self, local: LocalImage, measured: Grounded, share, impedance, compact: float):
        self.first, self.second = local.meter.first, local.meter.second
        self.share, self.impedance = share, impedance
        self.data, self.weight = weighted_data(local, measured, compact)
        self._couplings = measured.couplings is not None

    def predict(self, conductance: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(D,) data and their (D, n) derivative at g (n,), S."""
        carrying = np.flatnonzero(conductance)
        root = np.sqrt(conductance[carrying])
        share, impedance = self.share[:, carrying], self.impedance[carrying]
        system = np.eye(len(root)) + root[:, None] * impedance[:, carrying] * root
        passed = cho_solve(cho_factor(system), (share * root).T).T * root  # H W
        left = self.share - passed @ impedance  # H~
        currents = passed.sum(axis=1)
        slopes = left * left.sum(axis=0)
        if not self._couplings:
            return currents, slopes
        first, second = left[self.first], left[self.second]
        couplings = np.einsum("pk,pk->p", passed[self.first], share[self.second])
        return np.append(currents, couplings), np.vstack([slopes, first * second])

    def misfit(self, predicted: np.ndarray) -> float:
        """Weighted sum of squares."""
        return float((((predicted - self.data) * self.weight) ** 2).sum())


def solve_conductance(
    problem: ConductanceProblem, start: np.ndarray, typical: float, guess: np.ndarray
) -> tuple[np.ndarray, list[float], int]:
    """(n,) g >= 0, S; what was minimised after each step; the number of linear systems solved.

    Parameters
    ----------
    start : (n,) g >= 0, S
    typical : conductance of a pixel, S, that costs as much as an error of one standard deviation
    guess : (n,) >= 0, pixels that will carry something; the result does not depend on it
    """

    def cost(predicted, values):
        return problem.misfit(predicted) + float(((values / typical) ** 2).sum())

    values, solved = np.maximum(start, 0.0), 0
    weight = problem.weight[:, None]
    predicted, slopes = problem.predict(values)
    costs = [cost(predicted, values)]
    for _ in range(_STEPS):
        matrix = slopes * weight
        right = (problem.data - predicted) * problem.weight + matrix @ values
        gram = matrix.T @ matrix
        gram.ravel()[:: len(gram) + 1] += typical**-2
        wanted, steps = minimise(gram, matrix.T @ right, guess, blocks=True)
        guess, solved = wanted, solved + steps
        for halving in range(_HALVINGS):
            trial = values + (wanted - values) * 0.5**halving
            found, new_slopes = problem.predict(trial)
            if cost(found, trial) < costs[-1]:
                break
        else:
            break
        values, predicted, slopes = trial, found, new_slopes
        costs.append(cost(predicted, values))
        if costs[-2] - costs[-1] < _ENOUGH * costs[-1]:
            break
    return values, costs, solved


def conductance_image(
    local: LocalImage, measured: Grounded, start: np.ndarray, memory: Memory, recent: RecentBlock
) -> np.ndarray:
    """(K,) g of each pixel, S, started from the smoothed non-negative image `start` (K,).

    `memory` and `recent` of the last frame are updated.
    """
    out = np.zeros(len(start))
    top = start.max()
    active = np.flatnonzero(start > _SUPPORT * top) if top > 0 else np.empty(0, int)
    most = min(_MOST, _PER_DATUM * len(local.forward))
    if len(active) > most:
        active = np.sort(active[np.argpartition(-start[active], most)[:most]])
    if len(active):
        sheet = local.meter.sheet
        share, impedance = sheet.share[:, active], recent.among(sheet, active)
        problem = ConductanceProblem(local, measured, share, impedance, _COMPACT)
        guess = memory.recall(active)
        if guess is None:
            guess = np.maximum(start[active] - top / 2, 0.0)
        out[active], _, memory.steps = solve_conductance(
            problem, start[active], typical_pixel(local), guess
        )
        memory.values = out
    return out
