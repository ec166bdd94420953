"""Contacts in frames of finite elements: how many, where, how strong, how sure."""

from functools import cache

import numpy as np
import pytest
from contacts_support import (
    DRIVE,
    LAW,
    NOISE,
    deviations_off,
    disc,
    off,
    pipeline_of,
    places,
    rows_of,
    scene_on,
    sensor,
    told_rightly,
    unknown,
)

from tomotactile_ros.bench.sensor.readings import potentials, readings
from tomotactile_ros.bench.sensor.states import states
from tomotactile_ros.bench.trials import record, worn_scene
from tomotactile_ros.estimation.estimator import Estimator, State
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.search import Search
from tomotactile_ros.layouts.layout import Layout, equal_grid, load_layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.reconstruction.grounded import GroundedSheet
from tomotactile_ros.scenes.defects import Defects, SheetVariation

ONE = ((0.03, 0.02, 0.005, 2e4),)
TWO = (*ONE, (-0.05, -0.04, 0.004, 1e4))


def grid(count):
    return equal_grid(count, count, (0.2, 0.2), 0.0025, 1e4)


def layout_of(name, positions, outline=None):
    return Layout(name, outline or Outline.rectangle(0.2, 0.2), 1e4, 0.0025, positions)


ANGLE = 2 * np.pi * np.arange(16) / 16
SIX = grid(6).positions
LAYOUTS = {
    "inner": layout_of("inner", 0.86 * grid(8).positions),  # leaves 14 mm to the rim
    "4x4": grid(4),
    "8x8": grid(8),
    "void": layout_of(
        "void", SIX[np.abs(SIX).max(axis=1) > 0.03]
    ),  # without the four in the middle
    "ring": layout_of(
        "ring", 0.095 * np.stack([np.cos(ANGLE), np.sin(ANGLE)], axis=-1), Outline.circle(0.1)
    ),
}


@cache
def search(name):
    return Search(SheetOperator(LAYOUTS[name]))


def simulate(name, discs, noise=NOISE, sequence=0, variation=None):
    """(E, E) V: a frame of finite elements."""
    contacts = [disc(x, y, radius, pressure=pressure) for x, y, radius, pressure in discs]
    defects = Defects(sheet_variation=variation)
    made = sensor(LAYOUTS[name], *contacts, noise=noise, seed=0, adc=None, defects=defects)
    return made.frame(0.0, sequence)


def find(name, frame, noise=NOISE):
    """The fit of a frame."""
    return search(name).contacts(rows_of(frame, noise), unknown(search(name).operator))


@cache
def estimator(name, noise=NOISE):
    return Estimator(LAYOUTS[name], noise=noise, law=LAW, radius=0.005)


def estimate(name, frame, noise=NOISE):
    return estimator(name, noise).estimate(frame, np.arange(len(frame)), DRIVE, State())


def check(fit, discs, place=0.3e-3, force=0.12):
    """As many contacts as `discs`, each within `place` (m) and `force` (relative) of its own."""
    contacts = fit.unknowns.contacts
    assert len(contacts) == len(discs), contacts[:, :4]
    for x, y, radius, pressure in discs:
        apart = np.hypot(*(contacts[:, :2] - (x, y)).T)
        nearest = int(apart.argmin())
        assert apart[nearest] < place
        true = LAW.conductance(pressure) * np.pi * radius**2
        assert fit.prediction.conductances[nearest] == pytest.approx(true, rel=force)


@pytest.mark.parametrize(
    "name, discs, place, force",
    [
        ("4x4", ONE, 0.3e-3, 0.2),
        ("4x4", TWO, 0.3e-3, 0.2),
        ("8x8", ((0.0, 0.02, 0.005, 2e4), (0.03, 0.02, 0.005, 2e4)), 0.3e-3, 0.12),
        ("void", ((0.004, -0.003, 0.005, 2e4),), 0.3e-3, 0.3),
        ("ring", ((0.02, 0.03, 0.005, 2e4),), 2e-3, 0.3),
    ],
)
def test_contacts_on_layouts_of_every_kind(name, discs, place, force):
    check(find(name, simulate(name, discs)), discs, place, force)


def test_a_wide_contact_far_from_all_electrodes():
    discs = ((-0.0121, 0.0016, 0.01, 4.5e4),)
    result = estimate("ring", simulate("ring", discs))
    if result.state == "withheld":
        assert result.reason
        return
    assert len(result.contacts) == 1  # what touches is never passed over without a word
    assert off(result.contacts[0], discs[0]) < 2e-3


