"""Readings of contacts that move, against every row evaluated at its own time, and what is made of
them."""

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

import tomotactile_ros as tt
from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.forward import Prediction, Unknowns
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.search import Search
from tomotactile_ros.estimation.touch import patches_for
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.layouts.scan_order import spread
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.channels import Channels
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.scenes.scene import Noise, Scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

LAYOUT = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
LAW = ContactLaw(1e-4, 1.0)
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


def row_by_row(unknowns: Unknowns) -> np.ndarray:
    return np.concatenate(
        [
            Prediction(OPERATOR, unknowns.after(time), GROUNDED[i : i + 1]).readings
            for i, time in enumerate(TIMES)
        ]
    )


def moving(unknowns: Unknowns, grounded=GROUNDED, times=TIMES):
    return Prediction(OPERATOR, unknowns, grounded, times=times)


@pytest.mark.parametrize("speed", [0.1, 1.0, 5.0])
def test_rows_see_contacts_where_they_are_at_their_time(speed):
    """What is left over falls with the square of the ways that are taken for straight ones."""
    unknowns = sliding(speed)
    at_once = Prediction(OPERATOR, unknowns, GROUNDED).readings - row_by_row(unknowns)
    rest = moving(unknowns).readings - row_by_row(unknowns)
    assert np.linalg.norm(rest) < 0.3 * np.linalg.norm(at_once)


def test_what_first_order_leaves_falls_with_the_square_of_the_speed():
    """As long as one evaluation serves all rows."""
    rest = []
    for part in (1.0, 0.5, 0.25):
        unknowns = sliding(0.0)
        unknowns = replace(unknowns, rates=part * np.array([[0.3, -0.4, -8.0], [0.0, 0.0, 0.0]]))
        rest.append(np.linalg.norm(moving(unknowns).readings - row_by_row(unknowns)))
    assert rest[0] / rest[1] == pytest.approx(4, rel=0.25)
    assert rest[1] / rest[2] == pytest.approx(4, rel=0.25)


def test_what_does_not_move_reads_the_same():
    unknowns = sliding(0.0)
    still = replace(unknowns, rates=np.zeros((2, 3)))
    expected, found = Prediction(OPERATOR, still, GROUNDED), moving(still)
    np.testing.assert_allclose(found.readings, expected.readings, atol=1e-12)
    np.testing.assert_allclose(found.sheet_columns(), expected.sheet_columns(), atol=1e-12)
    at_rest = moving(still.in_motion(False)).contact_columns()
    np.testing.assert_allclose(at_rest, expected.columns(still.free), atol=1e-12)


def test_derivatives_are_those_of_every_row_at_its_time():
    unknowns = sliding(0.1)
    unknowns = replace(unknowns, rates=unknowns.rates * [0.5, 0.5, 0.05])
    found = moving(unknowns).contact_columns()
    each = [
        Prediction(OPERATOR, unknowns.after(time), GROUNDED[i : i + 1]).columns(unknowns.free)
        for i, time in enumerate(TIMES)
    ]
    true = np.concatenate(each, axis=1)
    rated = true[[0, 1, 2, 4, 5, 6]] * TIMES[:, None]
    for one, other in zip(found, [*true, *rated], strict=True):
        assert np.linalg.norm(one - other) < 0.03 * np.linalg.norm(other)


def test_missing_rows_and_a_middle_that_no_row_was_read_at():
    some = np.array([0, 1, 2, 14, 15])
    unknowns = sliding(2.0)
    found = moving(unknowns, GROUNDED[some], TIMES[some])
    whole = moving(unknowns)
    np.testing.assert_allclose(found.readings, whole.readings[some], atol=1e-12)
    np.testing.assert_allclose(found.means, whole.means)


PROFILES = ("fast", "balanced", "accurate")


@pytest.mark.parametrize("profile", PROFILES)
def test_the_velocity_of_a_contact_is_reported_and_its_place_is_that_of_the_last_row(profile):
    fast = Contact("disc", center=(-0.03, 0.02), radius=RADIUS, pressure=2e4, velocity=(0.5, -0.8))
    sensor = Simulator(LAYOUT, Scene("test", 3.3, (fast,), contact_law=LAW))
    pipeline = Pipeline(LAYOUT, Settings(profile, contact_law=LAW))
    result = pipeline.process(sensor.frame(0.0), sensor.grounded, 3.3, ROW_PERIOD)
    (contact,) = result.contacts
    np.testing.assert_allclose(contact.velocity, fast.velocity, atol=0.05)
    assert result.holds == pytest.approx(15 * ROW_PERIOD)
    there = np.add(fast.center, np.multiply(result.holds, fast.velocity))
    assert np.hypot(contact.x - there[0], contact.y - there[1]) < 1e-3


