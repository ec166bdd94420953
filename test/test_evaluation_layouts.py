"""Quality of images of layouts: HWHM, errors, blur, regions, point spreads, `evaluate --profile`."""

import json

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tomotactile_ros import cli
from tomotactile_ros.evaluation import profile_quality
from tomotactile_ros.evaluation.gram import Gram
from tomotactile_ros.evaluation.layout_quality import evaluate_layout
from tomotactile_ros.evaluation.metrics import blur, quality
from tomotactile_ros.evaluation.paper_model import green, green_self, paper_transfer
from tomotactile_ros.evaluation.point_nodes import point_nodes_transfer
from tomotactile_ros.evaluation.point_spread import PointSpread, gram_blocks
from tomotactile_ros.evaluation.profile_quality import evaluate_profile, off_lattice
from tomotactile_ros.evaluation.regions import layout_regions, quadrilaterals
from tomotactile_ros.evaluation.symmetry import find_symmetry
from tomotactile_ros.layouts.arrangements import electrode_ring
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout, equal_grid
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.reconstruction import Settings
from tomotactile_ros.sheet import ClosedFormSheet, make_sheet
from tomotactile_ros.sheet.sensitivity import Sensitivity

SQUARE = Outline.rectangle(0.2, 0.2)
CORNERS = [[-0.1, -0.1], [0.1, -0.1], [0.1, -0.03], [-0.03, -0.03], [-0.03, 0.1], [-0.1, 0.1]]


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
    result = quality(gaussian(grid, (0.095, 0.0), 0.02)[None], [[0.095, 0]], grid)
    # along the rim half the maximum is 0.0235 m from the peak; the centre lies further inside
    assert 0.02 < result.hwhm[0] < 0.035


def test_images_that_show_nothing_are_as_wide_as_the_sheet():
    grid = Grid.for_outline(SQUARE, 20)
    for value in (0.0, 1.0, -1.0):
        result = quality(np.full((2, 400), value), np.zeros((2, 2)), grid)
        assert result.hwhm == pytest.approx(np.sqrt(2) * 0.095)
        assert np.isfinite(result.blur).all()


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


@pytest.mark.parametrize(
    "layout, shape, places, owners",
    [
        (equal_grid(3, 5, (0.4, 0.2), 0.002, 1e4), (2, 4, True),
         [[-0.19, -0.01], [0.19, 0.01], [0.01, -0.09]], [0, 7, 2]),
        # outside all regions: the nearest
        (equal_grid(3, 3, (0.2, 0.2), 0.002, 1e4, inset=0.03), (2, 2, True),
         [[-0.09, -0.09], [0.09, 0.02], [0.01, 0.099]], [0, 3, 3]),
        # no grid: blocks
        (electrode_ring(16, 0.1, 0.002, 1e4), (3, 3, False), [[-0.05, -0.05], [0, 0.0]], [0, 4]),
    ],
)  # fmt: skip
def test_regions_of_a_layout(layout, shape, places, owners):
    regions = layout_regions(layout)
    assert (regions.rows, regions.cols, regions.electrodes) == shape
    rim = 2 * layout.outline.rim_distance(layout.positions).min()
    whole = np.prod(np.array(layout.outline.size) - rim)
    assert regions.areas == pytest.approx(whole / (shape[0] * shape[1]))
    assert regions.of(places).tolist() == owners


def test_quarters_of_a_warped_grid_own_their_points():
    random = np.random.default_rng(0)
    layout = equal_grid(4, 4, (0.2, 0.2), 0.002, 1e4)
    moves = random.uniform(-0.01, 0.01, (16, 2)) * (abs(layout.positions) < 0.09)
    regions = quadrilaterals(layout.positions + moves, 4, 4)
    points = random.uniform(-0.099, 0.099, (20000, 2))
    share = np.bincount(regions.of(points), minlength=9) / len(points)
    assert share == pytest.approx(regions.areas / 0.04, abs=0.012)


def test_potentials_of_single_nodes_far_from_the_source_are_those_of_the_closed_form():
    layout = equal_grid(4, 4, (0.2, 0.2), 0.001, 1.0, inset=0.02)
    grid = Grid.for_outline(layout.outline, 40)
    found = point_nodes_transfer(layout, grid).impedance(0)
    right = make_sheet(layout, "closed_form", shunting=False).transfer(grid.pixels, 0.001)
    far = np.linalg.norm(grid.pixels - layout.positions[0], axis=1) > 0.03
    for one in (5, 15):  # both differ by what the grounded node itself lacks, which is the same
        away = far & (np.linalg.norm(grid.pixels - layout.positions[one], axis=1) > 0.03)
        lack = found[one] - right.impedance(0)[one]
        assert np.ptp(lack[away]) < 0.01 * np.ptp(found[one, away])


@pytest.mark.parametrize("outline", [Outline.circle(0.1), Outline.rectangle(0.2, 0.1)])
def test_single_nodes_are_reciprocal_and_a_contact_on_an_electrode_is_that_electrode(outline):
    grid = Grid.for_outline(outline, 20)
    places = grid.pixels[[20, 60, 100]] + [[0, 0], [0.001, 0.0005], [0, 0.002]]
    transfer = point_nodes_transfer(Layout("three", outline, 1.0, 0.001, places), grid)
    assert transfer.electrode_of[20] == 0 and np.count_nonzero(transfer.electrode_of >= 0) == 1
    assert transfer.impedance(0)[:, 20] == pytest.approx(0, abs=1e-9)
    between = transfer.green(*2 * [np.arange(len(grid.pixels))])
    assert between == pytest.approx(between.T, abs=1e-9)
    assert (transfer.self_impedance()[1:] > 0).all()


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


