"""Every launch argument of tactile.launch.py and two_sensors.launch.py, with a right and with a wrong
value; nothing is started."""

from pathlib import Path
from types import SimpleNamespace

import pytest

for package in ("launch", "launch_ros"):
    pytest.importorskip(package, reason=f"{package} comes with a full ROS 2")

import yaml
from launch.actions import ExecuteLocal, IncludeLaunchDescription, LogInfo
from launch_ros.actions import Node
from launch_support import FOLDER, actions_of, module_of

tactile, two_sensors = (module_of(f"{name}.launch.py") for name in ("tactile", "two_sensors"))


def given(words: str) -> dict[str, str]:
    """Arguments as they are written on a command line."""
    return dict(word.split(":=") for word in words.split())


@pytest.fixture
def nodes_of(monkeypatch):
    """Executable of each node that would be started -> its command line and parameters."""
    commands = []

    def note(process, context):
        process.prepare(context)
        commands.append(process.process_details["cmd"])

    monkeypatch.setattr(ExecuteLocal, "execute", note)

    def nodes_of(words: str) -> dict[str, dict]:
        del commands[:]
        actions, context = actions_of(tactile, given(words))
        for action in actions:
            if isinstance(action, Node):
                Node.execute(action, context)  # that of a LifecycleNode would join ROS
        found = {}
        for line in commands:
            parameters = {}
            for file in (line[i + 1] for i, word in enumerate(line) if word == "--params-file"):
                for values in yaml.safe_load(Path(file).read_text()).values():
                    parameters |= values["ros__parameters"]
            found[line[0].rsplit("/", 1)[-1]] = {"words": line, **parameters}
        return found

    return nodes_of


TEXT = "device:=serial port:=/dev/x baud:=9600 protocol:=text-mV drive_voltage:=5"
RIGHT = [
    ("", "driver", {"device": "fake", "layout": "equal-8x8"}),
    ("layout:=equal-4x4", "reconstruction", {"layout": "equal-4x4"}),
    ("scene:=slide", "driver", {"scene": "slide"}),
    (TEXT, "driver", {"device": "serial", "port": "/dev/x", "baud": 9600}),
    (TEXT, "driver", {"protocol": "text-mV", "drive_voltage": 5.0}),
    ("device:=replay recording:=b topic:=/l", "driver", {"recording": "b", "topic": "/l"}),
    ("device:=replay recording:=b loop:=true", "driver", {"loop": True}),
    ("rate:=20", "driver", {"rate": 20.0}),
    ("delivery:=rows", "driver", {"delivery": "rows"}),
    ("profile:=accurate", "reconstruction", {"profile": "accurate"}),
    ("frame_id:=left", "driver", {"frame_id": "left"}),
    ("frame_id:=left", "reconstruction", {"frame_id": "left"}),
    ("hardware_id:=no7", "reconstruction", {"hardware_id": "no7"}),
    ("use_sim_time:=true", "driver", {"use_sim_time": True}),
    ("use_sim_time:=True", "reconstruction", {"use_sim_time": True}),
    ("lifecycle:=true", "driver_lifecycle", {"autostart": True}),
    ("lifecycle:=true autostart:=false", "reconstruction_lifecycle", {"autostart": False}),
    ("composed:=true profile:=fast", "tactile", {"profile": "fast", "device": "fake"}),
    ("composed:=true lifecycle:=true", "tactile_lifecycle", {"autostart": True}),
    ("on_refusal:=ignore", "driver", {}),
    ("view:=true use_sim_time:=true", "viewer", {"use_sim_time": True}),
]


@pytest.mark.parametrize("words, program, parameters", RIGHT)
def test_a_right_value_reaches_its_node(nodes_of, words, program, parameters):
    found = nodes_of(words)
    assert {key: found[program][key] for key in parameters} == parameters


