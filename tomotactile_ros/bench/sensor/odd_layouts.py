"""Layouts that are no full grid: a void, a ring, random places, an L."""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np

from tomotactile_ros.layout import Layout, equal_grid, load_layout
from tomotactile_ros.outline import Outline

GRID = "equal-8x8"
VOID = 27, 28, 35, 36  # the four electrodes amid 8 x 8
CONNECTOR = tuple(range(24, 32))  # eight neighbours, the fourth row of 8 x 8
_ELL = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.0], [0.0, 0.0], [0.0, 0.1], [-0.1, 0.1]]
_MARGIN = 0.01  # of the electrodes on the L and at random places, m
_RANDOM, _APART, _SEED = 40, 0.018, 11  # places, m between them
_SHEET, _RADIUS = 1e4, 0.0025  # ohm/sq, m


@cache
def grid() -> Layout:
    """8 x 8 on 200 mm."""
    return load_layout(GRID)


@cache
def void() -> Layout:
    """8 x 8 without the four electrodes in the middle."""
    kept = np.delete(grid().positions, VOID, axis=0)
    return replace(grid(), name="void-8x8", positions=kept, provenance={})


@cache
def ring() -> Layout:
    """16 electrodes on the rim of a circle of 100 mm radius."""
    return load_layout("ring-16")


@cache
def random_places() -> Layout:
    """40 electrodes anywhere on 200 mm x 200 mm, 18 mm or more from each other."""
    random = np.random.default_rng(_SEED)
    places = np.empty((0, 2))
    while len(places) < _RANDOM:
        point = random.uniform(_MARGIN - 0.1, 0.1 - _MARGIN, 2)
        if (np.linalg.norm(places - point, axis=1) > _APART).all():
            places = np.vstack([places, point.round(6)])
    return Layout("random-40", Outline.rectangle(0.2, 0.2), _SHEET, _RADIUS, places)


@cache
def ell() -> Layout:
    """A square of 200 mm without a quarter, electrodes on a grid of 25.7 mm."""
    outline = Outline.polygon(_ELL)
    every = equal_grid(8, 8, (0.2, 0.2), _RADIUS, _SHEET, margin=_MARGIN).positions
    inside = outline.contains(every) & (outline.rim_distance(every) > 2 * _RADIUS)
    return Layout("ell", outline, _SHEET, _RADIUS, every[inside])
