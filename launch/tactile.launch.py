"""Driver and reconstruction of one sensor, plain or managed, with rviz2 on request.

A node that refuses its parameters (exit status 2) fails the launch; one that dies otherwise is
started again. Launch arguments left empty do not override the parameter files.
"""

from pathlib import Path

from launch.actions import (
    DeclareLaunchArgument,
    OpaqueFunction,
    RegisterEventHandler,
)
from launch.event_handlers import OnProcessExit
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext, LaunchDescription

PACKAGE = "tomotactile_ros"
REFUSED = 2
ARGUMENTS = {
    "layout": "electrodes: a layout file or an installed name",
    "scene": "what touches a simulated sheet: a scene file or an installed name",
    "device": "fake, serial or replay",
    "port": "of the serial device",
    "recording": "to replay: a frames.npz or a rosbag2",
    "profile": "fast, balanced, accurate, joint or auto",
    "namespace": "of both nodes, one for each sensor",
    "params_file": "parameters of driver and reconstruction, beside config/*.yaml",
}
SWITCHES = {
    "viz": "start rviz2",
    "lifecycle": "managed nodes, brought up to active",
}
OF_NODE = {
    "driver": ("layout", "scene", "device", "port", "recording"),
    "reconstruction": ("layout", "profile"),
}
SHOWN = ("pressure_view", "contact_markers", "layout_markers", "surface")


def generate_launch_description() -> LaunchDescription:
    """Arguments, and what they start."""
    texts = [
        DeclareLaunchArgument(name, default_value="", description=text)
        for name, text in ARGUMENTS.items()
    ]
    switches = [
        DeclareLaunchArgument(
            name, default_value="false", choices=["true", "false"], description=text
        )
        for name, text in SWITCHES.items()
    ]
    return LaunchDescription([*texts, *switches, OpaqueFunction(function=start)])


def start(context: LaunchContext) -> list:
    """All actions, once the arguments are known."""
    given = {name: LaunchConfiguration(name).perform(context) for name in (*ARGUMENTS, *SWITCHES)}
    if given["params_file"] and not Path(given["params_file"]).is_file():
        raise RuntimeError(f"params_file: {given['params_file']}: no such file")
    managed = given["lifecycle"] == "true"
    # rviz2 first: if it is missing, the launch fails before there are nodes to be left behind
    actions = [make_rviz(given["namespace"])] if given["viz"] == "true" else []
    for name in OF_NODE:
        node = make_node(name, given, managed)
        actions += [fail_if_refused(name, node), node]
    return actions


def make_node(name: str, given: dict[str, str], managed: bool) -> Node:
    """The driver or the reconstruction."""
    files = [PathJoinSubstitution([FindPackageShare(PACKAGE), "config", f"{name}.yaml"])]
    files += [given["params_file"]] if given["params_file"] else []
    overrides = {
        key: ParameterValue(given[key], value_type=str) for key in OF_NODE[name] if given[key]
    }
    make = LifecycleNode if managed else Node
    if managed:
        overrides["autostart"] = True
    return make(
        package=PACKAGE,
        executable=f"{name}_lifecycle" if managed else name,
        name=name,
        namespace=given["namespace"],
        parameters=[*files, overrides],
        output="screen",
        respawn=True,
        respawn_delay=1.0,
    )


def fail_if_refused(name: str, node: Node) -> RegisterEventHandler:
    """Ends the launch with an error when the node has refused its parameters."""

    def judge(event, context):
        if event.returncode == REFUSED:
            raise RuntimeError(f"{name} refused its parameters, see its last line")

    return RegisterEventHandler(OnProcessExit(target_action=node, on_exit=judge))


def make_rviz(namespace: str) -> Node:
    """rviz2 on the topics of this sensor."""
    return Node(
        package="rviz2",
        executable="rviz2",
        namespace=namespace,
        arguments=[
            "-d",
            PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "tactile.rviz"]),
        ],
        remappings=[(f"/{topic}", topic) for topic in SHOWN],
    )
