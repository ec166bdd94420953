"""Sheets that are not cut as the layout has it, or torn, and electrodes that are not printed so: what is found of
that, and what is right afterwards."""

from dataclasses import replace

import numpy as np
import pytest
from contacts_support import DRIVE, NOISE, disc, off, sensor

import tomotactile_ros as tt
from tomotactile_ros.estimation.as_cut import AsCut, torn
from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.tears import find_tears
from tomotactile_ros.layouts.tolerance import Tolerance
from tomotactile_ros.learning.file import load_sensor, save_sensor
from tomotactile_ros.learning.findings import lines
from tomotactile_ros.learning.health import Health
from tomotactile_ros.reconstruction.pipeline import Pipeline
from tomotactile_ros.reconstruction.settings import Settings
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.scenes.sheet_field import SheetField, Tear


def layout_of(outline, half=0.1, side=4, radius=0.005):
    at = np.linspace(-half, half, side)
    places = np.array([[x, y] for y in at for x in at])
    return tt.Layout("cut", outline, 1e4, radius, places)


def square(size, **others):
    return layout_of(tt.Outline.rectangle(size, size), **others)


def round_of(radius):
    return layout_of(tt.Outline.circle(radius), 0.03, radius=0.003)


@pytest.mark.parametrize(
    "drawn, true",
    [
        (square(0.2), square(0.22, radius=0.0065)),
        (
            layout_of(tt.Outline.rectangle(0.2, 0.12), half=0.05),
            layout_of(tt.Outline.rectangle(0.19, 0.14), half=0.05, radius=0.004),
        ),
    ],
)
def test_an_operator_about_what_was_cut_and_printed_is_that_of_a_layout_drawn_so(drawn, true):
    operator, same = SheetOperator(drawn), SheetOperator(true)
    sheet = np.zeros(operator.modes)
    out = (np.array(true.outline.size) - drawn.outline.size) / 2
    sheet[operator.of_rim][:4] = np.repeat(out, 2)
    sheet[-1] = np.log(true.radius / drawn.radius)
    about = operator.near(sheet)
    np.testing.assert_allclose(about.expected, same.expected, rtol=1e-9, atol=1e-15)
    places = np.random.default_rng(0).uniform(-0.05, 0.05, (50, 2))
    pairs = zip(about.shares(places, 0.003), same.shares(places, 0.003), strict=True)
    for ours, theirs in pairs:
        np.testing.assert_allclose(ours, theirs, rtol=1e-9, atol=1e-9)
    assert about.near(sheet) is about and operator.near(0 * sheet) is operator


def test_a_sheet_is_never_taken_to_be_too_small_for_its_electrodes():
    drawn = square(0.2)  # electrodes on its rim
    smaller = AsCut(drawn, np.array([*4 * [-2e-3], 0, 0, 0, 0, 3.0]))
    assert smaller.layout.outline.size == drawn.outline.size
    assert 2 * smaller.layout.radius < drawn.pitches.min()


def test_electrodes_have_no_shift_turn_or_scale_in_common():
    operator = SheetOperator(square(0.2))
    x, y = operator.layout.positions.T
    covariance = ChannelPrior().covariance_of_places(operator)
    alone = ChannelPrior().aside * operator.pitch
    for way in ([1, 0], [0, 1], [x, y], [-y, x]):
        together = np.concatenate([np.broadcast_to(each, 16) for each in way]).astype(float)
        together /= np.linalg.norm(together)
        assert np.sqrt(together @ covariance @ together) < 0.02 * alone
    askew = np.concatenate([x, -y]) / np.linalg.norm([x, y])
    assert np.sqrt(askew @ covariance @ askew) == pytest.approx(alone)


def test_what_a_layout_says_of_its_making_is_expected_of_the_sheet():
    drawn = square(0.2)
    loose = replace(drawn, tolerance=Tolerance(outline=4e-3, places=2e-3, radius=0.3))
    before, after = (
        Prior.unknown(SheetOperator(each), ChannelPrior().for_layout(each), 0.005, DRIVE)
        for each in (drawn, loose)
    )
    np.testing.assert_allclose(after.sheet_deviation[-9:-1], 4 * before.sheet_deviation[-9:-1])
    assert after.sheet_deviation[-1] == pytest.approx(3 * before.sheet_deviation[-1])
    np.testing.assert_allclose(after.deviations[3], before.deviations[3] * 2e-3 / (3e-3 * 0.2 / 3))


