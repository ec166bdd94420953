"""Contacts followed row by row."""

import json
from collections import defaultdict
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tomotactile_ros import cli
from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.estimator import Estimator
from tomotactile_ros.estimation.follow import Follower
from tomotactile_ros.estimation.forward import Prediction, Unknowns
from tomotactile_ros.estimation.operator import operator_for
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.reported import Estimate
from tomotactile_ros.estimation.row_estimator import RowEstimator, RowsState
from tomotactile_ros.estimation.row_model import Known, RowModel
from tomotactile_ros.estimation.settling import Settling
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Adc, Noise
from tomotactile_ros.scenes.scene import Scene, load_scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

LAYOUT = load_layout("equal-4x4")
DRIVE, NOISE = 3.3, 1e-3
NEW = {"center": (-0.045, 0.03), "radius": 0.008, "pressure": 15e3}
PRESSED = {"center": (0.031, -0.022), "radius": 0.006, "pressure": 2e4}
RESTING = Contact("disc", center=(0.05, -0.04), radius=0.008, pressure=15e3)


@pytest.fixture(scope="module")
def operator():
    return operator_for(LAYOUT)


@pytest.fixture(scope="module")
def known(operator):
    prior = Prior.unknown(operator, ChannelPrior(), 0.008, DRIVE)
    return Known.before(prior, (NOISE / DRIVE) ** 2)


def frames_of(contacts, count):
    """(count, L, E) readings of the finite-element model, V, frames without a pause."""
    law = ContactLaw(1e-4, 1.0)
    scene = Scene("rows", DRIVE, contacts, law, Noise(NOISE, 1), Adc(12, DRIVE))
    simulator = Simulator(LAYOUT, scene, row_period=ROW_PERIOD)
    return np.array([simulator.frame(i * 16 * ROW_PERIOD, i) for i in range(count)])


def followed(operator, known, contacts, count):
    """{number: place} after each row."""
    follower = Follower(operator, 0.008, 0.6)
    state = follower.begin(known)
    out = []
    for i, row in enumerate(frames_of(contacts, count).reshape(-1, 16)):
        valid = np.arange(16) != i % 16
        follower.follow(state, np.nan_to_num(row) / DRIVE, valid, i % 16, i * ROW_PERIOD)
        belief = state.belief
        out.append(dict(zip(belief.numbers, belief.contacts[:, :2])))
    return out


def test_derivatives_of_a_row(operator, known):
    model = RowModel(operator, known)
    contacts = np.array([[0.03, 0.02, np.log(1e-4), np.log(0.008)], [-0.05, 0.04, -9.0, -4.8]])
    mutual, shift = model.mutual(contacts), np.zeros(len(known.shift_deviation))
    row = model.row(contacts, 5, shift, mutual)
    for i in range(2):
        for j, step in enumerate((1e-6, 1e-6, 1e-4)):
            sides = []
            for sign in (1, -1):
                moved = contacts.copy()
                moved[i, j] += sign * step
                sides.append(model.row(moved, 5, shift, mutual).readings)
            slope = (sides[0] - sides[1]) / (2 * step)
            assert np.allclose(
                row.changes[5 * i + (0, 1, 4)[j]], slope, atol=2e-3 * np.abs(slope).max()
            )


def test_a_row_is_that_of_the_estimator_of_frames(operator, known):
    places = [[0.03, 0.02], [-0.05, 0.04], [0.033, 0.033]]
    for place in places:  # the last one beside an electrode
        contact = np.array([*place, np.log(1e-4), np.log(0.008)])
        unknowns = Unknowns.at_rest(operator).with_contacts(
            np.array([[*contact, 0.0, 0.0]]), (7,), np.array([[True] * 4 + [False] * 2])
        )
        whole = Prediction(operator, unknowns, np.array([6])).readings[0]
        shift = np.zeros(len(known.shift_deviation))
        row = RowModel(operator, known).row(contact[None], 6, shift).readings
        assert np.abs(row - whole).max() < 5e-3


