"""Driver and reconstruction of one sensor: as two processes or one, plain or managed, with rviz2 or a page
for the browser.

Arguments that cannot be meant, and a node that refuses its parameters (exit status 2), stop the
launch, or only the sensor (on_refusal:=ignore); a node that dies otherwise is started again.
Arguments left empty do not override
the parameter files. Include this file in a group of its own, as two_sensors.launch.py does: launch
hands arguments of one include on to the next one otherwise.
"""

import difflib
import re
from collections.abc import Sequence
from pathlib import Path

from launch.actions import DeclareLaunchArgument, EmitEvent, LogInfo, OpaqueFunction, TimerAction
from launch.events import matches_action
from launch.events.process import ShutdownProcess
from launch.logging import get_logger
from launch.substitutions import LaunchConfiguration, PathJoinSubstitution
from launch_ros.actions import LifecycleNode, Node
from launch_ros.parameter_descriptions import ParameterValue
from launch_ros.substitutions import FindPackageShare

from launch import LaunchContext, LaunchDescription
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.params_files import TYPO, fits, parameters_of, read_sections

PACKAGE = "tomotactile_ros"
REFUSED = 2
AGAIN = 1.0  # s from the end of a node to its next start
STOPPED = "20"  # s that a node may take to end on a machine with other work, until launch insists
DEVICES = ("fake", "serial", "replay", "none")
FOR_DEVICE = {
    "port": "serial",
    "baud": "serial",
    "protocol": "serial",
    "recording": "replay",
    "topic": "replay",
    "loop": "replay",
    "scene": "fake",
}
TEXTS = {
    "layout": "electrodes: a layout file or an installed name",
    "scene": "for device:=fake: what touches the sheet, a scene file or an installed name",
    "device": "fake (simulated), serial, replay, or none: the reconstruction alone",
    "port": "for device:=serial",
    "baud": "for device:=serial: bit/s",
    "protocol": "for device:=serial: binary, or lines of text: text-V, text-mV, text-10bit ...",
    "drive_voltage": "V, for lines of text, and for recordings that do not hold it",
    "recording": "for device:=replay: a frames.npz or a rosbag2",
    "topic": "for device:=replay: which topic of a bag with several sensors",
    "rate": "frames/s; 0 leaves it to the device",
    "delivery": "frames, or rows: contacts after every few rows, without waiting for frames",
    "profile": "fast, balanced, accurate, auto or paper",
    "frame_id": "frame of the sensor",
    "hardware_id": "name of the sensor in diagnostics; frame_id if empty",
    "namespace": "of both nodes, one for each sensor",
    "params_file": "parameters of driver and reconstruction, beside config/*.yaml",
}
SWITCHES = {
    "loop": ("", "for device:=replay: start over at the end"),
    "use_sim_time": ("", "stamps of /clock"),
    "composed": ("false", "both nodes in one process: the lowest latency and load"),
    "lifecycle": ("false", "managed nodes"),
    "autostart": ("", "managed nodes bring themselves up; false leaves that to a manager"),
    "viz": ("false", "start rviz2"),
    "view": ("false", "serve a page for the browser: http://127.0.0.1:8080 or the next free port"),
}
NAMESPACE = r"/?([A-Za-z_]\w*(/[A-Za-z_]\w*)*)?/?"
ON_REFUSAL = ("stop", "ignore")
DELIVERIES = ("frames", "rows")
OF_NODE = {
    "driver": (
        "layout", "scene", "device", "port", "baud", "protocol", "drive_voltage", "recording", "topic",
        "rate", "delivery", "loop", "frame_id", "hardware_id", "use_sim_time", "autostart",
    ),
    "reconstruction": (
        "layout", "profile", "frame_id", "hardware_id", "use_sim_time", "autostart",
    ),
}  # fmt: skip
NUMBERS = {"rate": float, "baud": int, "drive_voltage": float}
SHOWN = ("pressure_view", "contact_markers", "layout_markers", "surface")


def generate_launch_description() -> LaunchDescription:
    """Arguments, and what they start."""
    declared = [DeclareLaunchArgument(n, default_value="", description=t) for n, t in TEXTS.items()]
    declared += [
        DeclareLaunchArgument(name, default_value=default, description=text)
        for name, (default, text) in SWITCHES.items()
    ]
    declared.append(
        DeclareLaunchArgument(
            "on_refusal",
            default_value="stop",
            description="what follows when arguments or parameters are refused: stop (everything "
            "that was launched) or ignore (nothing else)",
        )
    )
    return LaunchDescription([*declared, OpaqueFunction(function=start)])


