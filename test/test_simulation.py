"""Frames of scenes: repeatable, defects do what they say, every row is of its own moment."""

from dataclasses import replace

import contacts_support
import numpy as np
import pytest

from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.contact_law import Creep, Hysteresis
from tomotactile_ros.scenes.course import Tap
from tomotactile_ros.scenes.defects import Adc, Defects, Drift, Hum, Noise, SheetVariation
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.scenes.sheet_field import (
    Anisotropy,
    SheetField,
    Tear,
    Temperature,
    random_sheet,
)
from tomotactile_ros.sheet.contact_points import contact_points
from tomotactile_ros.sheet.voltages import frame
from tomotactile_ros.simulation import ROW_PERIOD, Simulator, convert
from tomotactile_ros.support.errors import InputError

DRIVE = 3.3
ROUNDED = 1e-5  # V, of 3.3 V in single precision, in which contacts that move are solved
LAYOUT = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
LAW = ContactLaw(1e-4, 1.0)
OFF = ~np.eye(16, dtype=bool)


def disc(x, y, radius=0.006, **times):
    return contacts_support.disc(x, y, radius, pressure=2e4, **times)


CONTACT = disc(0.03, 0.02)


def simulator(
    *contacts, model="closed_form", law=LAW, row_period=ROW_PERIOD, order=None, **settings
):
    scene = Scene("test", DRIVE, contacts or (CONTACT,), contact_law=law, **settings)
    return Simulator(LAYOUT, scene, model, row_period=row_period, order=order)


IDEAL = simulator().frame(0.0)


def test_the_data_come_from_finite_elements_unless_asked_otherwise():
    scene = Scene("test", DRIVE, (CONTACT,), contact_law=LAW)
    assert Simulator(LAYOUT, scene).model == "fem"
    assert Simulator(LAYOUT, scene, "auto").model == "closed_form"
    with pytest.raises(InputError, match="none of"):
        Simulator(LAYOUT, scene, "guess")


def test_same_scene_seed_and_sequence_same_frame():
    first, second = (simulator(noise=Noise(0.001, seed=7)) for _ in range(2))
    np.testing.assert_array_equal(first.frame(0.5, 3), second.frame(0.5, 3))
    assert np.abs(first.frame(0.5, 3) - first.frame(0.5, 4))[OFF].max() > 1e-4


def test_noise_has_the_named_size():
    noisy = simulator(noise=Noise(0.01))
    error = np.array([noisy.frame(0.0, n) - IDEAL for n in range(40)])[:, OFF]
    assert error.std() == pytest.approx(0.01, rel=0.03)
    assert abs(error.mean()) < 0.001


@pytest.mark.parametrize("bits", [1, 4, 12, 24, 32])
def test_conversion(bits):
    values = np.linspace(-0.5, 4.0, 1001)
    codes = convert(values, bits, 3.3) / (3.3 / 2**bits)
    np.testing.assert_allclose(codes, np.round(codes), atol=1e-6)
    assert codes.min() == 0 and codes.max() == pytest.approx(2**bits - 1)
    within = (values >= 0) & (values <= 3.3 * (1 - 2.0**-bits))
    assert np.abs(convert(values, bits, 3.3) - values)[within].max() <= 0.5001 * 3.3 / 2**bits
    frame = simulator(adc=Adc(bits, 3.3)).frame(0.0)
    np.testing.assert_allclose(frame[OFF], convert(IDEAL, bits, 3.3)[OFF])


def test_dead_electrodes_have_no_reading():
    frame = simulator(defects=Defects(dead=(5, 9))).frame(0.0)
    assert np.isnan(frame[:, [5, 9]]).all()
    alive = OFF & ~np.isin(np.arange(16), [5, 9])
    np.testing.assert_array_equal(frame[alive], IDEAL[alive])


def test_swapped_wires_swap_reading_and_grounding():
    frame = simulator(defects=Defects(swapped=((2, 7),))).frame(0.0)
    order = np.arange(16)
    order[[2, 7]] = 7, 2
    np.testing.assert_array_equal(frame, IDEAL[np.ix_(order, order)])


def test_hum_follows_the_rows_and_drift_the_electrodes():
    hum = (simulator(defects=Defects(hum=Hum(0.02, 50.0))).frame(0.1) - IDEAL)[OFF]
    assert 0.015 < hum.max() <= 0.02 + 1e-12
    drifting = simulator(defects=Defects(drift=Drift(0.05, 100.0, seed=1)))
    offset = drifting.frame(0.0) - IDEAL
    assert np.nanmax(np.nanstd(offset, axis=0)) < 1e-3 < np.nanstd(np.nanmean(offset, axis=0))
    np.testing.assert_allclose(drifting.frame(100.0)[OFF], drifting.frame(0.0)[OFF], atol=1e-9)


def test_variation_of_the_sheet():
    field = SheetVariation(0.2, 0.05, seed=3)
    where = np.random.default_rng(0).random((20000, 2)) * 20
    values = 1e4 * random_sheet(field)(where)
    assert values.min() > 0
    assert values.mean() == pytest.approx(1e4, rel=0.03)
    assert values.std() / values.mean() == pytest.approx(0.2, rel=0.1)
    near = 1e4 * random_sheet(field)(where + [0.05, 0.0])
    logs = np.log(values), np.log(near)
    assert np.corrcoef(*logs)[0, 1] == pytest.approx(np.exp(-0.5), abs=0.05)
    uneven = simulator(model="fem", defects=Defects(sheet_variation=field)).frame(0.0)
    even = simulator(model="fem").frame(0.0)
    assert 0.01 < np.abs(uneven - even)[OFF].max() < 1.0
    with pytest.raises(InputError, match="uniform"):
        simulator(defects=Defects(sheet_variation=field))


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


