"""Uneven, anisotropic, torn and warm sheets: against closed forms and the reference model."""

from dataclasses import replace

import numpy as np
import pytest
from contacts_support import DRIVE, disc, sensor

from tomotactile_ros.bench.reference import ReferenceSheet, reference_frame
from tomotactile_ros.layouts.layout import Layout, equal_grid, load_layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.scenes.sheet_field import (
    Anisotropy,
    Gradient,
    Patch,
    SheetField,
    SheetVariation,
    Tear,
    Temperature,
    conductance_of,
    resistance_of,
)
from tomotactile_ros.sheet.closed_form import ClosedFormSheet
from tomotactile_ros.sheet.contact_points import contact_points
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.sheet.voltages import frame
from tomotactile_ros.support.errors import InputError

GRID = equal_grid(4, 4, (0.1, 0.1), 0.0025, 1e4, inset=0.005)
H = 0.0025
OFF = ~np.eye(16, dtype=bool)


def simulated(field, place=(0.013, 0.021), layout=GRID, variation=None, t=0.0):
    defects = Defects(sheet=field, sheet_variation=variation)
    press = disc(*place, 0.005, pressure=2e4)
    return sensor(layout, press, noise=0.0, defects=defects, h=H, row_period=0.0).frame(t)


def rms(difference):
    return np.sqrt(np.nanmean(difference**2))


EVEN = simulated(SheetField())


@pytest.mark.parametrize("ratio, limit", [(1.5, 0.01), (1 / 3, 0.02)])
def test_anisotropy_is_the_closed_form_of_a_stretched_sheet(ratio, limit):
    """Isotropic where x is shortened and y lengthened; ellipses there, here discs of their mean
    semi-axis."""
    scale = np.array([ratio**-0.25, ratio**0.25])
    radius = scale.mean()
    outline = Outline.rectangle(*(0.1 * scale))
    stretched = Layout("s", outline, 1e4, radius * GRID.radius, GRID.positions * scale)
    place = np.array([0.013, 0.021])
    smaller = disc(*(place * scale), 0.005 * radius)
    # the same current through a disc of another area
    points = contact_points(
        ClosedFormSheet(stretched, ring=12), [(smaller.patches(24), 2 / radius**2)]
    )
    expected = frame(*points, DRIVE)
    found = simulated(SheetField(anisotropy=Anisotropy(ratio)), place)
    assert rms(found - expected) < limit < 0.2 * rms(found - EVEN)


def test_direction_of_anisotropy():
    """A sheet that is turned by 90 degrees with all that is on it."""
    place = np.array([0.013, 0.021])
    first = simulated(SheetField(anisotropy=Anisotropy(2.0, 20.0)), place)
    turned = place @ np.array([[0, 1], [-1, 0]])
    second = simulated(SheetField(anisotropy=Anisotropy(2.0, 110.0)), turned)
    grid = np.arange(16).reshape(4, 4)
    moved = np.rot90(grid, 3).ravel()  # electrode that comes to each place of the grid
    assert rms(second - first[np.ix_(moved, moved)]) < 1e-3


def test_cut_in_two_the_half_that_is_touched_is_a_sheet_of_its_own():
    field = SheetField(tears=(Tear(((0.0, -0.06), (0.0, 0.06)), 1e-4),))
    torn = simulated(field, (-0.028, 0.012))
    left = np.flatnonzero(GRID.positions[:, 0] < 0)
    right = np.setdiff1d(np.arange(16), left)
    # nothing flows to the other half: all of the touched one is at the drive voltage
    assert torn[np.ix_(right, left)].min() > 0.99 * DRIVE
    places = GRID.positions[left] + np.array([0.025, 0.0])
    half = Layout("half", Outline.rectangle(0.05, 0.1), 1e4, GRID.radius, places)
    alone = simulated(SheetField(), (-0.003, 0.012), half)
    assert rms(torn[np.ix_(left, left)] - alone) < 0.005 * DRIVE
    assert rms(EVEN[np.ix_(left, left)] - alone) > 0.05 * DRIVE


def test_lines_alone_change_nothing():
    """Elements that follow lines of an even sheet: as far as another mesh goes."""
    field = SheetField(tears=(Tear(((-0.02, 0.0), (0.03, 0.013)), 1e-4),))
    contact = disc(0.013, 0.021, 0.005).patches(6)
    found = [
        frame(*contact_points(FemSheet(GRID, h=H, lines=lines), [(contact, 2.0)]), DRIVE)
        for lines in ([], field.rims(H / 2))
    ]
    assert rms(found[0] - found[1]) < 0.003