@pytest.mark.parametrize("name, noise", [("4x4", 8e-3), ("8x8", 3e-3), ("ring", 8e-3)])
def test_more_noise_than_was_said_is_seen_and_taken_as_that(name, noise):
    """Of frames for which 1 mV was said: touched ones, which hold no other contact, and untouched
    ones, of which a converter cuts off half."""
    discs = TWO if name == "8x8" else ONE
    frame = simulate(name, discs, noise)
    said = estimate(name, frame)
    assert said.noise == pytest.approx(noise, rel=0.25)
    assert said.state == "valid" and said.misfit < 1.5
    for place in discs:  # within the region of 99 %, and this small
        assert min(deviations_off(c, place) for c in said.contacts) < 9.2
        assert min(off(c, place) for c in said.contacts) < 3e-3
    assert len(said.contacts) == len(discs)
    said = estimate(name, np.maximum(simulate(name, (), noise), 0.0))
    assert (said.state, said.contacts) == ("valid", [])
    assert said.noise == pytest.approx(noise, rel=0.25)


@pytest.mark.parametrize("said", [NOISE, 30e-3])
def test_noise_that_hides_how_many_contacts_there_are_is_named(said):
    """Of two contacts 52 mm apart, 30 mV on 16 electrodes made a valid one amid them."""
    discs = ((-0.0193, 0.0273, 0.005, 2e4), (-0.0707, 0.0188, 0.005, 2e4))
    frame = simulate("4x4", discs, 30e-3)
    found = estimate("4x4", frame, said)
    assert (found.state, found.contacts, found.parts) == ("withheld", [], [])
    assert "cannot tell contacts apart" in found.reason
    assert found.noise == pytest.approx(30e-3, rel=0.25)
    assert not estimate("4x4", simulate("4x4", (), 30e-3), said).contacts


def test_what_is_no_noise_is_not_taken_for_it():
    """Frames of two states of the sheet, without the times of their rows, leave much over that is
    the same for neighbours."""
    frame, other = simulate("8x8", ONE), simulate("8x8", TWO[1:])
    frame[32:] = other[32:]
    said = estimate("8x8", frame)
    assert said.state == "withheld" and said.noise < 3 * NOISE


def test_the_sheet_is_told_by_contacts():
    """Y0 as estimated from one frame is three times as near to the true one as an even sheet's.

    Noise of 5 mV is assumed, about what the elements of the frame are off by.
    """
    variation = SheetVariation(0.1, 0.05, seed=1)
    discs = ((0.03, 0.02, 0.005, 2e4), (-0.05, -0.04, 0.005, 2e4), (0.05, -0.06, 0.005, 2e4))
    frame = simulate("4x4", discs, 5e-3, variation=variation)
    fit = find("4x4", frame, noise=5e-3)
    check(fit, discs, place=2e-3, force=0.4)
    sheet = sensor(LAYOUTS["4x4"], defects=Defects(sheet_variation=variation)).sheet
    true = GroundedSheet(sheet.transfer(np.zeros((1, 2)), np.full(1, 0.001))).admittance
    seen = np.triu(np.abs(true) > 0.1 * np.abs(true).max(), 1)
    found, even = (
        np.log(y0[seen] / true[seen])
        for y0 in (fit.operator.admittance_of(fit.unknowns.sheet), fit.operator.admittance)
    )
    assert found.std() < even.std() / 3


def test_two_fingers_that_an_ellipse_nearly_explains_are_two():
    """On many electrodes what one ellipse leaves of two discs is little beside all readings."""
    layout = equal_grid(11, 11, (0.1375, 0.1375), 0.00125, 1e4)
    true = np.array([[0.016, -0.0332], [0.0015, -0.044]])
    contacts = [disc(*place, 0.005, pressure=2e4) for place in true]
    frame = sensor(layout, *contacts, seed=0, adc=None).frame(0.0)
    estimator = Estimator(layout, noise=NOISE, law=LAW, radius=0.005)
    at = places(estimator.estimate(frame, layout.grounded, DRIVE, State()).contacts)
    assert at.shape == (2, 2)
    assert np.hypot(*(true[:, None] - at).transpose(2, 0, 1)).min(axis=1).max() < 0.5e-3


@pytest.mark.parametrize(
    "place, seed",
    [
        ((-0.0841, -0.0819, 0.0071, 11e3), 6),
        ((0.0907, -0.0851, 0.0077, 7.5e3), 51),
        ((-0.0886, 0.0870, 0.0083, 10e3), 52),
    ],
)
def test_contacts_beyond_the_outermost_electrodes(place, seed):
    """The sheet was bent to a contact on the rim or across an electrode, 5 to 8 mm off."""
    frame = simulate("inner", [place], sequence=seed, variation=SheetVariation(0.1, 0.05, seed))
    (contact,) = estimate("inner", frame).contacts
    assert off(contact, place) < 3.5e-3 and deviations_off(contact, place) < 6  # 95 %


