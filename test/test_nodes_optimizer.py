"""The optimizer node: maps while it works, a layout at its end, a reason when it cannot."""

import time
from dataclasses import replace

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_support import Probe, ros_arguments
from sensor_msgs.msg import Image

from tomotactile_ros.layout import equal_grid, load_layout
from tomotactile_ros.nodes import optimizer
from tomotactile_ros.nodes.life import PlainNode
from tomotactile_ros.optimizer.equalize import equalize

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_it_writes_the_layout_and_ends(start, tmp_path):
    out = tmp_path / "better.yaml"
    parameters = {"layout": "equal-4x4", "steps": 1, "out": out, "name": "better"}
    process = start("optimizer", parameters)
    assert process.wait() == 0, process.output
    layout = load_layout(out)
    assert layout.name == "better" and layout.electrodes == 16
    assert layout.provenance["algorithm"] == "equalize"
    assert "step 1 of 1" in process.output


def test_a_free_search_that_is_stopped_keeps_what_it_has(probe, start, tmp_path):
    equal_grid(2, 2, (0.2, 0.2), 0.005, 1e4).save(tmp_path / "grid.yaml")
    out = tmp_path / "free.yaml"
    parameters = {"layout": tmp_path / "grid.yaml", "method": "free", "out": out}
    process = start("optimizer", parameters)
    probe.until(lambda: "step 1 of" in process.output, "the first step")
    assert process.stop() == 0, process.output
    metrics = load_layout(out).provenance["metrics"]
    assert metrics["after"]["hwhm"]["mean"] < metrics["before"]["hwhm"]["mean"]


@pytest.fixture
def patient(monkeypatch):
    """Lets the optimizer repeat its two steps until it is stopped."""

    def repeat(request, executor=None):
        start, better = equalize(request.layout, 1)
        yield start
        while True:
            time.sleep(0.05)
            yield replace(start, best=False)
            yield better

    monkeypatch.setattr(optimizer.Request, "steps_of", repeat)


def test_it_shows_a_map_of_each_step_and_a_stop_keeps_the_best_so_far(patient, domain, tmp_path):
    out = tmp_path / "best.yaml"
    rclpy.init(args=ros_arguments({"layout": "equal-4x4", "out": out}), domain_id=domain)
    node = PlainNode(optimizer.Optimizer)
    probe = Probe(domain)
    maps = probe.listen(Image, "/resolution_map", LATCHED)
    probe.until(lambda: len({bytes(m.data) for m in maps}) == 2, "maps of two steps")
    node.destroy_node()
    probe.close()
    shown = maps[0]
    hwhm = np.frombuffer(shown.data, np.float32)
    assert shown.encoding == "32FC1" and shown.header.frame_id == "tactile_link"
    assert 0.0 < hwhm.min() < hwhm.max() < 0.2
    assert not rclpy.ok()  # what ends the program
    best = load_layout(out).provenance["metrics"]["after"]["hwhm"]["worst_region"]
    assert best < load_layout(out).provenance["metrics"]["before"]["hwhm"]["worst_region"]


@pytest.mark.parametrize(
    "parameters, reason",
    [
        ({"layout": "none"}, "'none': no such file"),
        ({"steps": -1}, "steps"),
        ({"name": "''"}, "name: '' is not"),
        ({"method": "guess"}, "method: 'guess' is none of"),
        ({"layout": "equal-4x4", "steps": 1, "out": "/no/such/folder/a.yaml"}, "/no/such/folder"),
    ],
)
def test_what_is_impossible_ends_with_status_2(start, parameters, reason):
    process = start("optimizer", parameters)
    assert process.wait() == 2
    (line,) = process.output.splitlines()
    assert reason in line
