"""Scenes with two contacts and with wide contacts: voltages, and what their blur says."""

import numpy as np
import pytest

from tomotactile_ros.evaluation.paper_model import paper_transfer
from tomotactile_ros.evaluation.point_spread import PointSpread, gram_blocks
from tomotactile_ros.evaluation.symmetry import find_symmetry
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.optimizer.free import free
from tomotactile_ros.optimizer.objective import Aims, Objective
from tomotactile_ros.optimizer.scenes import SceneBlur, Scenes
from tomotactile_ros.optimizer.search import Effort
from tomotactile_ros.sheet.sensitivity import Sensitivity

LAYOUT = equal_grid(4, 4, (0.2, 0.2), 0.004, 1e4, inset=0.02)
GRID = Grid.for_outline(LAYOUT.outline, 16)


def scene_blur(layout, regularization=100.0, count=None):
    symmetry = find_symmetry(GRID, layout.positions)
    transfer = paper_transfer(layout, GRID.pixels, symmetry=symmetry)
    spread = PointSpread(gram_blocks(transfer, GRID, symmetry), regularization)
    return SceneBlur(Scenes(GRID, count or layout.electrodes), transfer, spread)


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
    assert scene_blur(LAYOUT).value == pytest.approx(np.mean(blurs), rel=1e-9)


def test_fewer_electrodes_and_more_regularization_blur():
    assert scene_blur(LAYOUT, 10.0).value < 0.9 * scene_blur(LAYOUT, 1000.0).value
    few = equal_grid(2, 2, (0.2, 0.2), 0.004, 1e4, inset=0.05)
    many = equal_grid(8, 8, (0.2, 0.2), 0.004, 1e4, inset=0.01)
    two, four, eight = (scene_blur(each, count=16).value for each in (few, LAYOUT, many))
    assert eight < 0.9 * four < 0.8 * two


def test_search_makes_scenes_sharper_where_they_count_alone():
    start = equal_grid(4, 4, (0.2, 0.2), 0.004, 1e4)
    anything = (10.0, 10.0, 10.0)
    aims = Aims(anything, anything, 10.0, scenes=0.8)
    effort = Effort(starts=2, rounds=2, descents=4, probes=0)
    *_, last = free(start, aims=aims, effort=effort, resolution=16)
    reached = Objective(start, aims=aims, resolution=16).figures(last.layout.positions)[-1]
    assert reached < 0.97
