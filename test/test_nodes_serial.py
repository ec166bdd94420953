"""The driver node with hardware that comes, goes and misbehaves: the emulator as a process; a curved sheet on a
line, and its recording, through both nodes."""

from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("rclpy")

import ros_checks
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point
from ros_support import ends_cleanly, program
from rosgraph_msgs.msg import Clock
from sensor_msgs.msg import Temperature
from std_srvs.srv import Trigger

from tomotactile_ros.devices import KINDS
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.layouts.scan_order import spread
from tomotactile_ros.msg import Contact, ContactArray, VoltageFrame
from tomotactile_ros.nodes.conversions import stamp_of
from tomotactile_ros.nodes.data_source import NATURES

PROMISED = """
    state frames rate_wanted rate_device rate_seen packets_lost crc_errors resynchronisations
    reconnects latency_mean_ms latency_p99_ms latency_max_ms age_ms dead_channels clock_jumps
    low_latency
"""


@pytest.fixture
def plug(spawn, tmp_path, scene):
    """Plugs a sensor in, the emulator in a process of its own, always at the same port."""
    port = tmp_path / "port"

    def plug_in(*arguments):
        port.unlink(missing_ok=True)
        words = "emulate", "--port", f"pty:{port}", "--scene", scene
        return spawn(program("tomotactile"), *words, *arguments)

    plug_in.port = str(port)
    return plug_in


@pytest.fixture
def values(probe):
    """The driver's figures, once they suit."""

    def suitable(**wanted) -> dict[str, str]:
        def suits(status):
            return wanted.items() <= {v.key: v.value for v in status.values}.items()

        status = ros_checks.status_of(probe, "driver: device", suits)
        return {v.key: v.value for v in status.values}

    return suitable


def test_the_driver_waits_for_its_sensor_loses_it_and_gets_it_back(probe, start, plug, values):
    driver = start("driver", {"device": "serial", "port": plug.port, "rate": 40})
    missing = DiagnosticStatus.ERROR, "does not exist; plug the sensor in"
    ros_checks.check_diagnostics(probe, "driver: device", *missing)
    answer = probe.call(Trigger, "/driver/restart")
    assert not answer.success
    assert "disconnected" in answer.message and plug.port in answer.message
    sensor = plug()
    frame = probe.wait_for(VoltageFrame, "/voltage_frame")
    assert (frame.layout_id, frame.electrodes) == (load_layout("equal-8x8").id, 64)
    voltages = np.reshape(frame.voltages, (64, 64))
    jumping = spread(load_layout("equal-8x8").positions, range(64))
    assert list(frame.grounded) == jumping
    assert np.array_equal(np.isnan(voltages), np.eye(64, dtype=bool)[jumping])
    assert np.nanmax(voltages) > 0.1
    assert set(PROMISED.split()) <= set(values(rate_device="40"))
    sensor.kill()
    values(state="disconnected")
    assert probe.set_parameter("/driver", "rate", 20.0).successful
    plug()
    assert int(values(rate_device="20", state="streaming")["reconnects"]) >= 1
    probe.wait_for(VoltageFrame, "/voltage_frame")
    assert probe.call(Trigger, "/driver/restart").success
    values(state="streaming", reconnects="0")
    ends_cleanly(driver)


