"""Images: eq. 1 through the compressed frames equals the dense solution, also with readings missing; the
local image of what a frame says about the sheet with all electrodes grounded, which is exact, whatever
touches it; and contacts told apart by the topology of an image."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.reconstruction.admittance import AdmittanceMeter
from tomotactile_ros.reconstruction.basis import FrameBasis
from tomotactile_ros.reconstruction.contacts_in_image import find_blobs
from tomotactile_ros.reconstruction.estimate import Strength, contacts_and_pressure
from tomotactile_ros.reconstruction.grounded import GroundedSheet
from tomotactile_ros.reconstruction.grounded_step import LocalImage
from tomotactile_ros.reconstruction.linear import LinearImage
from tomotactile_ros.scenes.contact import ContactLaw
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.sensitivity import Sensitivity
from tomotactile_ros.sheet.voltages import frame

LOST = {
    "none": np.empty(0, int),
    "a column": np.arange(5, 256, 16),
    "a row": 48 + np.arange(16),
    "some": np.random.default_rng(0).choice(256, 40, replace=False),
}


def pressed(side, resolution):
    """The transfer of a grid of so many electrodes, its dense sensitivity, and a frame of two contacts, V."""
    layout = equal_grid(side, side, (0.2, 0.2), 0.005, 1e4)
    transfer = make_sheet(layout).transfer(
        Grid.for_outline(layout.outline, resolution).pixels, 0.005
    )
    voltages = frame(transfer.at([70, 180]), np.array([3e3, 8e3]), 3.3)
    return transfer, Sensitivity(transfer).dense(), np.nan_to_num(voltages).ravel()


@pytest.fixture(scope="module")
def four():
    return pressed(4, 16)


def is_the_dense_solution(image, dense, voltages, level):
    left, values, right = np.linalg.svd(dense, full_matrices=False)
    level = max(level, values[0] ** 2 / 1e16)
    expected = right.T @ (values / (values**2 + level) * (left.T @ voltages))
    return np.linalg.norm(image - expected) < 2e-4 * np.linalg.norm(expected)


@pytest.mark.parametrize("condition", [1e2, 1e4, 1e6, 1e8, 1e10, 1e12, 1e14, 1e16])
@pytest.mark.parametrize("missing", LOST)
def test_image_is_right_at_any_condition(four, condition, missing):
    transfer, dense, voltages = four
    voltages = voltages + 1e-3 * np.random.default_rng(1).standard_normal(256)
    level = np.linalg.norm(dense, 2) ** 2 / condition
    dense = dense.copy()
    dense[LOST[missing]] = voltages[LOST[missing]] = 0
    image = LinearImage(FrameBasis(transfer, level), level, LOST[missing]).image(voltages)
    assert is_the_dense_solution(image, dense, voltages, level)


@pytest.mark.parametrize("side", [2, 3])
@pytest.mark.parametrize("regularization", [0.0, 1e-6, 1e-3, 1.0])
def test_more_pixels_than_readings(side, regularization):
    transfer, dense, voltages = pressed(side, 24)
    basis = FrameBasis(transfer, regularization)
    assert len(basis.analysis) <= len(dense)
    image = LinearImage(basis, regularization).image(voltages)
    assert is_the_dense_solution(image, dense, voltages, regularization)


# -- the local image -------------------------------------------------------------------------------

DRIVE, RESISTANCE = 3.3, 1e4
PLACES = [100, 137, 290]


@pytest.fixture(scope="module")
def setting():
    layout = equal_grid(6, 6, (0.15, 0.15), 0.0025, RESISTANCE, inset=0.005)
    grid = Grid.for_outline(layout.outline, 20)
    transfer = make_sheet(layout).transfer(grid.pixels, 0.002)
    sheet = GroundedSheet(transfer)
    meter = AdmittanceMeter(sheet, 1e-3)
    return transfer, sheet, meter, LocalImage(meter, grid, layout.positions, RESISTANCE)


def contacts(transfer, conductance):
    return frame(transfer.at(PLACES), 1 / np.asarray(conductance), DRIVE)


def true_admittance(sheet, conductance):
    inner = np.linalg.inv(np.diag(1 / np.asarray(conductance)) + sheet.among(PLACES))
    share = sheet.share[:, PLACES]
    return sheet.admittance + share @ inner @ share.T


@pytest.mark.parametrize("strength", [1e-3, 1e-4, 1e-5])
def test_frame_gives_currents_and_couplings_of_grounded_electrodes(setting, strength):
    transfer, sheet, meter, _ = setting
    conductance = strength * np.array([1.0, 0.5, 2.0])
    expected = true_admittance(sheet, conductance)
    measured = meter.read(contacts(transfer, conductance), DRIVE)
    # the factor is that of pairs between which nothing is; here contacts touch some of all pairs
    scale = expected.sum() / measured.total
    assert scale == pytest.approx(1, abs=0.01)
    assert np.allclose(scale * measured.currents, expected.sum(axis=1), atol=1e-4 * expected.sum())


def test_drive_voltage_does_not_matter(setting):
    transfer, _, meter, _ = setting
    voltages = contacts(transfer, [1e-4, 2e-4, 5e-5])
    one, other = meter.read(voltages, DRIVE), meter.read(voltages / DRIVE, 1.0)
    assert np.allclose(one.currents, other.currents, rtol=1e-4)


def test_linear_image_is_the_tikhonov_solution(setting):
    transfer, _, meter, local = setting
    grid, forward = local.grid, local.forward
    sigma = 0.5 * local.spacing / grid.cell_size[0]
    images = forward.reshape(-1, *grid.shape)
    smoothed = gaussian_filter(images, (0, sigma, sigma), mode="constant", truncate=8)
    area = grid.cell_area / local.spacing**2
    smoothed = 2 * np.pi * sigma**2 * (0.22 * area) ** 2 * smoothed.reshape(forward.shape)
    measured = meter.read(contacts(transfer, [1e-4, 2e-4, 5e-5]), DRIVE)
    error = np.full(len(forward), np.sqrt(local.regularization(local.level(measured))))
    error[: len(measured.currents)] = 0.02
    first, second = measured.currents[meter.first], measured.currents[meter.second]
    couplings = np.clip(measured.couplings, 0, first * second / (first + second))
    data = np.append(measured.currents, couplings)
    expected = smoothed.T @ np.linalg.solve(forward @ smoothed.T + np.diag(error**2), data)
    assert np.abs(local.image(measured) - expected).max() < 1e-4 * expected.max()


# -- contacts in an image --------------------------------------------------------------------------

GRID = Grid.for_outline(Outline.rectangle(0.2, 0.2), 40)
X, Y = GRID.centres.T


def bump(x, y, width=0.01, height=1.0):
    return height * np.exp(-((X - x) ** 2 + (Y - y) ** 2) / (2 * width**2)).reshape(GRID.shape)


def test_shoulder_without_prominence_belongs_to_its_neighbour():
    image = bump(0, 0) + bump(0.018, 0, height=0.25)
    assert len(find_blobs(image, GRID)) == 1
    assert len(find_blobs(bump(0, 0) + bump(0.045, 0, height=0.25), GRID)) == 2


def test_blobs_at_the_rim_of_the_image_do_not_wrap_around():
    image = np.zeros(GRID.shape)
    image[10, 39] = image[11, 0] = 1.0
    assert len(find_blobs(image, GRID)) == 2


@pytest.mark.parametrize("radius", [0.0005, 0.005, 0.011])
def test_only_what_lies_on_the_sheet_has_area_and_force(radius):
    area = np.pi * radius**2
    (blob,) = find_blobs(bump(0.04, -0.03), GRID)
    disc = Strength(np.array([0.1, 0.1]), 20e3 * area * 1e-4, area)  # in a corner
    (contact,), pressure = contacts_and_pressure(
        [blob], bump(0.04, -0.03).ravel(), [disc], ContactLaw(1e-4, 1.0), GRID
    )
    assert contact.area == pytest.approx(area / 4, rel=0.02)
    assert contact.force == pytest.approx(20e3 * area, rel=0.02)
    assert pressure.sum() * GRID.cell_area == pytest.approx(contact.force)
