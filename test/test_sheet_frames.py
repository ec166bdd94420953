"""Frames and sensitivities: against other solutions, physics, and at the extremes."""

import warnings

import numpy as np
import pytest
from contacts_support import disc
from hypothesis import given
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
OFF = ~np.eye(16, dtype=bool)


@pytest.fixture(scope="module")
def layout():
    return equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)


@pytest.fixture(scope="module", params=MODELS)
def sheet(request, layout):
    return make_sheet(layout, request.param)


def press(sheet, *contacts, **settings):
    """Frame of contacts (Contact, conductance in S/m^2)."""
    return frame(*contact_points(sheet, [(c.patches(), g) for c, g in contacts]), DRIVE, **settings)


def test_the_models_agree(layout):
    models = [make_sheet(layout, model) for model in ("closed_form", "fem")]
    for contacts in (
        [(disc(0.03, 0.04, 0.005), 2.0)],
        [(disc(0.03, 0.04, 0.005), 2.0), (disc(-0.02, 0.0, 0.01), 5.0)],
        [(disc(0.0, 0.0, 0.005), np.inf)],
        [(Contact("rectangle", center=(-0.03, 0.02), size=(0.05, 0.02), angle=30), 1.0)],
    ):
        first, second = (press(sheet, *contacts) for sheet in models)
        assert np.nanmax(np.abs(first - second)) < 0.012 * DRIVE


def test_both_limits_of_the_contact_conductance_are_reached_continuously(sheet):
    bare = press(sheet, (disc(0.03, 0.04, 0.005), np.inf))
    nearly = press(sheet, (disc(0.03, 0.04, 0.005), 1e12))
    assert np.nanmax(np.abs(bare - nearly)) < 1e-5 * DRIVE
    weak, weaker = (press(sheet, (disc(0.03, 0.04, 0.005), g)) for g in (1e-6, 1e-7))
    assert np.nanmax(np.abs(weak - 10 * weaker)) < 1e-5 * np.nanmax(weak)


def test_a_contact_on_an_electrode_holds_it_at_its_own_potential(sheet, layout):
    x, y = layout.positions[5]
    voltages = press(sheet, (disc(x, y, 0.002), np.inf))
    others = np.arange(16) != 5
    np.testing.assert_allclose(voltages[others, 5], DRIVE, rtol=1e-9)
    np.testing.assert_array_equal(voltages[5, others], 0.0)  # a short circuit: ground wins


INSIDE, RIM = (0.03, 0.04), [(0.1, 0.0), (0.1, 0.1), (-0.1, 0.03), (0.0999, -0.0999)]
PLACES = [
    *((INSIDE, 0.005, g) for g in (1e-3, 2.0, 1e3, np.inf)),
    *((where, 0.012, g) for where in RIM for g in (1e-6, 2.0, np.inf)),
]


@pytest.mark.parametrize("where, radius, conductance", PLACES)
def test_maximum_principle(sheet, where, radius, conductance):
    beside = [(disc(-0.05, 0.0, 0.005), 5.0)] if where == INSIDE else []
    voltages = press(sheet, (disc(*where, radius), conductance), *beside)[OFF]
    # charges on the rims of the sheet and of the contact show each other
    over = 1e-3 if sheet.model == "closed_form" and where != INSIDE else 1e-10
    assert np.isfinite(voltages).all()
    assert voltages.min() >= -1e-10 and voltages.max() <= DRIVE * (1 + over)


def sensitivity(sheet, grounded=None):
    random = np.random.default_rng(5)
    return Sensitivity(sheet.transfer((random.random((90, 2)) - 0.5) * 0.2, 0.001), grounded)


@pytest.mark.parametrize("grounded", [None, [3, 0, 9, 9]])
def test_sensitivity_and_its_adjoint(sheet, grounded):
    operator = sensitivity(sheet, grounded)
    random = np.random.default_rng(6)
    potential = random.standard_normal(operator.shape[1])
    voltages = random.standard_normal((len(operator.grounded), 16))
    voltages[np.arange(len(voltages)), operator.grounded] = 0.0
    seen = operator.forward(potential)
    there, back = (seen * voltages).sum(), operator.adjoint(voltages) @ potential
    size = np.linalg.norm(seen) * np.linalg.norm(voltages)
    assert abs(there - back) < 1e-12 * size
    np.testing.assert_allclose(operator.dense() @ potential, seen.ravel(), atol=1e-11)


def test_sensitivity_is_the_reading_of_one_bare_contact_at_one_volt(sheet):
    operator = sensitivity(sheet)
    for k in (0, 17, 50):
        reading = frame(operator.transfer.at([k]), [0.0], 1.0)
        seen = operator.forward(np.eye(operator.shape[1])[k])
        np.testing.assert_allclose(seen[OFF], reading[OFF], atol=1e-9)


