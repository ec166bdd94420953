"""Parameters: a bad value is refused with the reason, at the start and at run time."""

import sys
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest
import yaml

rclpy = pytest.importorskip("rclpy")

import ros_checks
from ament_index_python.packages import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import GetParameters, SetParameters
from rclpy.context import Context
from rclpy.parameter import Parameter
from ros_support import ends_cleanly, ros_arguments
from sensor_msgs.msg import Image

from tomotactile_ros.msg import ContactArray, VoltageFrame
from tomotactile_ros.reconstruction.calibration import Fit, save_calibration
from tomotactile_ros.scenes.contact import ContactLaw
from tomotactile_ros.support.params_files import parameters_of

POSES = Path(__file__).resolve().parent.parent / "config" / "poses" / "two_sensors.yaml"
MISTAKES = [
    ("driver layout:=nowhere", "'nowhere': no such file"),
    ("driver frame_id:=/palm_link", "palm_link would be one"),
    ("driver rate:=5 --ros-args -p device:=camera", "device: 'camera' is none of fake"),
    ("driver layout:=small-4x4 rate:=fast", "rate: 'fast' is not a number"),
    ("driver device:=serial", "port: missing"),
    ("driver port:=/dev/x", "port: /dev/x needs device:=serial, it is fake: data would be"),
    ("tactile scene:=tap port:=/dev/x", "port: /dev/x needs device:=serial"),
    ("driver baud:=-5", "parameter baud: -5 is out of range, "),
    ("driver loop:=3", "parameter loop: 3 is not true or false"),
    ("driver --ros-args -p use_sim_time:=maybe", "use_sim_time"),
    ("driver --ros-args -p qos_overrides./voltage_frame.publisher.reliability:=much", "much"),
    ("driver --ros-args -p rate", "what follows --ros-args is not understood"),
    ("driver --ros-args --params-file nope.yaml", "--params-file: nope.yaml: no such file"),
    ("driver --device serial", "'--device' is not known"),
    # what launch files take is none of a node's: it was ignored, and the default shown instead
    ("driver params_file:=a.yaml", "'params_file' is no parameter of driver"),
    ("tactile params_file:=a.yaml", "'params_file' is no parameter of tactile"),
    ("sensors params_file:=a.yaml", "'params_file' is no parameter of sensors"),
    ("tactile scene:=nothing", "'nothing': no such file"),
    ("reconstruction frame_id:=/palm_link", "'/palm_link' is no frame of tf2"),
    ("reconstruction profile:=best", "profile: 'best' is none of fast"),
    ("reconstruction resolution:=4.5", "resolution"),
    ("reconstruction excluded:=[64]", "electrode 64 does not exist"),
    (f"reconstruction excluded:=[{','.join(map(str, range(64)))}]", "0 of 64 electrodes left"),
    ("reconstruction sensor:=none.yaml", "none.yaml"),
    ("optimizer resolution:=1", "resolution: 1 is not"),
    ("optimizer method:=equalize seed:=3", "seed: is for method free only"),
    ("optimizer layout:=equal-4x4 rows:=4", "rows: layout has its own"),
    ("optimizer layout:=equal-4x4 out:=/no/such/folder/a.yaml", "/no/such/folder"),
    ("skin", "sensors: needs 1 to 255 different namespaces"),
    (f"skin sensors:=[left,/left/] poses:={POSES}", "different namespaces"),
    ("skin sensors:=[left-hand]", "sensors: 'left-hand' is no namespace"),
    ("skin sensors:=[1,2]", "sensors"),
    ("skin sensors:=[left] poses:=none.yaml", "none.yaml"),
    (f"skin sensors:=[left] poses:={POSES} frame_id:=arm", "is not that of the skin, arm"),
    ("viewer sensors:=[left,left]", "different namespaces"),
    ("sensors sensors:=[left-hand]", "'left-hand' is no namespace"),
]
# whose files in config/ name the parameters of each program
CONFIGURED = {
    "driver": ["driver"],
    "reconstruction": ["reconstruction"],
    "tactile": ["driver", "reconstruction"],
    "optimizer": ["optimizer"],
    "sensors": [],
    "skin": [],
}
LIFECYCLE = [f"{name}_lifecycle" for name in ("driver", "reconstruction", "tactile")]


