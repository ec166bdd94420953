"""Contacts followed row by row."""

import json
from collections import defaultdict
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
    scene_on,
    sensor,
    unknown,
)
from hypothesis import assume, given, settings
from hypothesis import strategies as st

from tomotactile_ros import cli
from tomotactile_ros.estimation.estimator import Estimator
from tomotactile_ros.estimation.follow import Follower
from tomotactile_ros.estimation.operator import operator_for
from tomotactile_ros.estimation.reported import Estimate
from tomotactile_ros.estimation.row_estimator import RowEstimator, RowsState
from tomotactile_ros.estimation.row_model import Known
from tomotactile_ros.estimation.settling import Settling
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.simulation import ROW_PERIOD

LAYOUT, EIGHT = load_layout("equal-4x4"), load_layout("equal-8x8")
NEW = (-0.045, 0.03)
NEW_DISC = disc(*NEW, 0.008, pressure=15e3)
RESTING = disc(0.05, -0.04, 0.008, pressure=15e3)
WIDE = disc(-0.01, 0.02, 0.03, pressure=5e3, start=0.0015)
AXIS = np.array([np.cos(0.7), np.sin(0.7)])


def known_of(operator, radius):
    return Known.before(unknown(operator, radius), (NOISE / DRIVE) ** 2)


def made(contacts, count):
    return frames_of(sensor(LAYOUT, *contacts), count)


SLIDE = 0.2 * AXIS  # m/s, in 150 rows past a place beside the electrode in the middle
BESIDE = EIGHT.positions[np.hypot(*EIGHT.positions.T).argmin()] + [0.0, 0.001]


@pytest.mark.parametrize(
    "place, newtons, velocity, within",
    [
        (BESIDE - 75 * ROW_PERIOD * SLIDE, 1.0, SLIDE, 0.4e-3),
        (EIGHT.positions[27] + 0.004 * AXIS, 20.0, (0, 0), 0.5e-3),
        (EIGHT.positions[27] + 0.004 * AXIS, 50.0, (0, 0), 0.5e-3),
    ],
    ids=["a slide across an electrode", "pressed hard", "harder"],
)
def test_a_contact_on_an_electrode_keeps_its_place_and_speed(place, newtons, velocity, within):
    """Taken for one patch at its centre, the slide was 1 mm off and 40 % off its speed; with shares that
    depended on how hard it presses, rows lost a hard press."""
    more = {"force": newtons, "velocity": tuple(velocity), "start": 3.5 * ROW_PERIOD}
    touch = disc(*place, 0.005, **more)
    operator = operator_for(EIGHT)
    follower = Follower(operator, 0.005, 0.6)
    state = follower.begin(known_of(operator, 0.005))
    for i, row in enumerate(frames_of(sensor(EIGHT, touch), 3).reshape(-1, 64)[:150]):
        valid, now = np.arange(64) != i % 64, i * ROW_PERIOD
        follower.follow(state, np.nan_to_num(row) / DRIVE, valid, i % 64, now)
        if i >= 40:
            assert state.belief.count == 1
            assert np.hypot(*(state.belief.mean[:2] - touch.at(now).center)) < within
            if any(velocity):
                assert state.belief.numbers == (1,)
                assert np.hypot(*(state.belief.mean[2:4] - SLIDE)) < 0.12 * 0.2


# -- rows and frames -------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def at_rest():
    """A frame of a resting contact, and what looks at it."""
    return made([RESTING], 1)[0], Pipeline(LAYOUT, Settings("accurate", contact_radius=0.008))


@settings(max_examples=6, deadline=None, derandomize=True)
@given(order=st.lists(st.integers(0, 15), min_size=8, max_size=40))
def test_rows_may_be_missing_repeated_and_in_any_order(at_rest, order):
    """As a frame of so many rows, and one after the other."""
    assume(len(set(order)) >= 6)
    (frame, pipeline), order = at_rest, np.array(order)
    pipeline.untare()
    whole = pipeline.process(frame[order], order, DRIVE, ROW_PERIOD)
    assert len(whole.contacts) == 1 and off(whole.contacts[0], RESTING.center) < 2e-3
    assert whole.holds == pytest.approx((len(order) - 1) * ROW_PERIOD)
    rows = RowEstimator(pipeline.estimator, frames=False)
    state = RowsState(waits=False)
    for i, ground in enumerate(order):
        ((*_, found),) = rows.estimate(frame[ground], ground, DRIVE, i * ROW_PERIOD, state).contacts
        assert off(found, RESTING.center) < 0.01
    assert off(found, RESTING.center) < 3e-3


