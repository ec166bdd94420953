"""Electrodes and contacts as single nodes of one mesh: its physics, by hand and by other models."""

import numpy as np
import pytest

from tomotactile_ros.evaluation.point_nodes import point_nodes_transfer
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout, equal_grid
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.sheet import make_sheet


def test_potentials_far_from_the_source_are_those_of_the_closed_form():
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
def test_what_goes_in_comes_out_on_any_outline(outline):
    """Reciprocity, and a contact on an electrode is that electrode."""
    grid = Grid.for_outline(outline, 20)
    places = grid.pixels[[20, 60, 100]] + [[0, 0], [0.001, 0.0005], [0, 0.002]]
    layout = Layout("three", outline, 1.0, 0.001, places)
    transfer = point_nodes_transfer(layout, grid)
    assert transfer.electrode_of[20] == 0 and np.count_nonzero(transfer.electrode_of >= 0) == 1
    assert transfer.impedance(0)[:, 20] == pytest.approx(0, abs=1e-9)
    every = np.arange(len(grid.pixels))
    green = transfer.green(every, every)
    assert green == pytest.approx(green.T, abs=1e-9)
    assert (transfer.self_impedance()[1:] > 0).all()
