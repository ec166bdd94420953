"""A sensor on a serial line, and a recording of one, with a curved sheet, through both nodes."""

import pytest

rclpy = pytest.importorskip("rclpy")

import ros_checks
from diagnostic_msgs.msg import DiagnosticStatus
from ros_support import ends_cleanly


@pytest.fixture
def curved(tmp_path):
    """File of a layout with a curved surface."""
    return ros_checks.write_curved_layout(tmp_path)


@pytest.mark.parametrize("device", ["serial", "replay"])
def test_a_curved_sheet_on_a_line_or_recorded(
    device, probe, start, domain, curved, scene, tmp_path
):
    source = ros_checks.arguments_of(device, tmp_path, curved, scene)
    driver = start("driver", {"layout": curved, "loop": "true", **source})
    reconstruction = start("reconstruction", {"layout": curved})
    emulator = ros_checks.plug_in(tmp_path, curved, scene, domain) if device == "serial" else None
    try:
        ros_checks.check_topics(probe)
        ros_checks.check_contact(probe, bent=True)
        ros_checks.check_surface(probe)
        ros_checks.check_diagnostics(probe, "driver: device", DiagnosticStatus.OK, "")
        ros_checks.check_tare(probe)
        ends_cleanly(driver)
        ends_cleanly(reconstruction)
    finally:
        if emulator is not None:
            emulator.kill()


def test_a_line_that_is_pulled_out_is_said_and_found_again(probe, start, domain, scene, tmp_path):
    driver = start("driver", ros_checks.arguments_of("serial", tmp_path, "equal-8x8", scene))
    start("reconstruction")
    for _ in range(2):
        emulator = ros_checks.plug_in(tmp_path, "equal-8x8", scene, domain)
        try:
            ros_checks.check_contact(probe)
        finally:
            emulator.kill()
        ros_checks.check_diagnostics(
            probe, "reconstruction: reconstruction", DiagnosticStatus.ERROR, "nothing arrives"
        )
        ros_checks.check_diagnostics(probe, "driver: device", DiagnosticStatus.ERROR, "port")
        ros_checks.has_logged(probe, driver, "ERROR", "disconnected: port")
