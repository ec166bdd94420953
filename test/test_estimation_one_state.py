"""What reciprocity alone says of rows: that they are of one state, which channels contradict all others,
how noisy they are, and what no contacts explain."""

from functools import cache

import numpy as np
import pytest
from contacts_support import DRIVE, LAW, NOISE, disc, off, sensor

from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.estimator import CONTRADICTS, Estimator, State
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.one_state import reciprocity, without_contradicting
from tomotactile_ros.estimation.operator import operator_for
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.search import Search
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.scenes.channels import Channels, Rms, Uniform
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.scenes.sheet_field import Gradient, SheetField

PRESSES = disc(0.02, 0.01, 0.005, pressure=2e4), disc(-0.03, -0.04, 0.008, pressure=1e4)
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
def frame(name="equal-8x8", contacts=PRESSES, noise=NOISE):
    """(E, E) V, of a sensor about which nothing is right."""
    how = {"noise": noise, "seed": 0, "adc": None, "defects": BAD, "row_period": 0.0}
    return sensor(load_layout(name), *contacts, **how).frame(0.0)


def rows_of(volts):
    weights = np.where(np.eye(len(volts), dtype=bool), 0.0, (DRIVE / NOISE) ** 2)
    return Rows(np.where(weights > 0, volts / DRIVE, 0.0), weights, np.arange(len(volts)))


def estimator():
    return Estimator(load_layout("equal-8x8"), noise=NOISE, law=LAW, radius=0.005)


def estimate(volts):
    return estimator().estimate(volts, np.arange(len(volts)), DRIVE, State())


@pytest.mark.parametrize("name", ["equal-8x8", "hex-37"])
def test_readings_obey_it_whatever_the_sensor_is_and_noise_is_told_from_it(name):
    found, noisy = (
        reciprocity(rows_of(frame(name, noise=factor * NOISE)), prior(name)) for factor in (1, 8)
    )
    assert 0.7 < found.misfit < 1.2 and noisy.misfit == pytest.approx(64, rel=0.3)
    positions = load_layout(name).positions
    assert found.scatter(positions) == pytest.approx(1.0, abs=0.25)
    assert noisy.scatter(positions) == pytest.approx(64, rel=0.3)


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
    volts, expected = frame().copy(), prior("equal-8x8")
    volts[:, list(broken)] = np.random.default_rng(1).uniform(0, DRIVE, (64, len(broken)))
    found, left_out = without_contradicting(reciprocity(rows_of(volts), expected), expected, 3)
    assert sorted(left_out) == list(broken) and found.misfit < 1.5
    said = estimate(volts)
    assert said.state == "valid" and len(said.contacts) == 2
    assert said.left_out == {each: CONTRADICTS for each in broken}


def test_a_channel_that_breaks_under_a_touch_that_rests_is_named():
    made, state, broken, random = estimator(), State(), frame().copy(), np.random.default_rng(4)
    for number, volts in enumerate((frame(), broken, broken)):
        said = made.estimate(volts, np.arange(64), DRIVE, state, 1e-3)
        assert said.state == "valid" and len(said.contacts) == 2
        for press in PRESSES:
            assert min(off(c, press.center) for c in said.contacts) < 5e-4
        # once, it may be a touch that ended
        assert said.left_out == ({30: CONTRADICTS} if number == 2 else {})
        broken[:, 30] = random.uniform(0, DRIVE, 64)


@pytest.mark.parametrize("what", ["columns", "rows", "two touches", "anything"])
def test_what_nothing_explains_is_withheld_before_contacts_are_looked_for(what, monkeypatch):
    """Columns or rows in another order, two touches in one frame, and no sensor: a search took up to 32 s to
    come to nothing."""

    def never(*_, **__):
        raise AssertionError("looked for contacts")

    random, volts = np.random.default_rng(2), frame()
    order = random.permutation(64)
    exchanged = {
        "columns": volts[:, order],
        "rows": volts[order],
        "two touches": np.vstack([volts[:30], frame(contacts=PRESSES[:1])[30:]]),
        "anything": random.uniform(0, DRIVE, (64, 64)),
    }
    monkeypatch.setattr(Search, "contacts", never)
    said = estimate(exchanged[what])
    assert (said.state, said.contacts) == ("withheld", [])
    assert "no contacts explain the readings" in said.reason or "scatter" in said.reason


def test_channels_that_hum_on_an_untouched_sheet_are_named():
    random = np.random.default_rng(1)
    volts = NOISE * random.standard_normal((64, 64))
    volts[:, [5, 9, 40]] += 0.05 * random.standard_normal((64, 3))
    assert Search(operator("equal-8x8")).untouched(rows_of(volts), prior("equal-8x8")) is not None
    said = estimate(volts)
    assert (said.state, said.contacts) == ("valid", [])
    assert said.left_out == {each: CONTRADICTS for each in (5, 9, 40)}
