"""The free search: gradient, constraints, symmetries, and that it finds better layouts."""

import pickle
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tomotactile_ros.evaluation.layout_quality import evaluate_layout
from tomotactile_ros.evaluation.metrics import half_maximum
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
from tomotactile_ros.optimizer.search import Effort
from tomotactile_ros.optimizer.sharpness import by_images
from tomotactile_ros.optimizer.step import best_of
from tomotactile_ros.support.errors import Doubt, InputError

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


def test_gradient_of_sharpness_is_that_of_smooth_images():
    """Wide smooth images, fine grid. Crossings nearly as far share the derivative: 30 %."""
    grid = Grid.for_outline(SQUARE, 80)
    target = np.array([[0.012, -0.007]])

    def image(p):
        x, y = grid.pixels.T - np.array(p[:2])[:, None]
        return np.exp(-(x**2) / (2 * p[2] ** 2) - y**2 / (2 * p[3] ** 2))[:, None]

    start = np.array([0.003, 0.002, 0.025, 0.016])
    first = image(start)
    found = half_maximum(first, grid)

    def figures(p):
        found = half_maximum(image(p), grid)
        return found.hwhm[0], np.linalg.norm(found.centre - target)

    for index, by in enumerate(np.eye(2)):
        derivative = by_images(found, first, target, grid, by[:1], by[1:])[:, 0]
        for axis, step in enumerate((4e-3, 4e-3, 2e-3, 2e-3)):
            move = step * np.eye(4)[axis]
            ends = [figures(start + s * move)[index] for s in (1, -1)]
            slope = (ends[0] - ends[1]) / (2 * step)
            change = (image(start + 1e-6 * move) - image(start - 1e-6 * move))[:, 0]
            assert derivative @ change / (2e-6 * step) == pytest.approx(slope, abs=0.3)


@pytest.mark.parametrize(
    "outline, elements",
    [
        (SQUARE, 8),
        (Outline.circle(0.1), 8),
        (Outline.rectangle(0.3, 0.2), 4),
        (Outline.polygon([[-0.1, -0.1], [0.1, -0.1], [0, 0.1]]), 2),
    ],
)
def test_symmetries_shared_with_the_outline(outline, elements):
    four = 0.04 * np.array([[-1, -1], [1, -1], [-1, 1], [1, 1]])
    if elements == 2:
        four = np.array([[-0.04, -0.05], [0.04, -0.05], [0, 0.02]])
    assert len(shared_group(outline, four)) == elements
    assert len(shared_group(outline, four + [0.001, 0.002])) == 1


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**32 - 1), st.integers(2, 30), st.sampled_from(["square", "circle", "hole"]))
def test_projection_ends_inside_or_nowhere(seed, count, kind):
    outline = {
        "square": SQUARE,
        "circle": Outline.circle(0.1),
        "hole": Outline.rectangle(0.2, 0.2, holes=[0.3 * SQUARE.shell]),
    }[kind]
    disc = Region(regular_polygon(0.02) + [0.05, 0.05])
    constraints = Constraints(outline, 0.02, 0.01, (disc,))
    positions = np.random.default_rng(seed).uniform(-0.12, 0.12, (count, 2))
    projected = constraints.project(positions)
    assert projected is None or constraints.violation(projected) <= constraints.tolerance


@pytest.mark.parametrize(
    "spacing, margin, message",
    [
        (0.003, 0.0, "lets electrodes of 0.002 m radius overlap"),
        (0.1, 0.0, "do not fit 0.1 m apart"),
        (0.005, 0.1, "leaves no room"),
        (0.005, -0.1, "margin: -0.1 is negative"),
    ],
)
def test_impossible_constraints(spacing, margin, message):
    layout = equal_grid(4, 4, (0.2, 0.2), 0.002, 1e4)
    with pytest.raises(InputError, match=message):
        next(free(layout, constraints=Constraints(SQUARE, spacing, margin)))


def test_constraints_hold_after_every_step():
    layout = equal_grid(4, 4, (0.2, 0.2), 0.004, 1e4)
    disc = Region(regular_polygon(0.015) + [0.03, 0.03])
    constraints = Constraints(SQUARE, 0.03, 0.02, (disc,))
    found = list(free(layout, constraints=constraints, effort=SHORT, resolution=10))
    assert len(found) == SHORT.total(layout) + 1
    for step in found[1:]:
        if step.best:
            assert constraints.violation(step.layout.positions) <= constraints.tolerance


