"""Frames and sensitivities: against solutions by other means, and what physics demands of them."""

import numpy as np
import pytest

from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.contact_points import contact_points
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.sheet.sensitivity import Sensitivity
from tomotactile_ros.sheet.triangles import corner_angles, links, stiffness
from tomotactile_ros.sheet.voltages import frame

DRIVE = 3.3


@pytest.fixture(scope="module")
def layout():
    return equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)


@pytest.fixture(scope="module", params=["fem", "closed_form"])
def sheet(request, layout):
    return make_sheet(layout, request.param)


def press(sheet, *contacts, **settings):
    """Frame of contacts (Contact, conductance in S/m^2)."""
    return frame(*contact_points(sheet, [(c.patches(), g) for c, g in contacts]), DRIVE, **settings)


def disc(x, y, radius=0.005):
    return Contact("disc", center=(x, y), radius=radius)


def test_against_one_solution_per_ground_condition(layout):
    """The full system of equations, assembled and solved for each ground condition apart."""
    sheet = FemSheet(layout)
    transfer, resistance = contact_points(sheet, [(disc(0.031, -0.022, 0.008).patches(), 2.0)])
    chosen = np.array([3, 9, 20])
    transfer, resistance = transfer.at(chosen), resistance[chosen]
    green = transfer.among(np.arange(3))
    for ground in (0, 5, 15):
        own = transfer.electrode_electrode[ground, ground]
        to_ground = transfer.electrode_point[ground]
        impedance = green - to_ground[:, None] - to_ground + own
        current = np.linalg.solve(impedance + np.diag(resistance), np.full(3, DRIVE))
        expected = transfer.impedance(ground) @ current
        got = frame(transfer, resistance, DRIVE, grounded=[ground])[0]
        others = np.arange(16) != ground
        np.testing.assert_allclose(got[others], expected[others], rtol=1e-9)
        assert np.isnan(got[ground])


def test_against_scikit_fem(layout):
    """An independent finite-element library on its own mesh: 1 % of the drive voltage."""
    skfem = pytest.importorskip("skfem")
    from skfem.helpers import dot, grad

    where, radius, conductance = np.array([0.035, 0.02]), 0.01, 2.0
    axis = np.linspace(-0.1, 0.1, 201)
    mesh = skfem.MeshTri.init_tensor(axis, axis)
    basis = skfem.Basis(mesh, skfem.ElementTriP1())

    @skfem.BilinearForm
    def sheet_form(u, v, w):
        inside = np.hypot(w.x[0] - where[0], w.x[1] - where[1]) < radius
        return dot(grad(u), grad(v)) / layout.sheet_resistance + conductance * inside * u * v

    @skfem.LinearForm
    def drive_form(v, w):
        inside = np.hypot(w.x[0] - where[0], w.x[1] - where[1]) < radius
        return conductance * DRIVE * inside * v

    matrix, right = sheet_form.assemble(basis), drive_form.assemble(basis)
    points = mesh.p.T
    electrodes = [
        np.flatnonzero(np.linalg.norm(points - p, axis=1) <= layout.radius + 1e-9)
        for p in layout.positions
    ]
    tied = np.arange(len(points))
    for nodes in electrodes:
        tied[nodes] = nodes[0]
    kept, unknown = np.unique(tied, return_inverse=True)
    from scipy import sparse

    reduce = sparse.csr_matrix((np.ones(len(points)), (np.arange(len(points)), unknown)))
    matrix, right = (reduce.T @ matrix @ reduce).tocsc(), reduce.T @ right
    ground = 6
    free = np.arange(len(kept)) != unknown[electrodes[ground][0]]
    potential = np.zeros(len(kept))
    potential[free] = sparse.linalg.spsolve(matrix[free][:, free], right[free])
    expected = potential[unknown[[nodes[0] for nodes in electrodes]]]
    for model in ("fem", "closed_form"):
        got = press(
            make_sheet(layout, model, h=0.0025 if model == "fem" else None),
            (disc(*where, radius), conductance),
            grounded=[ground],
        )[0]
        got[ground] = 0.0
        assert np.abs(got - expected).max() < 0.01 * DRIVE


def test_the_models_agree(layout):
    models = [make_sheet(layout, model) for model in ("closed_form", "fem")]
    for contacts in (
        [(disc(0.03, 0.04), 2.0)],
        [(disc(0.03, 0.04), 2.0), (disc(-0.02, 0.0, 0.01), 5.0)],
        [(disc(0.0, 0.0), np.inf)],
        [(Contact("rectangle", center=(-0.03, 0.02), size=(0.05, 0.02), angle=30), 1.0)],
    ):
        first, second = (press(sheet, *contacts) for sheet in models)
        assert np.nanmax(np.abs(first - second)) < 0.012 * DRIVE


