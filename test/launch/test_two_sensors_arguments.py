"""two_sensors.launch.py: every argument reaches its side alone, wrong ones are refused, and where a
package is missing it fails before it has started anything."""

import importlib.util
import logging
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

for package in ("launch", "launch_ros"):
    pytest.importorskip(package, reason=f"{package} comes with a full ROS 2")

from launch.actions import IncludeLaunchDescription
from launch.logging import get_logger
from launch_ros.actions import Node
from launch_support import FOLDER, include, reserve_domain
from ros_support import processes_of

import launch
from launch import LaunchContext

spec = importlib.util.spec_from_file_location("two_sensors", FOLDER / "two_sensors.launch.py")
two_sensors = importlib.util.module_from_spec(spec)
spec.loader.exec_module(two_sensors)


def actions_of(**arguments: str) -> list:
    """What the launch file would start with these arguments."""
    context = LaunchContext()
    context.launch_configurations.update(arguments)
    *declared, _ = two_sensors.generate_launch_description().entities
    for argument in declared:
        argument.execute(context)
    return two_sensors.start(context)


def test_what_may_be_missing_is_started_first():
    actions = actions_of(viz="true")
    own = [not isinstance(a, Node) or a.node_package == "tomotactile_ros" for a in actions]
    assert own == [False, False, True, True, True]


@pytest.mark.parametrize("side", two_sensors.SIDES)
@pytest.mark.parametrize("name", two_sensors.OF_SENSOR)
def test_an_argument_reaches_its_side_alone(side, name):
    groups = [a for a in actions_of(**{f"{side}_{name}": "value"}) if not isinstance(a, Node)]
    includes = [e for g in groups for e in g.get_sub_entities()]
    given = [dict(e.launch_arguments) for e in includes if isinstance(e, IncludeLaunchDescription)]
    values = {arguments["namespace"]: arguments[name] for arguments in given}
    assert values == {"left": "", "right": "", side: "value"}


def test_without_a_robot_the_poses_are_those_of_the_file():
    packages = [a.node_package for a in actions_of(robot="false") if isinstance(a, Node)]
    assert packages == ["tomotactile_ros"]


@pytest.fixture
def said():
    """What launch logs; caplog hears nothing of it under pytest 7."""
    messages = []
    handler = logging.Handler()
    handler.emit = lambda record: messages.append(record.getMessage())
    logger = get_logger("launch")
    logger.addHandler(handler)
    yield messages
    logger.removeHandler(handler)


@pytest.mark.parametrize(
    "arguments, complaint",
    [
        ({"left_port": "/dev/x"}, "port:=/dev/x needs device:=serial, it is fake"),
        ({"right_device": "seriel"}, "device:=seriel is none of fake"),
        ({"left_device": "replay", "left_scene": "slide"}, "scene:=slide needs device:=fake"),
        ({"right_recording": "b"}, "recording:=b needs device:=replay"),
        ({"right_topic": "/b"}, "topic:=/b needs device:=replay"),
        ({"robot": "maybe"}, "maybe"),
        ({"viz": "1"}, "viz"),
    ],
)
def test_a_wrong_value_fails_the_launch_and_leaves_nothing_behind(arguments, complaint, said):
    service, domain = launch.LaunchService(), reserve_domain()
    actions = include("two_sensors.launch.py", domain, {"robot": "false", **arguments})
    service.include_launch_description(launch.LaunchDescription(actions))
    assert service.run() == 1
    assert any(complaint in message for message in said)
    assert processes_of("tactile", domain) + processes_of("skin", domain) == []