WRONG = [
    ("device:=seriel", "device:=seriel is none of fake, serial, replay, none"),
    ("port:=/dev/x", "port:=/dev/x needs device:=serial, it is fake: data would be simulated"),
    ("protocol:=text-V", "protocol:=text-V needs device:=serial, it is fake"),
    ("device:=serial baud:=9600.5", "baud:=9600.5 is no whole number from 0 on"),
    ("drive_voltage:=five", "drive_voltage:=five is no number from 0 on"),
    ("recording:=b", "recording:=b needs device:=replay, it is fake: data would be simulated"),
    ("topic:=/l", "topic:=/l needs device:=replay"),
    ("loop:=true", "loop:=true needs device:=replay"),
    ("device:=serial scene:=slide", "scene:=slide needs device:=fake, it is serial"),
    ("device:=none rate:=5", "rate:=5 is the driver's"),
    ("device:=none delivery:=rows", "delivery:=rows is the driver's"),
    ("delivery:=row", "delivery:=row is neither frames nor rows"),
    ("rate:=quick", "rate:=quick is no number from 0 on"),
    ("rate:=-1", "rate:=-1 is no number from 0 on"),
    ("device:=replay recording:=b loop:=yes", "loop:=yes is neither true nor false"),
    ("use_sim_time:=1", "use_sim_time:=1 is neither true nor false"),
    ("composed:=maybe", "composed:=maybe is neither"),
    ("lifecycle:=on", "lifecycle:=on is neither"),
    ("autostart:=true", "autostart:=true needs lifecycle:=true"),
    ("viz:=rviz", "viz:=rviz is neither"),
    ("view:=page", "view:=page is neither"),
    ("on_refusal:=retry", "on_refusal:=retry is neither stop nor ignore"),
    ("namespace:=left-hand", "namespace:=left-hand is none: letters, digits and _ make names"),
    ("namespace:=a//b", "namespace:=a//b is none"),
    ("params_file:=/none.yaml", "params_file:=/none.yaml no such file"),
]


def refusal_of(words: str) -> str:
    """Why the launch fails; nothing but that is started."""
    (timer,), context = actions_of(tactile, given(words))
    (fail,) = timer.actions
    with pytest.raises(RuntimeError) as error:
        fail.execute(context)
    return str(error.value)


@pytest.mark.parametrize("words, complaint", WRONG)
def test_a_wrong_value_is_refused_in_one_line(words, complaint):
    said = refusal_of(words)
    assert said.startswith(complaint)
    assert "\n" not in said


def test_a_wrong_value_can_be_left_to_itself(monkeypatch):
    said = []
    monkeypatch.setattr(tactile, "get_logger", lambda name: SimpleNamespace(error=said.append))
    assert actions_of(tactile, given("rate:=quick on_refusal:=ignore"))[0] == []
    assert said == ["rate:=quick is no number from 0 on; this sensor is not started"]


def test_every_argument_is_tried_with_a_right_and_a_wrong_value():
    # what is wrong with these only the node can tell: test_launch_tests.py
    of_the_node = {"layout", "profile", "frame_id", "hardware_id"}
    declared = {a.name for a in tactile.generate_launch_description().get_launch_arguments()}
    tried = {name for words, *_ in RIGHT for name in given(words)}
    assert declared == tried | {"viz", "params_file", "namespace"}  # those in the tests below
    assert declared - of_the_node <= {name for words, _ in WRONG for name in given(words)}


def test_every_argument_is_described_and_documented():
    text = (FOLDER.parent / "docs" / "robots.md").read_text(encoding="utf-8")
    table = text.split("| argument | values | meaning |")[1].split("\n\n")[0]
    for argument in tactile.generate_launch_description().get_launch_arguments():
        assert argument.description and f"`{argument.name}`" in table, argument.name


@pytest.mark.parametrize("namespace", ["", "/", "left", "/left", "robot1/left_hand/"])
def test_a_namespace_may_have_parts(namespace):
    actions_of(tactile, {"namespace": namespace})


def test_a_misspelt_argument_is_told_and_others_are_not():
    words = ["prt:=/dev/x", "port:=/dev/x", "left_port:=/dev/y", "robot:=true", "-d"]
    assert tactile.typos(words, ["port", "scene"]) == [
        "prt:=/dev/x: no argument of tactile.launch.py, was port:= meant?"
    ]


