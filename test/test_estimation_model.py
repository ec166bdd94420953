"""The estimator's forward model, its derivatives, its solver and how sure it is of what it says."""

from dataclasses import replace

import numpy as np
import pytest
from contacts_support import DRIVE, LAW, disc, rows_of, sensor, unknown
from scipy.linalg import block_diag
from scipy.stats import chi2

from tomotactile_ros.estimation.equations import Linear
from tomotactile_ros.estimation.estimator import Estimator, State
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import Prediction, Unknowns
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.solver import solve
from tomotactile_ros.estimation.tables import induced_charges, mirrored
from tomotactile_ros.estimation.touch import (
    CONDUCTANCE,
    Touches,
    conductance,
    patches_for,
    patches_of,
)
from tomotactile_ros.layouts.layout import equal_grid, load_layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.scenes.sheet_field import Anisotropy, Gradient, SheetField, resistance_of
from tomotactile_ros.sheet.fem import FemSheet

E = 16
LAYOUT = equal_grid(4, 4, (0.2, 0.2), 0.0025, 1e4)
OPERATOR = SheetOperator(LAYOUT)
ALL = np.arange(E)
OFF = ~np.eye(E, dtype=bool)
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


def difference(unknowns, name, index, step, operator=OPERATOR):
    """(E, E) central difference of the readings by one number."""
    sides = []
    for sign in (1, -1):
        values = getattr(unknowns, name).copy()
        values[index] += sign * step
        sides.append(readings(replace(unknowns, **{name: values}), operator))
    return (sides[0] - sides[1]) / (2 * step)


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


EVEN = "a bar on an even sheet"
PLACES[EVEN] = pressed(bar(-0.02, 0.01, 0.06, 0.01, 95.0), contact(0.031, 0.02))


@pytest.mark.parametrize("where", PLACES)
def test_derivatives_by_contacts_and_by_the_sheet(where):
    """As central differences say, but for what the conductance of an uneven sheet changes with the
    place of a contact (0.4 %)."""
    even = where == EVEN
    unknowns = PLACES[where] if even else imperfect(PLACES[where])
    prediction = Prediction(OPERATOR, unknowns, ALL)
    index = list(np.ndindex(unknowns.contacts.shape))
    for (i, j), found in zip(index, prediction.contact_columns(), strict=True):
        true = difference(unknowns, "contacts", (i, j), 2e-6 if j < 2 else 1e-4)
        limit = 1e-5 if even else 0.006 if j < 2 else 1e-4
        assert np.abs(found - true).max() < limit * np.abs(true).max()
        if j == 2:
            np.testing.assert_allclose(found, true, atol=1e-6)
    steps = 1e-3 * OPERATOR.deviation
    true = np.array([step * difference(unknowns, "sheet", j, step) for j, step in enumerate(steps)])
    found = steps[:, None, None] * prediction.sheet_columns()
    assert np.abs(found - true).max() < 1e-6 * np.abs(true).max()


@pytest.mark.parametrize(
    "correlated, order",
    [(False, ALL), (True, ALL), (True, np.array([3, 9, 9, 0, 14, 7, 12, 1]))],
    ids=["apart", "correlated", "rows in any order"],
)
def test_a_step_is_that_of_all_unknowns_together(correlated, order):
    """Channels are eliminated (Schur complement); a dense system gives the same, however unequally
    they are known."""
    truth = imperfect(PLACES["between"])
    random = np.random.default_rng(2)
    noise = 1e-3
    read = (readings(truth) + noise * random.standard_normal((E, E)))[order]
    rows = Rows(read, np.full(read.shape, noise**-2.0), order)
    rows.weights[np.arange(len(order)), order] = 0.0
    rows.weights[3, 7:12] = 0.0
    here = replace(
        truth,
        gain=truth.gain + 1e-3 * random.standard_normal(E),
        offset=truth.offset + 1e-4 * random.standard_normal(E),
        resistance=truth.resistance + 300.0,
        free=np.array([[True, True, True, False, False, False]] * 2),
    )
    before = unknown(OPERATOR)
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
        columns += [difference(here, name, j, step)[order] for j in range(E)]
        off.append(getattr(here, name) - getattr(before, name))
    columns += [difference(here, "aside", ij, 1e-6)[order] for ij in np.ndindex(2, E)]
    off.append((here.aside - before.aside).ravel())
    off = np.concatenate(off)
    inverse = block_diag(np.diag(of_contacts), expected)
    root = np.sqrt(rows.weights).ravel()
    design = np.array(columns).reshape(len(columns), -1) * root
    normal = design @ design.T + inverse
    right = design @ (root * fit.misfit.ravel()) - inverse @ off
    step = np.linalg.solve(normal, right)
    reached = Linear(fit).step(0.0)
    got = [(reached.contacts - here.contacts)[:, :3].ravel()]
    for name in ("sheet", "gain", "offset", "resistance", "aside"):
        got.append((getattr(reached, name) - getattr(here, name)).ravel())
    got = np.concatenate(got)
    deviation = np.sqrt(np.linalg.inv(normal).diagonal())
    np.testing.assert_allclose(got / deviation, step / deviation, atol=1e-4)
    own = Linear(fit).covariance()
    np.testing.assert_allclose(np.sqrt(own.diagonal()), deviation[:6], rtol=2e-3)


