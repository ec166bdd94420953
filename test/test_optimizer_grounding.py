"""Which ground conditions can be spared."""

import itertools

import numpy as np
import pytest

from tomotactile_ros.evaluation.paper_model import paper_transfer
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.optimizer.grounding import drop_order, scans
from tomotactile_ros.sheet.sensitivity import Sensitivity
from tomotactile_ros.support.errors import InputError


def variance(layout, grounded, regularization=1000.0):
    """Trace of (J'J + lambda^2 I)^-1 with these conditions, computed as it is written."""
    grid = Grid.for_outline(layout.outline, 20)
    matrix = Sensitivity(paper_transfer(layout, grid.pixels), grounded).dense()
    scaled = regularization * len(grid.pixels) / 1600
    return np.trace(np.linalg.inv(matrix.T @ matrix + scaled * np.eye(len(grid.pixels))))


def test_first_choices_are_the_best_single_ones():
    layout = equal_grid(2, 3, (0.3, 0.2), 0.005, 1e4)
    order = drop_order(layout)
    assert sorted(order) == list(range(6))
    left = list(range(6))
    for spared in order[:4]:
        costs = {each: variance(layout, [e for e in left if e != each]) for each in left}
        assert costs[spared] == pytest.approx(min(costs.values()), rel=1e-9)
        left.remove(spared)


def test_greedy_choice_is_nearly_the_best_of_all():
    layout = equal_grid(3, 3, (0.2, 0.2), 0.005, 1e4)
    chosen = drop_order(layout)[-4:]
    all_choices = [variance(layout, each) for each in itertools.combinations(range(9), 4)]
    start = 400 / 250  # of 400 pixels without any reading; lambda^2 = 250 at this resolution
    gained = start - variance(layout, np.sort(chosen))
    assert gained > 0.99 * (start - min(all_choices))


def test_accuracy_falls_with_the_number_of_conditions():
    layout = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
    found = list(scans(layout, [16, 8, 4], resolution=20))
    assert [len(scan.grounded) for scan in found] == [16, 8, 4]
    assert [scan.speed for scan in found] == [1, 2, 4]
    hwhm = [scan.quality.metrics["hwhm"]["mean"] for scan in found]
    assert hwhm == sorted(hwhm)
    assert set(found[2].grounded) < set(found[1].grounded)


@pytest.mark.parametrize("count", [0, 17, 2.5])
def test_impossible_numbers_of_conditions(count):
    layout = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
    with pytest.raises(InputError, match="whole number from 1 to 16"):
        list(scans(layout, [count], resolution=10))