def pressed(true, places, sheet=None):
    """Frames of 2 N on a foot of 6 mm at one place after the other, V."""
    contacts = [disc(*at, force=2.0, start=i, end=i + 1.0) for i, at in enumerate(places)]
    defects = Defects(sheet=sheet or SheetField())
    simulator = sensor(true, *contacts, noise=0.0, adc=None, defects=defects)
    frames = np.array([simulator.frame(i + 0.5) for i in range(len(places))])
    return frames + np.random.default_rng(1).normal(0, NOISE, frames.shape)


def fine(size, half=0.1, radius=0.0025, side=8):
    return square(size, half=half, side=side, radius=radius)


TWO = ((0.037, 0.052), (-0.071, 0.018))


@pytest.mark.parametrize(
    "drawn, true, places, within",
    [
        (fine(0.2), fine(0.204), TWO, 0.3e-3),
        (fine(0.2, 0.09, side=6), fine(0.195, 0.09, side=6), TWO, 0.3e-3),
        (fine(0.2, side=6), fine(0.2, radius=0.0035, side=6), TWO, 1e-3),
        (square(0.2), square(0.204), TWO, 1.5e-3),
        (round_of(0.1), round_of(0.11), ((0.012, 0.017), (-0.022, 0.004)), 1e-3),
    ],
    ids=[
        "4 mm more",
        "5 mm less",
        "electrodes too large",
        "4 x 4, 4 mm more",
        "round, 20 mm more",
    ],
)
def test_a_contact_on_a_sheet_that_was_cut_or_printed_otherwise(drawn, true, places, within):
    pipeline = Pipeline(drawn, Settings("accurate"))
    for at, frame in zip(places, pressed(true, places), strict=True):
        pipeline.untare()  # as the first frame
        result = pipeline.process(frame, drawn.grounded, DRIVE)
        assert result.state == "valid", result.reason
        (found,) = result.contacts
        assert off(found, at) < within
        assert abs(found.force - 2.0) < max(0.2, 3 * found.force_std)


def test_where_a_tear_is_not_known_a_touch_shows_it_and_contacts_beside_it_are_right():
    layout = square(0.15, half=0.075, side=6, radius=0.0025)
    tear = (-0.02, 0.028, 0.05, 0.028)
    sheet = SheetField(tears=(Tear((tear[:2], tear[2:]), 0.001),))
    pipeline = Pipeline(layout, Settings("accurate"))
    places = (0.015, 0.036), (0.0, 0.02), (0.03, -0.03)
    for at, frame in zip(places, pressed(layout, places, sheet), strict=True):
        pipeline.untare()  # as the first frame
        result = pipeline.process(frame, layout.grounded, DRIVE)
        (contact,) = result.contacts
        assert off(contact, at) < (0.3e-3 if at[1] < 0 else 3e-3)
        assert off(contact, at) < 3 * contact.position_covariance[0] ** 0.5
        assert result.misfit < 1.5
    assert pipeline.made_otherwise.startswith("the sheet is torn from (")
    made = pipeline.estimator.made_as
    assert made is not None and distance(made.tears[0], tear) < 3e-3


def test_a_sheet_is_solved_as_its_first_touch_finds_it_cut():
    drawn, true, at = fine(0.2), fine(0.22), (0.037, 0.052)
    (frame,) = pressed(true, [at])
    pipeline = Pipeline(drawn, Settings("accurate"))
    (found,) = pipeline.process(frame, drawn.grounded, DRIVE).contacts
    assert off(found, at) < 0.3e-3
    used = tuple(range(64))
    cut = pipeline.estimator.operator_of(used).cut
    assert cut.outline.size == pytest.approx((0.22, 0.22), abs=0.5e-3)
    assert abs(found.force - 2.0) < 0.2 and found.force_std < 0.2  # linear: 2.7 +- 0.8
    said = pipeline.made_otherwise
    assert said.startswith("the sheet seems to be 2") and "not 200.0 mm x 200.0 mm" in said
    known = Pipeline(drawn, Settings("accurate", unknown=("gains", "offsets")))
    known.process(frame, drawn.grounded, DRIVE)
    assert known.estimator.operator_of(used).cut.outline.size == drawn.outline.size
    assert not known.made_otherwise


def test_places_of_electrodes_are_expected_as_a_first_touch_finds_them():
    drawn, at = fine(0.2), (0.037, 0.052)
    way = np.random.default_rng(4).normal(0, 1e-3, drawn.positions.shape)
    true = replace(drawn, positions=np.clip(drawn.positions + way, -0.1, 0.1))
    pipeline = Pipeline(drawn, Settings("accurate"))
    (frame,) = pressed(true, [at])
    result = pipeline.process(frame, drawn.grounded, DRIVE)
    (found,) = result.contacts
    assert result.misfit < 1.05  # 1.2 with 0.09 mm expected of what is 1 mm
    # all lie 0.2 mm aside in the mean, which nothing tells
    assert off(found, at) < 0.4e-3 and found.position_covariance[0] < 0.6e-3**2
    assert 0.5e-3 < pipeline.estimator.channels.aside * (0.2 / 7) < 1.2e-3


