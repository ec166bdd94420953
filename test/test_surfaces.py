"""Bent sheets: where points lie in space, and that bending keeps lengths."""

import bz2
import struct

import numpy as np
import pytest

from tomotactile_ros.layouts.layout import equal_grid, load_layout
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.surfaces import Cylinder, Flat, Mesh, PointGrid

SIZE = (0.2, 0.15)
RADIUS = 0.05
POINTS = np.random.default_rng(5).uniform(-0.5, 0.5, (40, 2)) * SIZE


def grid_of(surface, rows=13, columns=17, size=SIZE):
    """The surface again, as points of it."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, columns), np.linspace(-0.5, 0.5, rows))
    points = np.column_stack([x.ravel() * size[0], y.ravel() * size[1]])
    return PointGrid(surface.to_3d(points).reshape(rows, columns, 3), size)


SURFACES = [Flat(), Cylinder(RADIUS), grid_of(Cylinder(RADIUS))]


@pytest.mark.parametrize("surface", SURFACES, ids=lambda s: s.kind)
def test_jacobians_are_the_derivatives_of_positions(surface):
    step = 1e-6
    for axis in (0, 1):
        shift = step * np.eye(2)[axis]
        change = surface.to_3d(POINTS + shift) - surface.to_3d(POINTS - shift)
        found = surface.jacobians(POINTS)[:, :, axis]
        np.testing.assert_allclose(found, change / (2 * step), atol=1e-6)


@pytest.mark.parametrize("surface", SURFACES, ids=lambda s: s.kind)
def test_frames_are_rotations_with_the_normal_out_of_the_sheet(surface):
    frames = surface.frames(POINTS)
    np.testing.assert_allclose(
        frames @ np.swapaxes(frames, 1, 2), np.tile(np.eye(3), (40, 1, 1)), atol=1e-12
    )
    np.testing.assert_allclose(np.linalg.det(frames), 1.0)
    middle = surface.frames(np.zeros((1, 2)))[0]
    np.testing.assert_allclose(middle, np.eye(3), atol=1e-6)


@pytest.mark.parametrize("surface", SURFACES, ids=lambda s: s.kind)
def test_the_nearest_point_of_a_place_above_the_sheet_is_the_one_below_it(surface):
    above = surface.to_3d(POINTS) + 0.004 * surface.normals(POINTS)
    np.testing.assert_allclose(surface.nearest(above, SIZE), POINTS, atol=1e-9)
    assert np.isnan(surface.nearest([[np.nan, 0.0, 0.0]], SIZE)).any()


def test_a_grid_of_points_stands_for_the_cylinder_that_they_are_of():
    cylinder, grid = Cylinder(RADIUS), grid_of(Cylinder(RADIUS))
    np.testing.assert_allclose(grid.to_3d(POINTS), cylinder.to_3d(POINTS), atol=2e-5)
    np.testing.assert_allclose(grid.normals(POINTS), cylinder.normals(POINTS), atol=2e-3)


@pytest.mark.parametrize(
    "points, complaint",
    [
        (np.zeros((1, 2, 3)), "grid: needs 2 x 2 points"),
        (1000 * grid_of(Flat()).points, "become 1e.03 to 1e.03 times as long.*in m"),
        (np.zeros((2, 2, 3)), "become 0 to 0 times"),
        (np.full((2, 2, 3), np.nan), r"grid.points\[0\]: has no finite lengths"),
    ],
)
def test_points_that_are_no_sheet_are_refused(points, complaint):
    with pytest.raises(InputError, match=complaint):
        PointGrid(points, SIZE)


def tube(radius: float, turns: int = 720) -> str:
    """OFF file of a cylinder about the z axis, a prism of many sides, long rectangles in halves."""
    angles = 2 * np.pi * np.arange(turns) / turns
    ring = np.column_stack([radius * np.cos(angles), radius * np.sin(angles)])
    vertices = [(*p, z) for z in (-1.0, -0.03, 0.02, 1.0) for p in ring]
    faces = []
    for level in range(3):
        for k in range(turns):
            a, b = level * turns + k, level * turns + (k + 1) % turns
            faces += [(a, b, b + turns), (a, b + turns, a + turns)]
    lines = ["OFF", f"{len(vertices)} {len(faces)} 0"]
    lines += [" ".join(map(str, v)) for v in vertices]
    lines += [" ".join(map(str, (3, *f))) for f in faces]
    return "\n".join(lines)


def on_tube(tmp_path, size=SIZE, **changes):
    pytest.importorskip("trimesh")
    (tmp_path / "tube.off").write_text(tube(1000 * RADIUS))
    keys = {"file": "tube.off", "center": (0.0, RADIUS, 0.0), "x_axis": (-1.0, 0.0, 0.0)}
    keys |= {"scale": 1e-3, "folder": tmp_path, "size": size, **changes}
    return Mesh.load(**keys)


def test_a_sheet_on_the_mesh_of_a_tube_is_bent_like_on_a_cylinder(tmp_path):
    """The tube's axis is z there, the cylinder's y; heights of 2 m in units of mm."""
    size = (0.2, 0.0018)
    points = POINTS / SIZE * size
    mesh = on_tube(tmp_path, size)
    x, y, z = Cylinder(RADIUS).to_3d(points).T
    expected = np.column_stack([-x, z + RADIUS, y])
    np.testing.assert_allclose(mesh.to_3d(points), expected, atol=RADIUS * (2 * np.pi / 720))
    lengths = np.linalg.svd(mesh.jacobians(points), compute_uv=False)
    np.testing.assert_allclose(lengths, 1.0, atol=0.02)
    outwards = np.column_stack([expected[:, :2] / RADIUS, np.zeros(len(points))])
    np.testing.assert_allclose(mesh.normals(points), outwards, atol=0.02)


def test_a_sheet_on_a_ball_keeps_the_lengths_from_its_centre(tmp_path):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.icosphere(subdivisions=5, radius=0.3).export(tmp_path / "ball.stl")
    mesh = Mesh.load("ball.stl", (0.0, 0.0, 0.3), (1.0, 0.0, 0.0), 1.0, tmp_path, SIZE)
    places = mesh.to_3d(POINTS)
    np.testing.assert_allclose(np.linalg.norm(places, axis=1), 0.3, rtol=1e-3)
    distance = 0.3 * np.arccos(places[:, 2] / np.linalg.norm(places, axis=1))
    np.testing.assert_allclose(distance, np.linalg.norm(POINTS, axis=1), atol=5e-4)
    np.testing.assert_allclose(mesh.normals(POINTS), places / 0.3, atol=0.03)


def stl(*corners: float, count: int | None = None) -> bytes:
    """A binary STL of triangles; nine numbers each."""
    triangles = np.reshape(corners, (-1, 9))
    body = b"".join(struct.pack("<12fH", 0, 0, 1, *t, 0) for t in triangles)
    return bytes(80) + struct.pack("<I", len(triangles) if count is None else count) + body


@pytest.mark.parametrize(
    "name, data, complaint",
    [
        ("m.stl", stl(*range(9), count=4_000_000_000), "is damaged, or no STL file"),
        ("m.stl", stl(*[0.0] * 27), "no triangle has an area"),
        ("m.stl", stl(-1e30, 0, 0, 1e30, 0, 0, 0, 1e30, 0), "a corner has no finite lengths"),
        ("m.ply", b"ply\nformat SECRET 1.0\nelement vertex SECRET\nend_header\n", "no PLY file"),
        ("m.off", b"OFF\n4000000000 4000000000 0\n0 0 0\n", "no OFF file"),
        ("m.off", b"OFF\n3 1 0\n0 0 0\n1 0 0\n0 1 0\n3 0 1 99\n", "no OFF file"),
        ("m.bz2", 100 * bz2.compress(bytes(10**6)), "meshes are .stl"),
    ],
)
def test_a_hostile_mesh_is_one_line_that_tells_nothing_of_it(tmp_path, name, data, complaint):
    pytest.importorskip("trimesh")
    (tmp_path / name).write_bytes(data)
    with pytest.raises(InputError, match=complaint) as refusal:
        Mesh.load(name, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0), 1.0, tmp_path, SIZE)
    assert "SECRET" not in str(refusal.value)


def test_layouts_with_any_surface_survive_their_file(tmp_path):
    flat = equal_grid(3, 3, (0.2, 0.0018), 1e-4, 1e4)
    (tmp_path / "there").mkdir()
    mesh = on_tube(tmp_path, flat.outline.size)
    grid = grid_of(Cylinder(RADIUS), 3, 9, flat.outline.size)
    for surface in (Flat(), Cylinder(RADIUS), grid, mesh):
        from dataclasses import replace

        file = tmp_path / "there" / f"{surface.kind}.yaml"
        replace(flat, surface=surface).save(file)
        again = load_layout(file).surface
        assert again.kind == surface.kind
        points = flat.positions
        np.testing.assert_allclose(again.to_3d(points), surface.to_3d(points), atol=1e-12)
