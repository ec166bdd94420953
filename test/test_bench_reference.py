"""The reference model: converged, in agreement with the closed form, symmetric, any outline and
form."""

import os
import signal
import sys

import numpy as np
import pytest

from tomotactile_ros.bench.reference import Admittance, ReferenceSheet, disc, reference_frame
from tomotactile_ros.bench.reference_mesh import Ellipse
from tomotactile_ros.layouts.layout import Layout, equal_grid
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.layouts.region import Region
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.sheet.closed_form import ClosedFormSheet
from tomotactile_ros.sheet.contact_points import contact_points
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.sheet.voltages import frame
from tomotactile_ros.support.errors import InputError

pytestmark = pytest.mark.usefixtures("reference_model")

DRIVE = 3.3
GRID = equal_grid(3, 3, (0.1, 0.1), 0.0025, 1e4, inset=0.01)
PLACE = (0.013, 0.021)


def voltages(layout, contacts, **options):
    return reference_frame(ReferenceSheet(layout, **options).solve(contacts), DRIVE)


def rms(difference):
    return np.sqrt(np.nanmean(difference**2))


DISC = Contact("disc", center=PLACE, radius=0.005)
OVER_AN_ELECTRODE = Contact("disc", center=(0.003, 0.002), radius=0.006)
TURNED = Contact("rectangle", center=PLACE, size=(0.03, 0.01), angle=30)


@pytest.mark.parametrize(
    "contact, g", [(DISC, 2.0), (DISC, np.inf), (OVER_AN_ELECTRODE, 2.0), (TURNED, 1.0)]
)
def test_against_the_closed_form(contact, g):
    """A series against elements: nothing in common but the equation. 1 mV of 3.3 V."""
    closed = contact_points(ClosedFormSheet(GRID, ring=12), [(contact.patches(24), g)])
    difference = voltages(GRID, [(contact, g)]) - frame(*closed, DRIVE)
    assert rms(difference) < 1e-3


def test_halving_the_elements():
    """A disc of 5 mm that overlaps an electrode's rim: half a millivolt at most, and converging."""
    contact = [(disc((0.004, 0.004), 0.005), 2.0)]
    coarse, middle, fine = (voltages(GRID, contact, h=h) for h in (0.006, 0.003, 0.0015))
    assert rms(middle - fine) < 0.5e-3
    assert rms(middle - fine) < 0.4 * rms(coarse - middle)


def test_currents_balance_and_packing_keeps_them():
    axes = 0.01, 0.004
    contacts = [(disc(PLACE, 0.005), 2.0), (Ellipse((-0.02, 0.01), axes, 30.0), 0.5)]
    state = ReferenceSheet(GRID).solve(contacts)
    np.testing.assert_allclose(state.matrix.sum(axis=1), state.drive, rtol=1e-9)
    # all electrodes at V0: every contact is without current; all at 0 V: at most what its area
    # passes
    assert 0 < state.drive.sum() < np.pi * (2.0 * 0.005**2 + 0.5 * np.prod(axes))
    again = Admittance.unpack(state.packed.astype(np.float32))
    assert rms(reference_frame(again, DRIVE) - reference_frame(state, DRIVE)) < 1e-6


def test_a_poor_contact_over_the_whole_sheet_feeds_its_area():
    """All electrodes grounded, g -> 0: the current is g A."""
    g = 1e-9
    state = ReferenceSheet(GRID).solve([(Region([(-1, -1), (1, -1), (1, 1), (-1, 1)]), g)])
    assert state.drive.sum() == pytest.approx(g * 0.01, rel=1e-6)


def test_other_outlines_turn_with_their_contacts():
    """A ring of electrodes on a circle: turned by one electrode, readings move by one."""
    angle = 2 * np.pi * np.arange(6) / 6
    ring = 0.04 * np.column_stack([np.cos(angle), np.sin(angle)])
    layout = Layout("ring", Outline.circle(0.045), 1e4, 0.002, ring)
    turn = np.array([[np.cos(angle[1]), np.sin(angle[1])], [-np.sin(angle[1]), np.cos(angle[1])]])
    first = voltages(layout, [(disc((0.02, 0.005), 0.004), 1.0)])
    second = voltages(layout, [(disc(np.array([0.02, 0.005]) @ turn, 0.004), 1.0)])
    assert rms(np.roll(first, (1, 1), axis=(0, 1)) - second) < 0.5e-3


def test_rows_of_their_own_states_and_resistance_to_ground():
    states = [ReferenceSheet(GRID).solve([(disc((x, 0.02), 0.004), 1.0)]) for x in (0.0, 0.01)]
    rows = [states[row % 2] for row in range(9)]
    mixed = reference_frame(rows, DRIVE)
    for row, state in enumerate(rows):
        np.testing.assert_array_equal(mixed[row], reference_frame(state, DRIVE)[row])
    impedance = np.linalg.inv(states[0].matrix)
    behind = reference_frame(states[0], DRIVE, ground_resistance=150.0, grounded=[4])[0]
    expected = DRIVE * (1 - impedance[:, 4] / (impedance[4, 4] + 150.0))
    np.testing.assert_allclose(np.delete(behind, 4), np.delete(expected, 4))


def test_nothing_touches_and_a_bare_conductor_on_an_electrode_is_refused():
    assert (voltages(GRID, [])[~np.eye(9, dtype=bool)] == 0).all()
    with pytest.raises(InputError, match="a bare conductor touches an electrode"):
        ReferenceSheet(GRID).solve([(disc((0.0, 0.0), 0.005), np.inf)])


def test_the_process_still_survives_closed_pipes_and_ctrl_c():
    """Gmsh lets both end it, and the next write to a socket that the other side closed as well."""
    voltages(GRID, [(DISC, 2.0)])
    read, write = os.pipe()
    os.close(read)
    with pytest.raises(BrokenPipeError):
        os.write(write, b"x")
    os.close(write)
    with pytest.raises(KeyboardInterrupt):
        signal.raise_signal(signal.SIGINT)


@pytest.mark.parametrize("apart", [0.0, 0.003, 0.006, 0.008, 0.0105])
def test_a_simulated_disc_comes_over_an_electrode_as_a_real_one_does(apart):
    """Five coarse patches to its width: each feeds the electrode with what of it lies on it, the sheet with the rest."""
    contact = Contact("disc", center=(0.8 * apart, 0.6 * apart), radius=0.008)
    coarse = contact_points(FemSheet(GRID, h=0.00125), [(contact.patches(5), 2.0)])
    assert rms(voltages(GRID, [(contact, 2.0)]) - frame(*coarse, DRIVE)) < 3.5e-3


@pytest.mark.parametrize("missing", ["gmsh", "skfem"])
def test_what_it_needs_is_named_at_once(monkeypatch, missing):
    monkeypatch.setitem(sys.modules, missing, None)
    with pytest.raises(InputError, match="install gmsh scikit-fem"):
        voltages(GRID, [(disc(PLACE, 0.005), 1.0)])