def test_electrodes_that_lie_aside():
    """To first order, against the same electrodes where they are: what contacts do not explain of
    0.1 mm falls to a seventh beside a rim, as near to it as electrodes with a whole rim can be."""
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

    assert left(readings(moved, here)) < 0.15 * left(readings(resting, here))


def test_a_factor_of_all_conductances_leaves_readings_unchanged():
    other = SheetOperator(equal_grid(4, 4, (0.2, 0.2), 0.0025, 2e4))
    halved = replace(APART, contacts=APART.contacts - np.log(2) * np.eye(6)[2])
    np.testing.assert_allclose(readings(halved, other), readings(APART), atol=1e-9)


def test_a_sheet_that_is_known_to_be_very_uneven():
    """40 % from end to end and 2 : 1 anisotropic: first order is off by more than a millimetre."""
    uneven = SheetField(gradient=Gradient(0.4, 20.0), anisotropy=Anisotropy(2.0, 30.0))
    logarithm = -np.log(resistance_of(LAYOUT, uneven)(OPERATOR.field.centres) / 1e4)
    turn, modes = np.radians(2 * 30.0), OPERATOR.field.count
    sheet = np.zeros(OPERATOR.modes)
    sheet[:modes] = np.linalg.lstsq(OPERATOR.field.modes, logarithm)[0]
    sheet[modes : modes + 2] = np.log(2) / 2 * np.array([np.cos(turn), np.sin(turn)])
    press = disc(0.031, 0.02, 0.006, pressure=2e4)
    frame = sensor(LAYOUT, press, defects=Defects(sheet=uneven)).ideal_frame(0.0)
    left, off = [], []
    for operator in (OPERATOR, OPERATOR.about(sheet)):
        known = replace(unknown(operator), sheet=sheet, learned=True).held()
        start = replace(pressed(contact(0.031, 0.02, 0.006)), sheet=sheet)
        fit = solve(operator, start, rows_of(frame, 3e-4), known)
        left.append(np.sqrt(fit.chi_squared))
        off.append(np.hypot(*(fit.unknowns.contacts[0, :2] - press.center)))
    assert off[0] > 1e-3 and off[1] < 2e-4
    assert left[1] < left[0] / 5
    assert OPERATOR.near(np.zeros(OPERATOR.modes)) is OPERATOR


def test_an_untouched_sheet_tells_nothing_of_itself():
    """The leak that stands for it was a reading of the sheet: noise moved its coefficients by 0.03."""
    rest = Unknowns.at_rest(OPERATOR)
    read = np.random.default_rng(5).normal(readings(rest), 3e-4)
    assert not solve(OPERATOR, rest, rows_of(read, 3e-4), unknown(OPERATOR)).unknowns.sheet.any()


def test_the_centre_of_a_disc_that_covers_a_part_of_an_electrode_is_its_own():
    place = OPERATOR.layout.positions[5] + (0.004, 0.001)
    (form,) = pressed(contact(*place, 0.005)).contacts
    touches = Touches(OPERATOR, form[None], (14,), np.zeros(OPERATOR.modes))
    np.testing.assert_allclose(touches.centre(0), place, atol=1e-5)


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
    fit = solve(OPERATOR, start, rows, unknown(OPERATOR), 30)
    assert fit.chi_squared < 0.1 * rows.count
    np.testing.assert_allclose(fit.unknowns.contacts[0, :2], truth.contacts[0, :2], atol=1e-4)


