"""What a frame says about the sheet with all electrodes grounded: exact, whatever touches it."""

import numpy as np
import pytest
from scipy.ndimage import gaussian_filter

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.reconstruction.admittance import AdmittanceMeter
from tomotactile_ros.reconstruction.grounded import GroundedSheet
from tomotactile_ros.reconstruction.grounded_step import LocalImage
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.voltages import frame

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


def test_shares_and_admittance_conserve_current(setting):
    _, sheet, _, _ = setting
    assert np.allclose(sheet.share.sum(axis=0), 1, atol=1e-10)
    assert np.allclose(sheet.admittance.sum(axis=1), 0, atol=1e-10 * sheet.admittance.max())
    assert sheet.share.min() > -1e-9
    assert sheet.rest_share.sum() == pytest.approx(1)


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


def test_limit_of_weak_contacts_errs_in_proportion_to_their_strength(setting):
    transfer, sheet, meter, _ = setting
    errors = []
    for strength in (1e-6, 1e-7):
        conductance = strength * np.array([1.0, 0.5, 2.0])
        expected = true_admittance(sheet, conductance).sum(axis=1)
        found = meter.read_weak(contacts(transfer, conductance), DRIVE).currents
        errors.append(np.abs(found - expected).max() / expected.sum())
    assert errors[0] < 0.1
    assert errors[1] == pytest.approx(errors[0] / 10, rel=0.2)


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


def test_image_of_each_pixel_peaks_near_it(setting):
    transfer, _, meter, local = setting
    for place in (45, 105, 210, 377):
        voltages = frame(transfer.at([place]), np.array([5e3]), DRIVE)
        image = local.image(meter.read(voltages, DRIVE))
        peak = transfer.points[np.argmax(image)]
        assert np.linalg.norm(peak - transfer.points[place]) < 0.012