BENT = Tear(((-0.09, 0.01), (0.02, 0.06)), 1e-4)
# distances that count are those in stretched coordinates, with electrodes as ellipses there
TORN = Defects(sheet=SheetField(Anisotropy(1.5, 30.0), tears=(BENT,)))
WARMING = Defects(sheet=SheetField(temperature=Temperature(rate=20.0)), switch_resistance=300.0)
EVEN, COLD = {"defects": Defects()}, {"defects": replace(WARMING, sheet=SheetField())}
REST = [CONTACT, disc(-0.05, -0.05)]
AT_ONCE = {"row_period": 0}
CASES = [
    *((each, law, "fem", {}, AT_ONCE, ROUNDED, 0.1) for each in MOVING for law in (LAW, None)),
    ("through each other", LAW, "closed_form", {}, AT_ONCE, ROUNDED, 0.1),
    ("over electrodes", LAW, "fem", {"defects": TORN}, EVEN, ROUNDED, 0.1),
    ("begins and ends", LAW, "fem", {"defects": TORN}, EVEN, ROUNDED, 0.1),
    ("off the rim", LAW, "fem", {"defects": WARMING}, COLD, ROUNDED, 0.01),
    ("begins and ends", LAW, "fem", {"defects": WARMING}, COLD, ROUNDED, 0.01),
    # rows differ by the sheet alone; where only the switch tells its temperature, by that
    ("rest", LAW, "fem", {"defects": WARMING}, COLD, 1e-4 * DRIVE, 1e-3),
    ("rest", None, "fem", {"defects": WARMING}, COLD, 1e-4 * DRIVE, 1e-3),
]


@pytest.mark.parametrize("name, law, model, settings, otherwise, exactly, apart", CASES)
def test_a_frame_is_made_of_rows_that_are_each_solved_at_their_own_time(
    name, law, model, settings, otherwise, exactly, apart
):
    contacts = MOVING.get(name, REST)
    rows = simulator(*contacts, law=law, model=model, **settings)
    got = rows.frame(0.0)
    np.testing.assert_allclose(got, one_by_one(rows, 0.0), atol=exactly)
    other = simulator(*contacts, law=law, model=model, **(settings | otherwise)).frame(0.0)
    assert np.nanmax(np.abs(got - other)) > apart


WAY = {"path": [[0.03, 0.03], [0.03, -0.06]], "speed": 2.0}
BALL = {"profile": "hertz", "course": Tap(0.03), **WAY}
MEMORY = ContactLaw(1e-4, 1.0, Hysteresis(0.2), Creep(0.1, (0.01,)))


@pytest.mark.parametrize(
    "what, law, exactly",
    [
        (BALL, MEMORY, 1e-9),
        ({}, MEMORY, ROUNDED),
        ({"course": Tap(0.03)}, LAW, ROUNDED),
        (WAY, LAW, ROUNDED),
    ],
    ids=["ball", "memory alone", "tap alone", "way alone"],
)
def test_rows_of_what_presses_in_time_are_those_of_frozen_sheets(what, law, exactly):
    contact = Contact("disc", (-0.03, 0.01), radius=0.006, force=2.0, **what)
    frozen = simulator(contact, model="fem", law=law, row_period=0.0)
    expected = np.array([frozen.frame(0.01 + 1e-3 * row)[row] for row in range(16)])
    assert np.nanmax(np.abs(expected - frozen.frame(0.01))) > 1e-4
    rows = simulator(contact, model="fem", law=law).frame(0.01)
    np.testing.assert_allclose(rows, expected, atol=exactly)


@pytest.mark.parametrize("speed", [1e-3, 0.08])
def test_rows_of_slow_contacts_are_interpolated_to_half_a_millivolt(speed):
    for start in (-0.02, 0.033, 0.05):
        rows = simulator(
            disc(start, 0.03, velocity=(speed, speed)), disc(-0.05, -0.05), model="fem"
        )
        error = (rows.frame(0.1) - one_by_one(rows, 0.1))[OFF]
        assert np.abs(error).max() < 5e-4 and np.sqrt(np.mean(error**2)) < 2e-5


def test_any_order_of_electrodes():
    order = [9, 0, 3, 9, 15]
    contact = disc(-0.03, 0.02, velocity=(1.0, 0.0))
    scanned = simulator(contact, order=order, model="fem")
    found = scanned.frame(0.0)
    assert found.shape == (5, 16) and scanned.grounded.tolist() == order
    assert np.argwhere(np.isnan(found)).tolist() == [[i, e] for i, e in enumerate(order)]
    np.testing.assert_allclose(found, one_by_one(scanned, 0.0), atol=ROUNDED)
    resting = simulator(disc(0.03, 0.02), order=order, model="fem").frame(0.0)
    np.testing.assert_array_equal(
        resting, simulator(disc(0.03, 0.02), model="fem").frame(0.0)[order]
    )


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
