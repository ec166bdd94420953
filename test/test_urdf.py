"""urdf/*.xacro: a link whose frame is the sensor's; the example is where config/poses says it
is."""

from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from tomotactile_ros.skin import load_poses

xacro = pytest.importorskip("xacro", reason="xacro comes with a full ROS 2, or from PyPI")
ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def robot():
    document = xacro.process_file(str(ROOT / "urdf" / "two_sensors.urdf.xacro"))
    return ElementTree.fromstring(document.toxml())


def origin_of(element):
    origin = element.find("origin")
    xyz, rpy = (np.array(origin.get(key, "0 0 0").split(), float) for key in ("xyz", "rpy"))
    return xyz, Rotation.from_euler("xyz", rpy)


def test_the_sensors_surface_is_the_top_of_its_link(robot):
    for name in ("left_link", "right_link"):
        (link,) = (e for e in robot.findall("link") if e.get("name") == name)
        for part in ("visual", "collision"):
            xyz, _ = origin_of(link.find(part))
            size = np.array(link.find(f"{part}/geometry/box").get("size").split(), float)
            assert (xyz + size / 2)[2] == pytest.approx(0.0, abs=1e-12)
            assert size[:2].tolist() == [0.2, 0.2]


def test_the_poses_for_the_skin_without_tf2_are_those_of_the_robot(robot):
    poses = load_poses(ROOT / "config" / "poses" / "two_sensors.yaml", "base_link")
    joints = {joint.find("child").get("link"): joint for joint in robot.findall("joint")}
    assert set(joints) == set(poses)
    for name, pose in poses.items():
        assert joints[name].find("parent").get("link") == "base_link"
        xyz, rotation = origin_of(joints[name])
        np.testing.assert_allclose(pose.translation, xyz)
        assert (pose.rotation.inv() * rotation).magnitude() < 1e-9
        # upright, and away from the block
        outwards = {"left_link": 1, "right_link": -1}[name]
        np.testing.assert_allclose(pose.directions([0, 1, 0]), [0, 0, 1], atol=1e-9)
        np.testing.assert_allclose(pose.directions([0, 0, 1]), [0, outwards, 0], atol=1e-9)
