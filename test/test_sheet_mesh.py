"""Meshes: triangles that fill the outline, the same each time, and points found in them."""

import numpy as np
import pytest

from tomotactile_ros.estimation.uneven import bordered_inverse
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.layouts.region import Region
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.sheet.mesh import make_mesh

ANGLE = 2 * np.pi * np.arange(24) / 24
CIRCLE = np.column_stack([np.cos(ANGLE), np.sin(ANGLE)])
SLIT = [[-0.1, -0.1], [0.1, -0.1], [0.1, 0.1], [0.002, 0.1], [0.002, -0.05], [-0.002, -0.05]]
SLIT += [[-0.002, 0.1], [-0.1, 0.1]]
OUTLINES = {
    "rectangle": Outline.rectangle(0.2, 0.05),
    "circle": Outline.circle(0.1),
    "holes": Outline.rectangle(0.2, 0.2, holes=[0.02 * CIRCLE + 0.03, 0.01 * CIRCLE - 0.04]),
    "slit": Outline.polygon(SLIT),
}


def mesh_of(kind, h=0.005):
    positions = np.array([[-0.08, 0.01], [0.08, -0.01], [0.06, 0.0]])
    return make_mesh(Layout(kind, OUTLINES[kind], 1e4, 0.0025, positions), h)


def doubled_areas(mesh):
    a, b, c = (mesh.points[mesh.triangles[:, i]] for i in range(3))
    return (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]


@pytest.mark.parametrize("kind", OUTLINES)
def test_triangles_are_counter_clockwise_and_fill_the_outline(kind):
    mesh = mesh_of(kind)
    areas = doubled_areas(mesh) / 2
    assert areas.min() > 0
    assert areas.sum() == pytest.approx(OUTLINES[kind].area, rel=1e-3)
    assert np.array_equal(np.unique(mesh.triangles), np.arange(len(mesh.points)))


@pytest.mark.parametrize("kind", OUTLINES)
def test_points_are_found_in_their_triangle(kind):
    """Whatever lies between: a hole, a slit narrower than an element."""
    mesh, outline = mesh_of(kind), OUTLINES[kind]
    points = np.random.default_rng(1).uniform(-0.1, 0.1, (3000, 2))
    points = points[outline.contains(points) & (outline.rim_distance(points) > 1e-3)]
    points = np.concatenate([points, mesh.points])
    element, weights = mesh.locate(points)
    assert weights.min() > -1e-8
    found = np.einsum("qc,qcx->qx", weights, mesh.points[mesh.triangles[element]])
    np.testing.assert_allclose(found, points, atol=1e-9)


def test_points_beside_the_mesh_take_a_corner_of_the_nearest_triangle():
    mesh = mesh_of("holes")
    points = np.array([[0.11, 0.02], [0.0, -0.3], [0.03, 0.03], [-0.04, -0.041]])
    element, weights = mesh.locate(points)
    assert np.array_equal(np.sort(weights, axis=1), np.tile([0.0, 0.0, 1.0], (4, 1)))
    corner = mesh.points[mesh.triangles[element, weights.argmax(axis=1)]]
    apart = np.linalg.norm(mesh.points[:, None] - points, axis=2).min(axis=0)
    assert (np.linalg.norm(corner - points, axis=1) < apart + 0.005).all()


def test_points_beyond_a_slanted_outline_are_found_too():
    """A walk to them went round and round."""
    at = np.linspace(-0.054, 0.054, 5)
    positions = np.array([[x, y] for y in at for x in at])
    slanted = Outline.polygon([[-0.1, -0.08], [0.1, -0.08], [0.06, 0.08], [-0.1, 0.08]])
    mesh = make_mesh(Layout("slanted", slanted, 1e4, 0.003, positions), 0.005)
    points = np.random.default_rng(1).uniform(-0.12, 0.12, (3000, 2))
    element, weights = mesh.locate(points)
    inside = slanted.contains(points) & (slanted.rim_distance(points) > 1e-3)
    found = np.einsum("qc,qcx->qx", weights, mesh.points[mesh.triangles[element]])
    np.testing.assert_allclose(found[inside], points[inside], atol=1e-9)


@pytest.mark.parametrize("from_rim", [False, True])
def test_no_triangle_lies_across_a_slit(from_rim):
    """Of a sheet that is cut at y = 27 mm, half a millimetre wide, 90 mm long or from the rim."""
    low, high = -0.1 if from_rim else -0.045, 0.045
    slit = [(low, 0.02675), (high, 0.02675), (high, 0.02725), (low, 0.02725)]
    at = np.linspace(-0.1, 0.1, 8)
    places = np.array([[x, y] for y in at for x in at])
    notched = [(-0.1, -0.1), (0.1, -0.1), (0.1, 0.1), (-0.1, 0.1), *slit[::-1]]
    drawn = Outline.rectangle(0.2, 0.2)
    cut = Outline.polygon(notched) if from_rim else Outline.rectangle(0.2, 0.2, holes=[slit])
    torn, whole = (Layout("slit", each, 1e4, 0.0025, places) for each in (cut, drawn))
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
