"""What reciprocity alone says of rows: that they are of one state, which channels contradict all others,
how noisy they are, what no contacts explain; and what readings keep of the row before, as the multiplexer
had not settled: found, taken off, and nothing else taken for it."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from contacts_support import DRIVE, LAW, NOISE, disc, off, pipeline_of, rows_of, sensor, unknown

from tomotactile_ros.cli import main
from tomotactile_ros.estimation.estimator import CONTRADICTS, Estimator, State
from tomotactile_ros.estimation.one_state import reciprocity, without_contradicting
from tomotactile_ros.estimation.operator import operator_for
from tomotactile_ros.estimation.reciprocity import fit_gains
from tomotactile_ros.estimation.search import Search
from tomotactile_ros.estimation.settling import EXPECTED, Settling, rows_before, unsettled
from tomotactile_ros.evaluation.scoring import score
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.scenes.channels import Channels, Rms, Uniform
from tomotactile_ros.scenes.defects import Adc, Defects
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
    return unknown(operator(name))


@cache
def frame(name="equal-8x8", contacts=PRESSES, noise=NOISE):
    """(E, E) V, of a sensor about which nothing is right."""
    how = {"noise": noise, "seed": 0, "adc": None, "defects": BAD, "row_period": 0.0}
    return sensor(load_layout(name), *contacts, **how).frame(0.0)


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


# -- readings that keep a part of the row before ---------------------------------------------------

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


def told_by(name, settling, contacts=TWO, period=0.0, known=None):
    """What the first frame says of settling."""
    made = simulator(name, settling, contacts, period)
    volts, scan = made.frame(0.0), np.asarray(made.grounded)
    if known is not None:
        volts = known.taken_off(volts, scan)
    before = np.full((volts.shape[1],) * 2, np.nan)
    before[scan] = rows_before(volts, scan) / DRIVE
    found = reciprocity(rows_of(volts, grounded=scan), prior(name))
    return unsettled(found, before, np.arange(len(before)), prior(name), known)


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
        pipeline, results = pipeline_of("equal-8x8", profile), []
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
    made, pipeline, apart = simulator("equal-8x8", 0.02, (ONE,), 1e-3), pipeline_of("equal-8x8"), []
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
    result = pipeline_of("equal-8x8").process(frame, GROUNDED, DRIVE)
    (contact,) = result.contacts
    assert result.state == "valid" and off(contact, WHERE) < 5e-4 and result.misfit < 1.3


@pytest.mark.parametrize("settling", [0.005, 0.03])
def test_a_touch_that_begins_within_a_frame_and_rests_tells_it(settling):
    touch = disc(*WHERE, pressure=3e4, start=1.0205)
    made, pipeline = simulator("equal-8x8", settling, (touch,), 1e-3), pipeline_of("equal-8x8")
    for i in range(3):
        start = 1 + 0.064 * i
        result = pipeline.process(made.frame(start, i), GROUNDED, DRIVE, 1e-3, start)
    assert pipeline._state.settling.part.mean() == pytest.approx(settling, rel=0.08)
    (contact,) = result.contacts
    assert off(contact, WHERE) < 3e-4


def test_the_row_before_the_first_one_need_not_be_like_the_last():
    """A touch that begins after a pause, just before the first row."""
    pipeline = pipeline_of("equal-8x8")
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
    frame, pipeline = (
        simulator("equal-8x8", 0.02, swapped=((20, 45),)).frame(0.0),
        pipeline_of("equal-8x8"),
    )
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


def test_gains_from_reciprocity_are_known_as_well_as_they_say():
    """Six frames of any symmetric impedances, twenty draws of gains of 5 %."""
    ratios, misfits, one = [], [], np.ones(12)
    for seed in range(20):
        random = np.random.default_rng(seed)
        gain, volts = 1 + 0.05 * random.standard_normal(12), []
        for _ in range(6):
            root = random.random((12, 3))
            impedance = 2 * np.eye(12) + root @ root.T
            share = impedance / (impedance.diagonal() + random.random(12))[:, None]
            volts.append(DRIVE * gain * (1 - share) + NOISE * random.standard_normal((12, 12)))
            np.fill_diagonal(volts[-1], np.nan)
        known = (one, 0.05 * one), (0 * one, 1e-6 * one)
        found = fit_gains(np.array(volts), DRIVE, NOISE, *known)
        ratios += ((found.gain - gain) / np.sqrt(found.covariance.diagonal()[:12])).tolist()
        misfits += found.misfit.tolist()
    assert np.mean(misfits) == pytest.approx(1.0, abs=0.1)
    assert np.std(ratios) == pytest.approx(1.0, abs=0.25)  # neither biased nor sure of too much
