"""The estimator's forward model, its derivatives, its solver and how sure it is of what it says."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.linalg import block_diag
from scipy.stats import chi2

from tomotactile_ros.estimation.arrangement import resting
from tomotactile_ros.estimation.channels import ChannelPrior
from tomotactile_ros.estimation.equations import Linear
from tomotactile_ros.estimation.estimator import Estimator, State
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import Prediction, Unknowns
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.solver import solve
from tomotactile_ros.estimation.tables import Around, mirrored
from tomotactile_ros.estimation.touch import (
    CONDUCTANCE,
    Touches,
    conductance,
    patches_for,
    patches_of,
)
from tomotactile_ros.layouts.layout import equal_grid, load_layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.reconstruction.grounded import GroundedSheet
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.scenes.sheet_field import Anisotropy, Gradient, SheetField, resistance_of
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.simulation import Simulator

E, DRIVE = 16, 3.3
LAYOUT = equal_grid(4, 4, (0.2, 0.2), 0.0025, 1e4)
OPERATOR = SheetOperator(LAYOUT)
ALL = np.arange(E)
OFF = ~np.eye(E, dtype=bool)
LAW = ContactLaw(1e-4, 1.0)
DISC = np.array([[True] * 4 + [False] * 2])


def contact(x, y, radius=0.005, pressure=2e4, operator=OPERATOR):
    """(6,) parameters of a disc that presses, and its number of patches."""
    across = patches_for(radius, operator.pitch)
    form = np.array([x, y, 0.0, np.log(radius), 0.0, 0.0])
    touch = Touches(operator, form[None], [across], np.zeros(operator.modes))
    g = float(LAW.conductance(pressure)) * np.pi * radius**2
    form[2] = -np.log(1 / g + touch.mean[0])
    return form, across


def bar(x, y, length, width, direction, pressure=2e4):
    """The same of a rectangle, its sides in m; `direction` of its length, degrees from x."""
    long, angle = np.log(length / width) / 2, np.radians(2 * direction)
    form = [np.log(np.sqrt(length * width / np.pi)), long * np.cos(angle), long * np.sin(angle)]
    g = float(LAW.conductance(pressure)) * length * width
    form = np.array([x, y, np.log(g / 2), *form])
    across = patches_of(form, OPERATOR.pitch)
    assert across < 0
    return form, across


def pressed(*contacts, free=None, operator=OPERATOR):
    forms, across = zip(*contacts)
    forms = np.array(forms)
    free = np.ones(forms.shape, bool) if free is None else free
    return Unknowns.at_rest(operator).with_contacts(forms, across, free)


def imperfect(unknowns, seed=1):
    """The same on an uneven sheet, with channels that are all off."""
    random = np.random.default_rng(seed)
    return replace(
        unknowns,
        sheet=0.5 * OPERATOR.deviation * random.standard_normal(OPERATOR.modes),
        gain=1 + 0.02 * random.standard_normal(E),
        offset=1e-3 * random.standard_normal(E),
        resistance=200 * random.random(E),
    )


def readings(unknowns, operator=OPERATOR):
    return Prediction(operator, unknowns, np.arange(operator.count)).readings


def difference(unknowns, name, index, step):
    """(E, E) central difference of the readings by one number."""
    sides = []
    for sign in (1, -1):
        values = getattr(unknowns, name).copy()
        values[index] += sign * step
        sides.append(readings(replace(unknowns, **{name: values})))
    return (sides[0] - sides[1]) / (2 * step)


def prior(operator=OPERATOR, **channels):
    return Prior.unknown(operator, ChannelPrior(**channels), 0.005, DRIVE)


def rows_of(voltages, noise=3e-4):
    weights = np.where(np.isnan(voltages), 0.0, (DRIVE / noise) ** 2)
    np.fill_diagonal(weights, 0.0)
    return Rows(np.nan_to_num(voltages) / DRIVE, weights, np.arange(len(voltages)))


APART = pressed(contact(0.031, 0.02, 0.006), contact(-0.052, -0.04, 0.012, 5e3))
PLACES = {
    "between": APART,
    "weak": pressed(contact(0.03, 0.02, 0.004, 5e2)),
    "hard": pressed(contact(0.01, -0.02, 0.008, 2e5)),
    "across an electrode's rim": pressed(contact(-0.0655, 0.0333, 0.004)),
    "near each other": pressed(contact(0.03, 0.02, 0.005), contact(0.045, 0.02, 0.005)),
    "across the sheet's rim": pressed(contact(0.097, 0.02, 0.005)),
    "beside a stronger one": pressed(
        contact(0.031, 0.02, 0.008, 3e4), contact(0.051, 0.031, 0.004)
    ),
    "a bar across electrodes": pressed(bar(0.01, 0.02, 0.09, 0.006, 33.0)),
    "over an electrode": pressed(contact(*OPERATOR.layout.positions[9], 0.008, 2e4)),
}


@pytest.mark.parametrize("where", PLACES)
def test_derivatives_by_contacts(where):
    """As central differences say, but for what the conductance of an uneven sheet changes with the
    place of a contact (0.4 %)."""
    unknowns = imperfect(PLACES[where])
    found = iter(Prediction(OPERATOR, unknowns, ALL).contact_columns())
    for i in range(len(unknowns.contacts)):
        steps = [2e-6, 2e-6, 1e-4, 1e-4, 1e-4, 1e-4]
        true = [difference(unknowns, "contacts", (i, j), step) for j, step in enumerate(steps)]
        for each, limit in zip(true, [0.006, 0.006, 1e-4, 1e-4, 1e-4, 1e-4], strict=True):
            assert np.abs(next(found) - each).max() < limit * np.abs(each).max()
        np.testing.assert_allclose(
            Prediction(OPERATOR, unknowns, ALL).contact_columns()[6 * i + 2], true[2], atol=1e-6
        )


def test_derivatives_by_a_bar_on_an_even_sheet():
    unknowns = pressed(bar(-0.02, 0.01, 0.06, 0.01, 95.0), contact(0.031, 0.02))
    found = iter(Prediction(OPERATOR, unknowns, ALL).contact_columns())
    for i, j in np.ndindex(unknowns.contacts.shape):
        true = difference(unknowns, "contacts", (i, j), 2e-6 if j < 2 else 1e-4)
        assert np.abs(next(found) - true).max() < 1e-5 * np.abs(true).max()


def test_a_bar_is_a_rectangle_with_its_sides_at_right_angles():
    form, across = bar(0.01, 0.02, 0.09, 0.006, 33.0)
    along = np.radians(33.0)
    axes = np.array([[np.cos(along), np.sin(along)], [-np.sin(along), np.cos(along)]])
    corners = SheetOperator(
        equal_grid(2, 2, (0.2, 0.2), 0.0025, 1e4)
    )  # no patch is on an electrode
    cut = Touches(corners, form[None], (across,), np.zeros(corners.modes))
    places = (cut.places - form[:2]) @ axes.T
    assert cut.weight.sum() == pytest.approx(1.0)
    assert places.mean(axis=0) == pytest.approx(0.0, abs=1e-12)
    for side, at in zip((0.09, 0.006), places.T, strict=True):
        steps = np.unique(at.round(9))
        assert np.ptp(steps) + np.diff(steps).max() == pytest.approx(side)


@pytest.mark.parametrize("where", PLACES)
def test_derivatives_by_the_sheet(where):
    unknowns = imperfect(PLACES[where])
    found = Prediction(OPERATOR, unknowns, ALL).sheet_columns()
    steps = 1e-3 * OPERATOR.deviation
    true = np.array([step * difference(unknowns, "sheet", j, step) for j, step in enumerate(steps)])
    assert np.abs(steps[:, None, None] * found - true).max() < 1e-6 * np.abs(true).max()


@pytest.mark.parametrize("layout", ["hex-37", "ring-16", "balanced-4x4"])
def test_derivatives_by_places_and_sizes_on_other_layouts(layout):
    operator = SheetOperator(load_layout(layout))
    first = operator.layout.positions[operator.layout.electrodes // 2]
    near = 0.45 * operator.pitch
    two = [[*(0.9 * first), near / 3], [*(0.9 * first + [-near, near / 2]), near / 4]]
    contacts = np.zeros((2, 6))
    for row, (x, y, radius) in zip(contacts, two, strict=True):
        row[:4] = x, y, np.log(1e-4), np.log(radius)
    flat = resting(operator, prior(operator))
    unknowns = flat.with_contacts(contacts, (5, 5), np.ones((2, 6), bool))
    found = iter(Prediction(operator, unknowns, np.arange(operator.count)).contact_columns())
    for i, j in np.ndindex(contacts.shape):
        sides = []
        for sign in (1, -1):
            moved = contacts.copy()
            moved[i, j] += sign * (1e-6 if j < 2 else 1e-5)
            sides.append(readings(replace(unknowns, contacts=moved), operator))
        true = (sides[0] - sides[1]) / (2e-6 if j < 2 else 2e-5)
        assert np.abs(next(found) - true).max() <= 1e-3 * np.abs(true).max()


@pytest.mark.parametrize("correlated", [False, True])
def test_a_step_is_that_of_all_unknowns_together(correlated):
    """Channels are eliminated (Schur complement); a dense system gives the same, however unequally
    they are known."""
    truth = imperfect(PLACES["between"])
    random = np.random.default_rng(2)
    noise = 1e-3
    rows = Rows(
        readings(truth) + noise * random.standard_normal((E, E)), np.full((E, E), noise**-2.0), ALL
    )
    rows.weights[~OFF] = 0.0
    rows.weights[3, 7:12] = 0.0
    here = replace(
        truth,
        gain=truth.gain + 1e-3 * random.standard_normal(E),
        offset=truth.offset + 1e-4 * random.standard_normal(E),
        resistance=truth.resistance + 300.0,
        free=np.array([[True, True, True, False, False, False]] * 2),
    )
    before = prior()
    unequal = [each * np.exp(random.uniform(-3, 0, E)) for each in before.deviations]
    before = replace(before, deviations=tuple(unequal), precision=None)
    marginal = np.concatenate([before.sheet_deviation, *before.deviations])
    expected = np.diag(marginal**-2.0)
    if correlated:
        root = np.eye(len(marginal)) + 0.05 * random.standard_normal(expected.shape)
        expected = root @ root.T / marginal[:, None] / marginal
        before = replace(before, precision=expected)
    fit = Fit(OPERATOR, here, rows, before)
    columns = [*fit.prediction.contact_columns(), *fit.prediction.sheet_columns()]
    of_contacts = np.array([1 / 0.2, 1 / 0.2, 0.1] * 2) ** 2.0
    off = [np.zeros(6), here.sheet]
    for name, step in (("gain", 1e-5), ("offset", 1e-5), ("resistance", 0.1)):
        columns += [difference(here, name, j, step) for j in range(E)]
        off.append(getattr(here, name) - getattr(before, name))
    columns += [difference(here, "aside", (i, j), 1e-6) for i in range(2) for j in range(E)]
    off.append((here.aside - before.aside).ravel())
    off = np.concatenate(off)
    inverse = block_diag(np.diag(of_contacts), expected)
    root = np.sqrt(rows.weights).ravel()
    design = np.array(columns).reshape(len(columns), -1) * root
    normal = design @ design.T + inverse
    right = design @ (root * fit.misfit.ravel()) - inverse @ off
    step = np.linalg.solve(normal, right)
    reached = Linear(fit).step(0.0)
    got = np.concatenate(
        [
            (reached.contacts - here.contacts)[:, :3].ravel(),
            *(
                (getattr(reached, n) - getattr(here, n)).ravel()
                for n in ("sheet", "gain", "offset", "resistance", "aside")
            ),
        ]
    )
    deviation = np.sqrt(np.linalg.inv(normal).diagonal())
    np.testing.assert_allclose(got / deviation, step / deviation, atol=1e-4)
    own = Linear(fit).covariance()
    np.testing.assert_allclose(np.sqrt(own.diagonal()), deviation[:6], rtol=2e-3)


@pytest.mark.parametrize("rows", [ALL, np.array([3, 9, 9, 0, 14])], ids=["in turn", "in any order"])
def test_the_dot_test_of_channels(rows):
    """What channels do to readings and its transpose are never formed: y . (S c) = (S^T y) . c."""
    random, weights = np.random.default_rng(3), np.random.default_rng(4).random((len(rows), E))
    truth = imperfect(PLACES["between"])
    seen = Prediction(OPERATOR, truth, rows).readings
    slopes = Fit(OPERATOR, truth, Rows(seen, weights, rows), prior()).slopes
    channels, others = random.standard_normal((2, slopes.kinds, E))
    gain, offset, resistance, *aside = channels
    forward = slopes.in_columns[0] * gain + slopes.in_columns[1] * offset
    forward += slopes.in_columns[2] * aside[0] + slopes.in_columns[3] * aside[1]
    for by_row, each in zip(slopes.in_rows, (resistance, *aside), strict=True):
        forward += by_row * each[rows][:, None]
    data = random.standard_normal((1, len(rows), E))
    transposed = slopes.couplings(data)[0]
    assert (data[0] * forward).sum() == pytest.approx(transposed @ channels.ravel(), rel=1e-10)
    both = slopes.couplings(weights[None] * forward)[0]
    normal = slopes.normal(weights) @ channels.ravel()
    assert both @ others.ravel() == pytest.approx(normal @ others.ravel(), rel=1e-10)


@pytest.mark.parametrize("kind", ["grid", "circle", "ring"])
def test_electrodes_that_lie_aside(kind):
    """To first order, against the same electrodes where they are: what contacts do not explain of
    0.1 mm falls to a tenth, in closed form and with finite elements; to a seventh beside a rim."""
    layout, shown = replace(LAYOUT, positions=0.9 * LAYOUT.positions), 0.1
    if kind == "circle":
        positions = 0.55 * LAYOUT.positions
        layout = replace(LAYOUT, positions=positions, outline=Outline.circle(0.1))
    elif kind == "ring":  # as near to the rim as electrodes with a whole rim can be
        shown = 0.15
        turn = 2 * np.pi / E * np.arange(E)
        positions = 0.096 * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        layout = replace(LAYOUT, positions=positions, outline=Outline.circle(0.1))
    random = np.random.default_rng(5)
    aside = 1e-4 * random.standard_normal((2, E))
    there = SheetOperator(replace(layout, positions=layout.positions + aside.T))
    here = SheetOperator(layout)
    resting = replace(APART, sheet=np.zeros(here.modes), resistance=100 * random.random(E))
    prediction = Prediction(here, resting, ALL)
    truth = Prediction(there, replace(resting, sheet=np.zeros(there.modes)), ALL).readings
    moved = replace(resting, aside=aside)
    contacts = prediction.columns(np.array([DISC[0]] * 2)).reshape(8, -1)[:, OFF.ravel()].T

    def left(found):
        off = (truth - found)[OFF]
        off -= contacts @ np.linalg.lstsq(contacts, off, rcond=None)[0]
        return np.sqrt((off**2).mean())

    assert left(readings(moved, here)) < shown * left(readings(resting, here))


def test_impedance_is_reciprocal_and_currents_balance():
    np.testing.assert_allclose(OPERATOR.admittance, OPERATOR.admittance.T, atol=1e-18)
    unknowns = imperfect(APART)
    for sheet in (np.zeros(OPERATOR.modes), unknowns.sheet):
        y0 = OPERATOR.admittance_of(sheet)
        np.testing.assert_allclose(y0.sum(axis=1), 0.0, atol=1e-12 * y0.max())
        np.testing.assert_allclose(y0, y0.T, atol=1e-12 * y0.max())
    np.testing.assert_allclose(
        OPERATOR.admittance_change(unknowns.sheet).sum(axis=2), 0.0, atol=1e-16
    )
    places = np.array([[0.01, 0.03], [0.09, -0.05], [-0.0333, 0.0333]])
    share, own = OPERATOR.points(places, np.full(3, 0.003))
    np.testing.assert_allclose(share.sum(axis=0), 1.0, atol=1e-9)
    assert (own >= 0).all()
    np.testing.assert_allclose(
        OPERATOR.share_added(unknowns.sheet, Around(OPERATOR.lattice, places)).sum(axis=0),
        0.0,
        atol=1e-9,
    )
    z = Prediction(OPERATOR, unknowns, ALL).impedance
    np.testing.assert_allclose(z, z.T, rtol=1e-12)
    ideal = replace(unknowns, gain=np.ones(E), offset=np.zeros(E), resistance=np.zeros(E))
    v = readings(ideal)
    np.testing.assert_allclose(v.diagonal(), 0.0, atol=1e-12)
    assert (v[OFF] > 0).all() and (v < 1).all()


def test_operator_is_that_of_the_transfer_object():
    """Equation b's parts from the oracle beside it."""
    places, radii = np.array([[0.01, 0.03], [0.07, -0.05]]), np.full(2, 0.004)
    oracle = GroundedSheet(OPERATOR.sheet.transfer(places, radii))
    share, own = OPERATOR.points(places, radii)
    np.testing.assert_allclose(share, oracle.share, atol=1e-9)
    np.testing.assert_allclose(own, oracle.impedance, rtol=1e-9)
    np.testing.assert_allclose(OPERATOR.admittance, oracle.admittance, atol=1e-15)