@pytest.fixture
def call_main(monkeypatch, capfd):
    """Runs a program's main in this process; returns its status and what it complained of."""

    def call(name, arguments):
        monkeypatch.setattr("sys.argv", [name])
        status = import_module(f"tomotactile_ros.nodes.{name}").main(arguments)
        said = capfd.readouterr().err.splitlines()
        return status, [line for line in said if "[INFO]" not in line]

    return call


@pytest.mark.parametrize("command, reason", MISTAKES)
def test_a_mistake_ends_with_one_line_and_status_2(command, reason, call_main):
    name, *words = command.split()
    if name == "viewer":
        pytest.importorskip("viser", reason="viser is not installed")
    status, (line,) = call_main(name, words)
    assert status == 2 and reason in line and ".c:" not in line
    assert line.startswith(f"{name}: ")


@pytest.mark.parametrize("name", [*CONFIGURED, *LIFECYCLE])
def test_help_names_every_parameter(name, call_main, capfd, monkeypatch):
    monkeypatch.setattr(rclpy, "init", lambda *_, **__: pytest.fail("help starts no ROS"))
    monkeypatch.setattr("sys.argv", [name])
    module, managed = (
        name.removesuffix("_lifecycle"),
        {"managed": True} if name in LIFECYCLE else {},
    )
    assert import_module(f"tomotactile_ros.nodes.{module}").main(["--help"], **managed) == 0
    said = capfd.readouterr().out
    assert said.startswith(f"usage: {name} [NAME:=VALUE")
    for node in CONFIGURED[module]:
        file = Path(get_package_share_directory("tomotactile_ros"), "config", f"{node}.yaml")
        (settings,) = yaml.safe_load(file.read_text()).values()
        assert f"\nparameters of {node}" in said
        for parameter in settings["ros__parameters"]:
            assert f"\n  {parameter}:=" in said
    assert ("  autostart:=false" in said) == (name in LIFECYCLE)
    assert max(map(len, said.splitlines())) <= 100


def test_a_node_starts_without_ros2_in_its_namespace(probe, spawn):
    script = Path(__file__).resolve().parent.parent / "scripts" / "tomotactile"
    spawn(script, "driver", "layout:=small-4x4", "__ns:=/left")
    frame = probe.wait_for(VoltageFrame, "/left/voltage_frame")
    assert frame.layout_id.startswith("small-4x4#")


def refuses(probe, node, *wishes):
    """Whether a node keeps what it has, each with this reason."""
    for name, value, reason in wishes:
        before = probe.get_parameter(node, name)
        result = probe.set_parameter(node, name, value)
        assert not result.successful and reason in result.reason, name
        assert probe.get_parameter(node, name) == before


