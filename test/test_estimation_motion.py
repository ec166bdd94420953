"""Contacts that move, begin and end within frames: readings against every row evaluated at its own time,
and what is made of them."""

from dataclasses import replace

import numpy as np
import pytest
from contacts_support import (
    DRIVE,
    LAW,
    NOISE,
    disc,
    frames_of,
    off,
    pipeline_of,
    places,
    sensor,
)

import tomotactile_ros as tt
from tomotactile_ros.estimation.forward import Prediction, Unknowns
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.touch import patches_for
from tomotactile_ros.layouts.layout import equal_grid, load_layout
from tomotactile_ros.layouts.scan_order import spread
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.course import Ramp, Tap
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

LAYOUT = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
OPERATOR = SheetOperator(LAYOUT)
GROUNDED = np.arange(16)
TIMES = ROW_PERIOD * (GROUNDED - 7.5)
RADIUS = 0.006
PATH = (0.02, -0.015)  # m, where the moving one is at the time 0


def sliding(speed: float) -> Unknowns:
    """One that slides and lets go, and one that rests."""
    contacts = np.array([[*PATH, -8.7, np.log(RADIUS), 0, 0], [-0.06, 0.05, -9.0, -5.0, 0, 0]])
    across = (patches_for(RADIUS, OPERATOR.pitch),) * 2
    free = np.tile([True] * 4 + [False] * 2, (2, 1))
    moving = Unknowns.at_rest(OPERATOR).with_contacts(contacts, across, free).in_motion()
    rates = np.array([[0.6, -0.8, -20.0], [0.0, 0.0, 0.0]]) * [speed, speed, 1.0]
    return replace(moving, rates=rates)


def left_over(unknowns, times=TIMES):
    """How far readings of all rows together are from those of each at its time."""
    own = enumerate(TIMES)
    rows = [Prediction(OPERATOR, unknowns.after(t), GROUNDED[i : i + 1]).readings for i, t in own]
    true = np.concatenate(rows)
    return np.linalg.norm(Prediction(OPERATOR, unknowns, GROUNDED, times=times).readings - true)


@pytest.mark.parametrize("speed", [0.1, 1.0, 5.0])
def test_rows_see_contacts_where_they_are_at_their_time(speed):
    """What is left over falls with the square of the ways that are taken for straight ones, as long as one
    evaluation serves all rows."""
    assert left_over(sliding(speed)) < 0.3 * left_over(sliding(speed), None)
    slow = np.array([[0.3, -0.4, -8.0], [0.0, 0.0, 0.0]])
    rest = [left_over(replace(sliding(0.0), rates=part * slow)) for part in (1.0, 0.5, 0.25)]
    assert rest[0] / rest[1] == pytest.approx(4, rel=0.25)
    assert rest[1] / rest[2] == pytest.approx(4, rel=0.25)


# -- what is made of it ----------------------------------------------------------------------------


@pytest.mark.parametrize("profile", ["fast", "accurate"])
def test_the_velocity_of_a_contact_is_reported_and_its_place_is_that_of_the_last_row(profile):
    slide = disc(-0.03, 0.02, pressure=2e4, velocity=(0.5, -0.8))
    frame = sensor(LAYOUT, slide, noise=0.0, adc=None).frame(0.0)
    pipeline = Pipeline(LAYOUT, Settings(profile, contact_law=LAW))
    result = pipeline.process(frame, GROUNDED, DRIVE, ROW_PERIOD)
    (contact,) = result.contacts
    np.testing.assert_allclose(contact.velocity, slide.velocity, atol=0.05)
    assert result.holds == pytest.approx(15 * ROW_PERIOD)
    assert off(contact, slide.at(result.holds).center) < 1e-3


EIGHT = load_layout("equal-8x8")
ALL, LASTS = np.arange(64), 64 * ROW_PERIOD
FIRST = disc(-0.03, 0.0, pressure=2e4)


@pytest.mark.parametrize("profile", ["fast", "accurate"])
def test_two_touches_stay_two(profile):
    """The second begins in the middle of a frame, 60 mm away: no frame shows one between them, or
    one alone, and none is withheld but the one in which it begins."""
    second = disc(0.03, 0.0, pressure=2e4, start=2 * LASTS + 16 * ROW_PERIOD)
    pipeline = pipeline_of(EIGHT, profile)
    frames = frames_of(sensor(EIGHT, FIRST, second, seed=0, adc=None), 7)
    for n, result in enumerate(results_of(frames, pipeline)):
        if n == 2 and result.state == "withheld":
            continue
        assert result.state == "valid"
        found = sorted(c.x for c in result.contacts)
        assert found == pytest.approx([-0.03] if n < 2 else [-0.03, 0.03], abs=1e-3)


