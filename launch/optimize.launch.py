"""The optimizer of electrode layouts; the launch ends with it."""

from pathlib import Path

from launch.actions import DeclareLaunchArgument, OpaqueFunction, Shutdown
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext, LaunchDescription

PACKAGE = "tomotactile_ros"
ARGUMENTS = {
    "layout": "to start from: a layout file or an installed name",
    "method": "how electrodes are moved",
    "out": "file for the best layout",
    "namespace": "of the node",
    "params_file": "parameters of the optimizer, beside config/optimizer.yaml",
}


def generate_launch_description() -> LaunchDescription:
    """Arguments, and the node; those left empty do not override the parameter files."""
    arguments = [
        DeclareLaunchArgument(name, default_value="", description=text)
        for name, text in ARGUMENTS.items()
    ]
    return LaunchDescription([*arguments, OpaqueFunction(function=start)])


def start(context: LaunchContext) -> list:
    """The node, once the arguments are known."""
    given = {name: LaunchConfiguration(name).perform(context) for name in ARGUMENTS}
    if given["params_file"] and not Path(given["params_file"]).is_file():
        raise RuntimeError(f"params_file: {given['params_file']}: no such file")
    files = [PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "optimizer.yaml"])]
    files += [given["params_file"]] if given["params_file"] else []
    overrides = {
        key: ParameterValue(given[key], value_type=str)
        for key in ("layout", "method", "out")
        if given[key]
    }
    node = Node(
        package=PACKAGE,
        executable="optimizer",
        name="optimizer",
        namespace=given["namespace"],
        parameters=[*files, overrides],
        output="screen",
        on_exit=finish,
    )
    return [node]


def finish(event, context: LaunchContext) -> list:
    """Ends the launch: well, or with an error if the optimizer has failed."""
    if event.returncode:
        raise RuntimeError(f"the optimizer failed with status {event.returncode}")
    return [Shutdown(reason="the optimizer has finished")]