def test_a_touch_is_known_from_its_first_row_keeps_its_number_and_goes(operator, known):
    tap = Contact("disc", **NEW, start=0.0205, end=0.0505)
    rows = followed(operator, known, [tap], 5)
    assert all(not each for each in rows[:21])
    first, fourth = rows[21], rows[24]
    assert list(first) == [1] and np.hypot(*(first[1] - NEW["center"])) < 0.01
    assert np.hypot(*(fourth[1] - NEW["center"])) < 0.003
    assert all(list(each) == [1] for each in rows[21:51])
    assert all(not each for each in rows[53:])


def test_a_slide_is_followed_with_its_velocity(operator, known):
    velocity = np.array([0.4, -0.3])
    slide = Contact("disc", **NEW, velocity=tuple(velocity), start=0.0, end=1.0)
    follower = Follower(operator, 0.008, 0.6)
    state = follower.begin(known)
    for i, row in enumerate(frames_of([slide], 5).reshape(-1, 16)):
        valid = np.arange(16) != i % 16
        follower.follow(state, np.nan_to_num(row) / DRIVE, valid, i % 16, i * ROW_PERIOD)
    place = np.add(NEW["center"], velocity * 79 * ROW_PERIOD)
    assert state.belief.numbers == (1,)
    assert np.hypot(*(state.belief.mean[:2] - place)) < 0.003
    assert np.hypot(*(state.belief.mean[2:4] - velocity)) < 0.1


@pytest.fixture(scope="module")
def at_rest():
    """A frame of a resting contact, and what looks at it."""
    return frames_of([RESTING], 1)[0], Pipeline(LAYOUT, Settings("accurate", contact_radius=0.008))


@settings(max_examples=6, deadline=None, derandomize=True)
@given(order=st.lists(st.integers(0, 15), min_size=8, max_size=40))
def test_rows_may_be_missing_repeated_and_in_any_order(at_rest, order):
    """As a frame of so many rows, and one after the other."""
    assume(len(set(order)) >= 6)
    (frame, pipeline), order = at_rest, np.array(order)
    pipeline.untare()
    whole = pipeline.process(frame[order], order, DRIVE, ROW_PERIOD)
    assert len(whole.contacts) == 1 and is_at(whole.contacts[0], RESTING, 2e-3)
    assert whole.holds == pytest.approx((len(order) - 1) * ROW_PERIOD)
    rows = RowEstimator(pipeline.estimator, frames=False)
    state = RowsState(waits=False)
    for i, ground in enumerate(order):
        found = rows.estimate(frame[ground], ground, DRIVE, i * ROW_PERIOD, state).contacts
        assert len(found) == 1 and is_at(found[0][2], RESTING, 0.01)
    assert is_at(found[0][2], RESTING, 3e-3)


def is_at(found, contact, reach):
    return np.hypot(found.x - contact.center[0], found.y - contact.center[1]) < reach


@pytest.fixture(scope="module")
def estimator():
    return Estimator(LAYOUT, noise=NOISE, law=ContactLaw(1e-4, 1.0), radius=0.008)


def followed_late(estimator, contacts, count, late):
    """What is known after each row where a frame's estimate is told `late` rows after its last one;
    None: that row waits for it."""
    rows, state = RowEstimator(estimator), RowsState(waits=late is None)
    seen, out = {}, []
    for k, frame in enumerate(frames_of(contacts, count)):
        for i, row in enumerate(frame):
            now = 16 * k + i
            if now in seen:
                state.tell(seen[now])
            out.append(rows.estimate(row, i, DRIVE, now * ROW_PERIOD, state))
        if late is not None:
            told = rows.look(frame, np.arange(16), DRIVE, ROW_PERIOD, state.frames)
            seen[16 * k + 16 + late] = told.at(16 * k * ROW_PERIOD, ROW_PERIOD, 16)
    return out


def numbers_and_places(followed):
    return {number: (contact.x, contact.y) for number, _, contact in followed.contacts}


WIDE = Contact("disc", center=(-0.01, 0.02), radius=0.03, pressure=5e3, start=0.0015)