def test_rows_an_order_and_the_temperature_come_through_the_driver(probe, start, plug, tmp_path):
    plug("--temperature", "31.5")
    capture = tmp_path / "line.raw"
    order = [9, 0, 63, 9, 27, 54, 1]
    rows = {"delivery": "rows", "rows_per_message": 5, "scan": order, "capture": capture}
    start("driver", {"device": "serial", "port": plug.port, **rows})
    frame = probe.wait_for(VoltageFrame, "/voltage_frame", lambda m: len(m.grounded) == 7)
    assert list(frame.grounded) == order
    rows = probe.listen(VoltageFrame, "/voltage_rows", 1000)
    probe.until(lambda: len(rows) >= 20, "rows")
    assert {tuple(m.grounded) for m in rows} == {tuple(order[:5]), tuple(order[5:])}
    for message in rows:
        assert len(message.voltages) == 64 * len(message.grounded)
        assert message.row_period == pytest.approx(1e-3, rel=0.05)

    def distances():
        """From the first message of each of the last frames to the second, s."""
        pairs = [(a, b) for a, b in pairwise(rows) if a.sequence == b.sequence]
        return [stamp_of(b.header) - stamp_of(a.header) for a, b in pairs[-10:]]

    # on a busy machine the first rows come late, and the device's clock is not yet known well
    probe.until(lambda: distances() == pytest.approx([5e-3] * 10, abs=1e-3), "rows 5 ms apart")
    told = probe.wait_for(Temperature, "/temperature")
    assert told.temperature == 31.5 and told.header.frame_id == "tactile_link"
    assert probe.set_parameter("/driver", "scan", [3]).successful
    probe.wait_for(VoltageFrame, "/voltage_frame", lambda m: list(m.grounded) == [3])
    for name, value, why in (
        ("scan", [0, 64], "electrode 64 does not exist"),
        ("capture", "/tmp/other.raw", "read-only"),
    ):
        refused = probe.set_parameter("/driver", name, value)
        assert not refused.successful and why in refused.reason
    assert capture.read_bytes().startswith(b"tomotactile-raw/1\n")


def test_contacts_choose_what_the_next_frame_grounds(probe, start, plug):
    plug()
    start("driver", {"device": "serial", "port": plug.port, "order": "adaptive"})
    publisher = probe.node.create_publisher(ContactArray, "contacts", 1)
    touched = ContactArray(contacts=[Contact(position=Point(x=0.03, y=0.02))])
    timer = probe.node.create_timer(0.05, lambda: publisher.publish(touched))
    positions = load_layout("equal-8x8").positions
    nearest = set(np.argsort(np.hypot(*(positions - [0.03, 0.02]).T))[:12].tolist())
    frames = probe.listen(VoltageFrame, "/voltage_frame", 1000)
    probe.until(lambda: frames and nearest <= set(frames[-1].grounded), "rows near the contact")
    del frames[:]
    probe.until(lambda: len({e for f in frames for e in f.grounded}) == 64, "all electrodes")
    assert {len(frame.grounded) for frame in frames} == {16}
    probe.node.destroy_timer(timer)
    assert probe.set_parameter("/driver", "order", "device").successful
    probe.wait_for(VoltageFrame, "/voltage_frame", lambda m: list(m.grounded) == list(range(64)))


def test_stamps_in_simulated_time_go_back_only_with_it(probe, start, plug):
    plug("--rate", "100", "--temperature", "31.5")
    start("driver", {"device": "serial", "port": plug.port, "use_sim_time": "true"})
    frames = probe.listen(VoltageFrame, "/voltage_frame", 1000)
    temperatures = probe.listen(Temperature, "/temperature")
    clock = probe.node.create_publisher(Clock, "/clock", 10)

    def stamps():
        return [stamp_of(frame.header) for frame in frames]

    def has_come(second):
        clock.publish(Clock(clock=Time(sec=second)))
        return frames and second - 30 < stamps()[-1] <= second

    for second in (100, 50):
        probe.until(lambda second=second: has_come(second), f"stamp of second {second}")
        frames.clear()
        probe.until(lambda: len(frames) >= 50, "frames")
        assert stamps() == sorted(stamps())
        temperatures.clear()
        probe.until(lambda: temperatures, "temperature")
        assert second - 30 < stamp_of(temperatures[0].header) <= second


def test_a_sensor_that_prints_text_comes_through_the_driver(probe, start, plug, values):
    plug("--protocol", "text-12bit", "--layout", "equal-4x4")
    text = {"device": "serial", "port": plug.port, "protocol": "text-12bit"}
    driver = start("driver", {**text, "layout": "equal-4x4", "order": "adaptive"})
    frame = probe.wait_for(VoltageFrame, "/voltage_frame", lambda m: m.electrodes == 16)
    assert list(frame.grounded) == list(range(16))
    voltages = np.reshape(frame.voltages, (16, 16))
    assert np.array_equal(np.isnan(voltages), np.eye(16, dtype=bool))
    assert 0.1 < np.nanmax(voltages) < 3.3 and frame.row_period > 0
    assert int(values(state="streaming")["lines"]) >= 16
    refused = probe.set_parameter("/driver", "protocol", "text-volts")
    assert not refused.successful and "text-V" in refused.reason
    ends_cleanly(driver)


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
