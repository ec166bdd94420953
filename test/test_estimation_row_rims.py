"""Discs that cover an electrode in part, as one patch: shares as those of many patches, slopes, and a slide."""

import numpy as np
import pytest

from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.follow import Follower
from tomotactile_ros.estimation.forward import Prediction, Unknowns
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.row_model import Known
from tomotactile_ros.estimation.row_rims import Rims
from tomotactile_ros.estimation.row_shares import Shares
from tomotactile_ros.estimation.touch import Touches
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Adc, Noise
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import ROW_PERIOD, Simulator

DRIVE, NOISE, RADIUS = 3.3, 1e-3, 0.005
AXIS = np.array([np.cos(0.7), np.sin(0.7)])


@pytest.fixture(scope="module", params=["equal-8x8", "hex-37"])
def operator(request):
    return SheetOperator(load_layout(request.param))


def amid(operator):
    """Number and place of the electrode in the middle."""
    which = int(np.hypot(*operator.layout.positions.T).argmin())
    return which, operator.layout.positions[which]


def disc(operator, distance, conductance=1e-4, radius=RADIUS):
    """(6,) so far from an electrode; the ln c of `conductance`, S, of its own."""
    place = amid(operator)[1] + distance * AXIS
    contact = np.array([*place, 0.0, np.log(radius), 0.0, 0.0])
    mean = Touches(operator, contact[None], (14,), np.zeros(operator.modes)).mean[0]
    contact[2] = -np.log(1 / conductance + mean)
    return contact


def shares_of_patches(operator, contact):
    """(n,) what all patches together feed into each electrode while all are at one voltage, of their sum."""
    flat = Unknowns.at_rest(operator)
    unknowns = flat.with_contacts(contact[None], (14,), np.ones((1, 6), bool))
    prediction = Prediction(operator, unknowns, np.arange(operator.count))
    change = np.linalg.inv(prediction.impedance) - operator.admittance
    return change.sum(axis=1) / change.sum()


@pytest.mark.parametrize("millimetres", [0, 1, 2, 3, 4, 5, 6, 7])
@pytest.mark.parametrize("conductance", [2e-5, 2e-4])
def test_shares_are_those_of_many_patches(operator, millimetres, conductance):
    contact = disc(operator, 1e-3 * millimetres, conductance)
    found = Shares(operator, np.zeros(operator.modes), Rims(operator, RADIUS)).at(
        contact[None, :4]
    )[0][0]
    assert found.sum() == pytest.approx(1.0, abs=1e-9)
    wanted = shares_of_patches(operator, contact)
    assert np.abs(found - wanted).max() < 0.015  # the mean over the disc is off by up to 0.04
    others = np.delete(np.arange(operator.count), amid(operator)[0])
    strongest = others[np.argsort(-wanted[others])[:4]]
    assert found[strongest] == pytest.approx(wanted[strongest], rel=0.06)  # by 40 %


@pytest.mark.parametrize("millimetres", [1.5, 3, 4.5, 6])
def test_slopes_are_those_of_the_shares(operator, millimetres):
    shares, contact = (
        Shares(operator, np.zeros(operator.modes), Rims(operator, RADIUS)),
        disc(operator, 1e-3 * millimetres),
    )
    step = 2 * operator.pitch / 256
    found = shares.at(contact[None, :4])[1][0]
    for axis in range(2):
        ends = []
        for sign in (1, -1):
            moved = contact[:4].copy()
            moved[axis] += sign * step
            ends.append(shares.at(moved[None])[0][0])
        true = (ends[0] - ends[1]) / (2 * step)
        assert np.abs(found[axis] - true).max() < 0.1 / operator.pitch


def test_a_slide_across_an_electrode_keeps_its_place_and_speed():
    """Taken for one patch with the mean over its area, it was 1 mm off its place and 40 % off its speed."""
    layout, speed, rows = load_layout("equal-8x8"), 0.2, 150
    operator = SheetOperator(layout)
    middle = amid(operator)[1] + [0.0, 0.001]
    start = middle - 0.5 * rows * ROW_PERIOD * speed * AXIS
    pressure = 1.0 / (np.pi * RADIUS**2)
    slide = Contact(
        "disc",
        center=tuple(start),
        radius=RADIUS,
        pressure=pressure,
        start=3.5 * ROW_PERIOD,
        end=1.0,
        velocity=tuple(speed * AXIS),
    )
    scene = Scene("slide", DRIVE, [slide], ContactLaw(1e-4, 1.0), Noise(NOISE, 1), Adc(12, DRIVE))
    simulator = Simulator(layout, scene, row_period=ROW_PERIOD)
    known = Known.before(
        Prior.unknown(operator, ChannelPrior(), RADIUS, DRIVE), (NOISE / DRIVE) ** 2
    )
    follower, count, number = Follower(operator, RADIUS, 0.6), layout.electrodes, 0
    state = follower.begin(known)
    for frame in range(rows // count + 1):
        simulator.grounded = np.arange(count)
        for ground, row in enumerate(simulator.frame(number * ROW_PERIOD, frame)):
            now = number * ROW_PERIOD
            valid = np.arange(count) != ground
            follower.follow(state, np.nan_to_num(row) / DRIVE, valid, ground, now)
            number += 1
            if not 40 <= number < rows:
                continue
            assert state.belief.numbers == (1,)
            true = slide.at(now).center
            assert np.hypot(*(state.belief.mean[:2] - true)) < 0.4e-3
            assert np.hypot(*(state.belief.mean[2:4] - speed * AXIS)) < 0.12 * speed