def is_seen(contact, followed, place, force):
    """The number of the contact that is `contact` to `place`, m, and to the part `force`."""
    (number,) = (
        number
        for number, _, each in followed.contacts
        if np.hypot(each.x - contact.center[0], each.y - contact.center[1]) < place
    )
    found = {n: each for n, _, each in followed.contacts}[number]
    true = contact.pressure * np.pi * contact.radius**2
    assert abs(found.force - true) < max(force * true, 3 * found.force_std)
    assert abs(found.radius - contact.radius) < max(0.2 * contact.radius, 3 * found.radius_std)
    return number


@pytest.mark.parametrize("late", [None, 9])
def test_wide_and_small_contacts_whether_rows_wait_for_frames_or_not(estimator, late):
    tap = Contact("disc", center=(0.06, -0.06), radius=0.008, pressure=15e3, start=0.0345)
    followed = followed_late(estimator, [WIDE, tap], 5, late)
    assert all(each.state == "valid" for each in followed)
    for each in followed[2:35]:
        assert is_seen(WIDE, each, 9e-3, 0.4) == 1 and len(each.contacts) == 1
    for each in followed[36:]:  # the second row of the tap: of the sheet little is known yet
        assert is_seen(WIDE, each, 2e-3, 0.05) == 1
        assert is_seen(tap, each, 5e-3, 0.2) == 2 and len(each.contacts) == 2


def test_what_is_released_while_a_frame_is_estimated_does_not_come_back(estimator):
    tap = Contact("disc", **NEW, start=0.0005, end=0.0175)
    followed = followed_late(estimator, [tap], 3, 6)
    assert list(numbers_and_places(followed[15])) == [1]
    assert not any(each.contacts or each.reason for each in followed[21:])


def test_the_end_of_a_wide_contact_shows_in_the_next_row(estimator):
    followed = followed_late(estimator, [replace(WIDE, end=0.0405)], 4, 9)
    assert all(len(each.contacts) == 1 for each in followed[26:41])
    assert not any(each.contacts or each.reason for each in followed[41:])


def test_a_wide_contact_that_moves_is_reported_where_it_is():
    """Frames alone show it, 24 rows late here: it goes on meanwhile, and is up to 9 mm farther."""
    layout, law, speed = load_layout("equal-8x8"), ContactLaw(1e-4, 1.0), 0.1
    palm = Contact(
        "disc",
        center=(-0.05, 0.01),
        radius=0.025,
        pressure=5e3,
        start=0.0095,
        velocity=(speed, 0.0),
    )
    scene = Scene("palm", DRIVE, [palm], law, Noise(NOISE, 1), Adc(12, DRIVE))
    simulator = Simulator(layout, scene, row_period=ROW_PERIOD)
    estimator = Estimator(layout, noise=NOISE, law=law, radius=0.008)
    rows, state, seen, off = RowEstimator(estimator), RowsState(waits=False), {}, []
    for k in range(4):
        frame = simulator.frame(64 * k * ROW_PERIOD, k)
        for i, row in enumerate(frame):
            now = 64 * k + i
            if now in seen:
                state.tell(seen[now])
            said = rows.estimate(row, i, DRIVE, now * ROW_PERIOD, state)
            if now > 155:  # the second frame that shows it is told
                ((_, _, contact),) = said.contacts
                true = palm.at(now * ROW_PERIOD).center
                off.append(np.hypot(contact.x - true[0], contact.y - true[1]))
                assert contact.velocity[0] == pytest.approx(speed, rel=0.1)
        told = rows.look(frame, np.arange(64), DRIVE, ROW_PERIOD, state.frames)
        seen[64 * k + 64 + 24] = told.at(64 * k * ROW_PERIOD, ROW_PERIOD, 64)
    assert max(off) < 3e-3 and np.median(off) < 1e-3


