"""The two models of the sheet against each other and against physics; meshes."""

from dataclasses import replace

import numpy as np
import pytest

from tomotactile_ros.bench.reference import ReferenceSheet
from tomotactile_ros.estimation.as_cut import torn
from tomotactile_ros.estimation.uneven import bordered_inverse
from tomotactile_ros.layouts.layout import Layout, equal_grid
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.layouts.region import Region
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.changed import ChangedSheet
from tomotactile_ros.sheet.closed_form import ClosedFormSheet
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.sheet.green import green_rectangle, green_rectangle_self
from tomotactile_ros.sheet.mesh import make_mesh
from tomotactile_ros.support.errors import InputError


def transfer_impedances(between):
    """(L, E, E) Z_l(a, b) between electrodes, of G (E, E)."""
    own = np.diagonal(between)
    return between - between[:, :, None] - between[:, None, :] + own[:, None, None]


def points_away(layout, distance, count=300, seed=0):
    random = np.random.default_rng(seed)
    points = (random.random((count, 2)) - 0.5) * layout.outline.size
    apart = np.linalg.norm(points[:, None] - layout.positions, axis=2).min(axis=1)
    return points[apart > distance]


def image_series(point, source, size, images=40):
    """G by brute force: the image series of the rectangle with very many images."""
    (a, b), (x, y), (s, t) = size, point + np.array(size) / 2, source + np.array(size) / 2
    total = ((y**2 + t**2) / (2 * b) - max(y, t) + b / 3) / a
    for n in range(-images, images + 1):
        for distance in (abs(y - t + 2 * b * n), abs(y + t + 2 * b * n)):
            q = np.exp(-np.pi * distance / a)
            for shift in (x - s, x + s):
                total -= np.log(1 - 2 * q * np.cos(np.pi * shift / a) + q * q) / (4 * np.pi)
    return total


@pytest.mark.parametrize("size", [(0.2, 0.2), (0.2, 0.1), (0.13, 0.4), (0.01, 1.0)])
def test_closed_form_is_the_image_series(size):
    random = np.random.default_rng(1)
    points, sources = ((random.random((5, 2)) - 0.5) * size for _ in range(2))
    expected = [[image_series(p, q, size) for q in sources] for p in points]
    np.testing.assert_allclose(green_rectangle(points, sources, size), expected, atol=1e-13)


def test_self_term_is_the_mean_over_a_circle():
    centre, radius, angle = np.array([[0.03, -0.06]]), 0.004, np.linspace(0, 2 * np.pi, 721)[:-1]
    circle = centre + radius * np.column_stack([np.cos(angle), np.sin(angle)])
    mean = green_rectangle(circle, centre, (0.2, 0.2)).mean()
    self_term = green_rectangle_self(centre, (0.2, 0.2), radius)[0]
    assert self_term == pytest.approx(mean, abs=1e-3 / (2 * np.pi))


@pytest.mark.parametrize("count, radius", [(8, 0.001), (8, 0.0025), (4, 0.005), (4, 0.01)])
def test_fem_agrees_with_closed_form_like_with_like(radius, count):
    """Point electrodes with a radius, default mesh: 0.3 % of the two electrodes' impedance."""
    layout = equal_grid(count, count, (0.2, 0.2), radius, 1e4)
    exact = transfer_impedances(ClosedFormSheet(layout, shunting=False).electrode_electrode)
    meshed = transfer_impedances(FemSheet(layout, shunting=False).electrode_electrode)
    own = np.sqrt(np.maximum(np.einsum("lii->li", exact), 0))
    scale = own[:, :, None] * own[:, None, :]
    seen = scale > 0
    seen[np.arange(count**2), np.arange(count**2)] = False
    assert np.abs((meshed - exact)[seen] / scale[seen]).max() < 3e-3


def test_fem_converges_with_order_two():
    """Differences of potential between points away from electrodes."""
    layout = equal_grid(2, 2, (0.2, 0.15), 0.005, 1.0, inset=0.03)
    points = points_away(layout, 0.04)

    def differences(sheet):
        potential = sheet.transfer(points, 1e-3).electrode_point
        drop = potential[1:] - potential[0]
        return drop - drop.mean(axis=1, keepdims=True)

    exact = differences(ClosedFormSheet(layout, shunting=False))
    sizes = np.array([0.01, 0.005, 0.0025])
    errors = []
    for h in sizes:
        found = differences(FemSheet(layout, h=h, ring=round(0.32 / h), shunting=False))
        errors.append(np.sqrt(np.mean((found - exact) ** 2)))
    rate = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert rate > 1.8, errors