@pytest.fixture(scope="module")
def estimator():
    return Estimator(LAYOUT, noise=NOISE, law=LAW, radius=0.008)


def followed_late(estimator, frames, late):
    """What is known after each row where a frame's estimate is told `late` rows after its last one;
    None: that row waits for it."""
    rows, state = RowEstimator(estimator), RowsState(waits=late is None)
    seen, out, count = {}, [], len(frames[0])
    for k, frame in enumerate(frames):
        for i, row in enumerate(frame):
            now = count * k + i
            if now in seen:
                state.tell(seen[now])
            out.append(rows.estimate(row, i, DRIVE, now * ROW_PERIOD, state))
        if late is not None:
            told = rows.look(frame, np.arange(count), DRIVE, ROW_PERIOD, state.frames)
            seen[count * (k + 1) + late] = told.at(count * k * ROW_PERIOD, ROW_PERIOD, count)
    return out


def numbers_and_places(followed):
    return {number: (contact.x, contact.y) for number, _, contact in followed.contacts}


def is_seen(contact, followed, place, force):
    """The number of the contact that is `contact` to `place`, m, and to the part `force`."""
    ((number, _, found),) = (
        each for each in followed.contacts if off(each[2], contact.center) < place
    )
    true = contact.pressure * np.pi * contact.radius**2
    assert abs(found.force - true) < max(force * true, 3 * found.force_std)
    assert abs(found.radius - contact.radius) < max(0.2 * contact.radius, 3 * found.radius_std)
    return number


@pytest.mark.parametrize("late", [None, 9])
def test_wide_and_small_contacts_whether_rows_wait_for_frames_or_not(estimator, late):
    tap = disc(0.06, -0.06, 0.008, pressure=15e3, start=0.0345)
    followed = followed_late(estimator, made([WIDE, tap], 5), late)
    assert all(each.state == "valid" for each in followed)
    for each in followed[2:35]:
        assert is_seen(WIDE, each, 9e-3, 0.4) == 1 and len(each.contacts) == 1
    for each in followed[36:]:  # the second row of the tap: of the sheet little is known yet
        assert is_seen(WIDE, each, 2e-3, 0.05) == 1
        assert is_seen(tap, each, 5e-3, 0.2) == 2 and len(each.contacts) == 2


@pytest.mark.parametrize(
    "touch, frames, late, there, gone",
    [
        (replace(NEW_DISC, start=0.0005, end=0.0175), 3, 6, slice(15, 16), 21),
        (replace(WIDE, end=0.0405), 4, 9, slice(26, 41), 41),
    ],
    ids=["while a frame is estimated", "a wide one, with the next row"],
)
def test_what_is_released_does_not_come_back(estimator, touch, frames, late, there, gone):
    followed = followed_late(estimator, made([touch], frames), late)
    assert all(list(numbers_and_places(each)) == [1] for each in followed[there])
    assert not any(each.contacts or each.reason for each in followed[gone:])


def test_a_wide_contact_that_moves_is_reported_where_it_is():
    """Frames alone show it, 24 rows late here: it goes on meanwhile, and is up to 9 mm farther."""
    palm = disc(-0.05, 0.01, 0.025, pressure=5e3, start=0.0095, velocity=(0.1, 0.0))
    estimator, apart = Estimator(EIGHT, noise=NOISE, law=LAW, radius=0.008), []
    followed = followed_late(estimator, frames_of(sensor(EIGHT, palm), 4), 24)
    for i, said in enumerate(followed[156:], 156):  # the second frame that shows it is told
        ((_, _, contact),) = said.contacts
        apart.append(off(contact, palm.at(i * ROW_PERIOD).center))
        assert contact.velocity[0] == pytest.approx(0.1, rel=0.1)
    assert max(apart) < 3e-3 and np.median(apart) < 1e-3


