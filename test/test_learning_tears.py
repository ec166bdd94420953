"""Sheets that are torn: where, from touches of unknown place and force, and what is right afterwards."""

import numpy as np
import pytest
from contacts_support import DRIVE, NOISE, disc, off, sensor

import tomotactile_ros as tt
from tomotactile_ros.estimation.as_cut import torn
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.learning.file import load_sensor, save_sensor
from tomotactile_ros.learning.findings import lines
from tomotactile_ros.learning.health import Health
from tomotactile_ros.learning.tears import find_tears
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.scenes.sheet_field import SheetField, Tear

LAYOUT = tt.equal_grid(5, 5, (0.125, 0.125), sheet_resistance=1e4, radius=0.0025)
OPERATOR = SheetOperator(LAYOUT)
TEAR = (-0.02, 0.018, 0.04, 0.018)
TORN = SheetField(tears=(Tear((TEAR[:2], TEAR[2:]), 0.001),))

pytestmark = pytest.mark.usefixtures("ends_of_tears_are_found_to_3_mm")


def pressed(places, sheet, layout=LAYOUT):
    """Frames of a touch at one place after the other."""
    contacts = [disc(*at, force=2.0, start=i, end=i + 1.0) for i, at in enumerate(places)]
    how = {"noise": 0.0, "adc": None, "row_period": 0.0}
    simulator = sensor(layout, *contacts, defects=Defects(sheet=sheet), **how)
    frames = np.array([simulator.frame(i + 0.5) for i in range(len(places))])
    return frames + np.random.default_rng(1).normal(0, NOISE, frames.shape[1:])


def touches(count, sheet=TORN, seed=2):
    return pressed(np.random.default_rng(seed).uniform(-0.054, 0.054, (count, 2)), sheet)


def distance(tear, true):
    """Of the ends of one to those of the other, the farther one, m."""
    ends, others = np.reshape(tear, (2, 2)), np.reshape(true, (2, 2))
    return min(np.linalg.norm(ends - each, axis=1).max() for each in (others, others[::-1]))


def uncertain(layout):
    """Couplings of a sheet that is not quite even."""
    random = np.random.default_rng(0).normal(0, 0.05, (25, 25))
    return SheetOperator(layout).admittance * np.exp((random + random.T) / 2)


def test_a_second_tear_from_the_rim_is_found_beside_the_first():
    first, second = TEAR, (0.0, -0.0625, 0.0, -0.015)
    operator = OPERATOR.about(np.zeros(OPERATOR.modes), (first,))
    (found,) = find_tears(operator, uncertain(torn(LAYOUT, (first, second))))
    assert distance(found, second) < 0.01


def test_a_tear_that_cuts_an_electrode_off_is_none():
    corner = ((-0.07, -0.05, -0.05, -0.07),)
    with pytest.raises(tt.InputError, match="outside the outline"):
        torn(LAYOUT, corner)


def test_learning_names_a_tear_and_contacts_are_right_beside_it(tmp_path):
    learned = tt.learn(LAYOUT, touches(6), LAYOUT.grounded, DRIVE, noise=NOISE)
    (found,) = learned.state.tears
    assert distance(found, TEAR) < 0.01
    said = [line for line in lines(learned) if "torn from" in line]
    assert len(said) == 1 and learned.unexplained < 3
    save_sensor(tmp_path / "sensor.yaml", LAYOUT, learned.operator, learned.state)
    sensor = load_sensor(tmp_path / "sensor.yaml", LAYOUT)
    np.testing.assert_allclose(sensor.tears, learned.state.tears, atol=1e-6)
    health = Health(OPERATOR)
    for _ in range(2):
        health.update(sensor)
    assert any("torn from" in each.text for each in health.findings)
    settings = tt.Settings("accurate", noise=NOISE)
    pipeline = tt.Pipeline(LAYOUT, settings, sensor=sensor)
    places = (0.015, 0.026), (0.0, 0.012)
    for at, frame in zip(places, pressed(places, TORN), strict=True):
        pipeline.untare()  # as the first frame
        (contact,) = pipeline.process(frame, LAYOUT.grounded, DRIVE).contacts
        assert off(contact, at) < 1e-3


def test_where_a_tear_is_not_known_contacts_beside_it_are_right_or_withheld():
    layout = tt.equal_grid(6, 6, (0.15, 0.15), sheet_resistance=1e4, radius=0.0025)
    sheet = SheetField(tears=(Tear(((-0.02, 0.028), (0.05, 0.028)), 0.001),))
    pipeline = tt.Pipeline(layout, tt.Settings("accurate", noise=NOISE))
    places = (0.015, 0.036), (0.0, 0.02)
    for at, frame in zip(places, pressed(places, sheet, layout), strict=True):
        pipeline.untare()  # as the first frame
        result = pipeline.process(frame, layout.grounded, DRIVE)
        if result.state == "withheld":
            assert "is it torn" in result.reason
        else:
            (contact,) = result.contacts
            assert off(contact, at) < 3e-3