def test_regions_of_95_per_cent_hold_the_truth():
    """Sheet and channels drawn from their priors, noise 1 mV: the model's own promise."""
    random = np.random.default_rng(5)
    before = replace(
        unknown(OPERATOR, gain=0.02, offset=0.003, resistance=40.0),
        resistance=np.full(E, 150.0),
        sheet_deviation=0.5 * OPERATOR.deviation,
        spread=0.4,
    )
    trials, held = 40, np.zeros(3)
    for trial in range(trials):
        radius = 0.005 * np.exp(0.4 * random.standard_normal())
        place = random.uniform(-0.08, 0.08, 2)
        form = contact(*place, radius, random.uniform(5e3, 3e4))
        drawn = [spread * random.standard_normal(E) for spread in before.deviations[:3]]
        truth = replace(
            pressed(form, free=DISC),
            sheet=before.sheet_deviation * random.standard_normal(OPERATOR.modes),
            gain=1.0 + drawn[0],
            offset=drawn[1],
            resistance=np.maximum(150.0 + drawn[2], 0.0),
        )
        start = replace(pressed(form, free=DISC), resistance=before.resistance)
        fit = solve(OPERATOR, start, simulated(truth, 3e-4, trial), before, 20)
        off = (fit.unknowns.contacts - truth.contacts)[0, :4]
        cov = fit.covariance
        assert cov.shape == (4, 4)
        inside = off[:2] @ np.linalg.solve(cov[:2, :2], off[:2]) < chi2.ppf(0.95, 2)
        held += [inside, *(np.abs(off[2:]) < 1.96 * np.sqrt(cov.diagonal()[2:]))]
    assert (held >= 0.86 * trials).all(), held / trials


@pytest.mark.parametrize(
    "strength, radius", [(1.0, 0.005), (30.0, 0.005), (1.0, 0.03), (1e9, 0.005)]
)
def test_forces_of_nearly_bare_contacts_are_as_uncertain_as_they_are_wrong(radius, strength):
    """A smaller contact that conducts better looks the same: of bare ones no deviation could hold the truth."""
    layout = load_layout("equal-8x8")
    estimator, area = Estimator(layout, noise=1e-3, law=LAW, radius=0.005), np.pi * radius**2
    pressure = float(LAW.pressure(strength * 2 * np.pi / layout.sheet_resistance / area))
    press = disc(0.021, -0.034, radius, pressure=pressure)
    frame = sensor(layout, press, noise=0.0, adc=None).frame(0.0)
    (found,) = estimator.estimate(frame, layout.grounded, DRIVE, State()).contacts
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


def test_what_a_sheet_changes_is_the_integral_over_its_elements():
    """dH(x) = - int sigma m grad D_x . grad H, element by element; the operator sums it by nodes."""
    layout = equal_grid(3, 4, (0.1, 0.07), 0.002, 1e4)
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


@pytest.mark.parametrize("name", ["equal-8x8", "equal-16x16", "hex-37"])
def test_charges_induced_on_electrodes_are_those_of_the_circle_theorem(name):
    """+1 in the centre, -1 in the inverse point, of each electrode by itself; images in rims of a rectangle are places
    as well, and an electrode on a rim is its own one."""
    layout, random, count = load_layout(name), np.random.default_rng(3), 25
    electrodes, centres, radius = induced_charges(layout), layout.positions, layout.radius
    resistance = layout.sheet_resistance
    about = centres[random.integers(len(centres), size=count)]
    angle, distance = random.uniform(0, 2 * np.pi, count), random.uniform(1.05, 12.0, count)
    way = np.stack([np.cos(angle), np.sin(angle)], -1) * (distance * radius)[:, None]
    places = (about + way)[layout.outline.depth(about + way)[0] > 0]
    places = places[layout.nearest(places)[0] > 1.05 * radius]
    size = np.array(layout.outline.size) * layout.outline.is_uniform_rectangle
    turns = [(1, 0.0), (-1, 1.0), (-1, -1.0)] if size.any() else [(1, 0.0)]
    images = [
        lambda at, i=i, j=j: at * [i[0], j[0]] + size * [i[1], j[1]] for i in turns for j in turns
    ]

    def fed(at, image, centre):
        """Potentials at `at` of what `places` induce as seen through one of their images."""
        apart, source = at - centre, image(places) - centre
        inverse = source * (radius**2 / (source**2).sum(axis=1))[:, None]
        from_inverse = np.hypot(*(apart[:, None] - inverse).transpose(2, 0, 1))
        return np.log(from_inverse / np.hypot(*apart.T)[:, None])

    expected = np.zeros((len(places), len(places)))
    for centre in centres:
        own = [each for each in images if np.hypot(*(each(centre) - centre)) < 1e-6 * radius]
        assert electrodes.counted[np.argmin(np.hypot(*(centres - centre).T))] == len(own)
        for to in images:
            expected += sum(fed(to(places), each, centre) for each in images) / len(own)
    expected *= resistance / (2 * np.pi)
    found = electrodes.between(places)
    # of images, dipoles only
    np.testing.assert_allclose(found, expected, atol=5e-4 * resistance)
    np.testing.assert_allclose(found.diagonal(), electrodes.own(places), atol=1e-12 * resistance)
