"""Non-negative image and nonlinear inverse, each on its own model."""

import numpy as np
import pytest

from tomotactile_ros.grid import Grid
from tomotactile_ros.layout import equal_grid
from tomotactile_ros.reconstruction.admittance import AdmittanceMeter
from tomotactile_ros.reconstruction.conductance import ConductanceProblem, solve_conductance
from tomotactile_ros.reconstruction.grounded import GroundedSheet
from tomotactile_ros.reconstruction.local import LocalImage
from tomotactile_ros.reconstruction.nonnegative import (
    nonnegative_image,
    solve_nonnegative,
    spread,
)
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.frames import frame

DRIVE, RESISTANCE, NOISE = 3.3, 1e4, 1e-4


@pytest.fixture(scope="module")
def setting():
    layout = equal_grid(6, 6, (0.15, 0.15), 0.0025, RESISTANCE)
    grid = Grid.for_outline(layout.outline, 30)
    sheet = make_sheet(layout)
    transfer = sheet.transfer(grid.pixels, 0.447 * 0.005)
    meter = AdmittanceMeter(GroundedSheet(transfer), NOISE)
    return sheet, transfer, meter, LocalImage(meter, grid, layout.positions, RESISTANCE)


def measured(setting, places, conductance):
    _, transfer, meter, _ = setting
    return meter.read(frame(transfer.at(places), 1 / np.asarray(conductance), DRIVE), DRIVE)


def problem(setting, reading, active, compact=0.0):
    _, _, meter, local = setting
    share, impedance = meter.sheet.share[:, active], meter.sheet.among(active)
    return ConductanceProblem(local, reading, share, impedance, compact)


def test_non_negative_image_is_non_negative_sparse_and_keeps_the_total(setting):
    _, _, _, local = setting
    reading = measured(setting, [330, 520], [1e-4, 2e-4])
    image = nonnegative_image(local, reading, local.image(reading).astype(float))
    assert image.min() >= 0
    assert np.count_nonzero(image) < 40
    assert image.sum() == pytest.approx(reading.total, rel=0.01)
    wide = spread(image, local.grid, 0.006)
    assert wide.min() >= 0
    assert wide.sum() == pytest.approx(image.sum())


def test_slopes_are_those_of_the_prediction(setting):
    reading = measured(setting, [330], [1e-4])
    active = np.array([300, 330, 331, 365, 640])
    task = problem(setting, reading, active)
    start = np.array([1e-5, 2e-4, 3e-5, 0.0, 5e-5])
    predicted, slopes = task.predict(start)
    for k in range(len(active)):
        step = np.zeros(len(active))
        step[k] = 1e-9
        change = (task.predict(start + step)[0] - predicted) / 1e-9
        assert np.allclose(change, slopes[:, k], rtol=1e-3, atol=1e-4 * np.abs(slopes[:, k]).max())


def test_nonlinear_inverse_finds_its_own_contacts(setting):
    places, true = np.array([330, 331, 362, 361]), np.array([1e-4, 2e-5, 8e-5, 4e-5])
    reading = measured(setting, places, true)
    around = np.add.outer(np.arange(-2, 4) * 30, np.arange(-2, 4)).ravel() + 330
    task, start = problem(setting, reading, around), np.full(36, 1e-5)
    values, costs, _ = solve_conductance(task, start, 1e3, start)
    assert (np.diff(costs) < 0).all()
    assert costs[-1] < 1e-3 * costs[0]
    assert values.min() >= 0
    assert values.sum() == pytest.approx(true.sum(), rel=0.05)
    centre = values @ setting[1].points[around] / values.sum()
    assert np.linalg.norm(centre - true @ setting[1].points[places] / true.sum()) < 3e-4


def test_contacts_close_together_do_not_bias_each_other(setting):
    true = np.array([3e-4, 3e-4])
    reading = measured(setting, [330, 332], true)
    active = np.array([330, 332])
    start = np.full(2, 1e-4)
    values, _, _ = solve_conductance(problem(setting, reading, active), start, 1e3, start)
    linear = setting[2].sheet.share[:, active]
    effective = np.linalg.lstsq(linear, reading.currents, rcond=None)[0]
    assert values == pytest.approx(true, rel=0.01)
    assert effective.sum() < 0.7 * true.sum()


@pytest.mark.parametrize("shape", [(0, 3), (29, 0), (3, 2)], ids=str)
def test_nothing_to_solve_for_is_no_end_of_the_process(shape):
    found = solve_nonnegative(np.eye(*shape), np.ones(shape[0]))
    np.testing.assert_array_equal(found, np.ones(shape[1]) if min(shape) else np.zeros(shape[1]))
