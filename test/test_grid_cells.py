"""Image cells: orientation, tiling, cells outside the outline."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Outline
from tomotactile_ros.support.errors import InputError


@settings(deadline=None)
@given(
    a=st.floats(1e-3, 10),
    b=st.floats(1e-3, 10),
    height=st.integers(1, 30),
    width=st.integers(1, 30),
    data=st.data(),
)
def test_pixel_centres_follow_the_contract(a, b, height, width, data):
    grid = Grid(Outline.rectangle(a, b, unusual_size=True), height, width)
    row = data.draw(st.integers(0, height - 1))
    col = data.draw(st.integers(0, width - 1))
    expected = [-a / 2 + (col + 0.5) * a / width, b / 2 - (row + 0.5) * b / height]
    got = grid.centres.reshape(height, width, 2)[row, col]
    np.testing.assert_allclose(got, expected, atol=1e-12 * (a + b))
    assert grid.cell_area * height * width == pytest.approx(a * b)
    assert grid.inside.all() and len(grid.pixels) == height * width


@pytest.mark.parametrize(
    ("size", "shape"),
    [((0.2, 0.2), (40, 40)), ((0.2, 0.1), (20, 40)), ((0.1, 0.2), (40, 20)), ((10, 0.1), (1, 40))],
)
def test_resolution_counts_along_the_longer_side(size, shape):
    assert Grid.for_outline(Outline.rectangle(*size, unusual_size=True), 40).shape == shape


def test_cells_outside_a_polygon_are_nan():
    outline = Outline.polygon([[-1, -1], [1, -1], [1, 0], [0, 0], [0, 1], [-1, 1]])
    grid = Grid.for_outline(outline, 4)
    expected = np.ones((4, 4), bool)
    expected[:2, 2:] = False  # the upper right quarter is missing
    np.testing.assert_array_equal(grid.inside, expected)
    image = grid.fill(np.arange(12, dtype=np.float32))
    assert image.dtype == np.float32
    np.testing.assert_array_equal(np.isnan(image), ~expected)
    np.testing.assert_array_equal(image[0], [0, 1, np.nan, np.nan])
    assert grid.fill(np.ones(12), outside=0.0)[0, 3] == 0


def test_a_grid_that_misses_the_sheet_is_refused():
    ring = Outline.circle(1.0, holes=[[[-0.5, -0.5], [0.5, -0.5], [0.5, 0.5], [-0.5, 0.5]]])
    with pytest.raises(InputError, match="a finer grid is needed"):
        Grid(ring, 1, 1)
