"""The two models of the sheet against each other and against what physics demands."""

import numpy as np
import pytest

from tomotactile_ros.layouts.layout import Layout, equal_grid
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.closed_form import ClosedFormSheet
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.sheet.green import green_rectangle, green_rectangle_self
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


def test_closed_form_satisfies_its_equation():
    """-laplace G = -1/area away from the source, and the mean over the sheet is zero."""
    size, source, step = (0.2, 0.13), np.array([[0.031, -0.02]]), 1e-4
    star = np.array([[0, 0], [1, 0], [-1, 0], [0, 1], [0, -1]]) * step + [-0.05, 0.03]
    value = green_rectangle(star, source, size)[:, 0]
    laplacian = (value[1:].sum() - 4 * value[0]) / step**2
    assert laplacian == pytest.approx(1 / (size[0] * size[1]), rel=1e-4)
    x, y = ((np.arange(400) + 0.5) / 400 - 0.5 for _ in range(2))
    grid = np.stack(np.meshgrid(x * size[0], y * size[1]), axis=-1).reshape(-1, 2)
    assert abs(green_rectangle(grid, source, size, 1e-4).mean()) < 1e-4


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
    errors = [
        np.sqrt(np.mean((differences(FemSheet(layout, h=h, ring=round(0.32 / h), shunting=False))
                         - exact) ** 2))
        for h in sizes
    ]  # fmt: skip
    rate = np.polyfit(np.log(sizes), np.log(errors), 1)[0]
    assert rate > 1.8, errors


@pytest.mark.parametrize("model", ["fem", "closed_form"])
@pytest.mark.parametrize("shunting", [True, False])
def test_reciprocity(model, shunting):
    layout = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
    sheet = make_sheet(layout, model, shunting=shunting)
    between = sheet.electrode_electrode
    assert np.abs(between - between.T).max() < 1e-10 * np.abs(between).max()
    transfer = sheet.transfer(points_away(layout, 0.01, 30), 0.002)
    among = transfer.among(np.arange(len(transfer.points)))
    assert np.abs(among - among.T).max() < 1e-10 * np.abs(among).max()


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


def test_a_transfer_restricted_to_some_points_is_the_same_sheet():
    layout = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
    for model in ("fem", "closed_form"):
        whole = make_sheet(layout, model).transfer(points_away(layout, 0.01, 30), 0.002)
        some = whole.at([4, 2, 9])
        np.testing.assert_array_equal(some.points, whole.points[[4, 2, 9]])
        np.testing.assert_allclose(some.among([0, 2]), whole.among([4, 9]), rtol=1e-9)
        np.testing.assert_array_equal(some.impedance(3), whole.impedance(3)[:, [4, 2, 9]])


def symmetries(count):
    """Each symmetry of the square: how it moves points, and how it numbers a grid of electrodes."""
    grid = np.arange(count**2).reshape(count, count)
    turned, order = np.eye(2), grid
    for _ in range(4):
        turned, order = turned @ [[0, 1], [-1, 0]], np.rot90(order, -1)
        yield turned, order.ravel()
        yield turned * [[-1], [1]], order[:, ::-1].ravel()


def test_electrodes_see_the_symmetries_of_the_square():
    layout = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
    for model in ("fem", "closed_form"):
        plain = transfer_impedances(make_sheet(layout, model).electrode_electrode)
        for _, order in symmetries(4):
            moved = plain[np.ix_(order, order, order)]
            np.testing.assert_allclose(moved, plain, atol=1e-9 * plain.max())


def test_points_see_the_symmetries_of_the_square():
    """At mesh nodes; between them the diagonals of squares, which fall either way, show."""
    layout = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
    nodes = make_sheet(layout, "fem").mesh.points
    distance = np.linalg.norm(nodes[:, None] - layout.positions, axis=2).min(axis=1)
    points = nodes[distance > 0.008][::40]
    for model in ("closed_form", "fem"):
        sheet = make_sheet(layout, model)
        plain = sheet.transfer(points, 0.002).impedance(5)
        for turned, _ in symmetries(4):
            moved_electrodes = layout.positions @ turned
            apart = np.linalg.norm(layout.positions[:, None] - moved_electrodes, axis=2)
            index = apart.argmin(axis=0)
            moved = sheet.transfer(points @ turned, 0.002).impedance(index[5])[index]
            np.testing.assert_allclose(moved, plain, atol=1e-9 * plain.max())


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
    layout = Layout(
        "ring",
        Outline.circle(0.1, holes=[0.03 * circle]),
        1.0,
        0.002,
        np.array([[0.05, 0.0], [0.0, 0.08], [-0.08, 0.0]]),
    )
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


def test_outlines_that_only_finite_elements_can_do():
    l_shape = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.0], [0.0, 0.0], [0.0, 0.1], [-0.1, 0.1]]
    positions = np.array([[-0.08, -0.08], [0.08, -0.08], [-0.08, 0.08], [-0.02, -0.02]])
    layout = Layout("l", Outline.polygon(l_shape), 1e4, 0.003, positions)
    sheet = make_sheet(layout)
    assert sheet.model == "fem"
    impedance = transfer_impedances(sheet.electrode_electrode)
    assert impedance[1, 2, 2] > impedance[1, 3, 3] > 0  # round the corner is farther
    with pytest.raises(InputError, match="rectangle"):
        make_sheet(layout, "closed_form")
    with pytest.raises(InputError, match="none of auto, fem, closed_form"):
        make_sheet(layout, "bem")


def test_auto_takes_the_cheapest_model_that_can_do_it():
    layout = equal_grid(2, 2, (0.2, 0.2), 0.005, 1e4)
    assert make_sheet(layout).model == "closed_form"
    uneven = {"resistance": lambda points: 1e4 * (1 + points[:, 0])}
    assert make_sheet(layout, **uneven).model == "fem"
    with pytest.raises(InputError, match="uniform"):
        make_sheet(layout, "closed_form", **uneven)


def test_a_sheet_of_two_halves():
    """Halves of 1 and 3 ohm/sq in series along a strip: potential drops as 1 : 3."""
    layout = Layout(
        "strip", Outline.rectangle(0.4, 0.02), 2.0, 0.001, np.array([[-0.19, 0.0], [0.19, 0.0]])
    )
    sheet = FemSheet(layout, h=0.0025, resistance=lambda p: np.where(p[:, 0] < 0, 1.0, 3.0))
    where = np.array([[-0.15, 0.0], [-0.05, 0.0], [0.05, 0.0], [0.15, 0.0]])
    potential = np.diff(sheet.transfer(where, 1e-3).electrode_point, axis=0)[0]
    drop = np.diff(potential)
    assert drop[0] == pytest.approx(0.1 / 0.02, rel=1e-3)
    assert drop[2] / drop[0] == pytest.approx(3.0, rel=1e-3)