def test_gram_of_some_rows_is_that_of_the_dense_sensitivity():
    layout = warped(3, 4, move=(0.004, -0.003))
    grid = Grid.for_outline(layout.outline, 9)
    grounded, rows = [0, 5, 2], np.array([3, 0, 50])
    for transfer in (
        paper_transfer(layout, grid.pixels),
        ClosedFormSheet(layout).transfer(grid.pixels, 1e-3),
    ):
        expected = dense(transfer, 1.0, grounded)[0]
        found = Gram(transfer, grounded).rows(rows)
        assert found == pytest.approx(expected[rows], rel=1e-9, abs=1e-9 * expected.max())


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
    for name in ("position_error", "hwhm", "blur"):
        assert getattr(quick, name) == pytest.approx(getattr(plain, name), abs=1e-12)


def test_a_ring_on_a_round_sheet_is_evaluated_where_the_sheet_is():
    layout = electrode_ring(7, 0.1, 0.003, 1e4, inset=0.02)
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
    points = np.array([[0.02, 0.03], [0.02, 0.1], [-0.15, -0.1]])
    for centre in points:
        around = centre + circle
        around = around[(np.abs(around) <= np.array(size) / 2).all(axis=1)]
        for offset in (0.0, 0.4, 0.9, 1.5):
            source = centre * (1 - 1e-9) - offset * radius * np.sign(centre) / np.sqrt(2)
            exact = green(around, source[None], size, 1e-6).mean()
            assert green([centre], [source], size, radius)[0, 0] == pytest.approx(exact, abs=3e-3)
    own = np.diagonal(green(points, points, size, radius))
    assert green_self(points, size, radius) == pytest.approx(own, abs=1e-12)


@pytest.fixture(scope="module")
def ell():
    outline = Outline.polygon(CORNERS)
    every = equal_grid(6, 6, (0.2, 0.2), 0.0025, 1e4, inset=0.01).positions
    return Layout("ell", outline, 1e4, 0.0025, every[outline.contains(every)])


def test_places_of_contacts_lie_in_their_cells_and_nowhere_on_the_lattice(ell):
    grid = Grid.for_outline(ell.outline, 40)
    radii = np.array([0.002, 0.012])
    places, sizes = off_lattice(grid, radii, np.random.default_rng(0))
    pixel = np.abs(places[:, None] - grid.pixels).max(axis=2).argmin(axis=1)
    away = np.abs(places - grid.pixels[pixel])
    assert len(np.unique(pixel)) == len(places) and away.max() <= 0.0025
    assert 0.0010 < away.mean() < 0.0014  # evenly over the cell: a quarter of it
    assert ell.outline.contains(places).all()
    assert (ell.outline.rim_distance(places) >= sizes).all()
    near = ell.outline.rim_distance(places) < 0.0115
    assert (sizes[near] == 0.002).all() and set(sizes[~near]) == {0.002, 0.012}


def test_the_error_of_places_is_not_that_of_the_lattice():
    """Where contact, pixel and assumed size coincided it was 0.00 mm."""
    found = evaluate_profile(equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4), "balanced", resolution=8)
    assert Settings().contact_radius not in found.settings["contact_radius"]
    assert found.contacts["frames"] == len(found.quality.positions) > 55
    assert found.contacts["place"]["median"] > 5e-5
    assert found.contacts["force"]["median"] > 0.01
    assert (found.quality.position_error > 1e-4).mean() > 0.95


def test_regions_outside_the_outline_are_left_out(ell):
    found = evaluate_profile(ell, "fast", resolution=8)
    regions = found.by_region()
    places = {(region["row"], region["col"]) for region in regions}
    assert len(regions) == 8 and (2, 2) not in places
    assert sum(region["area"] for region in regions) == pytest.approx(ell.outline.area)
    assert sum(region["contacts"] for region in regions) == len(found.quality.positions)
    worst = max(region["hwhm"] for region in regions)
    assert found.metrics["hwhm"]["worst_region"] == worst


WORDS = ["evaluate", "--layout", "equal-4x4", "--profile", "fast", "--resolution", "4"]


@pytest.mark.parametrize("every", [2, 1])
def test_withheld_images_are_in_no_figure(monkeypatch, capsys, every):
    class Withholding(profile_quality.Pipeline):
        count = 0

        def process(self, *frame):
            self.count += 1
            result = super().process(*frame)
            if self.count % every == 0:
                result.pressure, result.reason = np.full_like(result.pressure, np.nan), "torn"
            return result

    monkeypatch.setattr(profile_quality, "Pipeline", Withholding)
    assert cli.main(WORDS) == (0 if every == 2 else 2)
    said = capsys.readouterr()
    assert "nan" not in said.out and ("withheld 8, left out" in said.out) == (every == 2)
    if every == 2:
        assert all(word in said.out for word in ("ghosts", "missed", "OSPA"))
    else:
        assert "all images are withheld, the last one: torn" in said.err


def test_the_command_states_ghosts_and_misses_beside_places(capsys):
    assert cli.main([*WORDS, "--contact-radius", "0.004", "--json"]) == 0
    content = json.loads(capsys.readouterr().out)
    assert content["settings"]["contact_radius"] == [0.004]
    assert {"ghosts", "missed", "place", "force", "ospa"} <= set(content["contacts"])
