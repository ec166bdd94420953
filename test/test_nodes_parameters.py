"""Parameters: a bad value is refused with the reason, at the start and at run time."""

import signal
from importlib import import_module
from pathlib import Path

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

import ros_checks
from ament_index_python.packages import get_package_share_directory
from diagnostic_msgs.msg import DiagnosticStatus
from rcl_interfaces.msg import ParameterType
from rcl_interfaces.srv import DescribeParameters, GetParameters, ListParameters
from ros_support import Process, ends_cleanly, program, ros_arguments
from sensor_msgs.msg import Image

from tomotactile_ros.contact import ContactLaw
from tomotactile_ros.msg import ContactArray, VoltageFrame
from tomotactile_ros.reconstruction.calibration import Fit, save_calibration

BAD_STARTS = [
    ("driver", {"layout": "nowhere"}, "'nowhere': no such file"),
    ("driver", {"layout": "5"}, "layout"),
    ("driver", {"device": "camera"}, "device: 'camera' is none of fake, serial, replay"),
    ("driver", {"scene": "nothing"}, "'nothing': no such file"),
    ("driver", {"rate": "fast"}, "rate: 'fast' is not a number"),
    ("driver", {"rate": "-1"}, "rate"),
    ("driver", {"rate": ".nan"}, "rate"),
    ("driver", {"baud": "12"}, "baud"),
    ("driver", {"device": "serial"}, "port: missing"),
    ("driver", {"use_sim_time": "maybe"}, "use_sim_time"),
    ("driver", {"qos_overrides./voltage_frame.publisher.reliability": "much"}, "much"),
    ("driver", {"device": "replay", "recording": "/none.npz"}, "/none.npz"),
    ("reconstruction", {"profile": "best"}, "profile: 'best' is none of fast"),
    ("reconstruction", {"resolution": "4.5"}, "resolution"),
    ("reconstruction", {"calibration": "/none.yaml"}, "/none.yaml"),
    ("reconstruction", {"excluded": "[64]"}, "electrode 64 does not exist"),
    ("reconstruction", {"excluded": [*range(64)]}, "0 of 64 electrodes left, need 2"),
    ("reconstruction", {"excluded": "[0.5]"}, "not a list of whole numbers"),
    ("reconstruction", {"contact_exponent": "0"}, "contact_exponent"),
    ("tactile", {"scene": "nothing"}, "'nothing': no such file"),
]


@pytest.fixture
def call_main(monkeypatch, capfd):
    """Runs a program's main in this process; returns its status and what it complained of."""
    interrupt = signal.getsignal(signal.SIGINT)

    def call(name, arguments):
        monkeypatch.setattr("sys.argv", [name])
        status = import_module(f"tomotactile_ros.nodes.{name}").main(arguments)
        said = capfd.readouterr().err.splitlines()
        return status, [line for line in said if "[INFO]" not in line]

    yield call
    signal.signal(signal.SIGINT, interrupt)


@pytest.mark.parametrize("name, parameters, reason", BAD_STARTS)
def test_a_bad_start_ends_with_one_line_and_status_2(name, parameters, reason, call_main):
    status, complaints = call_main(name, ros_arguments(parameters))
    assert status == 2
    assert len(complaints) == 1 and reason in complaints[0]
    assert complaints[0].startswith(f"{name}: ")


def test_a_bad_start_is_the_exit_status_of_the_program(domain):
    process = Process([program("driver"), *ros_arguments({"scene": "nothing"})], domain)
    assert process.wait() == 2
    assert len(process.output.splitlines()) == 1


def test_a_bad_command_line_ends_with_status_2(domain):
    process = Process([program("driver"), "--ros-args", "--params-file", "/no/such.yaml"], domain)
    assert process.wait() == 2
    assert "/no/such.yaml" in process.output
    assert "Traceback" not in process.output


@pytest.fixture
def tactile(domain):
    """Both nodes, started with their files of config/."""
    share = Path(get_package_share_directory("tomotactile_ros"), "config")
    files = [share / f"{name}.yaml" for name in ("driver", "reconstruction")]
    words = [word for file in files for word in ("--params-file", str(file))]
    process = Process([program("tactile"), "--ros-args", *words], domain)
    yield process
    process.kill()