def test_a_disc_that_covers_an_electrode_is_found_in_its_size():
    """From the typical radius it ended beside the electrode, with the sheet bent to it: 0.19 mm and 4 % off,
    said to be known to 0.05 mm. Frames of another model."""
    pressed = states("textbook-8x8", most=11)
    frame = readings(potentials(pressed.seen[10]), seed=(10, 1))
    pipeline = pipeline_of(pressed.layout)
    (contact,) = pipeline.process(frame, np.arange(64), DRIVE).contacts
    (true,) = pressed.truths[10]
    assert off(contact, (true["x"], true["y"])) < 0.1e-3
    assert contact.radius == pytest.approx(true["radius"], rel=0.05)


def crowd(count, side, random):
    """(count, 2) m, places about those of a square of 4 x 4."""
    at = np.linspace(-side, side, 4)
    lattice = np.array([(x, y) for x in at for y in at])
    return lattice[random.permutation(16)[:count]] + random.uniform(-3e-3, 3e-3, (count, 2))


@pytest.mark.parametrize("count", [12, 16])
def test_crowds_are_found_one_by_one(count):
    """Of twelve contacts, 40 mm or more apart, four were reported, of sixteen fingers three, one where nothing is."""
    random = np.random.default_rng(count)
    true = crowd(count, 0.07, random)
    discs = [(*at, random.uniform(4e-3, 7e-3), 1e4 * 5 ** random.random()) for at in true]
    check(find("8x8", simulate("8x8", discs)), discs, place=1e-3, force=0.25)


@pytest.mark.parametrize("count, side, seed", [(12, 0.066, 12), (12, 0.06, 101), (16, 0.054, 101)])
def test_a_crowd_on_a_worn_sensor(count, side, seed):
    """With the sensor as expected all hypotheses leave hundreds of times the noise: compared by that, fewer
    contacts won, and half of such frames had contacts where nothing is; two of the second were one shape of cells."""
    true, layout = crowd(count, side, np.random.default_rng(seed)), load_layout("equal-8x8")
    (frame,) = record(layout, worn_scene(), [true]).frames
    found = places(pipeline_of(layout).process(frame, np.arange(64), DRIVE).contacts)
    assert len(found) == count
    assert np.hypot(*(found[:, None] - true).transpose(2, 0, 1)).min(axis=0).max() < 1.5e-3


def test_a_search_that_is_used_up_says_so():
    """Of 24 contacts one spacing apart 15 to 18 were reported, some where nothing is, as all there is."""
    found, told = search("8x8"), []
    lattice = np.array([(0.03 * i, 0.03 * j) for i in range(-2, 3) for j in range(-2, 3)])
    dense = lattice + np.random.default_rng(1).uniform(-2e-3, 2e-3, (25, 2))
    for pressed, how in ((dense, {"budget": 1}), (crowd(16, 0.04, np.random.default_rng(14)), {})):
        frame = simulate("8x8", [(*at, 5e-3, 2e4) for at in pressed])
        fit = found.contacts(rows_of(frame), unknown(found.operator), **how)
        told.append((found.gave_up(fit), len(fit.unknowns.contacts) == len(pressed)))
    assert told == [(True, False), (False, True)]


def test_fingers_beside_a_palm_are_no_cells():
    """In four of six frames a shape of 66 cells with a bent sheet left nothing over: forces 8 % and radii 30 %
    off, and later frames went on from there."""
    simulator, pipeline = scene_on("equal-8x8", "hand")
    found = pipeline.process(simulator.measure(0.064, 1))
    assert told_rightly(found, simulator.scene.truth(0.0), 1e-3, 0.06)


def test_a_wide_contact_at_low_pressure_is_one():
    """To the first look it is six points, each a spacing from the next."""
    (contact,) = estimate("8x8", simulate("8x8", [(0.01, -0.02, 0.04, 5e3)])).contacts
    assert off(contact, (0.01, -0.02)) < 1e-3
    assert contact.radius == pytest.approx(0.04, rel=0.05)


@pytest.mark.parametrize("pressure", [18, 13])
def test_a_contact_hardly_above_the_noise_is_an_answer_or_a_reason(pressure):
    """Z is then nearly the same everywhere, as of an untouched sheet: sums of its differences must not
    vanish. No overflow, and no contact that is much stronger."""
    for sequence in (19, 21):
        frame = simulate("8x8", [(0.01, 0.01, 0.002, pressure)], sequence=sequence)
        with np.errstate(over="raise", divide="raise", invalid="raise"):
            found = estimate("8x8", frame)
        assert found.state == "valid" or found.reason
        assert sum(contact.force for contact in found.contacts) < 0.01


def test_of_a_conductor_on_an_electrode_no_points_are_picked_that_conduct_nothing():
    """64 were, in a second: what a conductor lets flow, small contacts do not explain."""
    x, y = LAYOUTS["8x8"].positions[36]
    rows, prior = rows_of(simulate("8x8", [(x, y, 0.005, 1e11)])), unknown(search("8x8").operator)
    look = search("8x8").detector.first_look(rows, *prior.deviations[:2])
    found, strengths, _ = look._points(0.005)
    assert 0 < len(found) < 10 and strengths.max() > 0
