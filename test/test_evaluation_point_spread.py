"""Point spreads without J against the dense computation, and against published figures."""

import numpy as np
import pytest

from tomotactile_ros.evaluation.gram import Gram
from tomotactile_ros.evaluation.layout_quality import evaluate_layout
from tomotactile_ros.evaluation.paper_model import green, green_self, paper_transfer
from tomotactile_ros.evaluation.point_spread import PointSpread, gram_blocks
from tomotactile_ros.evaluation.symmetry import find_symmetry
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout, equal_grid
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.sheet import ClosedFormSheet
from tomotactile_ros.sheet.sensitivity import Sensitivity


def warped(rows, cols, size=(0.2, 0.2), move=(0.0, 0.0)):
    """A grid with its electrodes drawn to the middle, then all moved."""
    layout = equal_grid(rows, cols, size, 0.002, 1e4, inset=0.01)
    half = np.array(size) / 2
    positions = half * np.sin(1.3 * layout.positions / half) / np.sin(1.3) * 0.95 + move
    return Layout("warped", layout.outline, 1e4, 0.002, positions)


def dense(transfer, regularization, grounded=None):
    matrix = Sensitivity(transfer, grounded).dense()
    gram = matrix.T @ matrix
    inverse = np.linalg.inv(gram + regularization * np.eye(len(gram)))
    return gram, inverse @ gram, inverse


@pytest.mark.parametrize("grounded", [None, [0, 5, 2]])
def test_gram_is_the_product_of_the_dense_sensitivity(grounded):
    layout = warped(3, 4, move=(0.004, -0.003))
    grid = Grid.for_outline(layout.outline, 9)
    for transfer in (
        paper_transfer(layout, grid.pixels),
        ClosedFormSheet(layout).transfer(grid.pixels, 1e-3),
    ):
        expected = dense(transfer, 1.0, grounded)[0]
        rows = np.array([3, 0, 50])
        assert Gram(transfer, grounded).rows(rows) == pytest.approx(
            expected[rows], rel=1e-9, abs=1e-9 * expected.max()
        )


@pytest.mark.parametrize("grounded", [None, [0, 5, 2]])
def test_adjoint_of_the_gram_is_its_derivative(grounded):
    """Directional derivatives by central differences, one array at a time."""
    layout = warped(2, 3, move=(0.004, -0.003))
    grid = Grid.for_outline(layout.outline, 6)
    transfer = paper_transfer(layout, grid.pixels)
    random = np.random.default_rng(1)
    rows = np.array([4, 11, 30])
    seed = random.standard_normal((3, 36))
    adjoint = Gram(transfer, grounded).adjoint(rows, seed)
    for name, derivative in zip(("electrode_point", "electrode_electrode"), adjoint):
        direction = random.standard_normal(derivative.shape)
        values = []
        for sign in (1, -1):
            moved = getattr(transfer, name) + sign * 1e-6 * direction
            fields = {field: getattr(transfer, field) for field in transfer.__dataclass_fields__}
            fields[name] = moved
            values.append((seed * Gram(type(transfer)(**fields), grounded).rows(rows)).sum())
        slope = (values[0] - values[1]) / 2e-6
        assert (derivative * direction).sum() == pytest.approx(slope, rel=1e-6)


@pytest.mark.parametrize(
    "layout, resolution, kinds",
    [
        (warped(4, 4), 12, 21),
        (warped(3, 3), 9, 15),
        (warped(4, 3), 12, 36),
        (warped(4, 4, (0.3, 0.2)), 12, 24),
        (warped(4, 4, move=(0.003, 0)), 10, 50),
        (warped(4, 4, move=(0.003, 0.001)), 8, 64),
    ],
)
def test_symmetry_changes_nothing_but_the_work(layout, resolution, kinds):
    grid = Grid.for_outline(layout.outline, resolution)
    symmetry = find_symmetry(grid, layout.positions)
    transfer = paper_transfer(layout, grid.pixels, symmetry=symmetry)
    spread = PointSpread(gram_blocks(transfer, grid, symmetry), 10.0)
    first = spread.symmetry.first
    assert len(first) == kinds
    _, expected, inverse = dense(paper_transfer(layout, grid.pixels), 10.0)
    assert spread.images == pytest.approx(expected[:, first], abs=1e-10 * expected.max())
    noise = np.sqrt(np.trace(expected @ inverse) / len(expected))
    assert spread.noise_gain == pytest.approx(noise, rel=1e-9)
    plain = PointSpread(gram_blocks(paper_transfer(layout, grid.pixels), grid), 10.0).quality()
    quick = spread.quality()
    assert quick.position_error == pytest.approx(plain.position_error, abs=1e-12)
    assert quick.hwhm == pytest.approx(plain.hwhm, abs=1e-12)
    assert quick.blur == pytest.approx(plain.blur, abs=1e-12)


def test_images_are_those_of_the_formula_for_a_circle():
    outline = Outline.circle(0.1)
    angle = np.arange(7) * 2 * np.pi / 7
    positions = 0.08 * np.column_stack([np.cos(angle), np.sin(angle)])
    layout = Layout("ring", outline, 1e4, 0.003, positions)
    result = evaluate_layout(layout, resolution=14, regularization=100.0)
    assert result.settings["model"] == "fem"
    assert np.isnan(result.hwhm_map).sum() == 14 * 14 - len(result.grid.pixels)
    assert np.isfinite(result.quality.hwhm).all()


@pytest.mark.parametrize(
    "count, radius, mean, worst_region", [(4, 0.005, 0.362, 0.418), (8, 0.0025, 0.163, 0.197)]
)
def test_equal_grids_of_the_paper(count, radius, mean, worst_region):
    """Reference values of an independent reproduction, to 1 % (parts of the side)."""
    layout = equal_grid(count, count, (0.2, 0.2), radius, 1e4)
    hwhm = evaluate_layout(layout).metrics["hwhm"]
    assert hwhm["mean"] / 0.2 == pytest.approx(mean, rel=0.01)
    assert hwhm["worst_region"] / 0.2 == pytest.approx(worst_region, rel=0.01)


def test_points_with_a_radius_are_means_over_circles():
    """Mean over a circle of the field of a point: in the sheet, at the rim, in a corner."""
    size, radius = (0.3, 0.2), 0.004
    angle = 2 * np.pi * (np.arange(720) + 0.5) / 720
    circle = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    for centre in ([0.02, 0.03], [0.02, 0.1], [-0.15, -0.1]):
        around = np.array(centre) + circle
        around = around[(np.abs(around) <= np.array(size) / 2).all(axis=1)]
        for offset in (0.0, 0.4, 0.9, 1.5):
            source = np.array(centre) * (1 - 1e-9)
            source = source - offset * radius * np.sign(centre) / np.sqrt(2)
            exact = green(around, source[None], size, 1e-6).mean()
            assert green([centre], [source], size, radius)[0, 0] == pytest.approx(exact, abs=3e-3)
    points = np.array([[0.02, 0.03], [0.02, 0.1], [-0.15, -0.1]])
    assert green_self(points, size, radius) == pytest.approx(
        np.diagonal(green(points, points, size, radius)), abs=1e-12
    )


def test_closed_form_and_finite_elements_agree():
    layout = warped(4, 4)
    by_model = [
        evaluate_layout(layout, model=model, resolution=20).metrics
        for model in ("closed_form", "fem")
    ]
    for name in ("hwhm", "blur"):
        first, second = (metrics[name]["mean"] for metrics in by_model)
        assert first == pytest.approx(second, rel=0.03)