def test_rows_are_withheld_where_frames_are(estimator):
    rows, state = RowEstimator(estimator), RowsState(waits=False)
    frame = frames_of([Contact("disc", **NEW)], 1)[0]
    seen = rows.look(frame, np.arange(16), DRIVE, ROW_PERIOD, state.frames)
    bad = replace(seen, estimate=Estimate([], [], "withheld", "the readings contradict"), fit=None)
    said = []
    rows.follow(np.zeros(16), 0, DRIVE, 15 * ROW_PERIOD, state)
    for told in (None, bad, bad, seen.at(0.0, ROW_PERIOD, 16)):
        if told is not None:
            state.tell(told)
        said.append(rows.estimate(frame[0], 0, DRIVE, ROW_PERIOD * (16 + len(said)), state))
    assert [each.reason for each in said] == ["", "", "the readings contradict", ""]
    assert not said[2].contacts and said[2].touched and said[3].contacts


def test_a_pause_or_a_clock_set_back_begins_anew_with_other_numbers(estimator):
    rows, state = RowEstimator(estimator), RowsState(waits=False)
    row = frames_of([Contact("disc", **NEW)], 1)[0][3]
    found = []
    for begun in (10.0, 12.0, 3.0):
        for i, readings in enumerate((np.zeros(16), row, row)):
            said = rows.estimate(readings, 3, DRIVE, begun + i * ROW_PERIOD, state)
        found.append(list(numbers_and_places(said)))
    assert found == [[1], [2], [3]]


SLIDING = Contact(
    "disc",
    center=(-0.07, 0.05),
    radius=0.008,
    pressure=15e3,
    velocity=(0.2, -0.16),
    start=0.0,
    end=9.0,
)


def test_a_frame_that_is_told_late_is_followed_by_the_rows_since(estimator):
    """It slides when rows begin; the first frame is told after half a second, 0.12 m farther."""
    rows, state = RowEstimator(estimator), RowsState(waits=False)
    frames = frames_of([SLIDING], 34)
    first = rows.look(frames[0], np.arange(16), DRIVE, ROW_PERIOD, state.frames)
    for i, row in enumerate(frames.reshape(-1, 16)):
        if i == 496:
            state.tell(first.at(0.0, ROW_PERIOD, 16))
        said = rows.estimate(row, i % 16, DRIVE, i * ROW_PERIOD, state)
        if i < 496:
            assert "when rows began" in said.reason
        else:
            place = np.add(SLIDING.center, np.multiply(SLIDING.velocity, i * ROW_PERIOD))
            assert numbers_and_places(said)[1] == pytest.approx(place, abs=3e-3)


def test_rows_that_begin_with_a_touched_sheet_wait_for_a_frame():
    """Two touches that were there before the first row became one of 3 N between them, 30 mm from
    either, and a frame's contact was taken for its new place."""
    layout = load_layout("equal-8x8")
    places = (0.041, -0.033), (-0.05, -0.045)
    law, noise = ContactLaw(1e-4, 1.0), Noise(NOISE, 1)
    contacts = [
        Contact("disc", center=place, radius=0.006, pressure=pressure)
        for place, pressure in zip(places, (15e3, 10e3))
    ]
    scene = Scene("two", DRIVE, contacts, law, noise, Adc(12, DRIVE))
    simulator = Simulator(layout, scene, row_period=ROW_PERIOD)
    estimator = Estimator(layout, noise=NOISE, law=law, radius=0.006)
    rows, state, said = RowEstimator(estimator), RowsState(waits=False), []
    grounded = np.arange(64)
    for frame in range(3):
        readings = simulator.frame(64 * frame * ROW_PERIOD, frame)
        readings[:, [4, 8, 16, 23, 27, 36, 44, 53]] = np.nan
        for ground, row in zip(grounded, readings):
            time = (64 * frame + int(ground)) * ROW_PERIOD
            said.append(rows.estimate(row, int(ground), DRIVE, time, state))
        seen = rows.look(readings, grounded, DRIVE, ROW_PERIOD, state.frames)
        state.tell(seen.at(64 * frame * ROW_PERIOD, ROW_PERIOD, 64))
    assert said[127].reason == (
        "something already touched when rows began: contacts follow with the next whole frame"
    )
    valid = [each for each in said if not each.reason]
    assert len(valid) == 64
    for each in valid:
        found = np.array([[contact.x, contact.y] for _, _, contact in each.contacts])
        assert np.abs(found - places).max() < 1e-3


