"""Contacts keep their numbers from frame to frame."""

from dataclasses import dataclass

import numpy as np
import pytest
from contacts_support import DRIVE, off

from tomotactile_ros.estimation.tracks import Tracks
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator


@dataclass
class At:
    x: float
    y: float
    velocity: tuple[float, float] = (0.0, 0.0)
    position_covariance: tuple[float, ...] = (1e-8, 0.0, 0.0, 1e-8)  # 0.1 mm


def numbers(tracks, contacts, time):
    return [each.number for each in tracks.follow(contacts, time)]


def test_a_way_between_frames_that_deviations_do_not_allow_is_a_velocity():
    for covariance, speed in (((1e-8, 0.0, 0.0, 1e-8), 0.1), ((1e-6, 0.0, 0.0, 1e-6), 0.0)):
        tracks = Tracks(0.025)
        for k in range(3):
            at = At(0.0016 * k, 0.0, position_covariance=covariance)
            ((_, _, velocity),) = tracks.follow([at], 0.016 * k)
        assert velocity == (pytest.approx(speed), 0.0)
    tracks = Tracks(0.025)  # rows that tell are believed
    tracks.follow([At(0.0, 0.0)], 0.0)
    ((_, _, velocity),) = tracks.follow([At(0.0016, 0.0, (0.12, 0.01))], 0.016)
    assert velocity == (0.12, 0.01)


def test_two_that_cross_keep_their_numbers():
    """20 mm apart across, 0.5 m/s against each other, 64 ms between frames."""
    tracks, step, speed = Tracks(0.025), 0.064, 0.5
    for k in range(-3, 4):
        way = speed * step * k
        contacts = [At(way, 0.01, (speed, 0.0)), At(-way, -0.01, (-speed, 0.0))]
        assert numbers(tracks, contacts, step * k) == [1, 2]


def test_taps_at_two_places_are_two_contacts_where_rows_say_that_both_rest():
    """90 mm apart, 0.3 s between frames that were processed."""
    for timed, second in ((0.063, 2), (0.0, 1)):
        tracks = Tracks(0.025)
        tracks.follow([At(0.03, 0.06)], 0.0, timed)
        assert tracks.follow([At(-0.06, 0.06)], 0.29, timed)[0].number == second


@pytest.mark.parametrize(
    "after, aside, number", [(0.03, 0.005, 1), (0.03, 0.025, 3), (0.08, 0.005, 3)]
)
def test_what_rows_lose_for_less_than_a_scan_is_the_same(after, aside, number):
    """It is back at the same place; elsewhere, or later, it is another."""
    tracks, lasts, other = Tracks(0.025), 0.063, At(-0.06, 0.06)
    tracks.follow([At(0.03, 0.0), other], 0.0, lasts, [(1, 0.0), (2, 0.0)])
    for k in range(1, 6):
        tracks.follow([other], after * k / 6, lasts, [(2, 0.0)])
    back = tracks.follow([At(0.03 + aside, 0.0), other], after, lasts, [(3, 0.0), (2, 0.0)])
    assert [each.number for each in back] == [number, 2]


def test_a_finger_that_begins_to_slide_or_turns_back_is_the_same():
    tracks, lasts = Tracks(0.025), 0.25
    tracks.follow([At(0.0, 0.0)], 0.0, 0.063)
    assert tracks.follow([At(0.02, 0.0, (0.1, 0.0))], lasts, 0.063)[0].number == 1
    assert tracks.follow([At(0.01, 0.0, (-0.1, 0.0))], 2 * lasts, 0.063)[0].number == 1


@pytest.mark.parametrize("timed", [0.0, 0.063])
def test_time_for_which_nothing_is_told_ends_no_contact(timed):
    """A frame may take long, and others be left out meanwhile: nobody saw anything let go."""
    tracks = Tracks(0.025)
    tracks.follow([At(0.0, 0.0), At(0.06, 0.0, (0.05, 0.0))], 0.0, timed)
    later = [At(0.11, 0.0, (0.05, 0.0)), At(0.002, 0.0), At(-0.06, 0.06)]
    assert [each.number for each in tracks.follow(later, 1.0, timed)] == [2, 1, 3]
    assert [each.age for each in tracks.follow(later[1:2], 60.0, timed)] == [60.0]