def test_a_factor_of_all_conductances_leaves_readings_unchanged():
    other = SheetOperator(equal_grid(4, 4, (0.2, 0.2), 0.0025, 2e4))
    halved = replace(APART, contacts=APART.contacts - np.log(2) * np.eye(6)[2])
    np.testing.assert_allclose(readings(halved, other), readings(APART), atol=1e-9)


@pytest.mark.parametrize("uneven", [0.05, 0.15])
def test_an_uneven_sheet_of_finite_elements(uneven):
    """Change of Y0 by a field of the prior: what first order in its logarithm leaves is a tenth."""
    random = np.random.default_rng(0)
    sheet = np.zeros(OPERATOR.modes)
    sheet[: OPERATOR.field.count] = uneven * random.standard_normal(OPERATOR.field.count)
    even, other = (
        GroundedSheet(model.transfer(np.zeros((1, 2)), np.full(1, 0.001))).admittance
        for model in (
            FemSheet(LAYOUT),
            FemSheet(LAYOUT, resistance=lambda p: 1e4 * np.exp(-OPERATOR.field_at(p) @ sheet)),
        )
    )
    change = OPERATOR.admittance_of(sheet) - OPERATOR.admittance
    assert np.linalg.norm(change - (other - even)) < 0.15 * np.linalg.norm(other - even)