def test_every_parameter_is_described(probe, tactile):
    for node in ("driver", "reconstruction"):
        listed = probe.call(ListParameters, f"/{node}/list_parameters").result.names
        own = [name for name in listed if "." not in name and name not in
               ("use_sim_time", "start_type_description_service")]  # fmt: skip
        request = DescribeParameters.Request(names=own)
        described = probe.call(DescribeParameters, f"/{node}/describe_parameters", request)
        assert len(own) >= 10
        assert all(d.description for d in described.descriptors)
        read_only = {d.name for d in described.descriptors if d.read_only}
        assert read_only == {"layout", "frame_id"}
    get = GetParameters.Request(names=["excluded"])
    (excluded,) = probe.call(GetParameters, "/reconstruction/get_parameters", get).values
    assert excluded.type == ParameterType.PARAMETER_INTEGER_ARRAY
    assert tactile.running()


def test_the_driver_changes_at_run_time_what_it_can(probe, start, scene):
    driver = start("driver", {"scene": "idle", "rate": "20"})  # a whole number will do
    probe.wait_for(VoltageFrame, "/voltage_frame")

    for name, value, reason in [
        ("layout", "equal-4x4", "read-only"),
        ("scene", "nothing", "'nothing': no such file"),
        ("device", "serial", "port: missing"),
        ("rate", -3.0, "out of range"),
        ("rate", -3, "out of range"),
        ("rate", "fast", "not a number"),
    ]:
        result = probe.set_parameter("/driver", name, value)
        assert not result.successful and reason in result.reason
    kept = probe.call(GetParameters, "/driver/get_parameters", GetParameters.Request(
        names=["scene", "device"])).values  # fmt: skip
    assert [v.string_value for v in kept] == ["idle", "fake"]

    assert probe.set_parameter("/driver", "rate", 50).successful
    assert probe.set_parameter("/driver", "scene", scene).successful
    largest = probe.wait_for(VoltageFrame, "/voltage_frame", lambda m: np.nanmax(m.voltages) > 0.1)
    assert largest.layout_id == "equal-8x8"

    assert probe.set_parameter("/driver", "streaming", False).successful
    ros_checks.check_diagnostics(probe, "driver: device", DiagnosticStatus.WARN, "stopped")
    assert probe.set_parameter("/driver", "streaming", True).successful
    ros_checks.check_diagnostics(probe, "driver: device", DiagnosticStatus.OK, "simulated")
    assert probe.set_parameter("/driver", "model", "closed_form").successful
    ends_cleanly(driver)


def test_the_reconstruction_changes_at_run_time_what_it_can(probe, start, scene, tmp_path):
    start("driver", {"scene": scene})
    reconstruction = start("reconstruction", {"resolution": 20, "view_size": 100})
    image = probe.wait_for(Image, "/pressure")
    assert (image.height, image.width) == (20, 20)

    for name, value, reason in [
        ("frame_id", "x", "read-only"),
        ("excluded", None, "not a list of whole numbers"),
        ("profile", "best", "none of"),
        ("resolution", 1000, "out of range"),
        ("excluded", [64], "electrode 64 does not exist"),
    ]:
        result = probe.set_parameter("/reconstruction", name, value)
        assert not result.successful and reason in result.reason

    assert probe.set_parameter("/reconstruction", "resolution", 30).successful
    probe.wait_for(Image, "/pressure", lambda m: (m.height, m.width) == (30, 30))
    view = probe.wait_for(Image, "/pressure_view", lambda m: m.height == 90)
    assert view.width == 90
    assert probe.set_parameter("/reconstruction", "excluded", [3, 7]).successful
    ros_checks.check_diagnostics(
        probe, "reconstruction: reconstruction", b"\x01", "electrodes left out: 3, 7"
    )
    law = tmp_path / "law.yaml"
    save_calibration(law, Fit(ContactLaw(2e-4, 1.0), 0.0, 1))
    before = probe.wait_for(ContactArray, "/contacts").contacts[0].force
    assert probe.set_parameter("/reconstruction", "calibration", str(law)).successful
    probe.wait_for(ContactArray, "/contacts", lambda m: m.contacts[0].force < 0.6 * before)
    assert probe.set_parameter("/reconstruction", "profile", "balanced").successful
    probe.wait_for(ContactArray, "/contacts", lambda m: len(m.contacts) > 0)
    ends_cleanly(reconstruction)


def test_a_misspelt_parameter_is_pointed_out(probe, start):
    both = start("tactile", {"scene": "idle", "rat": "20.0", "partial_frames": "true"})
    probe.wait_for(VoltageFrame, "/voltage_frame")
    assert "parameter 'rat' is unknown and ignored; did you mean 'rate'?" in both.output
    assert "partial_frames" not in both.output  # the other node's