def test_frames_and_rows_in_turn_keep_the_number_of_a_contact_and_show_the_same_image():
    law = ContactLaw(1e-4, 1.0)
    settings = Settings("accurate", noise=NOISE, contact_law=law, contact_radius=0.008)
    pipeline, grounded = Pipeline(LAYOUT, settings), np.arange(16)
    first, second = frames_of([Contact("disc", **NEW, start=0.0015)], 2)
    shown = pipeline.process(second, grounded, DRIVE, ROW_PERIOD, 0.0)
    state = pipeline.rows(waits=False)
    for i, row in enumerate(first):
        pipeline.follow_row(row, i, DRIVE, 1.0 + i * ROW_PERIOD, state)
    assert state.asks  # of what has just begun
    told = second, grounded, DRIVE, ROW_PERIOD, 1.016
    pipeline.process(*told)
    for i, row in enumerate(second):
        pipeline.follow_row(row, i, DRIVE, 1.016 + i * ROW_PERIOD, state)
    pipeline.correct(state, second, grounded, DRIVE, ROW_PERIOD, 1.016)
    pipeline.follow_row(second[0], 0, DRIVE, 1.032, state)
    assert not state.asks
    drawn = pipeline.image_after_row(state)
    again = pipeline.process(second, grounded, DRIVE, ROW_PERIOD, 2.0)
    assert [r.contacts[0].id for r in (shown, drawn, again)] == [1, 1, 1]
    for image in (shown.pressure, drawn.pressure):
        force = np.nansum(image) * pipeline.grid.cell_area
        assert force == pytest.approx(drawn.contacts[0].force, rel=0.1)
    assert np.nanargmax(drawn.pressure) == np.nanargmax(shown.pressure)


def test_every_row_of_a_file_has_a_result_with_the_keys_of_the_contract(tmp_path):
    tap = Contact("disc", **NEW, start=0.0205, end=1.0)
    np.savez(
        tmp_path / "frames.npz",
        voltages=frames_of([tap], 4),
        grounded=np.arange(16),
        stamps=7.0 + 0.016 * np.arange(4),
        row_period=ROW_PERIOD,
    )
    words = ["reconstruct", tmp_path / "frames.npz", "--layout", "equal-4x4", "--every-row"]
    words += ["--contact-radius", 0.008, "--out", tmp_path / "out.npz"]
    assert cli.main([str(word) for word in words]) == 0
    with np.load(tmp_path / "out.npz") as file:
        assert np.allclose(file["stamps"], 7.0 + ROW_PERIOD * np.arange(64))
        assert file["latency"].shape == (64,) and (file["latency"] > 0).all()
        contacts = json.loads(str(file["contacts"]))
    assert len(contacts) == 64 and not any(contacts[:21])
    keys = "id vx vy position_std force_std probability x y force pressure area radius age"
    for (contact,) in contacts[25:]:
        assert set(contact) == set(keys.split()) and contact["id"] == 1
        assert np.hypot(contact["x"] - NEW["center"][0], contact["y"] - NEW["center"][1]) < 0.003
        force = 15e3 * np.pi * 0.008**2
        assert abs(contact["force"] - force) < max(0.2 * force, 3 * contact["force_std"])


def test_a_frame_that_ends_just_after_a_touch_has_begun_changes_nothing(estimator):
    row = 1  # of the touch, the last one of the frame
    tap = Contact("disc", **NEW, start=(48 - row - 0.5) * ROW_PERIOD, end=0.09)
    followed = followed_late(estimator, [RESTING, tap], 6, 6)
    begun = 16 + 6  # the first frame is told after so many rows
    known = followed[begun:]
    assert not any(each.reason for each in known)
    numbers = [sorted(numbers_and_places(each)) for each in known]
    before, after = 48 - row - begun, 88 - begun
    resting, touching = numbers[0], numbers[before + 4]
    assert len(resting) == 1 and len(touching) == 2
    assert all(each == resting for each in numbers[:before])
    assert all(each == touching for each in numbers[before + 4 : after])
    for each in known[before + 4 : after]:
        assert is_seen(RESTING, each, 3e-3, 0.2) == resting[0]
        assert is_seen(tap, each, 5e-3, 0.3) != resting[0]