def test_paths_are_fixed_and_misspelt_parameters_pointed_out(probe, start, tmp_path):
    """Of both nodes, started with their files of config/ and one that is for another."""
    share = Path(get_package_share_directory("tomotactile_ros"), "config")
    files = [share / f"{name}.yaml" for name in ("driver", "reconstruction")]
    of_another = tmp_path / "p.yaml"
    of_another.write_text("left: {driver: {ros__parameters: {rate: 20.0}}}\n")
    given = {"rat": "20.0", "partial_frames": "true"}
    tactile = start("tactile", given, warm=False, files=[*files, of_another])
    probe.wait_for(VoltageFrame, "/voltage_frame")
    assert "parameter 'rat' is unknown and ignored; did you mean 'rate'?" in tactile.output
    assert "partial_frames" not in tactile.output  # the other node's
    probe.until(lambda: "is ignored" in tactile.output.split("'rat'", 1)[1], "word of the file")
    ignored = f"{of_another} is ignored: it is for /left/driver, this node is /driver"
    assert ignored in tactile.output
    assert "this node is /reconstruction" not in tactile.output
    for node, name in (
        ("/driver", "scene"),
        ("/driver", "port"),
        ("/driver", "recording"),
        ("/reconstruction", "calibration"),
    ):
        for reason in (f"{name}: is read-only", "allow_path_changes"):
            refuses(probe, node, (name, "/etc/passwd", reason))
    as_it_is = probe.get_parameter("/driver", "scene")
    assert probe.set_parameter("/driver", "scene", as_it_is).successful
    empty = GetParameters.Request(names=["excluded"])
    (value,) = probe.call(GetParameters, "/reconstruction/get_parameters", empty).values
    assert value.type == ParameterType.PARAMETER_INTEGER_ARRAY


def test_the_driver_changes_at_run_time_what_it_can(probe, start, scene):
    changing = {"allow_path_changes": "true"}
    driver = start("driver", {"scene": "idle", "rate": "20", **changing})  # a whole number will do
    probe.wait_for(VoltageFrame, "/voltage_frame")
    refuses(
        probe,
        "/driver",
        ("scene", "nothing", "'nothing': no such file"),
        ("device", "serial", "port: missing"),
        ("rate", -3, "out of range"),
        ("rate", "fast", "not a number"),
    )
    assert probe.set_parameter("/driver", "rate", 50).successful
    assert probe.set_parameter("/driver", "scene", scene).successful
    largest = probe.wait_for(VoltageFrame, "/voltage_frame", lambda m: np.nanmax(m.voltages) > 0.1)
    assert largest.layout_id.startswith("equal-8x8#")
    assert "rate is now 50.0\n" in driver.output and "rate is now -3" not in driver.output
    for streaming, level, said in (
        (False, DiagnosticStatus.WARN, "stopped"),
        (True, DiagnosticStatus.OK, "simulated"),
    ):
        assert probe.set_parameter("/driver", "streaming", streaming).successful
        ros_checks.check_diagnostics(probe, "driver: device", level, said)
    assert probe.set_parameter("/driver", "model", "closed_form").successful
    ends_cleanly(driver)


def test_the_reconstruction_changes_at_run_time_what_it_can(probe, start, scene, tmp_path):
    small = {"layout": "equal-4x4"}
    start("driver", {"scene": scene, "rate": 15.0, **small})
    given = {"resolution": 20, "view_size": 100, "allow_path_changes": "true"}
    reconstruction = start("reconstruction", given | small)
    image = probe.wait_for(Image, "/pressure")
    assert (image.height, image.width) == (20, 20)
    refuses(
        probe,
        "/reconstruction",
        ("excluded", None, "not a list of whole numbers"),
        ("profile", "best", "none of"),
        ("resolution", 1000, "out of range"),
        ("excluded", [64], "electrode 64 does not exist"),
    )

    def change(name, value):
        assert probe.set_parameter("/reconstruction", name, value).successful

    def has_law(text):
        """Where the newtons come from, as the diagnostics say."""
        found = ros_checks.figures_of(probe, "reconstruction: reconstruction")["contact law"]
        assert found == text

    change("resolution", 30)
    probe.wait_for(Image, "/pressure", lambda m: (m.height, m.width) == (30, 30))
    view = probe.wait_for(Image, "/pressure_view", lambda m: m.height == 90)
    assert view.width > 90  # the scale stands beside the image
    change("excluded", [3, 7])
    ros_checks.check_diagnostics(
        probe, "reconstruction: reconstruction", b"\x01", "electrodes left out: 3, 7"
    )
    law = tmp_path / "law.yaml"
    save_calibration(law, Fit(ContactLaw(2e-4, 1.0), 0.0, 1))
    before = probe.wait_for(ContactArray, "/contacts").contacts[0].force
    has_law("g = 0.0001 p^1, assumed: not calibrated (parameter calibration)")
    change("contact_coefficient", 3e-4)
    has_law("g = 0.0003 p^1, as the parameters say")
    change("calibration", str(law))
    has_law(f"calibration {law}")
    half = (0.45 * before, 0.55 * before)
    probe.wait_for(ContactArray, "/contacts", lambda m: half[0] < m.contacts[0].force < half[1])
    change("profile", "balanced")
    probe.wait_for(ContactArray, "/contacts", lambda m: len(m.contacts) > 0)
    said = reconstruction.output
    assert "resolution is now 30\n" in said
    for once in ("profile fast", "g = 0.0001 p^1, assumed: not calibrated"):
        assert said.count(once) == 1  # not with each change
    ends_cleanly(reconstruction)


