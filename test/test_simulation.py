"""Frames of scenes: repeatable, and every defect does what its name says, and nothing else."""

import numpy as np
import pytest

from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Adc, Defects, Drift, Hum, Noise, SheetVariation
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.scenes.sheet_field import random_sheet
from tomotactile_ros.simulation import Simulator, convert
from tomotactile_ros.support.errors import InputError

LAYOUT = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
CONTACT = Contact("disc", center=(0.03, 0.02), radius=0.006, pressure=2e4)
LAW = ContactLaw(1e-4, 1.0)


def simulator(*contacts, model="closed_form", row_period=1e-3, order=None, **settings):
    scene = Scene("test", 3.3, contacts or (CONTACT,), contact_law=LAW, **settings)
    return Simulator(LAYOUT, scene, model, row_period=row_period, order=order)


IDEAL = simulator().frame(0.0)
OFF = ~np.eye(16, dtype=bool)


def test_the_data_come_from_finite_elements_unless_asked_otherwise():
    scene = Scene("test", 3.3, (CONTACT,), contact_law=LAW)
    assert Simulator(LAYOUT, scene).model == "fem"
    assert Simulator(LAYOUT, scene, "auto").model == "closed_form"
    with pytest.raises(InputError, match="none of"):
        Simulator(LAYOUT, scene, "guess")


def test_same_scene_seed_and_sequence_same_frame():
    first, second = (simulator(noise=Noise(0.001, seed=7)) for _ in range(2))
    np.testing.assert_array_equal(first.frame(0.5, 3), second.frame(0.5, 3))
    assert np.abs(first.frame(0.5, 3) - first.frame(0.5, 4))[OFF].max() > 1e-4


def test_noise_has_the_named_size():
    noisy = simulator(noise=Noise(0.01))
    error = np.array([noisy.frame(0.0, n) - IDEAL for n in range(40)])[:, OFF]
    assert error.std() == pytest.approx(0.01, rel=0.03)
    assert abs(error.mean()) < 0.001


@pytest.mark.parametrize("bits", [1, 4, 12, 24, 32])
def test_conversion(bits):
    values = np.linspace(-0.5, 4.0, 1001)
    codes = convert(values, bits, 3.3) / (3.3 / 2**bits)
    np.testing.assert_allclose(codes, np.round(codes), atol=1e-6)
    assert codes.min() == 0 and codes.max() == pytest.approx(2**bits - 1)
    within = (values >= 0) & (values <= 3.3 * (1 - 2.0**-bits))
    assert np.abs(convert(values, bits, 3.3) - values)[within].max() <= 0.5001 * 3.3 / 2**bits
    frame = simulator(adc=Adc(bits, 3.3)).frame(0.0)
    np.testing.assert_allclose(frame[OFF], convert(IDEAL, bits, 3.3)[OFF])


def test_dead_electrodes_have_no_reading():
    frame = simulator(defects=Defects(dead=(5, 9))).frame(0.0)
    assert np.isnan(frame[:, [5, 9]]).all()
    alive = OFF & ~np.isin(np.arange(16), [5, 9])
    np.testing.assert_array_equal(frame[alive], IDEAL[alive])


def test_swapped_wires_swap_reading_and_grounding():
    frame = simulator(defects=Defects(swapped=((2, 7),))).frame(0.0)
    order = np.arange(16)
    order[[2, 7]] = 7, 2
    np.testing.assert_array_equal(frame, IDEAL[np.ix_(order, order)])


def test_hum_follows_the_rows_and_drift_the_electrodes():
    hum = (simulator(defects=Defects(hum=Hum(0.02, 50.0))).frame(0.1) - IDEAL)[OFF]
    assert 0.015 < hum.max() <= 0.02 + 1e-12
    drifting = simulator(defects=Defects(drift=Drift(0.05, 100.0, seed=1)))
    offset = drifting.frame(0.0) - IDEAL
    assert np.nanmax(np.nanstd(offset, axis=0)) < 1e-3 < np.nanstd(np.nanmean(offset, axis=0))
    np.testing.assert_allclose(drifting.frame(100.0)[OFF], drifting.frame(0.0)[OFF], atol=1e-9)


def test_contacts_come_go_and_move():
    timed = Contact("disc", center=(-0.05, 0.0), radius=0.005, pressure=1e4, start=1.0, end=2.0)
    moving = Contact(
        "disc", center=(0.0, 0.0), radius=0.005, pressure=1e4, velocity=(0.01, 0.0)
    )  # fmt: skip
    coming = simulator(timed)
    assert np.nanmax(coming.frame(0.9)) == 0.0 == np.nanmax(coming.frame(2.0))
    assert np.nanmax(coming.frame(1.5)) > 0.5
    there = Contact("disc", center=(0.03, 0.0), radius=0.005, pressure=1e4)
    for model in ("closed_form", "fem"):
        np.testing.assert_allclose(
            simulator(moving, model=model, row_period=0.0).frame(3.0),
            simulator(there, model=model).frame(0.0),
        )


def test_variation_of_the_sheet():
    field = SheetVariation(0.2, 0.05, seed=3)
    where = np.random.default_rng(0).random((20000, 2)) * 20
    values = random_sheet(field, 1e4)(where)
    assert values.min() > 0
    assert values.mean() == pytest.approx(1e4, rel=0.03)
    assert values.std() / values.mean() == pytest.approx(0.2, rel=0.1)
    near = random_sheet(field, 1e4)(where + [0.05, 0.0])
    logs = np.log(values), np.log(near)
    assert np.corrcoef(*logs)[0, 1] == pytest.approx(np.exp(-0.5), abs=0.05)
    uneven = simulator(model="fem", defects=Defects(sheet_variation=field)).frame(0.0)
    even = simulator(model="fem").frame(0.0)
    assert 0.01 < np.abs(uneven - even)[OFF].max() < 1.0
    with pytest.raises(InputError, match="uniform"):
        simulator(defects=Defects(sheet_variation=field))