@pytest.mark.parametrize("x, y", [(0.0, 0.075), (0.03, 0.1)])
def test_zones_without_the_symmetries_of_the_layout_stay_free(x, y):
    """Electrodes of scaled grids lie in the first, on one side alone; the second covers the
    start."""
    layout = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
    how = {"keep_out": ((x, y, 0.04),), "starts": 1, "steps": 1, "resolution": 10}
    request = Request(layout, "free", **how)
    with pytest.warns(Doubt, match="of the 8 symmetries"):
        history, best = best_of(request.steps_of())
    found = request.result("found", history, best)
    assert np.linalg.norm(found.positions - [x, y], axis=1).min() > 0.04 - 1e-9
    mirrored = [-1, 1] * found.positions
    away = np.linalg.norm(mirrored[:, None] - found.positions, axis=2).min(axis=1).max()
    assert (away < 1e-9) == (x == 0)


def test_search_improves_every_figure_and_in_processes_as_well():
    layout = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
    aims = Aims(other=(0.95, 0.95, 1.5))
    alone = list(free(layout, aims=aims, effort=SHORT, resolution=20))
    with ProcessPoolExecutor(2) as executor:
        together = list(free(layout, aims=aims, effort=SHORT, resolution=20, executor=executor))
    assert [step.score for step in alone] == [step.score for step in together]
    assert np.array_equal(alone[-1].layout.positions, together[-1].layout.positions)
    scores = [step.score for step in alone]
    assert scores == sorted(scores, reverse=True)
    before, after = alone[0].metrics, alone[-1].metrics
    assert after["hwhm"]["mean"] < 0.9 * before["hwhm"]["mean"]
    assert after["hwhm"]["worst_tenth"] < 0.95 * before["hwhm"]["worst_tenth"]
    assert after["position_error"]["mean"] < 0.9 * before["position_error"]["mean"]
    assert len(shared_group(SQUARE, alone[-1].layout.positions)) == 8


ANGLE = 2 * np.pi * (np.arange(8) + 0.5) / 8
BRACKET = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.0], [0.02, 0.02], [0.0, 0.1], [-0.1, 0.1]]
HOLE = [[-0.06, -0.06], [-0.03, -0.06], [-0.03, -0.03], [-0.06, -0.03]]


@pytest.mark.parametrize(
    "outline, positions",
    [
        (Outline.circle(0.1), 0.094 * np.column_stack([np.cos(ANGLE), np.sin(ANGLE)])),
        (
            Outline.polygon(BRACKET, holes=[HOLE]),
            0.09 * np.array([[-1, -1], [0, -1], [1, -1], [1, -0.1], [0, 0.3], [-1, 0], [-1, 1]]),
        ),
    ],
    ids=["circle", "polygon with a hole"],
)
def test_outlines_through_finite_elements(outline, positions):
    layout = Layout("start", outline, 1e4, 0.004, positions)
    constraints = Constraints(outline, 0.01, 0.005)
    effort = Effort(starts=1, rounds=1, descents=1, probes=1)
    found = list(free(layout, constraints=constraints, effort=effort, resolution=10))
    assert len(found) == 2
    assert found[-1].score < found[0].score
    assert constraints.violation(found[-1].layout.positions) <= constraints.tolerance
    quality = evaluate_layout(found[-1].layout, resolution=10)
    assert np.isfinite(quality.quality.hwhm).all()


def test_flat_objective_keeps_the_start():
    layout = equal_grid(3, 3, (0.2, 0.2), 0.004, 1e4)
    aims = Aims((1e200,) * 3, (1e200,) * 3, 1e200)
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

    def value_and_gradient(p):
        bowl = 10 * ((p - 0.25) ** 2).sum()
        return bowl + 0.02 * np.floor(40 * p[1]) % 0.04, 20 * (p - 0.25)

    def feasible(p):
        return None if p[0] > 0.3 else p

    descent = Descending(np.array([0.0, -0.3]), step=0.02)
    scores, looked = [], 0

    def look(p):
        nonlocal looked
        looked += 1
        return value_and_gradient(p)

    for count in (1, 2, 7, 20, 30):
        descent.run(look, feasible, count)
        descent = pickle.loads(pickle.dumps(descent))
        scores.append(descent.score)
    assert scores == sorted(scores, reverse=True) and looked <= 60
    assert descent.score < 0.05 and descent.best[0] <= 0.3