@pytest.mark.parametrize(
    "field, variation",
    [
        (SheetField(gradient=Gradient(0.3, 40.0)), None),
        (SheetField(patches=(Patch(4.0, (0.008, 0.012), 0.012),)), None),
        (SheetField(patches=(Patch(0.25, points=((0, 0), (0.03, 0.0), (0.03, 0.03))),)), None),
        (SheetField(tears=(Tear(((-0.06, 0.0), (0.03, 0.0)), 1e-3),)), None),
        (SheetField(anisotropy=Anisotropy(1.5, 30.0)), SheetVariation(0.2, 0.03, 1)),
    ],
)
def test_against_the_reference_model(reference_model, field, variation):
    """As good as on an even sheet (5 mV), where the defect shifts readings by ten times as much."""
    lines = [(line, 1.5e-3) for line in field.rims()]
    sheet = ReferenceSheet(GRID, conductance_of(GRID, field, variation), h=0.003, lines=lines)
    expected = reference_frame(sheet.solve([(disc(0.013, 0.021, 0.005), 2.0)]), DRIVE)
    found = simulated(field, variation=variation)
    assert rms(found - expected) < 0.012
    assert rms(expected - EVEN) > 5 * rms(found - expected)


def test_fields_multiply():
    field = SheetField(gradient=Gradient(0.2, 90.0), patches=(Patch(3.0, (0.0, 0.0), 0.01),))
    where = np.array([[0.02, 0.05], [0.02, -0.05], [0.02, 0.0], [0.0, 0.0]])
    expected = 1e4 * np.array([1.2, 0.8, 1.0, 3.0])
    np.testing.assert_allclose(resistance_of(GRID, field)(where), expected)
    tensor = conductance_of(GRID, SheetField(anisotropy=Anisotropy(4.0, 90.0)))(where)[0]
    np.testing.assert_allclose(tensor, np.diag([0.5e-4, 2e-4]), atol=1e-12)
    assert resistance_of(GRID, SheetField()) is None is conductance_of(GRID, SheetField())


def test_temperature_is_another_sheet_resistance():
    sine = SheetField(temperature=Temperature(relative=0.1, period=40.0))
    warm = equal_grid(4, 4, (0.1, 0.1), 0.0025, 1.1e4, inset=0.005)
    expected = simulated(SheetField(), layout=warm)
    np.testing.assert_allclose(simulated(sine, t=10.0)[OFF], expected[OFF], rtol=1e-9)
    np.testing.assert_array_equal(simulated(sine, t=0.0), EVEN)
    rate = SheetField(temperature=Temperature(rate=np.log(1.1) / 5))
    np.testing.assert_allclose(simulated(rate, t=5.0)[OFF], expected[OFF], rtol=1e-9)


def test_a_sheet_that_was_made_otherwise_reads_as_one_whose_layout_has_it():
    drawn = load_layout("equal-4x4")

    def frame_of(layout, **made):
        press = disc(0.03, 0.02, force=2.0)
        return sensor(layout, press, defects=Defects(**made)).ideal_frame(0.0)

    outline = Outline.rectangle(0.21, 0.204)
    expected = frame_of(replace(drawn, outline=outline, radius=0.006))
    found = frame_of(drawn, outline=outline, electrode_radius=0.006)
    np.testing.assert_allclose(found, expected, atol=3e-4)  # elements are parts of the layout
    assert np.nanmax(np.abs(found - frame_of(drawn))) > 0.02
    hole = np.array([[-0.02, -0.02], [0.02, -0.02], [0.0, 0.02]])
    holed = frame_of(drawn, outline=Outline.rectangle(0.2, 0.2, [hole]))
    np.testing.assert_array_equal(frame_of(drawn, holes=(hole,)), holed)
    with pytest.raises(InputError, match=r"as it was made: holes\[0\]: does not lie wholly inside"):
        frame_of(drawn, holes=(3 * hole + 0.08,))
    with pytest.raises(InputError, match="equal-4x4 as it was made.*outside the outline"):
        frame_of(drawn, outline=Outline.rectangle(0.19, 0.2))
