"""Frames within which something begins, ends or moves are followed row by row."""

from functools import cache

import numpy as np
import pytest

from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.course import Ramp, Tap
from tomotactile_ros.scenes.defects import Adc, Noise
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

LAYOUT, DRIVE, NOISE, LAW = load_layout("equal-8x8"), 3.3, 1e-3, ContactLaw(1e-4, 1.0)
GROUNDED, LASTS = np.arange(64), 64 * ROW_PERIOD
SOFT = Contact(
    "disc", (-0.05, -0.04), 0.007, force=3.0, profile="hertz", start=0.1, course=Tap(0.15)
)
HELD = Contact("disc", (0.04, 0.05), 0.006, force=2.0)


def pipeline(profile="accurate"):
    return Pipeline(LAYOUT, Settings(profile, noise=NOISE, contact_law=LAW))


@cache
def frames_of(*contacts, count):
    """(count, 64, 64) V, frames of the finite-element model without a pause, and their scene."""
    scene = Scene("changing", DRIVE, contacts, LAW, Noise(NOISE, 1), Adc(12, DRIVE))
    simulator = Simulator(LAYOUT, scene, row_period=ROW_PERIOD)
    return [simulator.frame(i * LASTS, i) for i in range(count)], scene


def results_of(frames, stamps=True, maker=None):
    maker = maker or pipeline()
    return [
        maker.process(frame, GROUNDED, DRIVE, ROW_PERIOD, i * LASTS if stamps else None)
        for i, frame in enumerate(frames)
    ]


def off(contact, place) -> float:
    return float(np.hypot(contact.x - place[0], contact.y - place[1]))


@pytest.mark.parametrize("profile", ["accurate", "fast"])
def test_a_tap_that_grows_and_fades_is_one_contact_where_it_is(profile):
    """It begins with row 36 of the second frame and ends with row 58 of the fourth: no two rows show the
    same force."""
    frames, scene = frames_of(SOFT, count=6)
    results = results_of(frames, maker=pipeline(profile))
    assert [result.state for result in results] == ["valid"] * 6
    assert [len(result.contacts) for result in results] == [0, 1, 1, 0, 0, 0]
    for k in (1, 2):
        (contact,) = results[k].contacts
        (true,) = scene.truth(k * LASTS + results[k].holds)
        assert off(contact, SOFT.center) < 1e-3
        assert abs(contact.force - true["force"]) < 2.5 * contact.force_std
    assert results[1].contacts[0].id == results[2].contacts[0].id


def test_a_frame_says_of_its_last_row_what_rows_say_of_it():
    frames = frames_of(SOFT, count=6)[0][:3]
    whole, by_rows = pipeline(), pipeline()
    state = by_rows.rows(waits=False)  # no frame corrects them
    for i, frame in enumerate(frames):
        result = whole.process(frame, GROUNDED, DRIVE, ROW_PERIOD, i * LASTS)
        for j, row in enumerate(frame):
            last = by_rows.process_row(row, j, DRIVE, i * LASTS + j * ROW_PERIOD, state)
    assert result.holds == pytest.approx(63 * ROW_PERIOD)
    (contact,), (other,) = result.contacts, last.contacts
    assert off(contact, (other.x, other.y)) < 1e-4
    assert contact.force == pytest.approx(other.force, rel=0.01)
    assert contact.velocity == pytest.approx(other.velocity, abs=1e-3)


def test_a_step_is_as_exact_as_its_rows_since_then():
    """Rows since a touch that does not change any more tell its size, too."""
    frames, _ = frames_of(Contact("disc", (0.033, -0.021), 0.009, force=4.0, start=0.09), count=2)
    (contact,) = results_of(frames)[1].contacts
    assert off(contact, (0.033, -0.021)) < 2e-4
    assert contact.radius == pytest.approx(0.009, rel=0.1)
    assert contact.force == pytest.approx(4.0, rel=0.1)


def test_a_finger_pressed_ever_harder_beside_another_stays_the_one_of_two():
    """Each frame 0.16 N more: fitted as one that rests, they became one between them."""
    held = Contact("disc", (-0.02, 0.0), 0.006, force=3.0)
    harder = Contact("disc", (0.016, 0.01), 0.006, force=2.0, start=0.1, course=Ramp(rise=0.8))
    frames, _ = frames_of(held, harder, count=8)
    results = results_of(frames)
    for result in results[2:]:
        places = sorted((contact.x, contact.y) for contact in result.contacts)
        assert np.hypot(*(np.array(places) - [held.center, harder.center]).T).max() < 3e-3
        assert {contact.id for contact in result.contacts} == {1, 2}


def test_a_wide_touch_that_lands_is_wide_in_its_first_frame():
    """Rows take it for a small one that conducts more than bare metal."""
    palm = Contact("disc", (-0.03, 0.01), 0.03, force=15.0, start=0.1, course=Tap(0.25))
    frames, scene = frames_of(palm, count=3)
    for k, result in enumerate(results_of(frames)[1:], 1):
        (contact,), (true,) = result.contacts, scene.truth(k * LASTS + result.holds)
        assert off(contact, palm.center) < 2e-3
        assert contact.radius == pytest.approx(0.03, rel=0.1)
        assert contact.force == pytest.approx(true["force"], rel=0.2)


def test_a_soft_release_beside_another_contact_ends_within_rows():
    """What is left of it is below the noise of each row, and not there in all of them."""
    frames, _ = frames_of(SOFT, HELD, count=5)
    maker = pipeline()
    state, ended = maker.rows(), SOFT.start + SOFT.course.duration
    shown = []
    for i, frame in enumerate(frames):
        for j, row in enumerate(frame):
            now = i * LASTS + j * ROW_PERIOD
            result = maker.process_row(row, j, DRIVE, now, state)
            near = any(off(contact, SOFT.center) < 0.02 for contact in result.contacts)
            if near and now >= ended:
                shown.append(now - ended)
            assert len(result.contacts) <= 2
    assert max(shown, default=0.0) <= 5 * ROW_PERIOD
