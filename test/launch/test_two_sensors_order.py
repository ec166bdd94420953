"""two_sensors.launch.py fails before it has started anything, where a package is missing."""

import importlib.util

import pytest

for package in ("launch", "launch_ros"):
    pytest.importorskip(package, reason=f"{package} comes with a full ROS 2")

from launch_ros.actions import Node
from launch_support import FOLDER

from launch import LaunchContext

spec = importlib.util.spec_from_file_location("two_sensors", FOLDER / "two_sensors.launch.py")
two_sensors = importlib.util.module_from_spec(spec)
spec.loader.exec_module(two_sensors)


def test_what_may_be_missing_is_started_first():
    context = LaunchContext()
    context.launch_configurations["viz"] = "true"
    *declared, _ = two_sensors.generate_launch_description().entities
    for argument in declared:
        argument.execute(context)
    actions = two_sensors.start(context)
    own = [not isinstance(a, Node) or a.node_package == "tomotactile_ros" for a in actions]
    assert own == [False, False, True, True, True]
