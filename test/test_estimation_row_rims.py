"""Discs that cover an electrode in part, as one patch: shares as those of many patches, slopes, and a slide."""

import numpy as np
import pytest

from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.follow import Follower
from tomotactile_ros.estimation.forward import Prediction, Unknowns
from tomotactile_ros.estimation.operator import operator_for
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.row_model import Known, RowModel
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
    return operator_for(load_layout(request.param))


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


def shares_of(operator):
    """H and its slopes of discs on an even sheet, as rows have them."""
    prior = Prior.unknown(operator, ChannelPrior(), RADIUS, DRIVE)
    return RowModel(operator, Known.before(prior, (NOISE / DRIVE) ** 2)).shares


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
    found = shares_of(operator)(contact[None, :4])[0][0]
    assert found.sum() == pytest.approx(1.0, abs=1e-9)
    wanted = shares_of_patches(operator, contact)
    assert np.abs(found - wanted).max() < 0.015  # the mean over the disc is off by up to 0.04
    others = np.delete(np.arange(operator.count), amid(operator)[0])
    strongest = others[np.argsort(-wanted[others])[:4]]
    assert found[strongest] == pytest.approx(wanted[strongest], rel=0.08)  # by 40 %


@pytest.mark.parametrize("millimetres", [1.5, 3, 4.5, 6])
def test_slopes_are_those_of_the_shares(operator, millimetres):
    shares, contact = shares_of(operator), disc(operator, 1e-3 * millimetres)
    step = 2 * operator.pitch / 256
    found = [each[0] for each in shares(contact[None, :4])[1]]
    for axis in range(2):
        ends = []
        for sign in (1, -1):
            moved = contact[:4].copy()
            moved[axis] += sign * step
            ends.append(shares(moved[None])[0][0])
        true = (ends[0] - ends[1]) / (2 * step)
        assert np.abs(found[axis] - true).max() < 0.1 / operator.pitch


def followed(layout, contact, rows, first):
    """Each row's time, from number `first` on, and what a follower believes after it."""
    law, noise = ContactLaw(1e-4, 1.0), Noise(NOISE, 1)
    scene = Scene("rows", DRIVE, [contact], law, noise, Adc(12, DRIVE))
    operator, count = operator_for(layout), layout.electrodes
    prior = Prior.unknown(operator, ChannelPrior(), RADIUS, DRIVE)
    follower = Follower(operator, RADIUS, 0.6)
    state = follower.begin(Known.before(prior, (NOISE / DRIVE) ** 2))
    simulator = Simulator(layout, scene, row_period=ROW_PERIOD)
    for number in range(rows):
        if number % count == 0:
            frame = simulator.frame(number * ROW_PERIOD, number // count)
        ground, now = number % count, number * ROW_PERIOD
        valid = np.arange(count) != ground
        follower.follow(state, np.nan_to_num(frame[ground]) / DRIVE, valid, ground, now)
        if number >= first:
            yield now, state.belief


def test_a_slide_across_an_electrode_keeps_its_place_and_speed():
    """Taken for one patch at its centre, it was 1 mm off its place and 40 % off its speed."""
    layout, speed, rows = load_layout("equal-8x8"), 0.2, 150
    middle = amid(operator_for(layout))[1] + [0.0, 0.001]
    slide = Contact(
        "disc",
        center=tuple(middle - 0.5 * rows * ROW_PERIOD * speed * AXIS),
        radius=RADIUS,
        pressure=1.0 / (np.pi * RADIUS**2),
        start=3.5 * ROW_PERIOD,
        end=1.0,
        velocity=tuple(speed * AXIS),
    )
    for now, belief in followed(layout, slide, rows, 40):
        assert belief.numbers == (1,)
        assert np.hypot(*(belief.mean[:2] - slide.at(now).center)) < 0.4e-3
        assert np.hypot(*(belief.mean[2:4] - speed * AXIS)) < 0.12 * speed


@pytest.mark.parametrize("newtons", [20.0, 50.0])
def test_a_hard_press_beside_an_electrode_is_followed(newtons):
    """With shares that depended on how hard it presses, rows lost it; with those of the centre it was 0.9 mm
    off."""
    layout = load_layout("equal-8x8")
    place = layout.positions[27] + 0.004 * AXIS
    press = Contact(
        "disc",
        center=tuple(place),
        radius=RADIUS,
        pressure=newtons / (np.pi * RADIUS**2),
        start=3.5 * ROW_PERIOD,
    )
    for _, belief in followed(layout, press, 150, 40):
        assert belief.count == 1
        assert np.hypot(*(belief.mean[:2] - place)) < 0.5e-3