def test_whoever_follows_contacts_in_between_says_which_are_the_same():
    """Rows do, by numbers of their own, until they begin anew."""
    tracks = Tracks(0.025)
    assert numbers(tracks, [At(0.0, 0.0), At(0.05, 0.0)], 0.0) == [1, 2]  # of a frame
    rows = tracks.follow([At(0.05, 0.0), At(0.0, 0.0)], 0.1, 0.063, [(7, 0.02), (8, 0.01)])
    assert [(each.number, each.age) for each in rows] == [(2, 0.1), (1, 0.1)]
    rows = tracks.follow([At(0.0, 0.0), At(0.05, 0.0)], 0.2, 0.063, [(9, 0.01), (7, 0.12)])
    assert [each.number for each in rows] == [1, 2]  # 9 is where 8 was a moment ago
    tracks.begin()
    rows = tracks.follow([At(0.05, 0.0), At(-0.09, 0.09)], 1.3, 0.063, [(9, 0.0), (7, 0.03)])
    assert [(each.number, each.age) for each in rows] == [(2, 1.3), (3, pytest.approx(0.03))]


@pytest.mark.parametrize("late", [0.2, 0.9, 5.0])
def test_a_frame_that_is_told_late_ends_and_moves_nothing(late):
    """Its estimate took long; rows went on meanwhile, and saw a second touch begin."""
    tracks = Tracks(0.025)
    tracks.follow([At(0.0, 0.0)], 1.0, 0.063, [(7, 0.1)])
    rows = [At(0.01 * late, 0.0, (0.01, 0.0)), At(0.09, 0.0)]
    now = 1.0 + late
    first = [each.number for each in tracks.follow(rows, now, 0.063, [(7, 0.1 + late), (9, 0.0)])]
    assert [each.number for each in tracks.follow([At(0.0, 0.0)], 1.0, 0.063)] == [1]
    after = tracks.follow(rows, now + 0.008, 0.063, [(7, 0.108 + late), (9, 0.008)])
    assert [each.number for each in after] == first == [1, 2]
    assert [each.age for each in after] == [pytest.approx(0.108 + late), pytest.approx(0.008)]


def test_one_that_moved_may_be_as_far_as_it_would_have_got():
    """Nothing is told of 18 s, in which it went to and fro; one that rested is where it was."""
    tracks = Tracks(0.025)
    tracks.follow([At(0.0, 0.0, (0.03, 0.0)), At(0.0, 0.09)], 0.0, 0.063)
    later = [At(-0.05, -0.04, (0.03, 0.0)), At(0.1, 0.09)]
    assert [each.number for each in tracks.follow(later, 18.0, 0.063)] == [1, 3]


@pytest.mark.parametrize("given", [None, [(7, 0.1)]], ids=["frames", "rows"])
@pytest.mark.parametrize("back", [1.0, 5.0])
def test_a_clock_set_back_by_seconds_is_no_frame_that_is_told_late(back, given):
    """Frames alone, or rows alone, come in the order of their times: nothing is kept of the time after."""
    tracks = Tracks(0.025)
    tracks.follow(
        [At(0.0, 0.0, (0.1, 0.0)), At(0.09, 0.0)], 100.0, 0.063, given and [*given, (9, 0.0)]
    )
    [now] = tracks.follow([At(0.0, 0.0)], 100.0 - back, 0.063, given)
    assert (now.number, now.velocity) == (3, (0.0, 0.0))
    rests = tracks.follow([At(0.0, 0.0)], 100.1 - back, 0.063, given)
    assert [each.number for each in rests] == [3]


def test_contacts_that_slide_on_through_a_second_without_readings_keep_their_ids():
    """The finger turns round a corner meanwhile, the ball turns back. What a frame says comes eight rows late,
    that of the one before the gap behind it: rows had lost one of the contacts by then, and took the frame for
    one that had found it gone."""
    layout, scene, told, ids = load_layout("equal-8x8"), load_scene("slide"), None, [set(), set()]
    order = np.arange(64) * 27 % 64
    simulator = Simulator(layout, scene, "closed_form", row_period=ROW_PERIOD)
    simulator.grounded = order
    pipeline = Pipeline(layout, Settings("accurate"))
    state = pipeline.rows(waits=False)
    for number, begun in enumerate([1.472, 1.536, 2.6, 2.664, 2.728]):
        frame = simulator.frame(begun, number)
        for i, ground in enumerate(order.tolist()):
            if i == 8 and told is not None and state.asks:
                pipeline.correct(state, *told)
            now = begun + i * ROW_PERIOD
            result = pipeline.process_row(frame[i], ground, DRIVE, now, state)
            for contact in result.contacts:
                apart = [off(contact, each.at(now).centroid) for each in scene.contacts]
                assert min(apart) < 0.01
                ids[int(np.argmin(apart))].add(contact.id)
        told = frame, order, DRIVE, ROW_PERIOD, begun
    assert [len(each) for each in ids] == [1, 1]
    assert len(result.contacts) == 2 and all(each.age > 1.0 for each in result.contacts)
