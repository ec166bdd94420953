"""The paper's optimizer: equal spatial resolution in all regions (Kojima et al. 2023, section 2.2).

Every update gives region m the area S_m / w_m^2, scaled to the sum of all (eq. 12), w_m being the
mean HWHM of the contacts in it, and places the electrodes accordingly (Algorithm 1; see
`algorithm1` for odd N, R x C electrodes and rectangles). The score is the mean HWHM, by which the
paper chooses its step, or that of the worst region. Outermost electrodes keep the distance from the
rim that they start with. On other outlines than rectangles they stay on the sides of their grid.
Symmetries that grid and outline share are kept.

An update that would make electrodes cross, overlap or leave the sheet is halved (the areas' ratio
to the power 1/2, 1/4, ...) until the layout is valid.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import partial

import numpy as np

from tomotactile_ros.evaluation.layout_quality import evaluate_layout
from tomotactile_ros.evaluation.regions import grid_shape, is_simple, quadrilaterals
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.optimizer.algorithm1 import place_by_displacement, place_in_rings
from tomotactile_ros.optimizer.orbits import MIRRORS, SWAP, shared_group
from tomotactile_ros.optimizer.step import Step, Steps
from tomotactile_ros.optimizer.work import Work
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

MODELS: dict[str, str] = {
    "closed-form": "paper",
    "fem": "fem",
    "point-nodes": "point_nodes",
}  # of evaluations
SELECTIONS: tuple[str, ...] = (
    "mean",
    "worst",
)  # whose HWHM is the score: all contacts', or the worst region's
_HALVINGS = 6
_CLOSE = 1e-6  # of the sheet's size: electrodes that a symmetry maps onto each other


def equalize(
    layout: Layout,
    updates: int = 5,
    *,
    select: str = SELECTIONS[0],
    work: Work | None = None,
    **evaluation,
) -> Iterator[Step]:
    """Equalize the resolution of a grid of electrodes.

    Parameters
    ----------
    layout : R x C electrodes on any outline, row by row from the lower left
    updates : how many; every one costs one evaluation
    select : one of `SELECTIONS`
    work : keeps what was evaluated
    evaluation : keywords of `evaluate_layout`

    Yields the start and every update. Ends early where no valid layout is left in the wanted
    direction.

    Raises InputError for layouts that the method cannot treat.
    """
    checks.integer(updates, "updates", 0, 1000)
    shape = grid_shape(layout.positions)
    if shape is None:
        raise InputError(
            f"layout {layout.name!r}: equalize needs rows and columns of electrodes, row by row from the "
            "lower left, whose lines do not cross; use method free"
        )
    symmetries = _symmetries(layout, shape)
    steps, work = Steps(updates), work or Work()
    evaluate = partial(evaluate_layout, **evaluation)
    for iteration in range(updates + 1):
        quality = work.do(evaluate, layout)
        hwhm = quality.metrics["hwhm"]
        yield steps.next(quality, hwhm["mean" if select == "mean" else "worst_region"])
        updated = _update(quality, symmetries) if iteration < updates else None
        if updated is None:
            return
        layout = updated


def _symmetries(layout, shape):
    """Which of these leave the sheet and the grid as they are: x mirrored, y mirrored, all of a
    square."""
    grid = layout.positions.reshape(*shape, 2)
    group = shared_group(layout.outline, layout.positions)

    def shared(element, image):
        return (
            (group == element).all(axis=(1, 2)).any()
            and image.shape == grid.shape
            and np.abs(image - grid).max() < _CLOSE * max(layout.outline.size)
        )

    swapped = grid.transpose(1, 0, 2)[..., ::-1]
    x = shared(MIRRORS[1], grid[:, ::-1] * [-1, 1])
    y = shared(MIRRORS[2], grid[::-1] * [1, -1])
    return x, y, x and y and shared(SWAP, swapped)


def _update(quality, symmetries):
    """The layout after one update, or None where none is valid."""
    layout, regions = quality.layout, quality.regions
    old = regions.areas.reshape(regions.rows, regions.cols)
    change = 1 / np.square(quality.region_hwhm).reshape(old.shape)
    mirrored_x, mirrored_y, square = symmetries
    if mirrored_y:
        change = (change + change[::-1]) / 2
    if mirrored_x:
        change = (change + change[:, ::-1]) / 2
    for halving in range(_HALVINGS + 1):
        areas = old * change ** (0.5**halving)
        areas *= old.sum() / areas.sum()
        placed = _place(layout, areas, square)
        if placed is not None:
            return placed
    return None


def _place(layout, areas, square):
    shape = (areas.shape[0] + 1, areas.shape[1] + 1)
    if square:
        positions = place_in_rings((areas + areas.T) / 2)
    else:
        positions = place_by_displacement(layout.positions.reshape(*shape, 2), areas)
    positions = positions.reshape(-1, 2)
    if not np.isfinite(positions).all() or not is_simple(quadrilaterals(positions, *shape)):
        return None
    low, high = np.array(layout.outline.bounds).reshape(2, 2)
    try:
        return replace(layout, positions=np.clip(positions, low, high))
    except InputError:  # electrodes overlap, or are not on the sheet
        return None
