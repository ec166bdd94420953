"""Contacts in space: against differences of positions, sampled clouds and moments by hand."""

import numpy as np
from scipy.spatial.transform import Rotation

from tomotactile_ros.reconstruction import ContactEstimate
from tomotactile_ros.spatial import Pose, in_space, wrench_of
from tomotactile_ros.surfaces import Cylinder, Flat

COVARIANCE = (4e-8, 1e-8, 1e-8, 9e-8)


def contact(x=0.03, y=-0.02, force=2.0, velocity=(0.2, -0.1)):
    return ContactEstimate(x, y, force, 2e4, 1e-4, 0.006, COVARIANCE, velocity=velocity)


def test_on_a_flat_sheet_everything_stays():
    placed = in_space(Flat(), [contact()])
    np.testing.assert_array_equal(placed.positions, [[0.03, -0.02, 0.0]])
    np.testing.assert_array_equal(placed.velocities, [[0.2, -0.1, 0.0]])
    np.testing.assert_array_equal(placed.covariances[0].ravel(), COVARIANCE)
    force, torque = placed.wrench()
    np.testing.assert_allclose(force, [0, 0, -2.0])
    np.testing.assert_allclose(torque, [0.04, 0.06, 0.0])


def test_a_velocity_is_that_of_the_position_on_the_surface():
    surface, step = Cylinder(0.05), 1e-5
    (velocity,) = in_space(surface, [contact()]).velocities
    later, before = (
        in_space(surface, [contact(0.03 + t * 0.2, -0.02 - t * 0.1)]).positions[0]
        for t in (step, -step)
    )
    np.testing.assert_allclose(velocity, (later - before) / (2 * step), atol=1e-6)


def test_a_covariance_in_space_is_that_of_many_contacts():
    surface, rng = Cylinder(0.05), np.random.default_rng(8)
    places = rng.multivariate_normal((0.03, -0.02), np.reshape(COVARIANCE, (2, 2)), 4000)
    sampled = np.cov(surface.to_3d(places).T)
    placed = in_space(surface, [contact()])
    along = placed.frames[0][:, :2]
    found = along @ placed.covariances[0] @ along.T
    np.testing.assert_allclose(found, sampled, atol=0.1 * max(COVARIANCE))


def test_opposite_contacts_around_a_cylinder_cancel_their_force_not_their_torque():
    radius = 0.05
    sides = [contact(x=s * radius * np.pi / 2, y=s * 0.03) for s in (-1, 1)]
    force, torque = in_space(Cylinder(radius), sides).wrench()
    np.testing.assert_allclose(force, 0, atol=1e-12)
    np.testing.assert_allclose(torque, [0, 0, 2 * 2.0 * 0.03], atol=1e-12)


def test_moved_contacts_have_the_moved_wrench():
    """f' = R f, t' = R t + p x f' (Featherstone, Rigid Body Dynamics Algorithms, 2008, eq.
    2.27)."""
    pose = Pose(np.array([0.3, -0.2, 0.5]), Rotation.from_euler("xyz", [0.3, -1.0, 2.0]))
    placed = in_space(Cylinder(0.05), [contact(), contact(-0.04, 0.05, 3.0)])
    force, torque = placed.wrench()
    normals = pose.directions(placed.frames[:, :, 2])
    moved = wrench_of(pose.positions(placed.positions), normals, placed.forces)
    rotated = pose.rotation.apply(force)
    np.testing.assert_allclose(moved[0], rotated)
    expected = pose.rotation.apply(torque) + np.cross(pose.translation, rotated)
    np.testing.assert_allclose(moved[1], expected)