def test_a_device_named_in_a_parameter_file_counts(nodes_of, tmp_path):
    file = tmp_path / "p.yaml"
    file.write_text("/**/driver: {ros__parameters: {device: serial}}\n")
    driver = nodes_of(f"params_file:={file} port:=/dev/x")["driver"]
    assert (driver["device"], driver["port"]) == ("serial", "/dev/x")
    said = refusal_of(f"params_file:={file} recording:=b")
    assert said == "recording:=b needs device:=replay, it is serial"


@pytest.mark.parametrize(
    "key, words, others",
    [
        ("/left/driver", "namespace:=right", "/right/driver or /right/reconstruction"),
        ("driver", "ros_namespace:=/left", "/left/driver or /left/reconstruction"),
        ("/**/drivr", "device:=serial", "/driver or /reconstruction"),
        ("/**/driver", "device:=none", "/reconstruction"),
    ],
)
def test_a_parameter_file_for_nobody_is_refused(tmp_path, key, words, others):
    """ROS ignores it: the sensor would be a simulation, whatever the file says."""
    file = tmp_path / "p.yaml"
    file.write_text(f"{key}: {{ros__parameters: {{device: serial, port: /dev/x}}}}\n")
    said = refusal_of(f"params_file:={file} {words}")
    whom = key if key.startswith("/") else f"/{key}"
    assert said == f"params_file:={file} is for {whom}, not for {others}"


def test_only_what_a_parameter_file_says_of_this_sensor_counts(tmp_path):
    file = tmp_path / "p.yaml"
    file.write_text(
        "left: {driver: {ros__parameters: {device: serial, port: /dev/x}}}\n"
        "/right/driver: {ros__parameters: {scene: idle}}\n"
    )
    words = f"params_file:={file} port:=/dev/y"
    for of_left in ("namespace:=left", "ros_namespace:=left"):
        actions, _ = actions_of(tactile, given(f"{words} {of_left}"))
        assert [type(action) for action in actions] == [Node, Node]
    said = refusal_of(f"{words} namespace:=right")
    assert said.startswith("port:=/dev/y needs device:=serial, it is fake")


def test_nodes_are_in_the_namespace_and_keep_their_names(nodes_of):
    for words in (node["words"] for node in nodes_of("namespace:=left").values()):
        assert "__ns:=/left" in words
    assert {"__node:=driver"} <= set(nodes_of("")["driver"]["words"])
    assert not any("__node" in word for word in nodes_of("composed:=true")["tactile"]["words"])
    # without a device there is the reconstruction alone
    assert set(nodes_of("device:=none composed:=true")) == {"reconstruction"}


@pytest.mark.parametrize(
    "words, said",
    [
        ("namespace:=left scene:=slide", "/left: SIMULATED data"),
        ("namespace:=left ros_namespace:=/robot", "/robot/left: SIMULATED data"),
        ("device:=serial port:=/dev/x", ""),
    ],
)
def test_simulated_data_are_announced(words, said):
    actions, context = actions_of(tactile, given(words))
    logs = [a for a in actions if isinstance(a, LogInfo)]
    logged = " ".join("".join(s.perform(context) for s in log.msg) for log in logs)
    assert said in logged and bool(said) == bool(logged)


def test_of_two_sensors_what_may_be_missing_is_started_first():
    for words, others in (("viz:=true", 2), ("robot:=false", 0)):
        actions, _ = actions_of(two_sensors, given(words))
        nodes = [not isinstance(a, Node) or a.node_package == "tomotactile_ros" for a in actions]
        assert nodes == [False] * others + [True] * 3


@pytest.mark.parametrize("side", two_sensors.SIDES)
@pytest.mark.parametrize("name", two_sensors.OF_SENSOR)
def test_of_two_sensors_an_argument_reaches_its_side_alone(side, name):
    actions, _ = actions_of(two_sensors, {f"{side}_{name}": "value"})
    includes = [e for a in actions if not isinstance(a, Node) for e in a.get_sub_entities()]
    sensors = [
        dict(e.launch_arguments) for e in includes if isinstance(e, IncludeLaunchDescription)
    ]
    values = {arguments["namespace"]: arguments[name] for arguments in sensors}
    assert values == {"left": "", "right": "", side: "value"}