def test_rows_take_up_the_noise_that_a_frame_shows():
    """Of idle rows with five times the noise that was said, those after the first frame show
    nothing."""
    pipeline, random = Pipeline(LAYOUT, Settings("accurate")), np.random.default_rng(2)
    state = pipeline.rows()
    for k in range(20 * 16):
        row = np.maximum(5e-3 * random.standard_normal(16), 0.0)
        pipeline.follow_row(row, k % 16, DRIVE, k * ROW_PERIOD, state)
        if k > 16:
            result = pipeline.after_row(state)
            assert (result.state, result.contacts) == ("valid", [])
    assert state.noise == pytest.approx(5e-3, rel=0.25)


@pytest.fixture(scope="module")
def on_8x8():
    """A pipeline of 8 x 8 electrodes, and rows with noise that a contact made from the second frame
    on: (readings, grounded electrode, time)."""
    layout, law = load_layout("equal-8x8"), ContactLaw(1e-4, 1.0)
    scene = Scene("press", DRIVE, (Contact("disc", **PRESSED),), law)
    frame = Simulator(layout, scene, "closed_form", row_period=0.0).frame(0.0, 0)
    random = np.random.default_rng(0)
    frames = [np.zeros((64, 64)), *[frame] * 4]
    rows = [row + 1e-3 * random.standard_normal(64) for each in frames for row in each]
    pipeline = Pipeline(layout, Settings(noise=1e-3, contact_law=law, profile="accurate"))
    return pipeline, [(row, i % 64, i * ROW_PERIOD) for i, row in enumerate(rows)]


@pytest.mark.parametrize("ahead", [0.25, 0.9])
def test_stamps_that_jump_move_no_contact(on_8x8, ahead):
    """A contact that nobody saw for so long may be anywhere; it was valid, up to 69 mm off."""
    pipeline, rows = on_8x8
    off = []
    for seed in range(3):
        random, state = np.random.default_rng(seed), pipeline.rows(waits=False)
        for readings, grounded, time in rows:
            time += ahead * (random.random() < 0.05)
            result = pipeline.process_row(readings, grounded, DRIVE, time, state)
            for c in result.contacts:
                off.append(np.hypot(*np.subtract((c.x, c.y), PRESSED["center"])))
                assert c.age >= 0.0
    assert off and max(off) < 0.01


def test_slides_that_pass_each_other_are_told_all_the_time():
    """Frames within which something moves had no fit and confirmed nothing: near each other, both might
    have been one wide contact that had just begun, and were withheld."""
    layout, speed = load_layout("equal-8x8"), 0.25
    slides = [
        Contact(
            "disc",
            center=(-sign * 0.075, sign * 0.01),
            radius=0.005,
            pressure=1.0 / (np.pi * 0.005**2),
            start=start * ROW_PERIOD,
            velocity=(sign * speed, 0.0),
        )
        for sign, start in ((1, 8.5), (-1, 20.5))
    ]
    law = ContactLaw(1e-4, 1.0)
    scene = Scene("passing", DRIVE, slides, law, Noise(NOISE, 1), Adc(12, DRIVE))
    simulator = Simulator(layout, scene, row_period=ROW_PERIOD)
    pipeline = Pipeline(layout, Settings("accurate", noise=NOISE, contact_law=law))
    state, numbers = pipeline.rows(waits=False), set()
    for number in range(6):
        begun = 64 * ROW_PERIOD * number
        frame = simulator.frame(begun, number)
        for i, row in enumerate(frame):
            pipeline.follow_row(row, i, DRIVE, begun + i * ROW_PERIOD, state)
            said = pipeline.after_row(state)
            if number > 1:
                assert said.state == "valid" and len(said.contacts) == 2
                numbers |= {each.id for each in said.contacts}
        given = frame, np.arange(64), DRIVE, ROW_PERIOD, begun
        pipeline.process(*given, numbered=False)
        pipeline.correct(state, *given)
    assert len(numbers) == 2