def test_a_sheet_that_is_known_to_be_very_uneven():
    """40 % from end to end and 2 : 1 anisotropic: first order is off by more than a millimetre."""
    uneven = SheetField(gradient=Gradient(0.4, 20.0), anisotropy=Anisotropy(2.0, 30.0))
    logarithm = -np.log(resistance_of(LAYOUT, uneven)(OPERATOR.field.centres) / 1e4)
    turn, modes = np.radians(2 * 30.0), OPERATOR.field.count
    sheet = np.zeros(OPERATOR.modes)
    sheet[:modes] = np.linalg.lstsq(OPERATOR.field.modes, logarithm)[0]
    sheet[modes : modes + 2] = np.log(2) / 2 * np.array([np.cos(turn), np.sin(turn)])
    press = Contact("disc", center=(0.031, 0.02), radius=0.006, pressure=2e4)
    scene = Scene("test", DRIVE, (press,), LAW, defects=Defects(sheet=uneven))
    frame = Simulator(LAYOUT, scene).ideal_frame(0.0)
    left, off = [], []
    for operator in (OPERATOR, OPERATOR.about(sheet)):
        known = replace(prior(operator), sheet=sheet, learned=True).held()
        start = replace(pressed(contact(0.031, 0.02, 0.006)), sheet=sheet)
        fit = solve(operator, start, rows_of(frame), known)
        left.append(np.sqrt(fit.chi_squared))
        off.append(np.hypot(*(fit.unknowns.contacts[0, :2] - press.center)))
    assert off[0] > 1e-3 and off[1] < 2e-4
    assert left[1] < left[0] / 5
    assert OPERATOR.near(np.zeros(OPERATOR.modes)) is OPERATOR