def start(context: LaunchContext) -> list:
    """All actions, once the arguments are known."""
    names = (*TEXTS, *SWITCHES, "on_refusal")
    given = {name: LaunchConfiguration(name).perform(context) for name in names}
    where = full_namespace(context, given["namespace"])
    for complaint in typos(context.argv, names):
        get_logger("tactile.launch.py").warning(complaint)
    try:
        device = check(given, where)
    except Refused as refusal:
        return refuse(str(refusal), given["on_refusal"])
    # rviz2 first: if it is missing, the launch fails before there are nodes to be left behind
    actions = [make_rviz(given)] if given["viz"] == "true" else []
    actions += [make_viewer(given)] if given["view"] == "true" else []
    if device == "fake":
        scene = given["scene"] or "that of the parameters"
        actions.append(LogInfo(msg=f"{where}: SIMULATED data, device fake, scene {scene}"))
    if device == "none":
        return [*actions, make_node("reconstruction", given)]
    if given["composed"] == "true":
        return [*actions, make_node("tactile", given)]
    return [*actions, *(make_node(name, given) for name in OF_NODE)]


def full_namespace(context: LaunchContext, namespace: str) -> str:
    """Namespace of the nodes from the root on: below that of the group that includes this file."""
    group = context.launch_configurations.get("ros_namespace", "")
    above = "" if namespace.startswith("/") else group.strip("/")
    return "/" + "/".join(part for part in (above, namespace.strip("/")) if part)


class Refused(RuntimeError):
    """Why arguments cannot be meant, in one line."""


def refuse(complaint: str, on_refusal: str) -> list:
    """Starts nothing; the launch fails as soon as it runs, unless that is to be ignored.

    Not at once: an error while launch still reads its files makes it forget what it has begun to
    start, and the nodes of a file that includes this one would be left behind.
    """

    def fail(context: LaunchContext) -> None:
        raise RuntimeError(complaint)

    if on_refusal == "ignore":
        get_logger("tactile.launch.py").error(f"{complaint}; this sensor is not started")
        return []
    return [TimerAction(period=0.0, actions=[OpaqueFunction(function=fail)])]


def check(given: dict[str, str], where: str) -> str:
    """The device in use by the sensor of a namespace; Refused for arguments that cannot be meant."""
    for name, (default, _) in SWITCHES.items():
        given[name] = given[name].lower()
        refuse_unless(
            given[name] in ("true", "false", default), given, name, "is neither true nor false"
        )
    refuse_unless(
        given["device"] in ("", *DEVICES), given, "device", f"is none of {', '.join(DEVICES)}"
    )
    refuse_unless(
        given["delivery"] in ("", *DELIVERIES), given, "delivery", "is neither frames nor rows"
    )
    refuse_unless(
        given["on_refusal"] in ON_REFUSAL, given, "on_refusal", "is neither stop nor ignore"
    )
    for name, kind in NUMBERS.items():
        refuse_unless(
            not given[name] or is_number(given[name], kind),
            given,
            name,
            f"is no {'whole ' if kind is int else ''}number from 0 on",
        )
    refuse_unless(
        re.fullmatch(NAMESPACE, given["namespace"]),
        given,
        "namespace",
        "is none: letters, digits and _ make names, and / parts them",
    )
    if given["params_file"]:
        refuse_unless(Path(given["params_file"]).is_file(), given, "params_file", "no such file")
    of_file = device_of_file(given, where)
    device = given["device"] or of_file or "fake"
    for name, needed in FOR_DEVICE.items():
        if given[name] and device != needed:
            simulated = ": data would be simulated" if device == "fake" else ""
            refuse_unless(False, given, name, f"needs device:={needed}, it is {device}{simulated}")
    for name in ("rate", "delivery"):
        if device == "none" and given[name]:
            refuse_unless(False, given, name, "is the driver's, and device:=none has none")
    managed = given["lifecycle"] == "true"
    refuse_unless(managed or not given["autostart"], given, "autostart", "needs lifecycle:=true")
    if managed:
        given["autostart"] = given["autostart"] or "true"
    return device


def typos(words: Sequence[str], names: Sequence[str]) -> list[str]:
    """What is said of words of the command line that look like an argument of this file.

    launch takes any name: prt:=/dev/x would be a simulation. It is no error, as the name may be an
    argument of a launch file that includes this one.
    """
    complaints = []
    for word in words:
        name, assigned, _ = word.partition(":=")
        near = difflib.get_close_matches(name, names, 1, TYPO)
        if assigned and name not in names and near:
            complaints.append(f"{word}: no argument of tactile.launch.py, was {near[0]}:= meant?")
    return complaints


