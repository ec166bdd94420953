"""Small contacts as discs: position and conductance by Gauss-Newton, with the exact Green function at each place.

An image places contacts on pixels. Where a contact is no wider than the image of a point, a disc of the expected
radius says more: its position is free, and the way to the electrodes, which changes over a few millimetres near an
electrode, is that of its true place. All contacts of a frame are refined together, wide ones as the pixels that
the image gave them.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.reconstruction.admittance import Grounded
from tomotactile_ros.reconstruction.conductance import ConductanceProblem
from tomotactile_ros.reconstruction.estimate import EVEN_DISC, LARGEST, PATCH
from tomotactile_ros.reconstruction.local import LocalImage

_STEPS = 4
_DIFFERENCE = 0.02  # for slopes with respect to positions, in radii
_REACH = 1.0  # largest step and largest way from the image's position, in radii


def refine_discs(
    local: LocalImage,
    measured: Grounded,
    sheet,
    positions: np.ndarray,
    conductances: np.ndarray,
    radius: np.ndarray,
    others: np.ndarray,
    other_conductances: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """Refined positions (n, 2), m, and conductances (n,), S, of discs of `radius` (n,), m.

    Parameters
    ----------
    sheet : model of the sheet
    others, other_conductances : (m,) pixels of all other contacts and their g, S
    """
    count = len(positions)
    start = positions
    best = None
    pixels = local.grid.pixels[others]
    for _ in range(_STEPS):
        predicted, slopes, problem = _predict(
            local, measured, sheet, positions, conductances, radius, pixels, other_conductances
        )
        misfit = problem.misfit(predicted)
        if best is not None and misfit >= best[0]:
            break
        best = misfit, positions, conductances
        # unknowns: x and y in radii, logarithm of the conductance
        matrix = slopes * problem.weight[:, None]
        right = (problem.data - predicted) * problem.weight
        step = np.linalg.lstsq(matrix, right, rcond=1e-10)[0].reshape(3, count)
        step = np.clip(step, -_REACH, _REACH)
        moved = positions + radius[:, None] * step[:2].T
        reach = _REACH * radius[:, None]
        moved = np.clip(moved, start - reach, start + reach)
        positions = np.where(local.grid.outline.contains(moved)[:, None], moved, positions)
        conductances = np.minimum(conductances * np.exp(step[2]), LARGEST / local.resistance)
    return best[1], best[2]


def _predict(local, measured, sheet, positions, conductances, radius, pixels, others):
    """(D,) data, (D, 3 n) slopes with respect to x, y in radii and ln g, and the problem."""
    count = len(positions)
    inward = -np.sign(positions) * _DIFFERENCE * radius[:, None]  # never over the rim
    places = np.concatenate(
        [positions, positions + inward * [1, 0], positions + inward * [0, 1], pixels]
    )
    patch = PATCH * np.sqrt(local.grid.cell_area)
    size = np.append(EVEN_DISC * np.tile(radius, 3), np.full(len(pixels), patch))
    grounded = local.meter.sheet.at(sheet.transfer(places, size))
    impedance = grounded.among(np.arange(len(places)))
    values = np.append(conductances, others)

    def problem_at(chosen):
        chosen = np.append(chosen, np.arange(3 * count, len(places)))
        return ConductanceProblem(
            local, measured, grounded.share[:, chosen], impedance[np.ix_(chosen, chosen)], 0.0
        )

    own = np.arange(count)
    problem = problem_at(own)
    predicted, by_conductance = problem.predict(values)
    slopes = np.empty((len(predicted), 3 * count))
    for axis in (0, 1):
        for i in range(count):
            moved = own.copy()
            moved[i] += (axis + 1) * count
            change = problem_at(moved).predict(values)[0] - predicted
            sign = np.sign(inward[i, axis]) or 1.0
            slopes[:, axis * count + i] = change * sign / _DIFFERENCE
    slopes[:, 2 * count :] = by_conductance[:, :count] * conductances
    return predicted, slopes, problem
