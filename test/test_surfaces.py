"""Bent sheets: where points lie in space; contacts there, by differences and moments. docs/surfaces.md
followed to the letter: its YAML are layouts, and on the mesh contacts, markers, layout and its own sum of
covariances agree with a tube by hand."""

import bz2
import re
import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import equal_grid, load_layout
from tomotactile_ros.reconstruction import ContactEstimate
from tomotactile_ros.spatial import Pose, in_space, wrench_of
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
def test_derivatives_frames_and_nearest_points_are_those_of_positions(surface):
    step, jacobians, frames = 1e-6, surface.jacobians(POINTS), surface.frames(POINTS)
    for axis in (0, 1):
        shift = step * np.eye(2)[axis]
        change = surface.to_3d(POINTS + shift) - surface.to_3d(POINTS - shift)
        np.testing.assert_allclose(jacobians[:, :, axis], change / (2 * step), atol=1e-6)
    turned = frames @ np.swapaxes(frames, 1, 2)
    np.testing.assert_allclose(turned, np.tile(np.eye(3), (40, 1, 1)), atol=1e-12)
    np.testing.assert_allclose(np.linalg.det(frames), 1.0)
    np.testing.assert_allclose(surface.frames(np.zeros((1, 2)))[0], np.eye(3), atol=1e-6)
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


def on_ball(folder):
    trimesh = pytest.importorskip("trimesh")
    trimesh.creation.icosphere(subdivisions=5, radius=300.0).export(folder / "ball.stl")
    return Mesh.load("ball.stl", (0.0, 0.0, 0.3), (1.0, 0.0, 0.0), 1e-3, folder, SIZE)


def test_a_sheet_on_a_ball_keeps_the_lengths_from_its_centre(tmp_path):
    mesh = on_ball(tmp_path)
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
    flat = equal_grid(3, 3, SIZE, 1e-4, 1e4)
    for surface in (grid_of(Cylinder(RADIUS), 3, 9), on_ball(tmp_path)):
        file = tmp_path / f"{surface.kind}.yaml"
        replace(flat, surface=surface).save(file)
        again = load_layout(file).surface
        assert again.kind == surface.kind
        points = flat.positions
        np.testing.assert_allclose(again.to_3d(points), surface.to_3d(points), atol=1e-12)


COVARIANCE = (4e-8, 1e-8, 1e-8, 9e-8)


def contact_at(x=0.03, y=-0.02, force=2.0, velocity=(0.2, -0.1)):
    return ContactEstimate(x, y, force, 2e4, 1e-4, 0.006, COVARIANCE, velocity=velocity)


def test_a_velocity_is_that_of_the_position_on_the_surface():
    surface, step = Cylinder(0.05), 1e-5
    (velocity,) = in_space(surface, [contact_at()]).velocities
    later, before = (
        in_space(surface, [contact_at(0.03 + t * 0.2, -0.02 - t * 0.1)]).positions[0]
        for t in (step, -step)
    )
    np.testing.assert_allclose(velocity, (later - before) / (2 * step), atol=1e-6)


def test_moved_contacts_have_the_moved_wrench():
    """f' = R f, t' = R t + p x f' (Featherstone, Rigid Body Dynamics Algorithms, 2008, eq. 2.27)."""
    pose = Pose(np.array([0.3, -0.2, 0.5]), Rotation.from_euler("xyz", [0.3, -1.0, 2.0]))
    placed = in_space(Cylinder(0.05), [contact_at(), contact_at(-0.04, 0.05, 3.0)])
    force, torque = placed.wrench()
    normals = pose.directions(placed.frames[:, :, 2])
    moved = wrench_of(pose.positions(placed.positions), normals, placed.forces)
    rotated = pose.rotation.apply(force)
    np.testing.assert_allclose(moved[0], rotated)
    expected = pose.rotation.apply(torque) + np.cross(pose.translation, rotated)
    np.testing.assert_allclose(moved[1], expected)


# -- docs/surfaces.md ------------------------------------------------------------------------------

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "docs" / "surfaces.md").read_text("utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", TEXT, re.DOTALL)
GRID, MESH = (code for language, code in BLOCKS if language == "yaml")
(COVARIANCE_IN_SPACE,) = (code for language, code in BLOCKS if language == "python")
WHERE, SPEED = (0.04, -0.03), (0.2, 0.1)  # m, m/s on the sheet


def layout_with(example: str, folder):
    file = folder / "layout.yaml"
    plain = (ROOT / "config" / "layouts" / "equal-8x8.yaml").read_text("utf-8")
    file.write_text(f"{plain}\n{example}")
    return load_layout(file)


