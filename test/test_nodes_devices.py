"""A sensor on a serial line, and a recording of one, with a curved sheet, through both nodes."""

import pytest

pytest.importorskip("rclpy")

import ros_checks
from diagnostic_msgs.msg import DiagnosticStatus
from ros_support import ends_cleanly

from tomotactile_ros.devices import KINDS
from tomotactile_ros.nodes.data_source import NATURES


def test_a_curved_sheet_on_a_line_and_recorded(probe, start, spawn, scene, tmp_path):
    """One reconstruction, of the sensor at first and then of its recording."""
    curved = ros_checks.write_curved_layout(tmp_path)
    reconstruction = start("reconstruction", {"layout": curved})
    spawn(*ros_checks.emulator(tmp_path, curved, scene), warm=False)
    for device in ("serial", "replay"):
        source = ros_checks.arguments_of(device, tmp_path, curved, scene)
        driver = start("driver", {"layout": curved, "loop": "true", **source})
        ros_checks.check_topics(probe)
        ros_checks.check_contact(probe, bent=True)
        ros_checks.check_surface(probe)
        ros_checks.check_diagnostics(probe, "driver: device", DiagnosticStatus.OK, "")
        ros_checks.check_tare(probe)
        ends_cleanly(driver)
    ends_cleanly(reconstruction)


def test_only_data_of_sensors_are_not_marked():
    sensors = {"serial"}
    assert set(NATURES) == set(KINDS) - sensors, (
        "a device that is no sensor needs its line in NATURES, nodes/data_source.py; one that is, a name here"
    )
