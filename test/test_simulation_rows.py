"""Rows in time: each row of a frame shows the sheet at its own moment."""

from dataclasses import replace

import numpy as np
import pytest

from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.scenes.sheet_field import Anisotropy, SheetField, Tear, Temperature
from tomotactile_ros.sheet.contact_points import contact_points
from tomotactile_ros.sheet.voltages import frame
from tomotactile_ros.simulation import ROW_PERIOD, Simulator
from tomotactile_ros.support.errors import InputError

DRIVE = 3.3
ROUNDED = 1e-5  # V, of 3.3 V in single precision, in which contacts that move are solved
LAYOUT = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
LAW = ContactLaw(1e-4, 1.0)
OFF = ~np.eye(16, dtype=bool)


def disc(x, y, radius=0.006, velocity=(0.0, 0.0), **times):
    return Contact(
        "disc", center=(x, y), radius=radius, pressure=2e4, velocity=velocity, **times
    )  # fmt: skip


def scene(*contacts, law=LAW, **settings):
    return Scene("test", DRIVE, contacts, contact_law=law, **settings)


def simulator(*contacts, model="fem", law=LAW, row_period=ROW_PERIOD, order=None, **settings):
    return Simulator(
        LAYOUT, scene(*contacts, law=law, **settings), model, row_period=row_period, order=order
    )


def one_by_one(rows: Simulator, t: float) -> np.ndarray:
    """The frame row by row: contacts where they are at the row's time, solved for it alone."""
    drive, to_ground = rows.scene.drive_voltage, rows.scene.defects.switch_resistance
    out = []
    for i, ground in enumerate(rows.grounded):
        now = t + i * rows.row_period
        there = [c.at(now) for c in rows.scene.contacts]
        law, warm = rows.scene.contact_law, rows.sheet_factor(now)
        patches = [
            (c.patches(across), np.inf if law is None else float(law.conductance(c.pressure)))
            for c, across in zip(there, rows._across)
            if c is not None
        ]
        transfer, resistance = contact_points(rows.sheet, patches)
        wire = {"grounded": [ground], "switch_resistance": to_ground / warm}
        out += [*frame(transfer, resistance / warm, drive, **wire)]
    return np.array(out)


MOVING = {
    "two apart": [disc(-0.07, 0.05, velocity=(1.0, 0.3)), disc(0.05, -0.05, velocity=(-2.0, 0.0))],
    "over electrodes": [disc(0.0, 0.033, 0.004, velocity=(3.0, 0.0))],
    "through each other": [disc(-0.01, 0.0, velocity=(2.0, 0.0)), disc(0.02, 0.0, 0.003)],
    "off the rim": [disc(0.08, 0.02, 0.012, velocity=(2.0, 0.5))],
    "begins and ends": [
        disc(-0.05, 0.0, velocity=(1.0, 0.0), end=0.005),
        disc(0.05, 0.0, start=0.0095),
        disc(0.0, 0.06, start=0.004, end=0.012, velocity=(0.0, -1.0)),
    ],
}


@pytest.mark.parametrize("law", [LAW, None], ids=["law", "bare"])
@pytest.mark.parametrize("contacts", MOVING.values(), ids=MOVING)
def test_a_frame_is_made_of_rows_that_are_each_solved_at_their_own_time(contacts, law):
    rows = simulator(*contacts, law=law)
    got, expected = rows.frame(0.0), one_by_one(rows, 0.0)
    np.testing.assert_allclose(got, expected, atol=ROUNDED)
    assert np.nanmax(np.abs(got - simulator(*contacts, law=law, row_period=0).frame(0.0))) > 0.1


@pytest.mark.parametrize("name", ["over electrodes", "begins and ends"])
def test_rows_of_an_anisotropic_torn_sheet(name):
    """Distances that count are those in stretched coordinates, with electrodes as ellipses
    there."""
    tear = Tear(((-0.09, 0.01), (0.02, 0.06)), 1e-4)
    uneven = Defects(sheet=SheetField(Anisotropy(1.5, 30.0), tears=(tear,)))
    contacts = MOVING[name]
    rows = simulator(*contacts, defects=uneven)
    got = rows.frame(0.0)
    np.testing.assert_allclose(got, one_by_one(rows, 0.0), atol=ROUNDED)
    assert np.nanmax(np.abs(got - simulator(*contacts).frame(0.0))) > 0.1