def test_a_point_beside_an_electrode_is_felt_through_it_in_both_models():
    """Finite elements are a millimetre wide there; with the image of the point in the electrode's rim they have
    the impedance between them, which without it is up to a quarter too large."""
    layout = equal_grid(4, 4, (0.2, 0.2), 0.0025, 1e4)
    away = (layout.radius + np.array([0.001, 0.0015, 0.002, 0.003]))[:, None]
    points = layout.positions[5] + away * [np.cos(0.3), np.sin(0.3)]
    found = []
    for sheet in (FemSheet(layout, h=0.0025), ClosedFormSheet(layout, ring=24)):
        seen = sheet.transfer(points, 0.0008)
        own = seen.electrode_electrode[5, 5]
        found.append(seen.point_self - 2 * seen.electrode_point[5] + own)
    np.testing.assert_allclose(*found, rtol=0.05)


@pytest.mark.parametrize("model", ["fem", "closed_form"])
def test_a_transfer_restricted_to_some_points_is_the_same_sheet(model):
    layout = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
    whole = make_sheet(layout, model).transfer(points_away(layout, 0.01, 30), 0.002)
    some = whole.at([4, 2, 9])
    np.testing.assert_array_equal(some.points, whole.points[[4, 2, 9]])
    np.testing.assert_allclose(some.among([0, 2]), whole.among([4, 9]), rtol=1e-9)


SYMMETRIES = [
    np.linalg.matrix_power([[0, 1], [-1, 0]], turns) @ np.diag([mirrored, 1])
    for turns in range(4)
    for mirrored in (1, -1)
]


@pytest.mark.parametrize("model", ["fem", "closed_form"])
def test_a_square_sheet_has_the_symmetries_of_the_square(model):
    """At mesh nodes; between them the diagonals of squares, which fall either way, show."""
    layout = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
    nodes = make_sheet(layout, "fem").mesh.points
    distance = np.linalg.norm(nodes[:, None] - layout.positions, axis=2).min(axis=1)
    points = nodes[distance > 0.008][::40]
    sheet = make_sheet(layout, model)
    between = transfer_impedances(sheet.electrode_electrode)
    seen = sheet.transfer(points, 0.002).impedance(5)
    for turned in SYMMETRIES:
        apart = np.linalg.norm(layout.positions[:, None] - layout.positions @ turned, axis=2)
        to = apart.argmin(axis=0)
        top = 1e-9 * between.max()
        np.testing.assert_allclose(between[np.ix_(to, to, to)], between, atol=top)
        moved = sheet.transfer(points @ turned, 0.002).impedance(to[5])[to]
        np.testing.assert_allclose(moved, seen, atol=1e-9 * seen.max())


@pytest.mark.parametrize("model", ["fem", "closed_form"])
def test_impedances_scale_with_resistance_and_not_with_length(model):
    def impedances(scale, resistance):
        size = (0.2 * scale, 0.14 * scale)
        layout = equal_grid(
            3, 3, size, 0.004 * scale, resistance, inset=0.02 * scale, unusual_size=True
        )
        return transfer_impedances(make_sheet(layout, model).electrode_electrode)

    plain = impedances(1.0, 1e4)
    top = np.abs(plain).max()
    np.testing.assert_allclose(impedances(1.0, 1e10) / 1e6, plain, atol=1e-9 * top)
    np.testing.assert_allclose(impedances(1000.0, 1e4), plain, atol=1e-7 * top)


@pytest.mark.parametrize("inset", [0.0, 0.01])
def test_induced_charges_model_the_shunting_of_floating_electrodes(inset):
    """Ring charges are near a fine mesh; points with a radius are not."""
    layout = equal_grid(8, 8, (0.2, 0.2), 0.0025, 1.0, inset=inset)
    fine = transfer_impedances(FemSheet(layout, h=0.0025, ring=32).electrode_electrode)

    def error(**settings):
        between = ClosedFormSheet(layout, **settings).electrode_electrode
        return np.abs(transfer_impedances(between) - fine).max() / fine.max()

    assert error() < 0.005
    assert error(ring=8) < 0.004
    assert error(shunting=False) > 0.02