def test_both_limits_of_the_contact_conductance_are_reached_continuously(sheet):
    bare = press(sheet, (disc(0.03, 0.04), np.inf))
    nearly = press(sheet, (disc(0.03, 0.04), 1e12))
    assert np.nanmax(np.abs(bare - nearly)) < 1e-5 * DRIVE
    weak, weaker = (press(sheet, (disc(0.03, 0.04), g)) for g in (1e-6, 1e-7))
    assert np.nanmax(np.abs(weak - 10 * weaker)) < 1e-5 * np.nanmax(weak)


@pytest.mark.parametrize("conductance", [1e-3, 2.0, 1e3, np.inf])
def test_maximum_principle(sheet, conductance):
    voltages = press(sheet, (disc(0.03, 0.04), conductance), (disc(-0.05, 0.0), 5.0))
    assert np.nanmin(voltages) >= -1e-10 and np.nanmax(voltages) <= DRIVE * (1 + 1e-10)


def test_currents_balance(layout):
    """What enters through the contacts leaves through the grounded electrode, and nowhere else."""
    sheet = FemSheet(layout)
    transfer, resistance = contact_points(sheet, [(disc(0.03, 0.04).patches(), 2.0)])
    everything = np.arange(len(transfer.points))
    for ground in (0, 6):
        z = transfer.among(everything) + sheet.electrode_electrode[ground, ground]
        z = z - transfer.electrode_point[ground] - transfer.electrode_point[ground][:, None]
        current = np.linalg.solve(z + np.diag(resistance), np.full(len(everything), DRIVE))
        feed = np.zeros(len(sheet.where))
        element, weights = sheet.mesh.locate(transfer.points)
        np.add.at(feed, sheet.unknown[sheet.mesh.triangles[element]], weights * current[:, None])
        feed[ground] -= current.sum()
        potential = sheet._solve(feed[:, None])[:, 0]
        flow = sheet.stiffness @ potential
        assert np.abs(flow - feed).max() < 1e-10 * current.sum()


def test_stiffness_rows_sum_to_zero_and_reproduce_linear_fields():
    sheet = FemSheet(equal_grid(2, 2, (0.2, 0.1), 0.005, 1.0, inset=0.03))
    mesh = sheet.mesh
    cotangents, angles = corner_angles(mesh.points, mesh.triangles)
    np.testing.assert_allclose(angles.sum(axis=1), np.pi)
    ends, conductance = links(mesh.triangles, cotangents, np.ones(len(mesh.triangles)))
    matrix = stiffness(ends, conductance, len(mesh.points))
    assert np.abs(matrix.sum(axis=1)).max() < 1e-10
    inside = sheet.layout.outline.rim_distance(mesh.points) > 1e-9
    assert np.abs((matrix @ mesh.points)[inside]).max() < 1e-12
    energy = mesh.points[:, 0] @ matrix @ mesh.points[:, 0]
    assert energy == pytest.approx(0.2 * 0.1, rel=1e-12)


def test_switch_resistance_raises_all_readings_alike(sheet):
    """In series with the ground: the sheet cannot tell it from a higher contact resistance."""
    open_, closed = (press(sheet, (disc(0.03, 0.04), 2.0), switch_resistance=r) for r in (1e9, 0.0))
    off = ~np.eye(16, dtype=bool)
    assert (open_[off] > closed[off]).all()
    assert np.abs(open_[off] - DRIVE).max() < 1e-3 * DRIVE


def test_a_contact_on_an_electrode_holds_it_at_its_own_potential(sheet, layout):
    x, y = layout.positions[5]
    voltages = press(sheet, (disc(x, y, 0.002), np.inf))
    others = np.arange(16) != 5
    np.testing.assert_allclose(voltages[others, 5], DRIVE, rtol=1e-9)
    np.testing.assert_array_equal(voltages[5, others], 0.0)  # a short circuit: ground wins


@pytest.mark.parametrize("where", [(0.1, 0.0), (0.1, 0.1), (-0.1, 0.03), (0.0999, -0.0999)])
@pytest.mark.parametrize("conductance", [1e-6, 2.0, np.inf])
def test_contacts_on_the_rim_and_in_corners(sheet, where, conductance):
    voltages = press(sheet, (disc(*where, 0.012), conductance))
    off = ~np.eye(16, dtype=bool)
    assert np.isfinite(voltages[off]).all()
    over = 1e-9 if sheet.model == "fem" else 1e-3  # charges on the rims of the two show each other
    assert voltages[off].min() >= -1e-9 and voltages[off].max() <= DRIVE * (1 + over)


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
        potential = np.zeros(operator.shape[1])
        potential[k] = 1.0
        reading = frame(operator.transfer.at([k]), [0.0], 1.0)
        seen = operator.forward(potential)
        off = ~np.eye(16, dtype=bool)
        np.testing.assert_allclose(seen[off], reading[off], atol=1e-9)
