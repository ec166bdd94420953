"""Which electrodes to ground: fewer ground conditions, more frames per second.

A frame takes a time proportional to the number L of ground conditions. Conditions are dropped one
at a time from all of them, always the one whose loss costs least. What it costs: images are linear
estimates with a prior of variance 1 / lambda^2 per pixel and readings of variance 1, so the trace
of

    S = (J'J + lambda^2 I)^-1

is the variance that is left, and J'J is the sum of one J_l'J_l for every condition l. Dropping l
changes S by

    S -> S + S J_l' (I - J_l S J_l')^-1 J_l S,   trace += tr((I - J_l S J_l')^-1 J_l S S J_l')

which needs only matrices of the size of the electrodes, E x E, for every l that is left; smaller
ones without the combinations of readings that hardly add to J'J.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from tomotactile_ros.evaluation.layout_quality import LayoutQuality, evaluate_layout
from tomotactile_ros.evaluation.paper_model import paper_transfer
from tomotactile_ros.evaluation.point_spread import REGULARIZATION
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.sensitivity import Sensitivity
from tomotactile_ros.support import checks

_CHOICE_RESOLUTION = 20  # contact positions along the longer side while choosing
_TELLING = 1e-4  # least that a combination of readings adds to J'J, in parts of lambda^2


@dataclass(frozen=True, eq=False)
class Scan:
    """What is left of the accuracy with some ground conditions.

    grounded : (L,) electrodes to ground, in the order of the layout
    quality : of images from these rows alone
    """

    grounded: np.ndarray
    quality: LayoutQuality

    @property
    def speed(self) -> float:
        """Frames per second, relative to a scan of all conditions."""
        return self.quality.layout.electrodes / len(self.grounded)


def drop_order(layout: Layout, regularization: float = REGULARIZATION) -> np.ndarray:
    """(E,) electrodes in the order in which their ground conditions can best be spared."""
    grid = Grid.for_outline(layout.outline, _CHOICE_RESOLUTION)
    if layout.outline.is_uniform_rectangle:
        transfer = paper_transfer(layout, grid.pixels)
    else:
        transfer = make_sheet(layout, "fem").transfer(grid.pixels, 1e-3)
    count = layout.electrodes
    regularization = regularization * len(grid.pixels) / 1600
    dense = Sensitivity(transfer).dense().reshape(count, count, -1)
    rows = [_telling(row, _TELLING * regularization) for row in dense]
    gram = sum(row.T @ row for row in rows)
    inverse = np.linalg.inv(gram + regularization * np.eye(len(gram)))
    left, order = list(range(count)), []
    while left:
        costs, updates = [], []
        for ground in left:
            own = rows[ground]
            reach = own @ inverse  # J_l S
            rest = np.eye(len(own)) - reach @ own.T
            gain = np.linalg.solve(rest, reach)
            costs.append(np.vdot(gain, reach))
            updates.append((reach, gain))
        spared = int(np.argmin(np.round(costs, 9)))
        reach, gain = updates[spared]
        inverse = inverse + reach.T @ gain
        order.append(left.pop(spared))
    return np.array(order)


def _telling(rows, least):
    """(r, K) with the same J'J as `rows` (E, K), but for eigenvalues below `least`."""
    values, vectors = np.linalg.eigh(rows @ rows.T)
    return vectors[:, values > least].T @ rows


def scans(
    layout: Layout, counts, regularization: float = REGULARIZATION, **evaluation
) -> Iterator[Scan]:
    """Accuracy with the best `counts` of ground conditions; lambda^2 stays, because the noise of a
    reading does.

    counts : numbers of conditions, each from 1 to E; evaluation : keywords of `evaluate_layout`
    """
    order = drop_order(layout, regularization)
    for count in counts:
        checks.integer(count, "counts", 1, layout.electrodes)
        grounded = np.sort(order[layout.electrodes - count :])
        quality = evaluate_layout(
            layout, regularization=regularization, grounded=grounded, **evaluation
        )
        yield Scan(grounded, quality)
