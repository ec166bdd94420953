"""Outlines, layouts at their limits, grids and rings and the command that writes them, and the cells of an image."""

import re
import shlex

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tomotactile_ros import cli
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout, Outline, equal_grid, load_layout
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import find_config

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


# -- arrangements ----------------------------------------------------------------------------------


def test_a_hexagonal_grid_gives_every_inner_electrode_six_neighbours_at_one_distance():
    pitch = 0.02
    size = 6 * pitch + 0.03, 4 * pitch * np.sqrt(3) / 2 + 0.03
    layout = equal_grid(5, 7, size, 0.002, 1e4, inset=0.015, hexagonal=True)
    assert layout.electrodes == 6 + 7 + 6 + 7 + 6
    inner = layout.outline.rim_distance(layout.positions) > 0.015 + 0.75 * pitch
    assert inner.sum() == 5 + 4 + 5 and layout.pitches == pytest.approx(pitch)
    apart = np.linalg.norm(layout.positions[:, None] - layout.positions, axis=2)
    assert (np.count_nonzero(apart < 1.01 * pitch, axis=1)[inner] == 1 + 6).all()


@pytest.mark.parametrize(
    "name", ["equal-4x4", "equal-8x8", "equal-16x16", "small-4x4", "small-8x8", "hex-37", "ring-16"]
)
def test_shipped_layouts_come_from_the_command_that_they_name(name, tmp_path):
    """Byte for byte: places, their order, keys and how numbers are written."""
    shipped = find_config("layouts", name)
    words = shlex.split(load_layout(shipped).provenance["settings"]["command"])
    again = tmp_path / f"{name}.yaml"
    assert words[0] == "tomotactile"
    assert cli.main([*words[1:], "--out", str(again)]) == 0
    assert again.read_bytes() == shipped.read_bytes()


@pytest.mark.parametrize("words", ["--size 0.1 0.07", "--size 0.2 0.14 --hex", "--size 0.07 0.1"])
def test_numbers_of_a_file_read_well_and_keep_the_id(words, tmp_path):
    """0.035, and neither 0.0035000000000000005 nor -0.034999999999999996."""
    out = tmp_path / "out.yaml"
    words = f"layout --rows 5 --cols 5 {words} --inset 0.01 --out {out}"
    assert cli.main(words.split()) == 0
    layout = load_layout(out)
    assert max(map(len, re.findall(r"\d\.(\d+)", out.read_text()))) <= 12
    layout.save(out)
    assert load_layout(out).id == layout.id