def test_a_hand_at_rest_stays_where_rows_are_left_out():
    """Rows that come too fast are left out; for those that were followed no finger was near, so that nobody knew
    how well it conducted by now: it was said to have ended, and began again with another number."""
    layout, scene = load_layout("equal-8x8"), load_scene("hand")
    simulator = Simulator(layout, scene, row_period=1e-3)
    pipeline = Pipeline(layout, Settings("accurate", contact_law=scene.contact_law))
    state, there = pipeline.rows(), set()
    for number in range(5):
        frame = simulator.measure(0.064 * number, number)
        for i, (row, ground) in enumerate(zip(frame.voltages, frame.grounded)):
            if number and 20 <= i < 44:
                continue
            time = frame.stamp + i * frame.row_period
            pipeline.follow_row(row, int(ground), frame.drive_voltage, time, state)
            if state.touching is not None:
                there.add(tuple(sorted(state.touching)))
    assert len(there) == 1 and len(there.pop()) == len(scene.contacts)


def test_frames_told_late_move_no_contact_where_rows_were_lost():
    """Rows told nothing of the end of a frame: what they had before was taken for what they said then, and by how far
    it was off, the contact was moved that they knew well by now. It got another number, and others came with it."""
    scene, layout = load_scene("slide"), load_layout("equal-8x8")
    simulator = Simulator(layout, scene, row_period=ROW_PERIOD)
    pipeline = Pipeline(layout, Settings("fast", contact_law=scene.contact_law))
    random, state = np.random.default_rng(1), pipeline.rows(waits=False)
    frames, ids, off, lost = [], defaultdict(set), [], 0
    for number in range(120):
        begun, last = 64 * ROW_PERIOD * number, None
        frames.append((simulator.frame(begun, number), np.arange(64), DRIVE, ROW_PERIOD, begun))
        for i, row in enumerate(frames[-1][0]):
            if number > 3 and lost <= 64 * number + i and random.random() < 0.04:
                lost = 64 * number + i + random.integers(10, 180)
            if lost <= 64 * number + i:
                last = begun + i * ROW_PERIOD
                pipeline.follow_row(row, i, DRIVE, last, state)
        if number >= 5 and state.asks:
            pipeline.correct(state, *frames[number - 5])
        if number < 8 or last is None:
            continue
        contacts = pipeline.after_row(state).contacts
        for which, true in enumerate(scene.contacts):
            place = true.at(last).centroid
            near = min(contacts, key=lambda c: np.hypot(c.x - place[0], c.y - place[1]))
            off.append(float(np.hypot(near.x - place[0], near.y - place[1])))
            ids[which].add(near.id)
    assert max(off) < 0.01 and [len(each) for each in ids.values()] == [1, 1]


def test_what_a_reading_keeps_is_of_the_row_before_it_also_where_rows_are_lost(estimator):
    """The last row that came was taken for it, and contacts were 0.7 mm off for it."""
    kept, frames = 0.02, frames_of([replace(RESTING, start=0.0205)], 12).reshape(-1, 16)
    before = np.nan_to_num(np.vstack([frames[:1], frames[:-1]]))
    rows, state = RowEstimator(estimator, frames=False), RowsState()
    expected = Settling.expected(16)
    state.settling = replace(expected, part=np.full(16, kept), covariance=1e-8 * np.eye(16))
    off = []
    for i, row in enumerate((1 - kept) * frames + kept * before):
        if i > 60 and i % 7 > 3:
            continue
        said = rows.estimate(row, i % 16, DRIVE, i * ROW_PERIOD, state)
        if i > 60:
            [place] = numbers_and_places(said).values()
            off.append(np.hypot(*np.subtract(place, RESTING.center)))
    assert len(off) > 60 and max(off) < 4e-4