def test_a_disc_with_a_hole_against_the_exact_resistance():
    """Between ring electrodes around a hole the resistance of an annulus is ln(b/a) / 2 pi."""
    angle = 2 * np.pi * np.arange(48) / 48
    circle = np.column_stack([np.cos(angle), np.sin(angle)])
    outline = Outline.circle(0.1, holes=[0.03 * circle])
    layout = Layout("ring", outline, 1.0, 0.002, [[0.05, 0.0], [0.0, 0.08], [-0.08, 0.0]])
    sheet = FemSheet(layout, h=0.004)
    outer, inner = (r * circle for r in (0.095, 0.035))
    transfer = sheet.transfer(np.concatenate([outer, inner]), 1e-4)
    feed = np.concatenate([np.full(48, 1 / 48), np.full(48, -1 / 48)])
    seen = transfer.among(np.arange(96)) @ feed
    mean = seen[:48].mean() - seen[48:].mean()
    # rings of points at 0.035 and 0.095 m; between them nothing is fed in; a ring of n points adds
    # ln(ring radius / (n point radius)) / (2 pi n) of its own
    own = sum(np.log(r / (48 * 1e-4)) / (2 * np.pi * 48) for r in (0.035, 0.095))
    assert mean - own == pytest.approx(np.log(95 / 35) / (2 * np.pi), rel=0.02)


def test_the_cheapest_model_that_can_do_it_is_taken():
    l_shape = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.0], [0.0, 0.0], [0.0, 0.1], [-0.1, 0.1]]
    positions = np.array([[-0.08, -0.08], [0.08, -0.08], [-0.08, 0.08], [-0.02, -0.02]])
    bent = Layout("l", Outline.polygon(l_shape), 1e4, 0.003, positions)
    sheet = make_sheet(bent)
    impedance = transfer_impedances(sheet.electrode_electrode)
    assert impedance[1, 2, 2] > impedance[1, 3, 3] > 0  # round the corner is farther
    layout = equal_grid(2, 2, (0.2, 0.2), 0.005, 1e4)
    uneven = {"resistance": lambda points: 1e4 * (1 + points[:, 0])}
    taken = [each.model for each in (sheet, make_sheet(layout), make_sheet(layout, **uneven))]
    assert taken == ["fem", "closed_form", "fem"]
    for what, model, options, complaint in (
        (bent, "closed_form", {}, "rectangle"),
        (layout, "closed_form", uneven, "uniform"),
        (layout, "bem", {}, "none of auto, fem, closed_form"),
    ):
        with pytest.raises(InputError, match=complaint):
            make_sheet(what, model, **options)


def test_a_sheet_of_two_halves():
    """Halves of 1 and 3 ohm/sq in series along a strip: potential drops as 1 : 3."""
    strip = Outline.rectangle(0.4, 0.02)
    layout = Layout("strip", strip, 2.0, 0.001, [[-0.19, 0.0], [0.19, 0.0]])
    sheet = FemSheet(layout, h=0.0025, resistance=lambda p: np.where(p[:, 0] < 0, 1.0, 3.0))
    where = np.array([[-0.15, 0.0], [-0.05, 0.0], [0.05, 0.0], [0.15, 0.0]])
    potential = np.diff(sheet.transfer(where, 1e-3).electrode_point, axis=0)[0]
    drop = np.diff(potential)
    assert drop[0] == pytest.approx(0.1 / 0.02, rel=1e-3)
    assert drop[2] / drop[0] == pytest.approx(3.0, rel=1e-3)


ANGLE = 2 * np.pi * np.arange(24) / 24
CIRCLE = np.column_stack([np.cos(ANGLE), np.sin(ANGLE)])
SLIT = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [0.002, 0.1], [0.002, -0.05], [-0.002, -0.05]]
SLIT += [[-0.002, 0.1], [-0.1, 0.1]]
OUTLINES = {
    "rectangle": Outline.rectangle(0.2, 0.05),
    "circle": Outline.circle(0.1),
    "holes": Outline.rectangle(0.2, 0.2, holes=[0.02 * CIRCLE + 0.03, 0.01 * CIRCLE - 0.04]),
    "slit": Outline.polygon(SLIT),
    # a walk to points beyond it went round and round
    "slanted": Outline.polygon([[-0.1, -0.08], [0.1, -0.08], [0.06, 0.08], [-0.1, 0.08]]),
}


def mesh_of(kind, h=0.005):
    positions = np.array([[-0.08, 0.01], [0.08, -0.01], [0.06, 0.0]])
    if kind == "slanted":
        positions = np.stack(np.meshgrid(*2 * [np.linspace(-0.054, 0.054, 5)]), -1).reshape(-1, 2)
    return make_mesh(Layout(kind, OUTLINES[kind], 1e4, 0.0025, positions), h)


