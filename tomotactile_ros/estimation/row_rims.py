"""A disc that covers an electrode in part, as one patch.

The mean share over its area: 1 in the electrode for what lies on it, and that of patches beside it for the
rest (as in `touch`). The share at the disc's centre, with the logarithm of the distance averaged, is that
mean in the electrode itself, but not in the others: what lies beside the electrode is farther from it than
the centre is. (Current prefers the electrode, the more the better a disc conducts; to count that makes shares
depend on ln c, and hard presses were lost.)
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.estimation.disc import unit_patches
from tomotactile_ros.estimation.induced import RIM
from tomotactile_ros.estimation.operator import SheetOperator

_ACROSS = 6  # patches to the width of a disc
_LEAST = 1e-3  # of the area of a disc: less beside the electrode is nothing


def rim_shares(operator: SheetOperator, x: float, y: float, radius: float) -> np.ndarray | None:
    """(3, n) shares of a disc at x, y (m) in the electrodes of `operator`, and their slopes, 1/m, on an even
    sheet; None where it reaches no rim but the sheet's, or next to nothing of it lies beside the electrode."""
    rim, centres = operator.layout.radius, operator.layout.positions[operator.used]
    apart = np.hypot(*(np.array([x, y]) - centres).T)
    which = int(apart.argmin())
    if not rim - radius < apart[which] < rim + radius:
        return None
    unit, area, width = unit_patches(_ACROSS)
    places = np.array([x, y]) + radius * unit
    if (operator.layout.outline.depth(places)[0] < 0).any():
        return None
    way = places - centres[which]
    distance = np.hypot(*way.T)
    off, rises = part_beyond((distance - rim) / (radius * width))
    weight = area * off
    if weight.sum() < _LEAST:
        return None
    steep = (area * rises / (radius * width * np.maximum(distance, 1e-12)))[:, None] * way
    there = weight > 0
    weight, steep = weight[there], steep[there]
    beside, distance, _, way, on = operator.placed(places[there])
    potentials, slopes = operator.potentials(beside)
    if on.any():  # these move along the rim; in the middle they do not know which way
        out = way[on].T[..., None]
        along = slopes[:, on] - out * (out * slopes[:, on]).sum(axis=0)
        slopes[:, on] = along * (RIM * rim / np.maximum(distance[on], 0.1 * rim))[:, None]
    inverse = operator.bordered[:-1]
    sums = np.vstack([weight @ potentials, weight @ slopes + steep.T @ potentials])
    parts = np.array([weight.sum(), *steep.sum(axis=0)])  # of what is beside the electrode
    shares = sums @ inverse[:, :-1].T + parts[:, None] * inverse[:, -1]
    shares[:, which] += np.array([1.0, 0.0, 0.0]) - parts
    return shares


def part_beyond(depth: np.ndarray):
    """What part of a patch lies beyond a line that it is `depth` radii beyond, and its slope."""
    inside = np.clip(depth + 0.5, 0.0, 1.0)
    return inside**2 * (3 - 2 * inside), 6 * inside * (1 - inside)