def test_an_untouched_sheet_tells_nothing_of_itself():
    """The leak that stands for it was a reading of the sheet: noise moved its coefficients by 0.03."""
    rest = Unknowns.at_rest(OPERATOR)
    read = np.random.default_rng(5).normal(readings(rest), 3e-4)
    assert not solve(OPERATOR, rest, rows_of(read), prior()).unknowns.sheet.any()


@pytest.mark.parametrize(
    ("radius", "place", "limit"),
    [
        (0.004, (0.03, 0.02), 0.01),
        (0.01, (0.01, -0.02), 0.01),
        (0.01, (0.03, 0.02), 0.05),  # 1.2 mm from the rim of an electrode
    ],
)
def test_the_limit_of_a_bare_conductor(radius, place, limit):
    """However hard: g grows and stays finite, readings end at those of the bare conductor, within
    `limit` V."""
    bare = Contact("disc", center=place, radius=radius)
    frame = Simulator(LAYOUT, Scene("test", DRIVE, (bare,))).ideal_frame(0.0)
    form, across = contact(*place, radius)
    last = 0.0
    for log_c in (-9.0, -8.0, -7.0, -5.0, 0.0):
        prediction = Prediction(OPERATOR, pressed(([*form[:2], log_c, *form[3:]], across)), ALL)
        assert np.isfinite(prediction.readings).all()
        assert prediction.conductances[0] > last
        last = prediction.conductances[0]
    assert np.abs(DRIVE * prediction.readings - frame)[OFF].max() < limit