@pytest.mark.parametrize("profile, frame", [("fast", 60), ("accurate", 61)])
def test_a_tap_that_begins_in_the_last_rows_is_right_or_withheld(profile, frame):
    """No contact elsewhere, and not none: the last rows read up to a volt."""
    scene = tt.load_scene("tap")
    layout = replace(EIGHT, scan=tuple(map(int, spread(EIGHT.positions, range(64)))))
    simulator = Simulator(layout, scene)
    pipeline = Pipeline(EIGHT, Settings(profile, noise=NOISE, contact_law=scene.contact_law))
    for number in (frame - 1, frame):
        made = simulator.measure(number * LASTS)
        result = pipeline.process(made)
    assert np.nanmax(np.where(ALL == made.grounded[:, None], 0, made.voltages)) > 0.3
    if result.state == "valid":
        (found,) = result.contacts
        assert off(found, (0.06, -0.03)) < 3e-3
    else:
        assert "last" in result.reason and not result.idle


# -- frames within which something changes are followed row by row ---------------------------------

SOFT = disc(-0.05, -0.04, 0.007, force=3.0, profile="hertz", start=0.1, course=Tap(0.15))


def results_of(frames, pipeline=None):
    pipeline = pipeline or pipeline_of(EIGHT)
    given = ALL, DRIVE, ROW_PERIOD
    return [pipeline.process(frame, *given, i * LASTS) for i, frame in enumerate(frames)]


def force_of(simulator, number, result):
    """The true one of the only contact at the time for which the result of a frame holds."""
    (true,) = simulator.scene.truth(number * LASTS + result.holds)
    return true["force"]


@pytest.mark.parametrize("profile", ["accurate", "fast"])
def test_a_tap_that_grows_and_fades_is_one_contact_where_it_is(profile):
    """It begins with row 36 of the second frame and ends with row 58 of the fourth: no two rows show the
    same force."""
    simulator = sensor(EIGHT, SOFT)
    results = results_of(frames_of(simulator, 6), pipeline_of(EIGHT, profile))
    assert [result.state for result in results] == ["valid"] * 6
    assert [len(result.contacts) for result in results] == [0, 1, 1, 0, 0, 0]
    for k in (1, 2):
        (contact,) = results[k].contacts
        assert off(contact, SOFT.center) < 1e-3
        true = force_of(simulator, k, results[k])
        assert abs(contact.force - true) < 2.5 * contact.force_std
    assert results[1].contacts[0].id == results[2].contacts[0].id


def test_a_frame_says_of_its_last_row_what_rows_say_of_it():
    frames, by_rows = frames_of(sensor(EIGHT, SOFT), 3), pipeline_of(EIGHT)
    state = by_rows.rows(waits=False)  # no frame corrects them
    for i, row in enumerate(frames.reshape(-1, 64)):
        last = by_rows.process_row(row, i % 64, DRIVE, i * ROW_PERIOD, state)
    result = results_of(frames)[-1]
    assert result.holds == pytest.approx(63 * ROW_PERIOD)
    (contact,), (other,) = result.contacts, last.contacts
    assert off(contact, (other.x, other.y)) < 1e-4
    assert contact.force == pytest.approx(other.force, rel=0.01)
    assert contact.velocity == pytest.approx(other.velocity, abs=1e-3)


@pytest.mark.parametrize(
    "touch, frames, within, force",
    [
        # rows since a touch that does not change any more tell its size, too
        (disc(0.033, -0.021, 0.009, force=4.0, start=0.09), (1,), 2e-4, 0.1),
        # rows take it for a small one that conducts more than bare metal
        (disc(-0.03, 0.01, 0.03, force=15.0, start=0.1, course=Tap(0.25)), (1, 2), 2e-3, 0.2),
    ],
    ids=["a step", "a wide touch that lands"],
)
def test_a_touch_has_its_size_in_the_frame_in_which_it_begins(touch, frames, within, force):
    simulator = sensor(EIGHT, touch)
    results = results_of(frames_of(simulator, frames[-1] + 1))
    for k in frames:
        (contact,) = results[k].contacts
        assert off(contact, touch.center) < within
        assert contact.radius == pytest.approx(touch.radius, rel=0.1)
        assert contact.force == pytest.approx(force_of(simulator, k, results[k]), rel=force)


def test_a_finger_pressed_ever_harder_beside_another_stays_the_one_of_two():
    """Each frame 0.16 N more: fitted as one that rests, they became one between them."""
    held = disc(-0.02, 0.0, force=3.0)
    harder = disc(0.016, 0.01, force=2.0, start=0.1, course=Ramp(rise=0.8))
    for result in results_of(frames_of(sensor(EIGHT, held, harder), 8))[2:]:
        found = np.array(sorted(places(result.contacts).tolist()))
        assert np.hypot(*(found - [held.center, harder.center]).T).max() < 3e-3
        assert {contact.id for contact in result.contacts} == {1, 2}


def test_a_soft_release_beside_another_contact_ends_within_rows():
    """What is left of it is below the noise of each row, and not there in all of them."""
    held, maker = disc(0.04, 0.05, force=2.0), pipeline_of(EIGHT)
    state, ended, shown = maker.rows(), SOFT.start + SOFT.course.duration, []
    for i, row in enumerate(frames_of(sensor(EIGHT, SOFT, held), 5).reshape(-1, 64)):
        result = maker.process_row(row, i % 64, DRIVE, i * ROW_PERIOD, state)
        if any(off(contact, SOFT.center) < 0.02 for contact in result.contacts):
            shown.append(i * ROW_PERIOD - ended)
        assert len(result.contacts) <= 2
    assert max(shown) <= 5 * ROW_PERIOD
