"""The sheet at the extremes: finite, silent and within physical bounds, or a clear refusal."""

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from tomotactile_ros.layouts.layout import Layout, equal_grid
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.contact_points import contact_points
from tomotactile_ros.sheet.sensitivity import Sensitivity
from tomotactile_ros.sheet.voltages import frame
from tomotactile_ros.support.errors import Doubt

DRIVE = 3.3
MODELS = ("closed_form", "fem")
_SHEETS = {}


def sheet_of(model, rows=4, resistance=1.0):
    """Models are built once; the sheet resistance scales them exactly (tested elsewhere)."""
    key = model, rows, resistance
    if key not in _SHEETS:
        layout = equal_grid(rows, rows, (0.2, 0.2), 0.004, resistance)
        _SHEETS[key] = make_sheet(layout, model, h=0.0025)
    return _SHEETS[key]


def press(sheet, contacts):
    return frame(*contact_points(sheet, [(c.patches(16), g) for c, g in contacts]), DRIVE)


def check(voltages, over=2e-3):
    off = ~np.eye(len(voltages), dtype=bool)
    assert np.isnan(np.diagonal(voltages)).all()
    assert np.isfinite(voltages[off]).all()
    assert voltages[off].min() >= -over * DRIVE and voltages[off].max() <= (1 + over) * DRIVE


conductances = st.one_of(
    st.just(0.0), st.just(np.inf), st.floats(-12, 12).map(lambda power: 10.0**power)
)
places = st.tuples(st.floats(-0.11, 0.11), st.floats(-0.11, 0.11))
discs = st.builds(lambda at, r: Contact("disc", center=at, radius=r), places, st.floats(1e-5, 0.09))


@settings(max_examples=20, deadline=None)
@given(st.sampled_from(MODELS), st.lists(st.tuples(discs, conductances), min_size=1, max_size=4))
def test_any_contacts(model, contacts):
    """Between ground and drive; up to 5 % over where a bare edge runs along an electrode."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", Doubt)  # of a sheet resistance of 1 ohm/sq
        check(press(sheet_of(model), contacts), over=0.05)


@pytest.mark.parametrize("model", MODELS)
def test_what_conducts_nothing_changes_nothing(model):
    """Its patches stood for smaller ones of the other contact, and readings were 5.3 % over the drive."""
    idle = Contact("disc", center=(-0.0390625, -0.0390625), radius=0.0234375)
    bare = Contact("disc", center=(-0.03966631229076803, -0.03125), radius=0.015625)
    both = press(sheet_of(model), [(idle, 0.0), (bare, np.inf)])
    np.testing.assert_allclose(both, press(sheet_of(model), [(bare, np.inf)]), rtol=1e-12)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize(
    "size", [(1e-3, 1e-3), (10.0, 10.0), (1.0, 0.01), (0.01, 1.0), (1.0, 0.05)], ids=str
)
def test_sizes_and_aspect_ratios(model, size):
    short = min(size)
    layout = equal_grid(2, 2, size, short / 20, 1e4, inset=short / 8, unusual_size=True)
    contact = Contact("disc", center=(0.0, 0.1 * short), radius=short / 15)
    check(press(make_sheet(layout, model), [(contact, np.inf)]))


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("gap", [1e-9, 1e-6, 1e-4])
def test_electrodes_that_nearly_touch(model, gap):
    positions = np.array([[-0.005 - gap / 2, 0.0], [0.005 + gap / 2, 0.0], [0.0, 0.05]])
    layout = Layout("near", Outline.rectangle(0.2, 0.2), 1.0, 0.005, positions)
    voltages = press(
        make_sheet(layout, model), [(Contact("disc", center=(0.04, 0.0), radius=0.005), np.inf)]
    )
    check(voltages)
    assert voltages[0, 1] < 0.5 * voltages[0, 2]  # beside the grounded electrode it is near 0 V


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("offset", [0.0, 1e-9, 1e-4, 0.003, 0.0049, 0.005, 0.0051])
def test_electrodes_at_every_distance_from_the_rim(model, offset):
    positions = np.array([[-0.1 + offset, 0.02], [0.05, 0.1 - offset], [0.05, -0.05]])
    layout = Layout("rim", Outline.rectangle(0.2, 0.2), 1.0, 0.005, positions)
    contact = Contact("disc", center=(-0.02, 0.0), radius=0.005)
    check(press(make_sheet(layout, model), [(contact, np.inf)]))


def test_single_precision_is_enough_for_frames():
    """Green functions rounded to float32 move no reading by more than 50 uV."""
    transfer = sheet_of("closed_form", 8).transfer([[0.03, 0.04], [-0.05, 0.0]], 0.003)
    rounded = transfer.at([0, 1])
    for name in ("electrode_electrode", "electrode_point", "point_self"):
        single = getattr(transfer, name).astype(np.float32).astype(float)
        object.__setattr__(rounded, name, single)
    first, second = (frame(one, [0.5, 0.0], DRIVE) for one in (transfer, rounded))
    assert 0 < np.nanmax(np.abs(first - second)) < 5e-5


def test_sensitivities_stay_finite_on_electrodes_and_rims():
    sheet = sheet_of("closed_form", 4)
    points = np.concatenate(
        [sheet.layout.positions, sheet.layout.positions + 0.00401, [[0.1, 0.1]]]
    )
    inside = sheet.layout.outline.contains(points)
    operator = Sensitivity(sheet.transfer(points[inside], 1e-3))
    assert np.isfinite(operator.dense()).all()
    assert np.abs(operator.dense()).max() <= 1.01


def test_elements_larger_than_the_teeth_of_a_comb_follow_them():
    comb = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1]]
    for x in np.linspace(0.08, -0.08, 9):
        comb += [[x, 0.1], [x, -0.09], [x - 0.004, -0.09], [x - 0.004, 0.1]]
    comb += [[-0.1, 0.1]]
    layout = Layout(
        "comb", Outline.polygon(comb), 1.0, 0.002, np.array([[-0.09, -0.095], [0.09, -0.095]])
    )
    found = []
    for h in (0.05, 0.01):
        sheet = make_sheet(layout, h=h)
        corners = sheet.mesh.points[sheet.mesh.triangles]
        assert layout.outline.contains(corners.mean(axis=1)).all()
        found.append(np.ptp(sheet.electrode_electrode))
    assert found[0] == pytest.approx(found[1], rel=0.05)  # of elements 12 times a tooth