WARMING = Defects(sheet=SheetField(temperature=Temperature(rate=20.0)), switch_resistance=300.0)


@pytest.mark.parametrize("name", ["off the rim", "begins and ends"])
def test_rows_of_a_sheet_that_becomes_warm(name):
    contacts = MOVING[name]
    rows = simulator(*contacts, defects=WARMING)
    got = rows.frame(0.0)
    np.testing.assert_allclose(got, one_by_one(rows, 0.0), atol=ROUNDED)
    cold = replace(WARMING, sheet=SheetField())
    assert np.nanmax(np.abs(got - simulator(*contacts, defects=cold).frame(0.0))) > 0.01


@pytest.mark.parametrize("law", [LAW, None], ids=["law", "bare"])
def test_contacts_at_rest_on_a_sheet_that_becomes_warm(law):
    """Rows differ by the sheet alone; where only the switch tells its temperature, by that."""
    rest = disc(0.03, 0.02), disc(-0.05, -0.05)
    rows = simulator(*rest, law=law, defects=WARMING)
    got = rows.frame(0.0)
    np.testing.assert_allclose(got, one_by_one(rows, 0.0), atol=1e-4 * DRIVE)
    cold = replace(WARMING, sheet=SheetField())
    assert np.nanmax(np.abs(got - simulator(*rest, law=law, defects=cold).frame(0.0))) > 1e-3


@pytest.mark.parametrize("speed", [1e-3, 0.08])
def test_rows_of_slow_contacts_are_interpolated_to_half_a_millivolt(speed):
    for start in (-0.02, 0.033, 0.05):
        rows = simulator(disc(start, 0.03, velocity=(speed, speed)), disc(-0.05, -0.05))
        error = (rows.frame(0.1) - one_by_one(rows, 0.1))[OFF]
        assert np.abs(error).max() < 5e-4 and np.sqrt(np.mean(error**2)) < 2e-5


def test_a_touch_begins_and_ends_between_two_rows():
    pressed, free = simulator(disc(0.03, 0.02)).frame(0.0), np.where(OFF, 0.0, np.nan)
    begins = simulator(disc(0.03, 0.02, start=1.0055)).frame(1.0)
    np.testing.assert_array_equal(begins, np.concatenate([free[:6], pressed[6:]]))
    ends = simulator(disc(0.03, 0.02, end=1.0055)).frame(1.0)
    np.testing.assert_array_equal(ends, np.concatenate([pressed[:6], free[6:]]))


def test_any_order_of_electrodes():
    order = [9, 0, 3, 9, 15]
    contact = disc(-0.03, 0.02, velocity=(1.0, 0.0))
    scanned = simulator(contact, order=order)
    found = scanned.frame(0.0)
    assert found.shape == (5, 16) and scanned.grounded.tolist() == order
    assert np.argwhere(np.isnan(found)).tolist() == [[i, e] for i, e in enumerate(order)]
    np.testing.assert_allclose(found, one_by_one(scanned, 0.0), atol=ROUNDED)
    resting = simulator(disc(0.03, 0.02), order=order).frame(0.0)
    np.testing.assert_array_equal(resting, simulator(disc(0.03, 0.02)).frame(0.0)[order])


@pytest.mark.parametrize(
    "settings, complaint",
    [
        ({"row_period": -1e-3}, "row_period: -0.001"),
        ({"row_period": np.nan}, "row_period: nan"),
        ({"row_period": np.inf}, "row_period: inf"),
        ({"order": [0, 16]}, "order: electrode 16 does not exist"),
        ({"order": [-1]}, "order: electrode -1 does not exist"),
        ({"order": []}, r"order: \[\] is not a list of electrodes"),
        ({"order": [0.5]}, "order: .* is not a list of electrodes"),
    ],
)
def test_impossible_scans_are_refused(settings, complaint):
    with pytest.raises(InputError, match=complaint):
        simulator(disc(0.0, 0.0), **settings)
