"""Readings taken before the multiplexer has settled: found by reciprocity, taken off, and nothing else
taken for it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from contacts_support import DRIVE, LAW, NOISE, disc, off, sensor

from tomotactile_ros.cli import main
from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.one_state import reciprocity
from tomotactile_ros.estimation.operator import operator_for
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.settling import EXPECTED, Settling, rows_before, unsettled
from tomotactile_ros.evaluation.scoring import score
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.channels import Channels, Rms
from tomotactile_ros.scenes.defects import Adc, Defects

WHERE = (0.02, 0.013)
ONE = disc(*WHERE, pressure=2e4)
TWO = (ONE, disc(-0.03, -0.04, 0.007, pressure=3e4))
GROUNDED = np.arange(64)


def simulator(name, settling=None, contacts=TWO, period=0.0, swapped=(), **how):
    """Of a sensor that keeps so much of the row before, or with such `Channels`."""
    channels = settling if isinstance(settling, Channels) else Channels(settling=settling)
    defects = Defects(channels=channels, swapped=swapped)
    how = {"seed": 0, "row_period": period, **how}
    return sensor(load_layout(name), *contacts, defects=defects, **how)


def pipeline_of(profile="accurate"):
    return Pipeline(load_layout("equal-8x8"), Settings(profile, noise=NOISE, contact_law=LAW))


@cache
def operator_of(name):
    return operator_for(load_layout(name))


def told_by(name, settling, contacts=TWO, period=0.0, known=None):
    """What the first frame says of settling."""
    made = simulator(name, settling, contacts, period)
    volts, scan = made.frame(0.0), np.asarray(made.grounded)
    if known is not None:
        volts = known.taken_off(volts, scan)
    prior = Prior.unknown(operator_of(name), ChannelPrior(), 0.005, DRIVE)
    weights = np.where(np.isnan(volts), 0.0, (DRIVE / NOISE) ** 2)
    rows = Rows(np.where(weights > 0, volts / DRIVE, 0.0), weights, scan)
    before = np.full((volts.shape[1],) * 2, np.nan)
    before[scan] = rows_before(volts, scan) / DRIVE
    return unsettled(reciprocity(rows, prior), before, np.arange(len(before)), prior, known)


@pytest.mark.parametrize("order", [None, (5, 3, 0, 15, 9, 1)])
def test_what_is_kept_is_taken_off(order):
    part = np.linspace(0.0, 0.04, 16)
    settling = Settling(part, np.zeros((16, 16)))
    made = simulator("equal-4x4", order=order)
    true, scan = made.ideal_frame(0.0), np.asarray(made.grounded)
    own = np.arange(len(scan)), scan
    potentials = true.copy()
    potentials[own] = 0.0
    read = (1 - part) * potentials + part * np.roll(potentials, 1, axis=0)
    read[own] = np.nan
    assert np.nanmax(np.abs(read - true)) > 0.03
    np.testing.assert_allclose(settling.taken_off(read, scan), true, atol=3e-4)
    np.testing.assert_allclose(settling.less(read, rows_before(true, scan)), true, atol=1e-9)
    first = np.full(16, np.nan)  # of the first row nothing is known then, of all others as much
    found = settling.taken_off(read, scan, first)
    assert np.isnan(found[0]).all()
    np.testing.assert_allclose(found[1:], true[1:], atol=6e-3)


def test_a_reading_after_one_that_is_missing_is_not_used():
    read = np.array([[np.nan, 1.0, np.nan], [2.0, np.nan, 0.5], [1.5, 1.2, np.nan]])
    settling = Settling(np.full(3, 0.1), np.zeros((3, 3)))
    found = settling.taken_off(read, np.array([0, 1, 2]))
    assert np.isnan(found[1, 2]) and np.isfinite(found[[0, 1, 2, 2], [1, 0, 0, 1]]).all()
    assert found[1, 0] == pytest.approx(2.0 / 0.9)  # it was grounded in the row before


@pytest.mark.parametrize(
    "name, settling", [("equal-8x8", 0.005), ("equal-4x4", 0.02), ("ring-16", 0.005)]
)
def test_any_touch_tells_it_whatever_gains_are(name, settling):
    found = told_by(name, Channels(gain=Rms(0.02, 1), offset=Rms(0.002, 1), settling=settling))
    spread, apart = np.sqrt(found.covariance.diagonal()), found.part - settling
    assert abs(apart.mean()) < 4 * np.sqrt(found.covariance.mean())
    assert np.sqrt(np.mean((apart / spread) ** 2)) < 1.7
    assert spread.max() < EXPECTED / 2  # more than was known before


def test_channels_are_told_one_by_one():
    part = 0.005 * (1 + 0.5 * np.random.default_rng(2).standard_normal(64)).clip(0.2, 1.8)
    found = told_by("equal-8x8", Channels(settling=tuple(part)))
    assert np.corrcoef(found.part, part)[0, 1] > 0.9


WORN = Channels(gain=Rms(0.05, 1), offset=Rms(0.005, 1))


def slide(speed):
    return disc(-0.05, 0.02, pressure=2e4, velocity=(speed, speed / 3))


@pytest.mark.parametrize(
    "name, channels, contacts, period",
    [
        ("equal-4x4", Channels(), TWO, 0.0),
        ("equal-4x4", Channels(), (), 0.0),
        ("equal-8x8", WORN, TWO, 0.0),
        ("equal-8x8", WORN, (), 0.0),
        ("equal-4x4", Channels(), (slide(0.02),), 1e-3),
        ("equal-8x8", Channels(), (slide(0.4),), 1e-3),
    ],
)
def test_neither_what_has_settled_nor_what_moves_is_taken_for_it(name, channels, contacts, period):
    assert told_by(name, channels, contacts, period) is None


def test_what_was_taken_for_it_by_mistake_is_found_out():
    wrong = Settling(np.full(64, 0.01), told_by("equal-8x8", 0.005).covariance)
    found = told_by("equal-8x8", Channels(), known=wrong)
    assert abs(found.part.mean()) < 5e-4


@pytest.mark.parametrize("profile", ["fast", "accurate"])
def test_contacts_are_those_of_a_sensor_that_settles(profile):
    pairs = [(WHERE, (-0.03, -0.04)), ((0.05, 0.06), (0.01, -0.05)), ((-0.07, 0.02), (0, 0))]
    force, scores = 2e4 * np.pi * 0.006**2, []
    truths = [[{"x": x, "y": y, "force": force} for x, y in pair] for pair in pairs]
    for settling in (None, 0.005):
        pipeline, results = pipeline_of(profile), []
        for pair in pairs:
            contacts = [disc(*place, pressure=2e4) for place in pair]
            volts = simulator("equal-8x8", settling, contacts).frame(0.0)
            results.append(pipeline.process(volts, GROUNDED, DRIVE))
        scores.append(score(results, truths))
    good, slow = scores
    for each in (good, slow):
        assert (each["ghosts"], each["doubled"], each["missed"], each["withheld"]) == (0, 0, 0, 0)
    assert slow["place"]["worst"] < good["place"]["worst"] + 1.5e-4
    assert slow["force"]["worst"] < good["force"]["worst"] + 0.05


def test_rows_go_on_without_what_they_keep():
    """Rows that are followed hear of it from the first frame; left in them, they are a millimetre off."""
    made, pipeline, apart = simulator("equal-8x8", 0.02, (ONE,), 1e-3), pipeline_of(), []
    state = pipeline.rows()
    for i in range(3):
        for ground, row in enumerate(made.frame(0.064 * i, i)):
            at = 0.064 * i + 1e-3 * ground
            result = pipeline.process_row(row, ground, DRIVE, at, state)
            apart += [off(each, WHERE) for each in result.contacts]
    assert state.frames.settling.part.mean() == pytest.approx(0.02, rel=0.05)
    assert len(apart) == 129 and max(apart) < 4e-4


# -- where it is harder to see ---------------------------------------------------------------------


def test_readings_at_the_end_of_the_range_are_still_known_as_such():
    press = disc(*WHERE, pressure=3e4)
    frame = simulator("equal-8x8", 0.005, (press,), adc=Adc(12, 2.3)).frame(0.0)
    assert np.nanmax(frame) < 2.3 and (frame == np.nanmax(frame)).sum() > 20
    result = pipeline_of().process(frame, GROUNDED, DRIVE)
    (contact,) = result.contacts
    assert result.state == "valid" and off(contact, WHERE) < 5e-4 and result.misfit < 1.3


@pytest.mark.parametrize("settling", [0.005, 0.03])
def test_a_touch_that_begins_within_a_frame_and_rests_tells_it(settling):
    touch = disc(*WHERE, pressure=3e4, start=1.0205)
    made, pipeline = simulator("equal-8x8", settling, (touch,), 1e-3), pipeline_of()
    for i in range(3):
        start = 1 + 0.064 * i
        result = pipeline.process(made.frame(start, i), GROUNDED, DRIVE, 1e-3, start)
    assert pipeline._state.settling.part.mean() == pytest.approx(settling, rel=0.08)
    (contact,) = result.contacts
    assert off(contact, WHERE) < 3e-4


def test_the_row_before_the_first_one_need_not_be_like_the_last():
    """A touch that begins after a pause, just before the first row."""
    pipeline = pipeline_of()
    for i, where in enumerate([WHERE, (-0.05, 0.04), (0.06, -0.03)]):
        touch = disc(*where, pressure=3e4, start=i - 1e-4, end=i + 0.5)
        frame, there = (
            simulator("equal-8x8", 0.02, (each,), 1e-3).frame(float(i), i)
            for each in (touch, replace(touch, start=i - 0.5))
        )
        assert np.nanmax(there[0] - frame[0]) > 0.02
        result = pipeline.process(frame, GROUNDED, DRIVE, 1e-3, float(i))
        (contact,) = result.contacts
        assert result.state == "valid" and off(contact, where) < 5e-4
    assert pipeline._state.settling.part.mean() == pytest.approx(0.02, rel=0.05)


def test_rows_of_electrodes_that_are_not_used_are_rows_before():
    frame, pipeline = simulator("equal-8x8", 0.02, swapped=((20, 45),)).frame(0.0), pipeline_of()
    result = pipeline.process(frame, GROUNDED, DRIVE)
    assert result.state == "valid" and len(result.contacts) == 2 and result.misfit < 1.3
    assert pipeline._state.settling.part.mean() == pytest.approx(0.02, rel=0.1)


@pytest.mark.parametrize("settling", [None, 0.01])
def test_a_recording_of_it_is_told_so(settling, tmp_path, capsys):
    made = simulator("equal-4x4", settling)
    frames, out = tmp_path / "frames.npz", tmp_path / "result.npz"
    voltages = np.array([made.frame(0.0, i) for i in range(2)])
    np.savez(frames, voltages=voltages, grounded=made.grounded, drive_voltage=DRIVE)
    words = ["--layout", "equal-4x4", "--profile", "accurate", "--out", str(out)]
    assert main(["reconstruct", str(frames), *words]) == 0
    said = "of the row before: the multiplexer is read too early; this is subtracted"
    assert (said in capsys.readouterr().out) == bool(settling)
