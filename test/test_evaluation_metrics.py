"""HWHM, position error and blur against images whose answers are known."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tomotactile_ros.evaluation.metrics import blur, quality
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.outline import Outline

SQUARE = Outline.rectangle(0.2, 0.2)


def gaussian(grid, centre, sigma):
    return np.exp(-((grid.pixels - centre) ** 2).sum(axis=1) / (2 * sigma**2))


def test_hwhm_of_a_gaussian_converges_with_the_square_of_the_cell():
    sigma, centre = 0.02, np.zeros(2)
    exact = sigma * np.sqrt(2 * np.log(2))
    for cells in (21, 41, 81, 161):  # odd: a pixel lies on the peak
        grid = Grid(SQUARE, cells, cells)
        cell = grid.cell_size[0]
        image = gaussian(grid, centre, sigma)[None]
        result = quality(image, centre, grid)
        assert result.position_error[0] < 1e-12
        # linear interpolation along a lattice line that touches the contour, curvature 1 / exact
        assert abs(result.hwhm[0] - exact) <= cell**2 / (8 * exact)
        assert blur(image, centre[None], grid) == pytest.approx(sigma, rel=1e-3)


def test_position_error_and_blur_are_taken_from_the_true_position():
    grid = Grid.for_outline(SQUARE, 80)
    sigma, shift = 0.01, 0.03
    image = gaussian(grid, (0.0, 0.0), sigma)[None]
    result = quality(image, [[shift, 0.0]], grid)
    assert result.position_error[0] == pytest.approx(shift, abs=1e-12)
    assert result.blur[0] == pytest.approx(np.hypot(shift, sigma), rel=1e-3)


def test_the_rim_and_cells_outside_are_no_contour():
    grid = Grid.for_outline(Outline.circle(0.1), 40)
    image = gaussian(grid, (0.095, 0.0), 0.02)[None]
    result = quality(image, [[0.095, 0]], grid)
    # along the rim half the maximum is 0.0235 m from the peak; the centre lies further inside
    assert 0.02 < result.hwhm[0] < 0.035


def test_images_that_show_nothing_are_as_wide_as_the_sheet():
    grid = Grid.for_outline(SQUARE, 20)
    for value in (0.0, 1.0, -1.0):
        result = quality(np.full((2, 400), value), np.zeros((2, 2)), grid)
        assert result.hwhm == pytest.approx(np.sqrt(2) * 0.095)
        assert np.isfinite(result.blur).all()


@settings(max_examples=30, deadline=None)
@given(st.floats(-0.08, 0.08), st.floats(-0.08, 0.08), st.floats(0.006, 0.06), st.floats(1e-6, 1e6))
def test_mirrored_and_scaled_images_have_the_same_quality(x, y, sigma, scale):
    grid = Grid.for_outline(SQUARE, 24)
    image = gaussian(grid, (x, y), sigma)
    images = [image, scale * image]
    images += [grid.gather(grid.fill(image)[::-1]), grid.gather(grid.fill(image).T[::-1, ::-1])]
    result = quality(images, [[x, y], [x, y], [x, -y], [y, x]], grid)
    for values in (result.hwhm, result.position_error, result.blur):
        assert values == pytest.approx(values[0], rel=1e-6, abs=1e-9)
    assert result.hwhm[0] > 0
