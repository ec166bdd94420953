"""The free search: gradient, constraints, symmetries, and that it finds better layouts."""

from dataclasses import replace

import numpy as np
import pytest

from tomotactile_ros.evaluation.layout_quality import evaluate_layout
from tomotactile_ros.evaluation.paper_model import paper_transfer
from tomotactile_ros.evaluation.point_spread import PointSpread, gram_blocks
from tomotactile_ros.evaluation.symmetry import find_symmetry
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout, equal_grid
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.layouts.region import Region, regular_polygon
from tomotactile_ros.optimizer.constraints import Constraints
from tomotactile_ros.optimizer.descent import Descending, Probing
from tomotactile_ros.optimizer.free import free
from tomotactile_ros.optimizer.objective import Aims, Objective
from tomotactile_ros.optimizer.orbits import find_orbits, shared_group
from tomotactile_ros.optimizer.request import Request
from tomotactile_ros.optimizer.scenes import SceneBlur, Scenes
from tomotactile_ros.optimizer.search import Effort
from tomotactile_ros.optimizer.step import best_of
from tomotactile_ros.sheet.sensitivity import Sensitivity
from tomotactile_ros.support.errors import Doubt

SQUARE = Outline.rectangle(0.2, 0.2)
SHORT = Effort(starts=2, rounds=2, descents=3, probes=2)


@pytest.mark.parametrize(
    "rows, size, move, noise_gain, scenes",
    [
        (4, (0.2, 0.2), 0, 1.0, None),
        (3, (0.25, 0.2), 0, 1e9, 1.0),
        (3, (0.2, 0.2), 0.004, 1.0, None),
    ],
)
def test_gradient_through_symmetries_and_green_function(rows, size, move, noise_gain, scenes):
    """Noise gain and scenes are smooth: their gradient must be that of differences, along every
    parameter."""
    reference = equal_grid(rows, 4, size, 0.003, 1e4, inset=0.02)
    aims = Aims((1e9, 1e9, 1e9), (1e9, 1e9, 1e9), noise_gain, scenes)
    objective = Objective(reference, 200.0, aims, resolution=14)
    positions = reference.positions * 0.93 + [move, move / 2]
    orbits = find_orbits(positions, shared_group(reference.outline, positions))
    parameters = orbits.parameters(positions)
    score, gradient = objective(positions)
    assert score == objective.score(positions)
    for i, slope in enumerate(orbits.matrix.T @ gradient.ravel()):
        move = 1e-6 * np.eye(len(parameters))[i]
        up, down = (objective.score(orbits.positions(parameters + s * move)) for s in (1, -1))
        assert slope == pytest.approx((up - down) / 2e-6, rel=1e-4, abs=1e-5)


def test_figures_are_means_over_lattices_of_what_evaluate_says():
    reference = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
    moved = replace(reference, positions=0.9 * reference.positions)
    found = Objective(reference, 500.0, resolution=20).figures(moved.positions)
    ratios = []
    for resolution in (20, 22):  # 21.5 rounded
        how = {"resolution": resolution, "regularization": 500.0 * (resolution / 40) ** 2}
        before, after = (evaluate_layout(each, **how).metrics for each in (reference, moved))
        ratios.append(
            [
                after["hwhm"]["mean"] / before["hwhm"]["mean"],
                after["position_error"]["mean"] / before["position_error"]["mean"],
                after["noise_gain"] / before["noise_gain"],
            ]
        )
    assert found[[0, 2, 3]] == pytest.approx(np.mean(ratios, axis=0))


TRIANGLE = Outline.polygon([[-0.1, -0.1], [0.1, -0.1], [0, 0.1]])
FOUR = 0.04 * np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]])
SYMMETRIC = [(SQUARE, FOUR, 8), (Outline.circle(0.1), FOUR, 8)]
SYMMETRIC += [(Outline.rectangle(0.3, 0.2), FOUR, 4)]
SYMMETRIC += [(TRIANGLE, np.array([[-0.04, -0.05], [0.04, -0.05], [0, 0.02]]), 2)]


@pytest.mark.parametrize("outline, positions, elements", SYMMETRIC)
def test_symmetries_shared_with_the_outline(outline, positions, elements):
    assert len(shared_group(outline, positions)) == elements
    assert len(shared_group(outline, positions + [0.001, 0.002])) == 1


@pytest.mark.parametrize("x, y", [(0.0, 0.075), (0.03, 0.1)])
def test_zones_without_the_symmetries_of_the_layout_stay_free(x, y):
    """Electrodes of scaled grids lie in the first, on one side alone; the second covers the
    start."""
    layout = equal_grid(4, 4, (0.2, 0.2), 0.004, 1e4)
    how = {"keep_out": ((x, y, 0.04),), "spacing": 0.02, "margin": 0.01}
    request = Request(layout, "free", **how, starts=1, steps=1, resolution=10)
    with pytest.warns(Doubt, match="of the 8 symmetries"):
        history, best = best_of(request.steps_of())
    found = request.result("found", history, best)
    zone = Region(regular_polygon(0.04) + [x, y])
    constraints = Constraints(SQUARE, 0.02, 0.01, (zone,))
    assert all(constraints.kept_by(s.layout.positions) for s in history[1:] if s.best)
    assert np.linalg.norm(found.positions - [x, y], axis=1).min() > 0.04 - 1e-9
    mirrored = [-1, 1] * found.positions
    away = np.linalg.norm(mirrored[:, None] - found.positions, axis=2).min(axis=1).max()
    assert (away < 1e-9) == (x == 0)