def test_rows_are_withheld_where_frames_are(estimator):
    rows, state = RowEstimator(estimator), RowsState(waits=False)
    frame = made([NEW_DISC], 1)[0]
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
    row, found = made([NEW_DISC], 1)[0][3], []
    for begun in (10.0, 12.0, 3.0):
        for i, readings in enumerate((np.zeros(16), row, row)):
            said = rows.estimate(readings, 3, DRIVE, begun + i * ROW_PERIOD, state)
        found.append(list(numbers_and_places(said)))
    assert found == [[1], [2], [3]]


def test_rows_that_begin_with_a_touched_sheet_wait_for_a_frame():
    """Two touches that were there before the first row became one of 3 N between them, 30 mm from
    either, and a frame's contact was taken for its new place."""
    true = (0.041, -0.033), (-0.05, -0.045)
    contacts = [disc(*place, pressure=p) for place, p in zip(true, (15e3, 10e3))]
    frames = frames_of(sensor(EIGHT, *contacts), 3)
    frames[:, :, [4, 8, 16, 23, 27, 36, 44, 53]] = np.nan
    estimator = Estimator(EIGHT, noise=NOISE, law=LAW, radius=0.006)
    said = followed_late(estimator, frames, 0)
    assert said[127].reason == (
        "something already touched when rows began: contacts follow with the next whole frame"
    )
    valid = [each for each in said if not each.reason]
    assert len(valid) == 64
    for each in valid:
        assert np.abs(list(numbers_and_places(each).values()) - np.array(true)).max() < 1e-3


def test_frames_and_rows_in_turn_keep_the_number_of_a_contact_and_show_the_same_image():
    pipeline, grounded = pipeline_of(LAYOUT, contact_radius=0.008), np.arange(16)
    first, second = made([replace(NEW_DISC, start=0.0015)], 2)
    shown = pipeline.process(second, grounded, DRIVE, ROW_PERIOD, 0.0)
    state, told = pipeline.rows(waits=False), (second, grounded, DRIVE, ROW_PERIOD, 1.016)
    for i, row in enumerate(first):
        pipeline.follow_row(row, i, DRIVE, 1.0 + i * ROW_PERIOD, state)
    assert state.asks  # of what has just begun
    pipeline.process(*told)
    for i, row in enumerate(second):
        pipeline.follow_row(row, i, DRIVE, 1.016 + i * ROW_PERIOD, state)
    pipeline.correct(state, *told)
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
    """Of a tap, from its first row on and with the same number."""
    frames, out = tmp_path / "frames.npz", tmp_path / "out.npz"
    voltages = made([replace(NEW_DISC, start=0.0205, end=0.0505)], 5)
    times = {"stamps": 7.0 + 0.016 * np.arange(5), "row_period": ROW_PERIOD}
    np.savez(frames, voltages=voltages, grounded=np.arange(16), **times)
    words = ["reconstruct", frames, "--layout", "equal-4x4", "--every-row"]
    words += ["--contact-radius", 0.008, "--out", out]
    assert cli.main([str(word) for word in words]) == 0
    with np.load(out) as file:
        assert np.allclose(file["stamps"], 7.0 + ROW_PERIOD * np.arange(80))
        assert file["latency"].shape == (80,) and (file["latency"] > 0).all()
        contacts = json.loads(str(file["contacts"]))
    assert len(contacts) == 80 and not any(contacts[:21]) and not any(contacts[53:])
    keys = "id vx vy position_std force_std probability x y force pressure area radius age"
    force = 15e3 * np.pi * 0.008**2
    for i, (contact,) in enumerate(contacts[21:51]):
        assert set(contact) == set(keys.split()) and contact["id"] == 1
        apart = np.hypot(contact["x"] - NEW[0], contact["y"] - NEW[1])
        assert apart < (0.01 if i < 3 else 0.003)
        assert i < 4 or abs(contact["force"] - force) < max(0.2 * force, 3 * contact["force_std"])


