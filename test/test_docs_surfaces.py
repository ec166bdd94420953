"""docs/surfaces.md followed to the letter: its YAML are layouts, and on the mesh contacts, markers,
cloud, layout and its own sum of covariances agree with a tube by hand."""

import re
from pathlib import Path

import numpy as np
import pytest
import yaml
from scipy.spatial.transform import Rotation

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import ContactEstimate
from tomotactile_ros.spatial import in_space

ROOT = Path(__file__).resolve().parent.parent
TEXT = (ROOT / "docs" / "surfaces.md").read_text("utf-8")
BLOCKS = re.findall(r"```(\w+)\n(.*?)```", TEXT, re.DOTALL)
GRID, MESH = (code for language, code in BLOCKS if language == "yaml")
(COVARIANCE_IN_SPACE,) = (code for language, code in BLOCKS if language == "python")
RADIUS = 0.05  # m, of the forearm
WHERE, SPEED = (0.04, -0.03), (0.2, 0.1)  # m, m/s on the sheet
COVARIANCE = np.array([[4e-8, 1e-8], [1e-8, 9e-8]])


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


def test_on_the_mesh_contacts_markers_cloud_and_layout_agree(forearm):
    pytest.importorskip("rclpy")
    from tomotactile_ros.nodes import contact_messages, conversions
    from tomotactile_ros.nodes.markers import ContactMarkers, layout_markers

    header = conversions.make_header(1.0, "forearm_link")
    place, step = on_tube(*WHERE), 1e-6
    along_x, along_y = (
        (on_tube(*(WHERE + s)) - on_tube(*(WHERE - s))) / (2 * step) for s in step * np.eye(2)
    )
    normal = place * [1, 1, 0] / RADIUS
    found = ContactEstimate(
        *WHERE, 2.0, 2e4, 1e-4, 0.006, tuple(COVARIANCE.ravel()), velocity=SPEED
    )
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
    np.testing.assert_allclose(known["covariance"], slopes @ COVARIANCE @ slopes.T, atol=3e-9)

    arrow, disc = ContactMarkers().of([found], placed, header).markers
    turn = disc.pose.orientation
    axis = Rotation.from_quat([turn.x, turn.y, turn.z, turn.w]).apply([0, 0, 1])
    for shown in (disc.pose.position, arrow.points[1]):
        np.testing.assert_array_equal(xyz(shown), xyz(contact.position))
    np.testing.assert_allclose(axis, xyz(contact.normal), atol=1e-9)
    outwards = xyz(arrow.points[0]) - xyz(arrow.points[1])
    np.testing.assert_allclose(outwards / np.linalg.norm(outwards), axis, atol=1e-9)

    grid = Grid.for_outline(forearm.outline, 40)
    cloud = conversions.cloud_to_message(
        forearm.surface.to_3d(grid.pixels), np.zeros(len(grid.pixels)), header
    )
    points = np.frombuffer(cloud.data, np.float32).reshape(-1, 4)[:, :3]
    described = contact_messages.layout_to_message(forearm, grid, header)
    np.testing.assert_allclose(points, [xyz(c) for c in described.cells], atol=1e-7)
    nearest = points[np.linalg.norm(points - place, axis=1).argmin()]
    assert np.linalg.norm(nearest - place) < np.hypot(*grid.cell_size)
    electrodes = [xyz(e) for e in described.electrodes]
    np.testing.assert_allclose(electrodes, [on_tube(*p) for p in forearm.positions], atol=2e-5)
    drawn = [m for m in layout_markers(forearm, header).markers if m.ns == "electrode"]
    np.testing.assert_allclose([xyz(m.pose.position) for m in drawn], electrodes, atol=1e-7)
