"""Regions between electrodes: which they are, how large, and which contact belongs to which."""

import numpy as np
import pytest

from tomotactile_ros.evaluation.regions import grid_shape, layout_regions, quadrilaterals
from tomotactile_ros.layouts.layout import Layout, equal_grid
from tomotactile_ros.layouts.outline import Outline


def test_regions_of_a_grid():
    layout = equal_grid(3, 5, (0.4, 0.2), 0.002, 1e4)
    regions = layout_regions(layout)
    assert (regions.rows, regions.cols, regions.electrodes) == (2, 4, True)
    assert regions.areas == pytest.approx(0.08 / 8)
    points = np.array([[-0.19, -0.01], [0.19, 0.01], [0.01, -0.09]])
    assert regions.of(points).tolist() == [0, 7, 2]


def test_points_outside_all_regions_belong_to_the_nearest():
    layout = equal_grid(3, 3, (0.2, 0.2), 0.002, 1e4, inset=0.03)
    regions = layout_regions(layout)
    assert regions.of([[-0.09, -0.09], [0.09, 0.02], [0.01, 0.099]]).tolist() == [0, 3, 3]


def test_quarters_of_a_warped_grid_own_their_points():
    random = np.random.default_rng(0)
    layout = equal_grid(4, 4, (0.2, 0.2), 0.002, 1e4)
    positions = layout.positions + random.uniform(-0.01, 0.01, (16, 2)) * (
        abs(layout.positions) < 0.09
    )
    regions = quadrilaterals(positions, 4, 4)
    points = random.uniform(-0.099, 0.099, (20000, 2))
    share = np.bincount(regions.of(points), minlength=9) / len(points)
    assert share == pytest.approx(regions.areas / 0.04, abs=0.012)


def test_grid_shape_is_read_from_the_positions():
    for rows, cols in ((2, 8), (8, 2), (4, 4), (2, 2), (5, 3)):
        layout = equal_grid(rows, cols, (0.2, 0.2), 0.002, 1e4)
        assert grid_shape(layout.positions) == (rows, cols)
    angle = np.arange(16) * 2 * np.pi / 16
    ring = 0.08 * np.column_stack([np.cos(angle), np.sin(angle)])
    assert grid_shape(ring) is None
    assert grid_shape(ring[:13]) is None


def test_layouts_that_are_no_grid_have_blocks():
    layout = Layout("three", Outline.circle(0.1), 1e4, 0.002, [[0, 0], [0.05, 0], [0, 0.05]])
    regions = layout_regions(layout)
    assert (regions.rows, regions.cols, regions.electrodes) == (3, 3, False)
    assert regions.areas == pytest.approx(0.04 / 9)