@pytest.mark.parametrize("harder, known", [(1.0, True), (1e3, False), (1e9, False)])
def test_the_force_of_a_bare_conductor_is_a_lower_bound(harder, known):
    """A smaller contact that conducts better looks the same: no deviation could hold the truth."""
    law = ContactLaw(harder * LAW.coefficient, 1.0)
    press = Contact("disc", center=(0.03, 0.02), radius=0.005, pressure=2e4)
    frame = Simulator(LAYOUT, Scene("test", DRIVE, (press,), contact_law=law)).ideal_frame(0.0)
    estimator = Estimator(LAYOUT, noise=1e-3, law=law, radius=0.005)
    (found,) = estimator.estimate(frame, ALL, DRIVE, State()).contacts
    true = press.pressure * np.pi * press.radius**2
    assert np.isfinite(found.force_std) == known
    assert abs(found.force - true) < 1.96 * found.force_std if known else found.force < true


def test_what_channels_do_to_readings():
    unknowns = imperfect(APART)
    ideal = replace(unknowns, gain=np.ones(E), offset=np.zeros(E))
    np.testing.assert_allclose(
        readings(unknowns), readings(ideal) * unknowns.gain + unknowns.offset, atol=1e-12
    )
    z = Prediction(OPERATOR, unknowns, ALL).impedance
    own = z.diagonal() - OPERATOR.by_radius * unknowns.sheet[-1] + unknowns.resistance
    expected = 1 - z / own[:, None]
    expected[np.diag_indices(E)] = unknowns.resistance / own
    np.testing.assert_allclose(readings(ideal), expected, atol=1e-12)