def test_learning_finds_the_outline_and_makes_places_no_worse(tmp_path):
    drawn, true, random = square(0.2), square(0.204), np.random.default_rng(11)
    frames = pressed(true, random.uniform(-0.085, 0.085, (14, 2)))
    learned = tt.learn(drawn, frames, drawn.grounded, DRIVE, noise=NOISE)
    out, spread = (
        each[learned.operator.of_rim][:4] for each in (learned.state.mean, learned.state.deviation)
    )
    assert (np.abs(out - 2e-3) < 3 * spread).all() and spread.max() < 0.4e-3
    assert any("left +" in line for line in lines(learned))
    save_sensor(tmp_path / "sensor.yaml", drawn, learned.operator, learned.state)
    again = load_sensor(tmp_path / "sensor.yaml", drawn)
    places, apart = random.uniform(-0.08, 0.08, (8, 2)), []
    pipelines = [Pipeline(drawn, Settings("accurate"), sensor=each) for each in (again, None)]
    for at, frame in zip(places, pressed(true, places), strict=True):
        for pipeline in pipelines:
            pipeline.untare()  # as the first frame
            (found,) = pipeline.process(frame, drawn.grounded, DRIVE).contacts
            apart.append(off(found, at))
    learned, drawn_only = np.median(np.reshape(apart, (-1, 2)), axis=0)
    assert learned < drawn_only


# -- torn: where -----------------------------------------------------------------------------------

LAYOUT = square(0.125, half=0.0625, side=5, radius=0.0025)
OPERATOR = SheetOperator(LAYOUT)
TEAR = (-0.02, 0.018, 0.04, 0.018)
OF_TEAR = SheetField(tears=(Tear((TEAR[:2], TEAR[2:]), 0.001),))


def distance(tear, true):
    """Of the ends of one to those of the other, the farther one, m."""
    ends, others = np.reshape(tear, (2, 2)), np.reshape(true, (2, 2))
    return min(np.linalg.norm(ends - each, axis=1).max() for each in (others, others[::-1]))


def uncertain(layout):
    """Couplings of a sheet that is not quite even."""
    random = np.random.default_rng(0).normal(0, 0.05, (25, 25))
    return SheetOperator(layout).admittance * np.exp((random + random.T) / 2)


def test_a_second_tear_from_the_rim_is_found_beside_the_first():
    first, second = TEAR, (0.0, -0.0625, 0.0, -0.015)
    operator = OPERATOR.about(np.zeros(OPERATOR.modes), (first,))
    (found,) = find_tears(operator, uncertain(torn(LAYOUT, (first, second))))
    assert distance(found, second) < 0.01


def test_a_tear_that_cuts_an_electrode_off_is_none():
    corner = ((-0.07, -0.05, -0.05, -0.07),)
    with pytest.raises(tt.InputError, match="outside the outline"):
        torn(LAYOUT, corner)


def test_learning_names_a_tear_and_contacts_are_right_beside_it(tmp_path):
    touches = pressed(LAYOUT, np.random.default_rng(2).uniform(-0.054, 0.054, (6, 2)), OF_TEAR)
    learned = tt.learn(LAYOUT, touches, LAYOUT.grounded, DRIVE, noise=NOISE)
    (found,) = learned.state.tears
    assert distance(found, TEAR) < 3e-3
    said = [line for line in lines(learned) if "torn from" in line]
    assert len(said) == 1 and learned.unexplained < 3
    save_sensor(tmp_path / "sensor.yaml", LAYOUT, learned.operator, learned.state)
    known = load_sensor(tmp_path / "sensor.yaml", LAYOUT)
    np.testing.assert_allclose(known.tears, learned.state.tears, atol=1e-6)
    health = Health(OPERATOR)
    for _ in range(2):
        health.update(known)
    assert any("torn from" in each.text for each in health.findings)
    pipeline = Pipeline(LAYOUT, Settings("accurate"), sensor=known)
    places = (0.015, 0.026), (0.0, 0.012)
    for at, frame in zip(places, pressed(LAYOUT, places, OF_TEAR), strict=True):
        pipeline.untare()  # as the first frame
        (contact,) = pipeline.process(frame, LAYOUT.grounded, DRIVE).contacts
        assert off(contact, at) < 1e-3