def test_the_points_of_the_example_are_on_its_surface(tmp_path):
    points = yaml.safe_load(GRID)["surface"]["grid"]["points"]
    steps = np.linspace(-0.1, 0.1, 3)
    x, y = np.meshgrid(steps, steps)
    places = layout_with(GRID, tmp_path).surface.to_3d(np.column_stack([x.ravel(), y.ravel()]))
    np.testing.assert_allclose(places, np.reshape(points, (9, 3)), atol=1e-12)


@pytest.fixture
def forearm(tmp_path, monkeypatch):
    """The layout of the example, on a tube along z that a robot's package shares, in mm."""
    trimesh = pytest.importorskip("trimesh")
    file = tmp_path / "share" / "my_robot_description" / "meshes" / "forearm.stl"
    file.parent.mkdir(parents=True)
    trimesh.creation.cylinder(1000 * RADIUS, 800.0, sections=256).export(file)
    monkeypatch.setenv("AMENT_PREFIX_PATH", str(tmp_path))
    return layout_with(MESH, tmp_path)


def on_tube(x: float, y: float) -> np.ndarray:
    """The sheet's x runs along z from the centre [0.05, 0, 0.12], its y around the tube."""
    return np.array([RADIUS * np.cos(y / RADIUS), -RADIUS * np.sin(y / RADIUS), 0.12 + x])


def xyz(vector) -> np.ndarray:
    return np.array([vector.x, vector.y, vector.z])


def test_on_the_mesh_contacts_markers_and_layout_agree(forearm):
    pytest.importorskip("rclpy")
    from tomotactile_ros.nodes import contact_messages, conversions
    from tomotactile_ros.nodes.markers import ContactMarkers, layout_markers

    header = conversions.make_header(1.0, "forearm_link")
    place, step = on_tube(*WHERE), 1e-6
    along_x, along_y = (
        (on_tube(*(WHERE + s)) - on_tube(*(WHERE - s))) / (2 * step) for s in step * np.eye(2)
    )
    normal = place * [1, 1, 0] / RADIUS
    found = contact_at(*WHERE, velocity=SPEED)
    placed = in_space(forearm.surface, [found])
    (contact,) = contact_messages.contacts_to_message([found], placed, header).contacts
    np.testing.assert_allclose(xyz(contact.position), place, atol=2e-5)
    np.testing.assert_allclose(xyz(contact.normal), normal, atol=0.02)
    np.testing.assert_allclose(xyz(contact.tangent), along_x, atol=0.02)
    velocity = along_x * SPEED[0] + along_y * SPEED[1]
    np.testing.assert_allclose(xyz(contact.velocity), velocity, atol=5e-3)

    known = {"np": np, "contact": contact}
    exec(COVARIANCE_IN_SPACE, known)  # noqa: S102 - what the document says is what is tried
    slopes = np.column_stack([along_x, along_y])
    np.testing.assert_allclose(
        known["covariance"], slopes @ np.reshape(COVARIANCE, (2, 2)) @ slopes.T, atol=3e-9
    )

    arrow, disc = ContactMarkers().of([found], placed, header).markers
    turn = disc.pose.orientation
    axis = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply([0, 0, 1])
    for shown in (disc.pose.position, arrow.points[1]):
        np.testing.assert_array_equal(xyz(shown), xyz(contact.position))
    np.testing.assert_allclose(axis, xyz(contact.normal), atol=1e-9)
    outwards = xyz(arrow.points[0]) - xyz(arrow.points[1])
    np.testing.assert_allclose(outwards, 0.02 * axis, atol=1e-9)  # of 2 N
    assert (disc.scale.x, disc.scale.y) == (0.012, 0.012)

    grid = Grid.for_outline(forearm.outline, 40)
    described = contact_messages.layout_to_message(forearm, grid, header)
    assert (described.layout_id, described.surface) == (forearm.id, "mesh")
    x = described.first_x + described.cell_width * np.arange(described.width)
    y = described.first_y - described.cell_height * np.arange(described.height)
    cells = [on_tube(across, up) for up in y for across in x]
    np.testing.assert_allclose([xyz(cell) for cell in described.cells], cells, atol=2e-5)
    electrodes = [xyz(e) for e in described.electrodes]
    np.testing.assert_allclose(electrodes, [on_tube(*p) for p in forearm.positions], atol=2e-5)
    drawn = [m for m in layout_markers(forearm, header).markers if m.ns == "electrode"]
    np.testing.assert_allclose([xyz(m.pose.position) for m in drawn], electrodes, atol=1e-7)
