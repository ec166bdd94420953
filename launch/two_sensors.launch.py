"""Two sensors and the skin that they are: an example to copy.

Each include is in a group of its own, without arguments from elsewhere: otherwise those of the
first include would silently be those of the second one, too. Poses come from the robot's
description by tf2, or with robot:=false from config/poses/two_sensors.yaml.
"""

from launch.actions import (
    DeclareLaunchArgument,
    GroupAction,
    IncludeLaunchDescription,
    OpaqueFunction,
    ResetLaunchConfigurations,
)
from launch.launch_description_sources import PythonLaunchDescriptionSource
from launch.substitutions import Command, LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext, LaunchDescription

SHARE = FindPackageShare("tomotactile_ros")
SIDES = ("left", "right")
OF_SENSOR = {
    "layout": "electrodes: a layout file or an installed name",
    "device": "fake, serial, replay or none",
    "scene": "for device fake",
    "port": "for device serial",
    "recording": "for device replay: a frames.npz or a rosbag2",
    "topic": "for device replay: which topic of a bag with several sensors",
}
SWITCHES = {
    "robot": ("true", "robot_state_publisher with urdf/two_sensors.urdf.xacro"),
    "viz": ("false", "start rviz2"),
}


def generate_launch_description() -> LaunchDescription:
    """Arguments of each side (left_scene:=slide), and what they start."""
    declared = [
        DeclareLaunchArgument(f"{side}_{name}", default_value="", description=f"{side}: {text}")
        for side in SIDES
        for name, text in OF_SENSOR.items()
    ]
    declared += [
        DeclareLaunchArgument(
            name, default_value=default, choices=["true", "false"], description=text
        )
        for name, (default, text) in SWITCHES.items()
    ]
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def start(context: LaunchContext) -> list:
    """Both sensors, the skin, the robot, rviz2."""
    given = {
        name: LaunchConfiguration(name).perform(context)
        for name in (*(f"{side}_{name}" for side in SIDES for name in OF_SENSOR), *SWITCHES)
    }
    robot = given["robot"] == "true"
    # what may be missing first: the launch then fails before there are nodes to be left behind
    actions: list = []
    if robot:
        file = PathJoinSubstitution([SHARE, "urdf", "two_sensors.urdf.xacro"])
        description = ParameterValue(Command(["xacro ", file]), value_type=str)
        actions.append(
            Node(
                package="robot_state_publisher",
                executable="robot_state_publisher",
                parameters=[{"robot_description": description}],
            )
        )
    if given["viz"] == "true":
        config = PathJoinSubstitution([SHARE, "config", "two_sensors.rviz"])
        actions.append(Node(package="rviz2", executable="rviz2", arguments=["-d", config]))
    actions += [
        make_sensor(side, {name: given[f"{side}_{name}"] for name in OF_SENSOR}) for side in SIDES
    ]
    poses = (
        {} if robot else {"poses": PathJoinSubstitution([SHARE, "config/poses/two_sensors.yaml"])}
    )
    skin = {"sensors": list(SIDES), "frame_id": "base_link", **poses}
    actions.append(
        Node(package="tomotactile_ros", executable="skin", parameters=[skin], output="screen")
    )
    return actions


def make_sensor(side: str, arguments: dict[str, str]) -> GroupAction:
    """One sensor in its namespace, with its frame; nothing gets out of the group or into it."""
    source = PythonLaunchDescriptionSource(
        PathJoinSubstitution([SHARE, "launch", "tactile.launch.py"])
    )
    own = {"namespace": side, "frame_id": f"{side}_link", "composed": "true", **arguments}
    include = IncludeLaunchDescription(source, launch_arguments=own.items())
    # not forwarding=False, which would reset the environment, too
    return GroupAction([ResetLaunchConfigurations(), include], scoped=True)
