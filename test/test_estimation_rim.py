"""Sheets that are not cut as the layout has it, and electrodes that are not printed so."""

from dataclasses import replace

import numpy as np
import pytest

import tomotactile_ros as tt
from tomotactile_ros.bench.trials import LAW
from tomotactile_ros.estimation.as_cut import AsCut
from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.tables import Around, off_electrodes
from tomotactile_ros.layouts.tolerance import Tolerance
from tomotactile_ros.learning.file import load_sensor, save_sensor
from tomotactile_ros.learning.findings import lines
from tomotactile_ros.reconstruction.pipeline import Pipeline
from tomotactile_ros.reconstruction.settings import Settings
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.scenes.sheet_field import SheetField, Tear

DRIVE, NOISE = 3.3, 1e-3


def layout(outline, half=0.1, side=4, radius=0.005):
    at = np.linspace(-half, half, side)
    places = np.array([[x, y] for y in at for x in at])
    return tt.Layout("cut", outline, 1e4, radius, places)


def square(size, **others):
    return layout(tt.Outline.rectangle(size, size), **others)


OUTLINES = {
    "square": lambda by: square(0.2 + 2 * by),
    "round": lambda by: layout(tt.Outline.circle(0.1 + by), 0.03, radius=0.003),
}


@pytest.mark.parametrize("name, by", [("square", 3e-3), ("round", 10e-3)])
def test_a_larger_outline_changes_couplings_and_shares_as_another_mesh_of_it_says(name, by):
    """To first order: what meshes differ by, and second order, are the rest."""
    drawn, cut = (SheetOperator(OUTLINES[name](way), "fem") for way in (0.0, by))
    sheet = np.zeros(drawn.modes)
    sheet[drawn.of_rim][:4] = by
    seen = (np.abs(drawn.admittance) > 2e-3 * drawn.admittance.max()) & ~np.eye(16, dtype=bool)
    change = np.log(cut.admittance[seen] / drawn.admittance[seen])
    told = np.log(drawn.admittance_of(sheet)[seen] / drawn.admittance[seen])
    assert np.abs(change - told).max() < 0.25 * np.abs(change).max()
    places = off_electrodes(np.random.default_rng(0).uniform(-0.06, 0.06, (99, 2)), drawn.layout)
    shares = [each.points(places, np.full(99, 0.003))[0] for each in (drawn, cut)]
    change, told = shares[1] - shares[0], drawn.share_added(sheet, Around(drawn.lattice, places))
    assert 0.6 < np.polyfit(told.ravel(), change.ravel(), 1)[0] < 1.2


def wider(by):
    return SheetOperator(square(0.2, radius=0.005 * np.exp(by)))


def test_wider_electrodes_change_couplings_and_shares_as_solutions_with_them_differ():
    step, drawn, sheet = 0.05, wider(0.0), np.zeros(wider(0.0).modes)
    more, less = wider(step), wider(-step)
    off, sheet[-1] = ~np.eye(16, dtype=bool), 1.0
    change = ((more.admittance - less.admittance) / (2 * step))[off]
    own = drawn.admittance @ (drawn.by_radius[:, None] * drawn.admittance)  # of less resistance
    told = (drawn.admittance_change(0 * sheet)[-1] + own)[off]
    assert np.abs(change - told).max() < 5e-3 * np.abs(change).max()
    nodes = drawn.lattice.points[(np.abs(drawn.lattice.points) < 0.095).all(axis=1)]
    nodes = nodes[drawn.layout.nearest(nodes)[0] > 0.015]
    share, *shares = (
        each.points(nodes, np.full(len(nodes), 1e-5))[0] for each in (drawn, more, less)
    )
    change = (shares[0] - shares[1]) / (2 * step)
    told = drawn.admittance @ (drawn.by_radius[:, None] * share)
    told += drawn.share_added(sheet, Around(drawn.lattice, nodes))
    assert np.abs(change - told).max() < 0.05 * np.abs(change).max()


