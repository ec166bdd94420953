"""Rows that cannot be: a sheet that is touched and untouched in turn, readings beyond the range; and rows
of sensors with wrong channels, and of which electrodes lie elsewhere."""

from dataclasses import replace

import numpy as np
import pytest
from contacts_support import (
    DRIVE,
    LAW,
    NOISE,
    deviations_off,
    disc,
    frames_of,
    off,
    pipeline_of,
    sensor,
)

from tomotactile_ros.estimation.estimator import Estimator
from tomotactile_ros.estimation.row_checks import IN_TURN
from tomotactile_ros.estimation.row_estimator import RowEstimator, RowsState
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.scenes.channels import Channels
from tomotactile_ros.scenes.defects import Adc, Defects
from tomotactile_ros.simulation import ROW_PERIOD

FIVE = 5.0  # V, of this sensor
PLACES = np.array([(0.03, 0.02), (-0.05, -0.03)])
START = 24  # rows before the first touch; the second one comes 30 rows later
FEW = 16 * 7  # rows: three frames with both touches
NEAR = 0.010  # m


@pytest.fixture(scope="module")
def pipeline():
    return pipeline_of("equal-4x4")


@pytest.fixture(scope="module")
def good(pipeline):
    """(rows, 16) V, of the finite-element model."""
    starts = [(START + 30 * i - 0.5) * ROW_PERIOD for i in range(2)]
    contacts = [disc(*at, pressure=1.2e4, start=t) for at, t in zip(PLACES, starts)]
    made = sensor(pipeline.layout, *contacts, drive=FIVE, adc=Adc(12, FIVE))
    return np.vstack(frames_of(made, 12))


def results(pipeline, rows, waits=True):
    """What is said of each row; where none waits for frames, they are told as they end."""
    pipeline.untare()
    state, said = pipeline.rows(waits), []
    for i, row in enumerate(rows):
        said.append(pipeline.process_row(row, i % 16, FIVE, i * ROW_PERIOD, state))
        if not waits and i % 16 == 15:
            frame = rows[i - 15 : i + 1], np.arange(16), FIVE, ROW_PERIOD
            pipeline.process(*frame)
            pipeline.correct(state, *frame, (i - 15) * ROW_PERIOD)
    return said


def wrong(said) -> int:
    """How many contacts are shown where none is."""
    count = 0
    for number, result in enumerate(said):
        true = PLACES[: 0 if number < START else 1 if number < START + 30 else 2]
        count += sum(all(off(c, place) > NEAR for place in true) for c in result.contacts)
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
    said = results(pipeline, rows, waits)
    assert not any(each.contacts for each in said)
    assert "never change while others do" in said[-1].reason
    result = pipeline.process(rows[-16:], np.arange(16), FIVE, ROW_PERIOD)
    assert waits or said[-1].reason == result.reason


# -- wrong sensors ---------------------------------------------------------------------------------

EIGHT = load_layout("equal-8x8")
PLACE, BEGUN, ENDED = (-0.021, 0.034), 10, 50  # m, rows


@pytest.fixture(scope="module")
def estimator():
    return Estimator(EIGHT, noise=NOISE, law=LAW, radius=0.008)


def followed(estimator, defects, layout=EIGHT):
    """What is known after each row of a tap, and the state in the end; no frame is told."""
    times = {"start": (BEGUN - 0.5) * ROW_PERIOD, "end": (ENDED - 0.5) * ROW_PERIOD}
    (frame,) = frames_of(sensor(layout, disc(*PLACE, pressure=15e3, **times), defects=defects), 1)
    rows, state, said, asked = RowEstimator(estimator), RowsState(waits=False), [], []
    for i, row in enumerate(frame):
        said.append(rows.estimate(row, i, DRIVE, i * ROW_PERIOD, state))
        asked.append(bool(state.rows.distrusted.any()))
    return said, state, asked


@pytest.mark.parametrize(
    "defects",
    [
        Defects(channels=Channels(stuck={37: 1.0})),
        Defects(channels=Channels(stuck={20: 0.0})),
        Defects(swapped=((44, 45),)),
        Defects(swapped=((3, 58),)),
    ],
    ids=["stuck at 1 V", "stuck at 0 V", "neighbours exchanged", "others exchanged"],
)
def test_a_wrong_channel_is_no_contact_and_moves_none(estimator, defects):
    """The channel is left out, and a frame is asked for, as it can tell what is wrong."""
    said, state, asked = followed(estimator, defects)
    found = [[c for *_, c in each.contacts] for each in said[BEGUN:ENDED]]
    seen = [each for each in found if each]
    assert len(seen) > 0.9 * len(found) and all(len(each) == 1 for each in seen)
    assert max(off(contact, PLACE) for (contact,) in seen) < 2e-3
    assert all(not each.contacts for each in said[ENDED:])
    assert any(asked[BEGUN:ENDED]) and state.asks


def test_what_a_slow_multiplexer_leaves_of_a_touch_is_none(estimator):
    said, *_ = followed(estimator, Defects(channels=Channels(settling=0.005)))
    assert all(len(each.contacts) == 1 for each in said[BEGUN:ENDED])
    assert not any(each.contacts or each.reason for each in said[ENDED + 2 :])


def test_electrodes_a_millimetre_aside_make_no_contacts(estimator):
    moved = EIGHT.positions + np.random.default_rng(0).normal(0, 1e-3, EIGHT.positions.shape)
    inside = np.abs(moved).max(axis=1) < EIGHT.outline.size[0] / 2 - EIGHT.radius
    layout = replace(EIGHT, positions=np.where(inside[:, None], moved, EIGHT.positions))
    said, *_ = followed(estimator, Defects(), layout)
    for each in said[BEGUN:ENDED]:
        ((_, _, contact),) = each.contacts
        assert off(contact, PLACE) < 5e-3 and deviations_off(contact, PLACE) < 14  # 0.1 %
    assert not any(each.contacts for each in said[ENDED:])