@pytest.mark.parametrize("uneven", [0.0, 0.3], ids=["even", "uneven"])
def test_a_floating_electrode_is_one_that_is_never_there(uneven):
    """15 electrodes read what they read among 16, but for the bound of g near 1/c = D."""
    used = np.delete(ALL, 5)
    fewer = OPERATOR.of(used)
    a, b = (0.031, 0.02), (-0.052, -0.04)
    forms = [contact(*a, 0.006, operator=fewer), contact(*b, 0.012, 5e3, operator=fewer)]
    sheet = uneven * OPERATOR.deviation * np.random.default_rng(0).standard_normal(OPERATOR.modes)
    got = readings(replace(pressed(*forms, operator=fewer), sheet=sheet), fewer)
    among = readings(replace(APART, sheet=sheet))
    np.testing.assert_allclose(got, among[np.ix_(used, used)], atol=4e-4)


def simulated(truth, noise, seed):
    """`Rows` of the model's own readings with Gaussian noise, parts of V0."""
    random = np.random.default_rng(seed)
    return rows_of(
        DRIVE * (readings(truth) + noise * random.standard_normal((E, E))), DRIVE * noise
    )


def test_solver_returns_to_the_truth_from_afar():
    """Misfit that resistances to ground explain in part, too, must not end the iteration."""
    truth = pressed(contact(-0.0145, 0.0476, 0.002), free=DISC)
    rows = simulated(truth, 1e-6, 0)
    rows = replace(rows, weights=np.where(rows.weights > 0, 3e-4**-2.0, 0.0))
    start = replace(truth, contacts=truth.contacts + [[0.003, -0.003, 0.2, 0.3, 0.0, 0.0]])
    fit = solve(OPERATOR, start, rows, prior(), 30)
    assert fit.chi_squared < 0.1 * rows.count
    np.testing.assert_allclose(fit.unknowns.contacts[0, :2], truth.contacts[0, :2], atol=1e-4)