@pytest.mark.parametrize(
    "drawn, true",
    [
        (square(0.2), square(0.22, radius=0.0065)),
        (
            layout(tt.Outline.rectangle(0.2, 0.12), half=0.05),
            layout(tt.Outline.rectangle(0.19, 0.14), half=0.05, radius=0.004),
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
    contacts = [
        Contact("disc", center=at, radius=0.006, force=2.0, start=i, end=i + 1.0)
        for i, at in enumerate(places)
    ]
    defects = Defects(sheet=sheet or SheetField())
    simulator = tt.Simulator(true, Scene("cut", DRIVE, contacts, LAW, defects=defects))
    frames = np.array([simulator.frame(i + 0.5) for i in range(len(places))])
    return frames + np.random.default_rng(1).normal(0, NOISE, frames.shape)


def fine(size, half=0.1, radius=0.0025):
    return square(size, half=half, side=8, radius=radius)


@pytest.mark.parametrize(
    "drawn, true, within",
    [
        (fine(0.2), fine(0.204), 0.3e-3),
        (fine(0.2, 0.09), fine(0.195, 0.09), 0.3e-3),
        (fine(0.2), fine(0.2, radius=0.0035), 1e-3),
        (square(0.2), square(0.204), 1.5e-3),
    ],
    ids=["4 mm more", "5 mm less", "electrodes too large", "4 x 4, 4 mm more"],
)
def test_a_contact_on_a_sheet_that_was_cut_or_printed_otherwise(drawn, true, within):
    places, pipeline = ((0.037, 0.052), (-0.071, 0.018)), Pipeline(drawn, Settings("accurate"))
    for at, frame in zip(places, pressed(true, places), strict=True):
        pipeline.untare()  # as the first frame
        result = pipeline.process(frame, drawn.grounded, DRIVE)
        assert result.state == "valid", result.reason
        (found,) = result.contacts
        assert np.hypot(found.x - at[0], found.y - at[1]) < within
        assert abs(found.force - 2.0) < max(0.2, 3 * found.force_std)


def test_a_sheet_is_solved_as_its_first_touch_finds_it_cut():
    drawn, true, at = fine(0.2), fine(0.22), (0.037, 0.052)
    (frame,) = pressed(true, [at])
    pipeline = Pipeline(drawn, Settings("accurate"))
    (found,) = pipeline.process(frame, drawn.grounded, DRIVE).contacts
    assert np.hypot(found.x - at[0], found.y - at[1]) < 0.3e-3
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


def test_a_contact_on_a_torn_sheet():
    """No sheet near the layout's explains its couplings; its currents tell all the same."""
    torn = SheetField(tears=(Tear(((-0.045, 0.027), (0.045, 0.027)), 0.001),))
    at, layout = (-0.043, -0.03), fine(0.2)
    (frame,) = pressed(layout, [at], torn)
    result = Pipeline(layout, Settings("accurate")).process(frame, layout.grounded, DRIVE)
    assert result.state == "valid" and result.misfit > 10
    (found,) = result.contacts
    assert np.hypot(found.x - at[0], found.y - at[1]) < 1e-3


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
    np.testing.assert_allclose(again.mean, learned.state.mean, atol=1e-5)
    np.testing.assert_allclose(again.deviation, learned.state.deviation, rtol=1e-3)
    np.testing.assert_allclose(again.expected, learned.state.expected, rtol=1e-5)
    places, off = random.uniform(-0.08, 0.08, (8, 2)), []
    pipelines = [Pipeline(drawn, Settings("accurate"), sensor=each) for each in (again, None)]
    for at, frame in zip(places, pressed(true, places), strict=True):
        for pipeline in pipelines:
            pipeline.untare()  # as the first frame
            (found,) = pipeline.process(frame, drawn.grounded, DRIVE).contacts
            off.append(np.hypot(found.x - at[0], found.y - at[1]))
    learned, drawn_only = np.median(np.reshape(off, (-1, 2)), axis=0)
    assert learned < drawn_only