@pytest.mark.parametrize("kind", OUTLINES)
def test_triangles_are_counter_clockwise_fill_the_outline_and_hold_its_points(kind):
    mesh = mesh_of(kind)
    a, b, c = (mesh.points[mesh.triangles[:, i]] for i in range(3))
    areas = np.linalg.det(np.stack([b - a, c - a], axis=1)) / 2
    assert areas.min() > 0
    assert areas.sum() == pytest.approx(OUTLINES[kind].area, rel=1e-3)
    assert np.array_equal(np.unique(mesh.triangles), np.arange(len(mesh.points)))
    # points are found, whatever lies between: a hole, a slit narrower than an element; others need an answer only
    outline = OUTLINES[kind]
    points = np.random.default_rng(1).uniform(-0.12, 0.12, (3000, 2))
    points = np.concatenate([points, mesh.points])
    inside = outline.contains(points) & (outline.rim_distance(points) > 1e-3)
    inside[3000:] = True
    element, weights = mesh.locate(points)
    assert weights.min() > -1e-8
    found = np.einsum("qc,qcx->qx", weights, mesh.points[mesh.triangles[element]])
    np.testing.assert_allclose(found[inside], points[inside], atol=1e-9)


def test_points_beside_the_mesh_take_a_corner_of_the_nearest_triangle():
    mesh = mesh_of("holes")
    points = np.array([[0.11, 0.02], [0.0, -0.3], [0.03, 0.03], [-0.04, -0.041]])
    element, weights = mesh.locate(points)
    assert np.array_equal(np.sort(weights, axis=1), np.tile([0.0, 0.0, 1.0], (4, 1)))
    corner = mesh.points[mesh.triangles[element, weights.argmax(axis=1)]]
    apart = np.linalg.norm(mesh.points[:, None] - points, axis=2).min(axis=0)
    assert (np.linalg.norm(corner - points, axis=1) < apart + 0.005).all()


@pytest.mark.parametrize("from_rim", [False, True])
def test_no_triangle_lies_across_a_slit(from_rim):
    """Of a sheet that is cut at y = 27 mm, half a millimetre wide, 90 mm long or from the rim."""
    low, high = -0.1 if from_rim else -0.045, 0.045
    slit = [(low, 0.02675), (high, 0.02675), (high, 0.02725), (low, 0.02725)]
    notched = [(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1), *slit[::-1]]
    cut = Outline.polygon(notched) if from_rim else Outline.rectangle(0.2, 0.2, holes=[slit])
    whole = equal_grid(8, 8, (0.2, 0.2), 0.0025, 1e4)
    torn = replace(whole, outline=cut)
    mesh = make_mesh(torn, 0.005)
    inside = Region(slit)
    for first, second in ((0, 1), (1, 2), (2, 0)):
        middles = mesh.points[mesh.triangles[:, [first, second]]].mean(axis=1)
        assert not (inside.contains(middles) & (inside.rim_distance(middles) > 1e-6)).any()
    torn, whole = (
        -bordered_inverse(FemSheet(each).electrode_electrode, np.arange(64))
        for each in (torn, whole)
    )
    across = 36, 44  # electrodes on either side of the middle of the slit
    assert 0 < torn[across] < 0.1 * whole[across]


def test_a_sheet_that_was_changed_has_the_errors_of_the_best_model_of_the_whole_one():
    """Couplings of a torn sheet, against the reference model; beside its ends neither is right."""
    pytest.importorskip("gmsh")
    layout = equal_grid(4, 4, (0.1, 0.1), 0.0025, 1e4)
    cut = torn(layout, ((-0.02, 0.01, 0.03, 0.01),))
    whole, same, changed = ClosedFormSheet(layout, ring=16), FemSheet(layout), FemSheet(cut)
    one, true = ChangedSheet(whole, same, changed), ReferenceSheet(cut).solve([]).between
    strong = np.triu(true > 0.2 * true.max(), 1)
    rough, good = (
        np.log(-bordered_inverse(each.electrode_electrode, np.arange(16))[:-1, :-1][strong])
        for each in (changed, one)
    )
    assert np.median(np.abs(good - np.log(true[strong]))) < 1e-3
    assert np.median(np.abs(rough - np.log(true[strong]))) > 5e-3
    points = points_away(layout, 0.01)
    none = ChangedSheet(whole, same, same).transfer(points, 0.002)
    exact = whole.transfer(points, 0.002)
    np.testing.assert_allclose(none.electrode_point, exact.electrode_point, rtol=1e-9)
    np.testing.assert_allclose(none.among(range(9)), exact.among(range(9)), rtol=1e-9)