@pytest.mark.parametrize("profile", PROFILES)
def test_what_rests_is_found_again_beside_what_begins(profile):
    """The touch that begins within a frame hides how the other one read before."""
    rests = Contact("disc", center=(-0.05, 0.05), radius=RADIUS, pressure=2e4)
    begins = replace(rests, center=(0.06, -0.04), start=1.5 * 16 * ROW_PERIOD)
    sensor = Simulator(LAYOUT, Scene("test", 3.3, (rests, begins), contact_law=LAW))
    pipeline = Pipeline(LAYOUT, Settings(profile, contact_law=LAW))
    for k, count in enumerate((1, 2, 2)):
        start = k * 16 * ROW_PERIOD
        result = pipeline.process(sensor.frame(start), sensor.grounded, 3.3, ROW_PERIOD, start)
        assert len(result.contacts) == count
        apart = [np.hypot(c.x + 0.05, c.y - 0.05) for c in result.contacts]
        assert min(apart) < 1e-3


EIGHT = equal_grid(8, 8, (0.2, 0.2), 0.0025, 1e4)
FRAME = 64 * ROW_PERIOD
TIMES_OF_64 = ROW_PERIOD * (np.arange(64) - 31.5)
FIRST = Contact("disc", center=(-0.03, 0.0), radius=0.006, pressure=2e4)


def simulator_of(*contacts, gains=None) -> Simulator:
    """8 x 8 electrodes at 1 mV of noise."""
    defects = Defects() if gains is None else Defects(channels=Channels(gain=tuple(gains)))
    noise = Noise(rms=1e-3)
    return Simulator(
        EIGHT, Scene("test", 3.3, contacts, noise=noise, contact_law=LAW, defects=defects)
    )


@cache
def search_of_64() -> Search:
    return Search(SheetOperator(EIGHT))


@pytest.mark.parametrize("off", [0.0, 0.05])
@pytest.mark.parametrize("row", [20, 47, 58])
def test_reciprocity_says_which_rows_are_of_one_state(row, off):
    """Whatever touches, and with channels of which nothing is known."""
    second = Contact(
        "disc", center=(0.03, 0.01), radius=0.005, pressure=1e4, start=row * ROW_PERIOD
    )
    gains = 1 + off * np.random.default_rng(3).standard_normal(64)
    simulator = simulator_of(FIRST, second, gains=gains)
    search = search_of_64()
    channels = ChannelPrior(gain=max(off, 0.03))
    prior = Prior.unknown(search.operator, channels, RADIUS, 3.3)
    for begun, alike in ((0.0, 64 - row), (FRAME, 64)):
        frame = simulator.frame(begun) / 3.3
        weights = np.where(np.eye(64, dtype=bool), 0.0, 3.3e3**2)
        rows = Rows(np.where(weights > 0, frame, 0.0), weights, np.arange(64), TIMES_OF_64)
        assert alike - 2 <= search.of_one_state(rows, prior) <= alike + 1


@pytest.mark.parametrize("profile", ["balanced", "accurate"])
def test_two_touches_stay_two(profile):
    """The second begins in the middle of a frame, 60 mm away: no frame shows one between them, or
    one alone, and none is withheld but the one in which it begins."""
    second = replace(FIRST, center=(0.03, 0.0), start=2 * FRAME + 16 * ROW_PERIOD)
    simulator = simulator_of(FIRST, second)
    pipeline = Pipeline(EIGHT, Settings(profile, noise=1e-3, contact_law=LAW))
    for n in range(7):
        begun = n * FRAME
        frame = simulator.frame(begun, n)
        result = pipeline.process(frame, simulator.grounded, 3.3, ROW_PERIOD, begun)
        if n == 2 and result.state == "withheld":
            continue
        assert result.state == "valid"
        found = sorted(c.x for c in result.contacts)
        assert found == pytest.approx([-0.03] if n < 2 else [-0.03, 0.03], abs=1e-3)


@pytest.mark.parametrize("profile, frame", [("fast", 60), ("accurate", 61)])
def test_a_tap_that_begins_in_the_last_rows_is_right_or_withheld(profile, frame):
    """No contact elsewhere, and not none: the last rows read up to a volt."""
    plain, scene = tt.load_layout("equal-8x8"), tt.load_scene("tap")
    layout = replace(plain, scan=tuple(map(int, spread(plain.positions, range(64)))))
    simulator = Simulator(layout, scene)
    settings = Settings(profile, noise=1e-3, contact_law=scene.contact_law)
    pipeline = Pipeline(plain, settings)
    for number in (frame - 1, frame):
        time = number * 64 * ROW_PERIOD
        voltages, grounded = simulator.frame(time), simulator.grounded
        result = pipeline.process(voltages, grounded, 3.3, ROW_PERIOD, time)
    assert np.nanmax(np.where(np.arange(64) == grounded[:, None], 0, voltages)) > 0.3
    if result.state == "valid":
        (found,) = result.contacts
        assert np.hypot(found.x - 0.06, found.y + 0.03) < 3e-3
    else:
        assert "last" in result.reason and not result.idle