def test_every_step_of_the_solver_lowers_the_cost():
    rows = simulated(imperfect(APART), 3e-4, 1)
    start = replace(APART, contacts=APART.contacts + 0.2 * np.array([0.02, -0.02, 1, 1, 0, 0]))
    costs = [Fit(OPERATOR, start, rows, prior()).cost]
    costs += [solve(OPERATOR, start, rows, prior(), steps).cost for steps in (1, 2, 4, 8)]
    assert (np.diff(costs) <= 0).all() and costs[-1] < 0.01 * costs[0]


def test_regions_of_95_per_cent_hold_the_truth():
    """Sheet and channels drawn from their priors, noise 1 mV: the model's own promise."""
    random = np.random.default_rng(5)
    before = replace(
        prior(gain=0.02, offset=0.003, resistance=40.0),
        resistance=np.full(E, 150.0),
        sheet_deviation=0.5 * OPERATOR.deviation,
        spread=0.4,
    )
    trials, held = 40, np.zeros(3)
    for trial in range(trials):
        radius = 0.005 * np.exp(0.4 * random.standard_normal())
        place = random.uniform(-0.08, 0.08, 2)
        form = contact(*place, radius, random.uniform(5e3, 3e4))
        gain, offset, resistance = (
            mean + deviation * random.standard_normal(E)
            for mean, deviation in zip((1.0, 0.0, 150.0), before.deviations)
        )
        truth = replace(
            pressed(form, free=DISC),
            sheet=before.sheet_deviation * random.standard_normal(OPERATOR.modes),
            gain=gain,
            offset=offset,
            resistance=np.maximum(resistance, 0.0),
        )
        start = replace(pressed(form, free=DISC), resistance=before.resistance)
        fit = solve(OPERATOR, start, simulated(truth, 3e-4, trial), before, 20)
        off = (fit.unknowns.contacts - truth.contacts)[0, :4]
        cov = fit.covariance
        assert cov.shape == (4, 4)
        inside = off[:2] @ np.linalg.solve(cov[:2, :2], off[:2]) < chi2.ppf(0.95, 2)
        held += [inside, *(np.abs(off[2:]) < 1.96 * np.sqrt(cov.diagonal()[2:]))]
    assert (held >= 0.86 * trials).all(), held / trials


@pytest.fixture(scope="module")
def on_8x8():
    layout, law = equal_grid(8, 8, (0.2, 0.2), 0.0025, 1e4), ContactLaw(1e-4, 1.0)
    return Estimator(layout, noise=1e-3, law=law, radius=0.005), law


@pytest.mark.parametrize("strength, radius", [(1.0, 0.005), (30.0, 0.005), (1.0, 0.03)])
def test_forces_of_nearly_bare_contacts_are_as_uncertain_as_they_are_wrong(
    on_8x8, radius, strength
):
    estimator, law = on_8x8
    layout, area = estimator.layout, np.pi * radius**2
    pressure = float(law.pressure(strength * 2 * np.pi / layout.sheet_resistance / area))
    contact = Contact("disc", center=(0.021, -0.034), radius=radius, pressure=pressure)
    frame = Simulator(layout, Scene("one", 3.3, (contact,), law), model="fem").frame(0.0, 0)
    (found,) = estimator.estimate(frame, layout.grounded, 3.3, State()).contacts
    if strength > 12:  # readings do not tell how much more than a bare conductor it is
        assert np.isinf(found.force_std)
        assert found.force < 1.05 * pressure * area
    else:
        assert abs(found.force - pressure * area) < 2 * found.force_std
        assert found.force_std < 0.3 * found.force