def test_search_improves_every_figure():
    layout = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
    found = list(free(layout, aims=Aims(other=(0.95, 0.95, 1.5)), effort=SHORT, resolution=20))
    scores = [step.score for step in found]
    assert scores == sorted(scores, reverse=True)
    before, after = found[0].metrics, found[-1].metrics
    assert after["hwhm"]["mean"] < 0.9 * before["hwhm"]["mean"]
    assert after["hwhm"]["worst_tenth"] < 0.95 * before["hwhm"]["worst_tenth"]
    assert after["position_error"]["mean"] < 0.9 * before["position_error"]["mean"]
    assert len(shared_group(SQUARE, found[-1].layout.positions)) == 8


def test_a_polygon_with_a_hole_through_finite_elements():
    bracket = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.0], [0.02, 0.02], [0.0, 0.1], [-0.1, 0.1]]
    hole = [[-0.06, -0.06], [-0.03, -0.06], [-0.03, -0.03], [-0.06, -0.03]]
    outline = Outline.polygon(bracket, holes=[hole])
    positions = [[-1, -1], [0, -1], [1, -1], [1, -0.1], [0, 0.3], [-1, 0], [-1, 1]]
    layout = Layout("start", outline, 1e4, 0.004, 0.09 * np.array(positions))
    constraints = Constraints(outline, 0.01, 0.005)
    effort = Effort(starts=1, rounds=1, descents=1, probes=1)
    start, last = free(layout, constraints=constraints, effort=effort, resolution=10)
    assert last.score < start.score and constraints.kept_by(last.layout.positions)
    assert np.isfinite(last.quality.quality.hwhm).all()


@pytest.mark.parametrize("aim", [1e7, 1e200])
def test_what_is_not_better_by_a_millionth_does_not_take_the_place_of_the_start(aim):
    layout = equal_grid(3, 3, (0.2, 0.2), 0.004, 1e4)
    aims = Aims((aim,) * 3, (aim,) * 3, aim)
    found = list(free(layout, aims=aims, effort=SHORT, resolution=8))
    assert len(found) == SHORT.total(layout) + 1
    assert {step.score for step in found} == {found[0].score}
    assert np.array_equal(found[-1].layout.positions, layout.positions)


def test_descent_and_probing_find_a_minimum():
    centre = np.array([0.3, -0.2, 0.1])
    scale = np.array([1.0, 5.0, 20.0])

    def value(p):
        return float((scale * (p - centre) ** 2).sum())

    descent = Descending(np.zeros(3), step=0.01)
    for _ in range(6):
        descent.run(lambda p: (value(p), 2 * scale * (p - centre)), lambda p: p, 10)
    assert descent.best == pytest.approx(centre, abs=1e-3)
    assert descent.score == value(descent.best)
    probing = Probing(np.zeros(3), value(np.zeros(3)), step=0.0125, reach=8.0)
    probing.run(lambda p: (p, value(p)), 840)
    assert probing.best == pytest.approx(centre, abs=1e-3)
    assert probing.score == value(probing.best)


def test_descent_goes_on_beyond_jumps_and_along_what_is_forbidden():
    """Steps in the way end the line search; nothing is feasible beyond 0.3."""
    looked = []

    def look(p):
        looked.append(p)
        bowl = 10 * ((p - 0.25) ** 2).sum()
        return bowl + 0.02 * np.floor(40 * p[1]) % 0.04, 20 * (p - 0.25)

    descent, scores = Descending(np.array([0.0, -0.3]), step=0.02), []
    for count in (1, 2, 7, 20, 30):
        descent.run(look, lambda p: None if p[0] > 0.3 else p, count)
        scores.append(descent.score)
    assert scores == sorted(scores, reverse=True) and len(looked) <= 60
    assert descent.score < 0.05 and descent.best[0] <= 0.3


LAYOUT = equal_grid(4, 4, (0.2, 0.2), 0.004, 1e4, inset=0.02)
GRID = Grid.for_outline(LAYOUT.outline, 16)


def test_blur_is_that_of_sums_of_point_spreads():
    """Images by the dense formula, without symmetry."""
    matrix = Sensitivity(paper_transfer(LAYOUT, GRID.pixels)).dense()
    gram = matrix.T @ matrix
    images = np.linalg.solve(gram + 100.0 * np.eye(len(gram)), gram)
    scenes = Scenes(GRID, LAYOUT.electrodes)
    blurs = []
    for contact in scenes.contacts.T.astype(bool):
        image = images[:, contact].sum(axis=1)
        away = np.linalg.norm(GRID.pixels[:, None] - GRID.pixels[contact], axis=2).min(axis=1)
        blurs.append(np.sqrt((image**2 @ away**2) / (image @ image)))
    symmetry = find_symmetry(GRID, LAYOUT.positions)
    transfer = paper_transfer(LAYOUT, GRID.pixels, symmetry=symmetry)
    spread = PointSpread(gram_blocks(transfer, GRID, symmetry), 100.0)
    assert SceneBlur(scenes, spread).value == pytest.approx(np.mean(blurs), rel=1e-9)


def test_search_makes_scenes_sharper_where_they_count_alone():
    start = equal_grid(4, 4, (0.2, 0.2), 0.004, 1e4)
    anything = (10.0, 10.0, 10.0)
    aims = Aims(anything, anything, 10.0, scenes=0.8)
    effort = Effort(starts=2, rounds=2, descents=4, probes=0)
    *_, last = free(start, aims=aims, effort=effort, resolution=16)
    reached = Objective(start, aims=aims, resolution=16).figures(last.layout.positions)[-1]
    assert reached < 0.97
