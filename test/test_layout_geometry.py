"""Outlines, equal grids, a layout at its limits, and the cells of an image."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout, Outline, equal_grid
from tomotactile_ros.support.errors import InputError

HOLE = [[-0.2, -0.2], [0.2, -0.2], [0.2, 0.2], [-0.2, 0.2]]


def test_equal_grid_counts_row_by_row_from_the_lower_left():
    layout = equal_grid(2, 3, (0.4, 0.2), 0.01, 1e4)
    assert layout.name == "equal-2x3"
    np.testing.assert_array_equal(
        layout.positions, [[-0.2, -0.1], [0, -0.1], [0.2, -0.1], [-0.2, 0.1], [0, 0.1], [0.2, 0.1]]
    )


@given(n=st.integers(2, 16), side=st.floats(1e-3, 10.0), aspect=st.floats(0.01, 1.0))
def test_every_grid_size_and_shape_makes_a_mirror_symmetric_layout(n, side, aspect):
    pitch = side * aspect / (n - 1)
    layout = equal_grid(n, n, (side, side * aspect), 0.499 * pitch, 1e4, unusual_size=True)
    grid = layout.positions.reshape(n, n, 2)
    np.testing.assert_array_equal(grid[:, ::-1] * [-1, 1], grid)
    np.testing.assert_array_equal(grid[::-1] * [1, -1], grid)


def test_electrodes_may_all_but_touch_and_sit_on_any_rim():
    gap = 0.01 * (1 + 1e-9)
    Layout("near", Outline.rectangle(0.2, 0.2), 1e4, 0.005, [[0.0, 0.0], [gap, 0.0]])
    angle = np.linspace(0, 2 * np.pi, 37)[:-1] + 0.01
    rim = 0.1 * np.column_stack([np.cos(angle), np.sin(angle)])
    assert Layout("round", Outline.circle(0.1), 1e4, 0.002, rim).electrodes == 36
    with pytest.raises(InputError, match=r"positions\[0\].*lies outside the outline \(circle"):
        Layout("out", Outline.circle(0.1), 1e4, 0.002, rim * (1 + 1e-6))
    corners = np.array([[-2, -1], [0, -2], [2, -1], [2, 1], [0.5, 2], [-2, 1]])
    assert Layout("corners", Outline.polygon(corners), 1e4, 0.1, corners).electrodes == 6


def test_positions_do_not_follow_their_source():
    source = np.array([[0.0, 0.0], [0.1, 0.0]])
    layout = Layout("fixed", Outline.rectangle(0.3, 0.3), 1e4, 0.005, source)
    source[0] = 5
    assert layout.positions[0, 0] == 0


def test_rectangle_circle_and_polygon_measure_up():
    rectangle = Outline.rectangle(0.4, 0.2, holes=[np.array(HOLE) / 4])
    assert rectangle.size == (0.4, 0.2) and rectangle.bounds == (-0.2, -0.1, 0.2, 0.1)
    assert rectangle.area == pytest.approx(0.08 - 0.01, rel=1e-14)
    assert not rectangle.is_uniform_rectangle
    assert Outline.rectangle(0.4, 0.2).is_uniform_rectangle
    circle = Outline.circle(0.1)
    assert circle.area == pytest.approx(np.pi * 0.01, rel=1e-14)
    assert circle.size == pytest.approx((0.2, 0.2), rel=1e-14)
    assert len(circle.shell) >= 128
    assert np.linalg.norm(circle.shell, axis=1).max() < 0.1 * 1.0001


def test_contains_and_rim_distance():
    outline = Outline.rectangle(1.0, 1.0, holes=[HOLE])
    points = np.array([[0.0, 0.0], [0.3, 0.0], [0.5, 0.5], [0.2, 0.0], [0.5001, 0.0], [9, 9]])
    assert outline.contains(points).tolist() == [False, True, True, True, False, False]
    assert outline.contains(points, 2e-4).tolist() == [False, True, True, True, True, False]
    np.testing.assert_allclose(outline.rim_distance(points[:5]), [0.2, 0.1, 0, 0, 1e-4], atol=1e-15)
    circle = Outline.circle(1.0, holes=[HOLE])
    points = np.array([[0.0, 0.0], [0.6, 0.8], [0.0, 0.9], [0.0, 1.5], [1.00005, 0.0]])
    assert circle.contains(points, 1e-12).tolist() == [False, True, True, False, False]
    np.testing.assert_allclose(circle.rim_distance(points), [0.2, 0, 0.1, 0.5, 5e-5], atol=1e-12)


@given(scale=st.floats(1e-3, 1e3))
def test_polygon_must_be_centred_to_a_millionth(scale):
    square = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    assert Outline.polygon(scale * (square + 1e-6), unusual_size=True).size[0] == pytest.approx(
        2 * scale
    )
    with pytest.raises(InputError, match="move all points"):
        Outline.polygon(scale * (square + 4e-6), unusual_size=True)


@given(st.floats(1e-3, 10), st.floats(1e-3, 10), st.integers(1, 30), st.integers(1, 30))
def test_pixel_centres_follow_the_contract(a, b, height, width):
    grid = Grid(Outline.rectangle(a, b, unusual_size=True), height, width)
    x = -a / 2 + (np.arange(width) + 0.5) * a / width
    y = b / 2 - (np.arange(height) + 0.5) * b / height
    expected = np.stack(np.meshgrid(x, y), axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(grid.centres, expected, atol=1e-12 * (a + b))
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