SLOW_SETTINGS = """
import sys, time
from pathlib import Path
from tomotactile_ros.nodes.reconstruction import main
from tomotactile_ros.reconstruction import Pipeline

folder = Path(sys.argv.pop(1))
prepare = Pipeline.with_settings

def slowly(self, settings):
    (folder / "begun").touch()
    while not (folder / "enough").exists():
        time.sleep(0.01)
    return prepare(self, settings)

Pipeline.with_settings = slowly
sys.exit(main())
"""


def test_images_go_on_while_parameters_are_put_into_effect(probe, start, spawn, tmp_path):
    """The change ends only after images and diagnostics that were made meanwhile."""
    small = {"layout": "equal-4x4"}
    start("driver", {"scene": "idle", "rate": "10.0", **small})
    words = "-c", SLOW_SETTINGS, tmp_path, *ros_arguments(small)
    reconstruction = spawn(sys.executable, *words)
    images = probe.listen(Image, "/pressure")
    reports = probe.listen(DiagnosticArray, "/diagnostics")
    probe.until(lambda: len(images) > 2, "images")
    client = probe.node.create_client(SetParameters, "/reconstruction/set_parameters")
    probe.until(client.service_is_ready, "service")
    wish = Parameter("resolution", value=20).to_parameter_msg()
    answer = client.call_async(SetParameters.Request(parameters=[wish]))
    probe.until((tmp_path / "begun").exists, "change under way")
    images.clear()
    reports.clear()

    def well():
        said = [s for report in reports for s in report.status if "reconstruction" in s.name]
        return len(images) > 5 and len(said) > 2

    probe.until(well, "images and reports meanwhile")
    assert images[-1].height == 40
    (tmp_path / "enough").touch()
    probe.until(lambda: images[-1].height == 20, "images of the new resolution")
    probe.until(answer.done, "the end of the change")
    ends_cleanly(reconstruction)


KEYS = """
    driver /driver /left/driver left/driver /*/driver /**/driver /left/* /left/** /** /*
    /right/driver drivr
"""


@pytest.mark.parametrize("namespace", ["/", "/left", "/robot/left"])
def test_keys_of_a_parameter_file_are_understood_as_ros_understands_them(
    domain, tmp_path, namespace
):
    file = tmp_path / "p.yaml"
    text = "".join(
        f"{key!r}: {{ros__parameters: {{p{i}: true, last: {i}}}}}\n"
        for i, key in enumerate(KEYS.split())
    )
    file.write_text(text + "left: {driver: {ros__parameters: {nested: true}}}\n")
    context = Context()
    rclpy.init(args=["--ros-args", "--params-file", str(file)], context=context, domain_id=domain)
    try:
        node = rclpy.create_node("driver", namespace=namespace, context=context)
        taken = {p.name: p.value for p in node._parameter_overrides.values()}
        assert parameters_of(file, node.get_fully_qualified_name()) == taken
        node.destroy_node()
    finally:
        context.try_shutdown()
