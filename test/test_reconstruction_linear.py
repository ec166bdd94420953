"""The one-step image of eq. 1 through the compressed frames equals the dense solution, also with readings missing."""

import numpy as np
import pytest

from tomotactile_ros.grid import Grid
from tomotactile_ros.layout import equal_grid
from tomotactile_ros.reconstruction.basis import FrameBasis
from tomotactile_ros.reconstruction.linear import LinearImage
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.frames import frame
from tomotactile_ros.sheet.sensitivity import Sensitivity


@pytest.fixture(scope="module")
def setting():
    layout = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
    grid = Grid.for_outline(layout.outline, 16)
    transfer = make_sheet(layout).transfer(grid.pixels, 0.005)
    voltages = frame(transfer.at([70, 180]), np.array([3e3, 8e3]), 3.3)
    return transfer, FrameBasis(transfer), Sensitivity(transfer).dense(), np.nan_to_num(voltages).ravel()


@pytest.mark.parametrize("regularization", [0.1, 10.0, 1000.0, 1e30])
@pytest.mark.parametrize("missing", ["none", "a column", "a row", "some"])
def test_image_equals_the_dense_solution(setting, regularization, missing):
    _, basis, dense, voltages = setting
    lost = {
        "none": np.empty(0, int),
        "a column": np.arange(5, 256, 16),
        "a row": 48 + np.arange(16),
        "some": np.random.default_rng(0).choice(256, 40, replace=False),
    }[missing]
    kept = dense.copy()
    kept[lost] = 0
    voltages = voltages.copy()
    voltages[lost] = 0
    system = kept.T @ kept + regularization * np.eye(kept.shape[1])
    expected = np.linalg.solve(system, kept.T @ voltages)
    found = LinearImage(basis, regularization, lost).image(voltages.astype(np.float32))
    assert np.linalg.norm(found - expected) < 2e-3 * np.linalg.norm(expected)


def test_basis_reproduces_the_sensitivity(setting):
    _, basis, dense, _ = setting
    again = basis.analysis.T @ basis.sensitivity
    assert np.abs(again - dense).max() < 1e-3 * np.abs(dense).max()
    overlap = basis.analysis @ basis.analysis.T
    assert np.allclose(overlap, np.eye(len(overlap)), atol=1e-4)


def test_sensitivity_and_adjoint_agree(setting):
    transfer, _, _, _ = setting
    random = np.random.default_rng(2)
    operator = Sensitivity(transfer)
    image, voltages = random.standard_normal(256), random.standard_normal((16, 16))
    np.fill_diagonal(voltages, 0)
    left, right = np.vdot(operator.forward(image), voltages), np.vdot(image, operator.adjoint(voltages))
    assert left == pytest.approx(right, rel=1e-10)


def test_no_regularization_stays_finite(setting):
    _, basis, _, voltages = setting
    assert np.isfinite(LinearImage(basis, 0.0).image(voltages.astype(np.float32))).all()