def test_a_frame_that_ends_just_after_a_touch_has_begun_changes_nothing(estimator):
    # rows: the first frame is told, the last one before the touch, the last one of it
    begun, before, after = 22, 47, 88
    tap = replace(NEW_DISC, start=(before - 0.5) * ROW_PERIOD, end=0.09)
    followed = followed_late(estimator, made([RESTING, tap], 6), 6)
    assert not any(each.reason for each in followed[begun:])
    numbers = [sorted(numbers_and_places(each)) for each in followed]
    resting, touching = numbers[begun], numbers[before + 4]
    assert len(resting) == 1 and len(touching) == 2
    assert all(each == resting for each in numbers[begun:before])
    assert all(each == touching for each in numbers[before + 4 : after])
    for each in followed[before + 4 : after]:
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


@pytest.mark.parametrize("ahead", [0.25, 0.9])
def test_stamps_that_jump_move_no_contact(ahead):
    """A contact that nobody saw for so long may be anywhere; it was valid, up to 69 mm off."""
    place = (0.031, -0.022)
    press = disc(*place, pressure=2e4)
    frame = sensor(EIGHT, press, noise=0.0, adc=None, model="closed_form", row_period=0.0).frame(
        0.0
    )
    random, apart = np.random.default_rng(0), []
    rows = np.concatenate([np.zeros((64, 64)), *[frame] * 4])
    rows = rows + 1e-3 * random.standard_normal(rows.shape)
    pipeline = pipeline_of("equal-8x8")
    for seed in range(3):
        random, state = np.random.default_rng(seed), pipeline.rows(waits=False)
        for i, row in enumerate(rows):
            time = i * ROW_PERIOD + ahead * (random.random() < 0.05)
            for c in pipeline.process_row(row, i % 64, DRIVE, time, state).contacts:
                apart.append(off(c, place))
                assert c.age >= 0.0
    assert apart and max(apart) < 0.01


def test_slides_that_pass_each_other_are_told_all_the_time():
    """Frames within which something moves had no fit and confirmed nothing: near each other, both might
    have been one wide contact that had just begun, and were withheld."""
    slides = [
        disc(-s * 0.075, s * 0.01, 0.005, force=1.0, start=row * ROW_PERIOD, velocity=(0.25 * s, 0))
        for s, row in ((1, 8.5), (-1, 20.5))
    ]
    pipeline = pipeline_of("equal-8x8")
    state, numbers = pipeline.rows(waits=False), set()
    for number, frame in enumerate(frames_of(sensor(EIGHT, *slides), 6)):
        begun = 64 * ROW_PERIOD * number
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
    simulator, pipeline = scene_on("equal-8x8", "hand")
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
    assert len(there) == 1 and len(there.pop()) == len(simulator.scene.contacts)


def test_frames_told_late_move_no_contact_where_rows_were_lost():
    """Rows told nothing of the end of a frame: what they had before was taken for what they said then, and by how far
    it was off, the contact was moved that they knew well by now. It got another number, and others came with it."""
    simulator, pipeline = scene_on("equal-8x8", "slide", "fast")
    random, state = np.random.default_rng(1), pipeline.rows(waits=False)
    frames, ids, apart, lost = [], defaultdict(set), [], 0
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
        for which, true in enumerate(simulator.scene.contacts):
            place = true.at(last).centroid
            near = contacts[int(np.hypot(*(places(contacts) - place).T).argmin())]
            apart.append(off(near, place))
            ids[which].add(near.id)
    assert max(apart) < 0.01 and [len(each) for each in ids.values()] == [1, 1]


def test_what_a_reading_keeps_is_of_the_row_before_it_also_where_rows_are_lost(estimator):
    """The last row that came was taken for it, and contacts were 0.7 mm off for it."""
    kept, frames = 0.02, made([replace(RESTING, start=0.0205)], 12).reshape(-1, 16)
    before = np.nan_to_num(np.vstack([frames[:1], frames[:-1]]))
    rows, state = RowEstimator(estimator, frames=False), RowsState()
    expected = Settling.expected(16)
    state.settling = replace(expected, part=np.full(16, kept), covariance=1e-8 * np.eye(16))
    apart = []
    for i, row in enumerate((1 - kept) * frames + kept * before):
        if i > 60 and i % 7 > 3:
            continue
        said = rows.estimate(row, i % 16, DRIVE, i * ROW_PERIOD, state)
        if i > 60:
            ((_, _, contact),) = said.contacts
            apart.append(off(contact, RESTING.center))
    assert len(apart) > 60 and max(apart) < 4e-4