def refuse_unless(right: object, given: dict[str, str], name: str, complaint: str) -> None:
    """Says in one line what is wrong with an argument."""
    if not right:
        raise Refused(f"{name}:={given[name]} {complaint}")


def is_number(text: str, kind: type) -> bool:
    """Whether a text is a number of that type, from 0 on."""
    try:
        return 0.0 <= kind(text) < float("inf")
    except ValueError:
        return False


def device_of_file(given: dict[str, str], where: str) -> str:
    """The device that the parameter file names for the driver, or nothing.

    Refused for a file that is for none of the nodes in the namespace: ROS would ignore all of it.
    """
    file = given["params_file"]
    if not file:
        return ""
    names = ["reconstruction"] if given["device"] == "none" else list(OF_NODE)
    nodes = [f"{where.rstrip('/')}/{name}" for name in names]
    try:
        keys = [key for key, _ in read_sections(file)]
        device = parameters_of(file, nodes[0]).get("device", "")
    except InputError as error:
        raise Refused(f"params_file:={error}") from None
    if not any(fits(key, node) for key in keys for node in nodes):
        for_whom = ", ".join(keys) or "nobody"
        raise Refused(f"params_file:={file} is for {for_whom}, not for {' or '.join(nodes)}")
    return str(device)


def make_node(name: str, given: dict[str, str]) -> Node:
    """The driver, the reconstruction, or `tactile`: both in one process."""
    managed, both = given["lifecycle"] == "true", name == "tactile"
    parts = list(OF_NODE) if both else [name]
    share = FindPackageShare(PACKAGE)
    files = [PathJoinSubstitution([share, "config", f"{part}.yaml"]) for part in parts]
    files += [given["params_file"]] if given["params_file"] else []
    keys = dict.fromkeys(key for part in parts for key in OF_NODE[part] if given[key])
    # without a name the parameters are those of both nodes, which ignore each other's
    named = {} if both else {"name": name}
    return (LifecycleNode if managed and not both else Node)(
        **named,
        package=PACKAGE,
        executable=f"{name}_lifecycle" if managed else name,
        namespace=given["namespace"],
        parameters=[*files, {key: typed(key, given[key]) for key in keys}],
        output="screen",
        # launch keeps the command for that: a new action would not be in the group of this one
        respawn=True,
        respawn_delay=AGAIN,
        sigterm_timeout=LaunchConfiguration("sigterm_timeout", default=STOPPED),
        on_exit=lambda event, context: after(name, given, event, context),
    )


def typed(key: str, text: str) -> bool | int | float | ParameterValue:
    """An argument in the type of its parameter; a text stays one, also where YAML sees a number."""
    if key in SWITCHES:
        return text == "true"
    return NUMBERS[key](text) if key in NUMBERS else ParameterValue(text, value_type=str)


def after(name: str, given: dict[str, str], event, context: LaunchContext) -> list:
    """What follows the end of a node, beside its next start: none where it refused its parameters."""
    if context.is_shutdown or event.returncode != REFUSED:
        return []
    complaint = f"{name} refused its parameters, see its last line"
    if given["on_refusal"] == "stop":
        raise RuntimeError(complaint)
    return [
        EmitEvent(event=ShutdownProcess(process_matcher=matches_action(event.action))),
        LogInfo(msg=f"{complaint}; it is not started again (on_refusal:=ignore)"),
    ]


def make_rviz(given: dict[str, str]) -> Node:
    """rviz2 on the topics of this sensor, in its frame."""
    config = PathJoinSubstitution([FindPackageShare(PACKAGE), "config", "tactile.rviz"])
    frame = ["-f", given["frame_id"]] if given["frame_id"] else []
    return Node(
        package="rviz2",
        executable="rviz2",
        namespace=given["namespace"],
        arguments=["-d", config, *frame],
        remappings=[(f"/{topic}", topic) for topic in SHOWN],
    )


def make_viewer(given: dict[str, str]) -> Node:
    """The page of this sensor."""
    time = {"use_sim_time": True} if given["use_sim_time"] == "true" else {}
    return Node(
        package=PACKAGE,
        executable="viewer",
        namespace=given["namespace"],
        parameters=[time],
        output="screen",
    )
