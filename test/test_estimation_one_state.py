"""What reciprocity alone says of rows: that they are of one state, which channels contradict all others,
how noisy they are, and what no contacts explain."""

from functools import cache

import numpy as np
import pytest

from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.estimator import CONTRADICTS, Estimator, State
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.one_state import reciprocity, without_contradicting
from tomotactile_ros.estimation.operator import operator_for
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.search import Search
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.scenes.channels import Channels, Rms, Uniform
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Defects, Noise
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.scenes.sheet_field import Gradient, SheetField
from tomotactile_ros.simulation import Simulator

DRIVE, NOISE, LAW = 3.3, 1e-3, ContactLaw(1e-4, 1.0)
PRESSES = (
    Contact("disc", center=(0.02, 0.01), radius=0.005, pressure=2e4),
    Contact("disc", center=(-0.03, -0.04), radius=0.008, pressure=1e4),
)
BAD = Defects(
    channels=Channels(
        gain=Rms(0.02, 1), offset=Rms(0.002, 1), ground_resistance=Uniform(200, 100, 1)
    ),
    sheet=SheetField(gradient=Gradient(0.2, 20.0)),
)


@cache
def operator(name):
    return operator_for(load_layout(name))


def prior(name):
    return Prior.unknown(operator(name), ChannelPrior(), 0.005, DRIVE)


@cache
def frame(name, contacts=PRESSES, defects=BAD, noise=NOISE):
    """(E, E) V, of a sensor about which nothing is right."""
    scene = Scene("test", DRIVE, contacts, noise=Noise(rms=noise), contact_law=LAW, defects=defects)
    return Simulator(load_layout(name), scene, row_period=0.0).frame(0.0)


def rows_of(volts):
    weights = np.where(np.eye(len(volts), dtype=bool), 0.0, (DRIVE / NOISE) ** 2)
    return Rows(np.where(weights > 0, volts / DRIVE, 0.0), weights, np.arange(len(volts)))


def estimate(name, volts):
    sensor = Estimator(load_layout(name), noise=NOISE, law=LAW, radius=0.005)
    return sensor.estimate(volts, np.arange(len(volts)), DRIVE, State())


LAYOUTS = "equal-8x8", "hex-37"


@pytest.mark.parametrize("name", LAYOUTS)
def test_readings_obey_it_whatever_the_sensor_is(name):
    found = reciprocity(rows_of(frame(name)), prior(name))
    assert 0.7 < found.misfit < 1.2
    assert found.scatter(load_layout(name).positions) == pytest.approx(1.0, abs=0.25)


@pytest.mark.parametrize("name", LAYOUTS)
def test_noise_is_told_from_it(name):
    found = reciprocity(rows_of(frame(name, noise=8 * NOISE)), prior(name))
    assert found.misfit == pytest.approx(64, rel=0.3)
    assert found.scatter(load_layout(name).positions) == pytest.approx(64, rel=0.3)


def test_no_contacts_leave_less_over():
    """A hum of 20 mV on all that a row reads: the best fit of the true contacts and of all else."""
    volts = frame("equal-4x4") + 0.02 * np.sin(np.arange(16))[:, None]
    rows, search = rows_of(volts), Search(operator("equal-4x4"))
    bound = reciprocity(rows, prior("equal-4x4"))
    best = search.contacts(rows, prior("equal-4x4"))
    assert bound.chi_squared > 1.5 * rows.count
    assert best.chi_squared > 0.99 * bound.chi_squared


@pytest.mark.parametrize("broken", [(5,), (5, 30), (5, 30, 31)])
def test_channels_that_read_anything_are_named(broken):
    volts = frame("equal-8x8").copy()
    volts[:, list(broken)] = np.random.default_rng(1).uniform(0, DRIVE, (64, len(broken)))
    found, left_out = without_contradicting(
        reciprocity(rows_of(volts), prior("equal-8x8")), prior("equal-8x8"), 3
    )
    assert sorted(left_out) == list(broken) and found.misfit < 1.5
    said = estimate("equal-8x8", volts)
    assert said.state == "valid" and len(said.contacts) == 2
    assert said.left_out == {each: CONTRADICTS for each in broken}


def test_a_channel_that_breaks_under_a_touch_that_rests_is_named():
    sensor, state = Estimator(load_layout("equal-8x8"), noise=NOISE, law=LAW, radius=0.005), State()
    whole = frame("equal-8x8")
    broken, random = whole.copy(), np.random.default_rng(4)
    for number, volts in enumerate((whole, broken, broken)):  # once, it may be a touch that ended
        said = sensor.estimate(volts, np.arange(64), DRIVE, state, 1e-3)
        assert said.state == "valid" and len(said.contacts) == 2
        for press in PRESSES:
            apart = [np.hypot(c.x - press.center[0], c.y - press.center[1]) for c in said.contacts]
            assert min(apart) < 5e-4
        assert said.left_out == ({30: CONTRADICTS} if number == 2 else {})
        broken[:, 30] = random.uniform(0, DRIVE, 64)


def exchanged():
    """Readings of the same frame whose columns, or whose rows, are in another order; of two touches in
    one frame; and of no sensor."""
    random = np.random.default_rng(2)
    volts, order = frame("equal-8x8"), random.permutation(64)
    other = frame("equal-8x8", PRESSES[:1])
    return {
        "columns": volts[:, order],
        "rows": volts[order],
        "two touches": np.vstack([volts[:30], other[30:]]),
        "anything": random.uniform(0, DRIVE, (64, 64)),
    }


@pytest.mark.parametrize("what", ["columns", "rows", "two touches", "anything"])
def test_what_nothing_explains_is_withheld_before_contacts_are_looked_for(what, monkeypatch):
    """A search took up to 32 s to come to nothing."""

    def never(*_, **__):
        raise AssertionError("looked for contacts")

    monkeypatch.setattr(Search, "contacts", never)
    said = estimate("equal-8x8", exchanged()[what])
    assert (said.state, said.contacts) == ("withheld", [])
    assert "no contacts explain the readings" in said.reason or "scatter" in said.reason


def test_channels_that_hum_on_an_untouched_sheet_are_named():
    random = np.random.default_rng(1)
    volts = NOISE * random.standard_normal((64, 64))
    volts[:, [5, 9, 40]] += 0.05 * random.standard_normal((64, 3))
    assert Search(operator("equal-8x8")).untouched(rows_of(volts), prior("equal-8x8")) is not None
    said = estimate("equal-8x8", volts)
    assert (said.state, said.contacts) == ("valid", [])
    assert said.left_out == {each: CONTRADICTS for each in (5, 9, 40)}
