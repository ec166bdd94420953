"""Contacts are told apart by the topology of the image."""

import numpy as np
import pytest

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.reconstruction.contacts_in_image import find_blobs
from tomotactile_ros.reconstruction.estimate import Strength, contacts_and_pressure
from tomotactile_ros.scenes.contact import ContactLaw

GRID = Grid.for_outline(Outline.rectangle(0.2, 0.2), 40)
X, Y = GRID.centres.T


def bump(x, y, width=0.01, height=1.0):
    return height * np.exp(-((X - x) ** 2 + (Y - y) ** 2) / (2 * width**2)).reshape(GRID.shape)


def test_two_bumps_are_two_blobs_highest_first():
    blobs = find_blobs(bump(-0.05, 0.03, height=0.6) + bump(0.04, -0.02), GRID)
    assert len(blobs) == 2
    assert np.allclose([b.position for b in blobs], [[0.04, -0.02], [-0.05, 0.03]], atol=5e-4)
    assert blobs[0].peak > blobs[1].peak


@pytest.mark.parametrize("x", [0.0, 0.0011, 0.0025, 0.0037])
def test_positions_are_finer_than_pixels(x):
    (blob,) = find_blobs(bump(x, 0.01 - x), GRID)
    assert np.linalg.norm(blob.position - [x, 0.01 - x]) < 3e-4


def test_shoulder_without_prominence_belongs_to_its_neighbour():
    image = bump(0, 0) + bump(0.018, 0, height=0.25)
    assert len(find_blobs(image, GRID)) == 1
    assert len(find_blobs(bump(0, 0) + bump(0.045, 0, height=0.25), GRID)) == 2


def test_every_pixel_above_the_floor_belongs_to_one_blob():
    random = np.random.default_rng(4)
    image = random.random(GRID.shape)
    blobs = find_blobs(image, GRID, floor=0.5)
    pixels = np.concatenate([blob.pixels for blob in blobs])
    assert len(np.unique(pixels)) == len(pixels)
    assert set(pixels) == set(np.flatnonzero(image.ravel() > 0.5 * image.max()))


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
