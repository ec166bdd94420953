"""The reconstruction learns its sensor: what it publishes, and keeps over a crash."""

import pytest

rclpy = pytest.importorskip("rclpy")

import numpy as np
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_support import ends_cleanly
from test_learning import layout, simulator, truth

from tomotactile_ros.msg import ContactArray, SensorState

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def known(probe, touches):
    return probe.wait_for(SensorState, "/sensor_state", lambda m: m.touches >= touches, LATCHED)


def test_it_learns_publishes_and_keeps_what_it_knows(probe, start, tmp_path):
    layout().save(tmp_path / "layout.yaml")
    simulator(60).scene.save(tmp_path / "scene.yaml")
    file = tmp_path / "sensor.yaml"
    sensor = {"layout": tmp_path / "layout.yaml", "scene": tmp_path / "scene.yaml", "rate": 10}
    start("driver", sensor)
    own = {
        "layout": tmp_path / "layout.yaml", "profile": "accurate", "resolution": 16,
        "sensor": file, "learn": "all",
    }  # fmt: skip
    first = start("reconstruction", own)
    message = known(probe, 3)
    ratio = np.array(message.gain) / truth().gain
    assert (ratio / ratio.mean()).std() < 1e-3
    assert message.layout_id == layout().id and len(message.places) == len(message.logarithm)
    evidence = dict(zip(message.unknown, message.evidence, strict=True))
    assert evidence["gains"] > 100 and evidence["gains"] > evidence["places"]
    assert message.radius == pytest.approx(layout().radius, rel=0.2) and not message.tears
    assert max(message.gain_deviation) < 0.02 and message.header.stamp.sec > 0
    probe.until(file.exists, "file of the sensor")
    first.kill()
    second = start("reconstruction", {**own, "learn": "off"})
    again = known(probe, 3)
    assert np.array(again.gain) == pytest.approx(message.gain, abs=2e-3)
    probe.wait_for(ContactArray, "/contacts", lambda m: m.state == m.VALID and len(m.contacts) == 1)
    ends_cleanly(second)
