"""Rows of sensors with wrong channels, and of which electrodes lie elsewhere."""

from dataclasses import replace

import numpy as np
import pytest

from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.estimator import Estimator
from tomotactile_ros.estimation.forward import Prediction, Unknowns
from tomotactile_ros.estimation.operator import operator_for
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.row_estimator import RowEstimator, RowsState
from tomotactile_ros.estimation.row_model import Known, RowModel
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.scenes.channels import Channels
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Adc, Defects, Noise
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

LAYOUT = load_layout("equal-8x8")
DRIVE, NOISE, LAW = 3.3, 1e-3, ContactLaw(1e-4, 1.0)
PLACE, BEGUN, ENDED = (-0.021, 0.034), 10, 50  # m, rows


@pytest.fixture(scope="module")
def estimator():
    return Estimator(LAYOUT, noise=NOISE, law=LAW, radius=0.008)


def followed(estimator, defects, layout=LAYOUT, contacts=None):
    """What is known after each row of a tap, and the state in the end; no frame is told."""
    times = {"start": (BEGUN - 0.5) * ROW_PERIOD, "end": (ENDED - 0.5) * ROW_PERIOD}
    tap = Contact("disc", center=PLACE, radius=0.006, pressure=15e3, **times)
    scene = Scene("rows", DRIVE, [tap], LAW, Noise(NOISE, 1), Adc(12, DRIVE), defects)
    frame = Simulator(layout, scene, row_period=ROW_PERIOD).frame(0.0, 0)
    rows, state, said, asked = RowEstimator(estimator), RowsState(waits=False), [], []
    for i, row in enumerate(frame):
        said.append(rows.estimate(row, i, DRIVE, i * ROW_PERIOD, state))
        asked.append(bool(state.rows.distrusted.any()))
    return said, state, asked


def test_what_a_reading_takes_with_it_is_what_leaving_it_out_takes():
    random = np.random.default_rng(5)
    half = random.standard_normal((16, 16))
    covariance = 1e-4 * (half @ half.T + np.eye(16))
    misfit = np.linalg.cholesky(covariance) @ random.standard_normal(16)
    misfit[[2, 7]] += (0.7, -0.4)

    def cost(kept):
        own = covariance[np.ix_(kept, kept)]
        return misfit[kept] @ np.linalg.solve(own, misfit[kept]) + np.linalg.slogdet(own)[1]

    found, gained = compiled.outliers(misfit, np.linalg.cholesky(covariance), np.ones(16, bool), 3)
    assert set(found) == {2, 7}
    kept = np.setdiff1d(np.arange(16), found)
    price = -2 * np.log(compiled.WRONG) - np.log(2 * np.pi)
    assert cost(np.arange(16)) - cost(kept) - 2 * price == pytest.approx(gained)


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
    places = [[(c.x, c.y) for *_, c in each.contacts] for each in said[BEGUN:ENDED]]
    seen = [each for each in places if each]
    assert len(seen) > 0.9 * len(places)
    assert all(len(each) == 1 for each in seen)
    assert np.hypot(*(np.array(seen)[:, 0] - PLACE).T).max() < 2e-3
    assert all(not each.contacts for each in said[ENDED:])
    assert any(asked[BEGUN:ENDED]) and state.asks


def test_what_a_slow_multiplexer_leaves_of_a_touch_is_none(estimator):
    said, *_ = followed(estimator, Defects(channels=Channels(settling=0.005)))
    assert all(len(each.contacts) == 1 for each in said[BEGUN:ENDED])
    assert not any(each.contacts or each.reason for each in said[ENDED + 2 :])


def test_electrodes_a_millimetre_aside_make_no_contacts(estimator):
    moved = LAYOUT.positions + np.random.default_rng(0).normal(0, 1e-3, LAYOUT.positions.shape)
    inside = np.abs(moved).max(axis=1) < LAYOUT.outline.size[0] / 2 - LAYOUT.radius
    moved = np.where(inside[:, None], moved, LAYOUT.positions)
    layout = replace(LAYOUT, positions=moved)
    said, *_ = followed(estimator, Defects(), layout)
    for each in said[BEGUN:ENDED]:
        ((_, _, contact),) = each.contacts
        off = np.array([contact.x, contact.y]) - PLACE
        covariance = np.array(contact.covariance).reshape(2, 2)
        assert np.hypot(*off) < 5e-3 and off @ np.linalg.solve(covariance, off) < 14  # 0.1 %
    assert not any(each.contacts for each in said[ENDED:])


def test_one_row_knows_electrodes_aside_as_frames_do():
    operator = operator_for(LAYOUT)
    forms = np.array([[*PLACE, -9.5, np.log(0.006), 0.0, 0.0]])
    free = np.array([[True] * 4 + [False] * 2])
    flat = Unknowns.at_rest(operator).with_contacts(forms, (5,), free)
    known = Known.before(Prior.unknown(operator, ChannelPrior(), 0.006, DRIVE), 1e-6)
    shift, aside = np.zeros(len(known.shift_deviation)), np.zeros((2, operator.count))
    rows = np.array([0, 27])
    for which in (9, 27, 28):
        moved = aside.copy()
        moved[:, which] = 3e-4, -4e-4
        ends = []
        for at in (aside, moved):
            whole = Prediction(operator, replace(flat, aside=at), rows).readings
            model = RowModel(operator, replace(known, aside=at))
            row = [model.row(forms[:, :4], each, shift).readings for each in rows]
            ends.append((whole, np.array(row)))
        (whole, row), (whole_moved, row_moved) = ends
        change = whole_moved - whole
        assert np.abs(row_moved - row - change).max() < 0.05 * np.abs(change).max()