def test_ways_through_the_sheet_change_readings_as_differences_say():
    """Of D times a factor, c held: by the formula for readings from H, D and g, dense."""
    operator = SheetOperator(LAYOUT)
    contacts = np.array([[0.01, 0.02, np.log(2e-4), np.log(0.012), 0.2, -0.1]])
    unknowns = Unknowns.at_rest(operator).with_contacts(contacts, (5,), np.ones((1, 6), bool))
    rows, step = np.arange(16), 1e-4
    prediction = Prediction(operator, unknowns, rows)
    slope, touches = prediction.way_columns()[0], prediction.touches

    def readings(factor: float) -> np.ndarray:
        g = conductance(contacts[0, CONDUCTANCE], factor * touches.mean[0])[0]
        own = np.diag(1 / (g * touches.weight)) + factor * touches.impedance
        added = touches.share @ np.linalg.solve(own, touches.share.T)
        added += np.diag(g * touches.direct[0])
        impedance = np.linalg.inv(operator.admittance + added)
        return 1 - impedance[rows] / impedance[rows, rows][:, None]

    np.testing.assert_allclose(readings(1.0), prediction.readings, atol=1e-12)
    change = (readings(1 + step) - readings(1 - step)) / (2 * step)
    np.testing.assert_allclose(change, slope, atol=1e-5 * np.abs(slope).max())


@pytest.mark.parametrize("layout", [LAYOUT, equal_grid(3, 4, (0.1, 0.07), 0.002, 1e4)])
def test_what_a_sheet_changes_is_the_integral_over_its_elements(layout):
    """dH(x) = - int sigma m grad D_x . grad H, element by element; the operator sums it by nodes."""
    operator = SheetOperator(layout)
    fem, field = FemSheet(layout), operator.field
    mesh, places = fem.mesh, mirrored(operator.lattice.points, np.array(layout.outline.size) / 2)
    bordered = np.ones((layout.electrodes + 1,) * 2)
    bordered[:-1, :-1], bordered[-1, -1] = fem.electrode_electrode, 0.0
    inverse = np.linalg.inv(bordered)
    fed = np.vstack([fem.to_electrodes.T, np.ones(len(fem.where))])
    element, weights = mesh.locate(places)
    feed = np.zeros((len(fem.where), len(places)))
    np.add.at(
        feed.T, (np.arange(len(places))[:, None], fem.unknown[mesh.triangles[element]]), weights
    )
    green = fem._solve(feed) - fed.T @ (inverse @ (fed @ feed))  # D, with all electrodes at 0 V
    corners = mesh.points[mesh.triangles]
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=1)
    twice = edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0]
    steps = np.array([[-1.0, 1.0, 0.0], [-1.0, 0.0, 1.0]])
    slope = np.linalg.inv(edges) @ steps  # (T, 2, 3) gradients of the corners' functions
    sigma = np.abs(twice) / 2 / layout.sheet_resistance
    of_share = slope @ (inverse @ fed)[:-1].T[fem.unknown[mesh.triangles]]
    of_green = slope @ green[fem.unknown[mesh.triangles]]
    at_places, nodes = field.cell_values(places), np.arange(len(places))
    for mode in (0, 7, field.count - 1):
        values = field.modes[field.owner, mode]
        change = -np.einsum("t,tdq,tdn->qn", sigma * values, of_green, of_share, optimize=True)
        whole = -np.einsum("t,tdq,tdn->qn", sigma, of_green, of_share, optimize=True)
        change -= at_places[:, [mode]] * whole
        found = operator.added_at(np.eye(operator.modes)[mode], nodes).T
        assert found == pytest.approx(change, abs=2e-6 * float(np.abs(change).max()))
    along = np.einsum("t,tq,tn->qn", sigma, of_green[:, 0], of_share[:, 0], optimize=True)
    across = np.einsum("t,tq,tn->qn", sigma, of_green[:, 1], of_share[:, 1], optimize=True)
    found = operator.added_at(np.eye(operator.modes)[field.count], nodes).T
    assert found == pytest.approx(across - along, abs=2e-6 * float(np.abs(found).max()))