def check(voltages, over=2e-3):
    off = ~np.eye(len(voltages), dtype=bool)
    assert np.isnan(np.diagonal(voltages)).all()
    assert np.isfinite(voltages[off]).all()
    assert voltages[off].min() >= -over * DRIVE and voltages[off].max() <= (1 + over) * DRIVE


@pytest.fixture(scope="module")
def fine_sheets():
    layout = equal_grid(4, 4, (0.2, 0.2), 0.004, 1.0)
    return {model: make_sheet(layout, model, h=0.0025) for model in MODELS}


def finely(sheet, *contacts):
    return frame(*contact_points(sheet, [(c.patches(16), g) for c, g in contacts]), DRIVE)


conductances = st.one_of(
    st.just(0.0), st.just(np.inf), st.floats(-12, 12).map(lambda power: 10.0**power)
)
places = st.tuples(st.floats(-0.11, 0.11), st.floats(-0.11, 0.11))
discs = st.builds(lambda at, r: Contact("disc", center=at, radius=r), places, st.floats(1e-5, 0.09))


@given(
    model=st.sampled_from(MODELS),
    contacts=st.lists(st.tuples(discs, conductances), min_size=1, max_size=4),
)
def test_any_contacts(fine_sheets, model, contacts):
    """Between ground and drive; up to 5 % over where a bare edge runs along an electrode."""
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        warnings.simplefilter("ignore", Doubt)  # of a sheet resistance of 1 ohm/sq
        check(finely(fine_sheets[model], *contacts), over=0.05)


@pytest.mark.parametrize("model", MODELS)
def test_what_conducts_nothing_changes_nothing(fine_sheets, model):
    """Its patches stood for smaller ones of the other contact, and readings were 5.3 % over the drive."""
    idle = Contact("disc", center=(-0.0390625, -0.0390625), radius=0.0234375)
    bare = Contact("disc", center=(-0.03966631229076803, -0.03125), radius=0.015625)
    both = finely(fine_sheets[model], (idle, 0.0), (bare, np.inf))
    np.testing.assert_allclose(both, finely(fine_sheets[model], (bare, np.inf)), rtol=1e-12)


def of_size(size):
    short = min(size)
    layout = equal_grid(2, 2, size, short / 20, 1e4, inset=short / 8, unusual_size=True)
    return layout, (0.0, 0.1 * short), short / 15


def nearly_touching(gap):
    places = [[-0.005 - gap / 2, 0.0], [0.005 + gap / 2, 0.0], [0.0, 0.05]]
    return Layout("near", Outline.rectangle(0.2, 0.2), 1.0, 0.005, places), (0.04, 0.0), 0.005


def at_the_rim(offset):
    places = [[-0.1 + offset, 0.02], [0.05, 0.1 - offset], [0.05, -0.05]]
    return Layout("rim", Outline.rectangle(0.2, 0.2), 1.0, 0.005, places), (-0.02, 0.0), 0.005


EXTREMES = [
    *(
        (of_size, size)
        for size in ((1e-3, 1e-3), (10.0, 10.0), (1.0, 0.01), (0.01, 1.0), (1.0, 0.05))
    ),
    *((nearly_touching, gap) for gap in (1e-9, 1e-6, 1e-4)),
    *((at_the_rim, offset) for offset in (0.0, 1e-9, 1e-4, 0.003, 0.0049, 0.005, 0.0051)),
]


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("make, how", EXTREMES)
def test_layouts_at_the_extremes(model, make, how):
    layout, place, radius = make(how)
    voltages = finely(make_sheet(layout, model), (disc(*place, radius), np.inf))
    check(voltages)
    if make is nearly_touching:  # beside the grounded electrode it is near 0 V
        assert voltages[0, 1] < 0.5 * voltages[0, 2]


def test_sensitivities_stay_finite_on_electrodes_and_rims(layout):
    points = np.concatenate([layout.positions, layout.positions + 0.00501])
    points = points[layout.outline.contains(points)]
    dense = Sensitivity(make_sheet(layout, "closed_form").transfer(points, 1e-3)).dense()
    assert np.isfinite(dense).all() and np.abs(dense).max() <= 1.01


def test_elements_larger_than_the_teeth_of_a_comb_follow_them():
    comb = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1]]
    for x in np.linspace(0.08, -0.08, 9):
        comb += [[x, 0.1], [x, -0.09], [x - 0.004, -0.09], [x - 0.004, 0.1]]
    comb += [[-0.1, 0.1]]
    layout = Layout("comb", Outline.polygon(comb), 1.0, 0.002, [[-0.09, -0.095], [0.09, -0.095]])
    found = []
    for h in (0.05, 0.01):
        sheet = make_sheet(layout, h=h)
        corners = sheet.mesh.points[sheet.mesh.triangles]
        assert layout.outline.contains(corners.mean(axis=1)).all()
        found.append(np.ptp(sheet.electrode_electrode))
    assert found[0] == pytest.approx(found[1], rel=0.05)  # of elements 12 times a tooth
