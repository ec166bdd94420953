"""Rows that cannot be: a sheet that is touched and untouched in turn, readings beyond the range."""

import numpy as np
import pytest

from tomotactile_ros.estimation.row_checks import IN_TURN
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Adc, Noise
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

LAYOUT, DRIVE, LAW = load_layout("equal-4x4"), 5.0, ContactLaw(1e-4, 1.0)
PLACES = np.array([(0.03, 0.02), (-0.05, -0.03)])
START = 24  # rows before the first touch; the second one comes 30 rows later
FRAMES = 12
FEW = 16 * 7  # rows: three frames with both touches
NEAR = 0.010  # m


@pytest.fixture(scope="module")
def pipeline():
    return Pipeline(LAYOUT, Settings("accurate", noise=1e-3, contact_law=LAW))


@pytest.fixture(scope="module")
def good():
    """(rows, 16) V, of the finite-element model."""
    contacts = [
        Contact(
            "disc",
            center=tuple(place),
            radius=0.006,
            pressure=1.2e4,
            start=(START + 30 * i - 0.5) * ROW_PERIOD,
        )
        for i, place in enumerate(PLACES)
    ]
    scene = Scene("rows", DRIVE, contacts, LAW, Noise(1e-3, 1), Adc(12, DRIVE))
    simulator = Simulator(LAYOUT, scene, row_period=ROW_PERIOD)
    return np.vstack([simulator.frame(16 * i * ROW_PERIOD, i) for i in range(FRAMES)])


def results(pipeline, rows):
    """What is said of each row."""
    pipeline.untare()
    state = pipeline.rows()
    return [
        pipeline.process_row(row, i % 16, DRIVE, i * ROW_PERIOD, state)
        for i, row in enumerate(rows)
    ]


def wrong(said) -> int:
    """How many results are valid and show a contact where none is."""
    count = 0
    for number, result in enumerate(said):
        true = PLACES[: 0 if number < START else 1 if number < START + 30 else 2]
        for c in result.contacts:
            apart = np.hypot(*(true - [c.x, c.y]).T)
            count += not (apart < NEAR).any()
    return count


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_rows_that_are_not_read_make_no_contacts(pipeline, good, share):
    """Rows of 0 V between those of two contacts: they became one between the two, and valid."""
    for seed in range(3):
        rows = good.copy()
        lost = np.random.default_rng(seed).random(len(rows)) < share
        lost[-48:] = False  # the electronics are mended
        rows[lost] = 0.0
        said = results(pipeline, rows)
        assert not wrong(said)
        assert sum(each.reason == IN_TURN for each in said) > 50


def test_rows_are_told_again_a_while_after_the_last_one_that_was_not_read(pipeline, good):
    rows = good.copy()
    rows[80] = 0.0
    said = results(pipeline, rows)
    assert not wrong(said)
    assert said[79].contacts and said[81].reason == IN_TURN
    assert [len(each.contacts) for each in said[-32:]] == [2] * 32


@pytest.mark.parametrize("highest", [1.0, 2.0])
def test_readings_at_the_end_of_the_range_are_none(pipeline, good, highest):
    """They put contacts up to 60 mm away."""
    said = results(pipeline, np.minimum(good, highest))
    assert not wrong(said) and any("converter's range" in each.reason for each in said)


def test_with_half_of_the_channels_stuck_nothing_is_told(pipeline, good):
    """Of two contacts on 4 x 4 electrodes, one in seven frames had one more than 10 mm off."""
    for seed in range(2):
        rows = good[:FEW].copy()
        rows[:, np.random.default_rng(seed).permutation(16)[:8]] = 1.1
        assert not any(each.contacts for each in results(pipeline, rows))


@pytest.mark.parametrize("waits", [True, False])
def test_rows_are_withheld_where_frames_are_before_any_estimate(pipeline, good, waits):
    """Three of four channels at 0 V are no touch that the others see: frames said so, rows did not."""
    rows = good[:FEW].copy()
    rows[:, 4:] = 0.0
    pipeline.untare()
    state, said = pipeline.rows(waits), []
    for i, row in enumerate(rows):
        said.append(pipeline.process_row(row, i % 16, DRIVE, i * ROW_PERIOD, state))
        if not waits and i % 16 == 15:
            frame = rows[i - 15 : i + 1], np.arange(16), DRIVE, ROW_PERIOD
            result = pipeline.process(*frame)
            pipeline.correct(state, *frame, (i - 15) * ROW_PERIOD)
    assert not any(each.contacts for each in said)
    assert "never change while others do" in said[-1].reason
    assert waits or said[-1].reason == result.reason
