"""The one-step image of eq. 1 through the compressed frames equals the dense solution, also with
readings missing."""

import numpy as np
import pytest

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.reconstruction.basis import FrameBasis
from tomotactile_ros.reconstruction.linear import LinearImage
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.sensitivity import Sensitivity
from tomotactile_ros.sheet.voltages import frame


@pytest.fixture(scope="module")
def setting():
    layout = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
    grid = Grid.for_outline(layout.outline, 16)
    transfer = make_sheet(layout).transfer(grid.pixels, 0.005)
    voltages = frame(transfer.at([70, 180]), np.array([3e3, 8e3]), 3.3)
    return (
        transfer,
        FrameBasis(transfer),
        Sensitivity(transfer).dense(),
        np.nan_to_num(voltages).ravel(),
    )


def masked(dense, voltages, lost):
    dense, voltages = dense.copy(), voltages.copy()
    dense[lost] = 0
    voltages[lost] = 0
    return dense, voltages


LOST = {
    "none": np.empty(0, int),
    "a column": np.arange(5, 256, 16),
    "a row": 48 + np.arange(16),
    "some": np.random.default_rng(0).choice(256, 40, replace=False),
}


@pytest.mark.parametrize("regularization", [0.1, 10.0, 1000.0, 1e30])
@pytest.mark.parametrize("missing", LOST)
def test_image_equals_the_dense_solution(setting, regularization, missing):
    _, basis, dense, voltages = setting
    dense, voltages = masked(dense, voltages, LOST[missing])
    system = dense.T @ dense + regularization * np.eye(dense.shape[1])
    expected = np.linalg.solve(system, dense.T @ voltages)
    found = LinearImage(basis, regularization, LOST[missing]).image(voltages.astype(np.float32))
    assert np.linalg.norm(found - expected) < 2e-4 * np.linalg.norm(expected)


@pytest.mark.parametrize("condition", [1e2, 1e4, 1e6, 1e8, 1e10, 1e12, 1e14, 1e16])
@pytest.mark.parametrize("missing", LOST)
def test_image_is_right_at_any_condition(setting, condition, missing):
    transfer, _, dense, voltages = setting
    voltages = voltages + 1e-3 * np.random.default_rng(1).standard_normal(256)
    level = np.linalg.norm(dense, 2) ** 2 / condition
    dense, voltages = masked(dense, voltages, LOST[missing])
    left, values, right = np.linalg.svd(dense, full_matrices=False)
    expected = right.T @ (values / (values**2 + level) * (left.T @ voltages))
    found = LinearImage(FrameBasis(transfer, level), level, LOST[missing]).image(voltages)
    assert np.linalg.norm(found - expected) < 2e-4 * np.linalg.norm(expected)


@pytest.mark.parametrize("side", [2, 3])
@pytest.mark.parametrize("regularization", [0.0, 1e-6, 1e-3, 1.0])
def test_more_pixels_than_readings(side, regularization):
    layout = equal_grid(side, side, (0.2, 0.2), 0.005, 1e4)
    grid = Grid.for_outline(layout.outline, 24)
    transfer = make_sheet(layout).transfer(grid.pixels, 0.005)
    dense = Sensitivity(transfer).dense()
    voltages = np.nan_to_num(frame(transfer.at([70, 180]), np.array([3e3, 8e3]), 3.3)).ravel()
    left, values, right = np.linalg.svd(dense, full_matrices=False)
    level = max(regularization, values[0] ** 2 / 1e16)
    expected = right.T @ (values / (values**2 + level) * (left.T @ voltages))
    basis = FrameBasis(transfer, regularization)
    assert len(basis.analysis) <= len(dense)
    found = LinearImage(basis, regularization).image(voltages)
    assert np.linalg.norm(found - expected) < 2e-4 * np.linalg.norm(expected)


def test_basis_reproduces_the_sensitivity(setting):
    _, basis, dense, _ = setting
    again = basis.analysis.T @ basis.sensitivity
    assert np.abs(again - dense).max() < 1e-12 * np.abs(dense).max()
    overlap = basis.analysis @ basis.analysis.T
    assert np.allclose(overlap, np.eye(len(overlap)), atol=1e-12)


def test_sensitivity_and_adjoint_agree(setting):
    transfer, _, _, _ = setting
    random = np.random.default_rng(2)
    operator = Sensitivity(transfer)
    image, voltages = random.standard_normal(256), random.standard_normal((16, 16))
    np.fill_diagonal(voltages, 0)
    left, right = (
        np.vdot(operator.forward(image), voltages),
        np.vdot(image, operator.adjoint(voltages)),
    )
    assert left == pytest.approx(right, rel=1e-10)


def test_no_regularization_stays_finite(setting):
    _, basis, _, voltages = setting
    assert np.isfinite(LinearImage(basis, 0.0).image(voltages.astype(np.float32))).all()
