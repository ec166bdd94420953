"""The optimizer node: maps while it works, a layout at its end, a reason when it cannot."""

import threading
from dataclasses import replace

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_support import LIMIT, Probe, ros_arguments
from sensor_msgs.msg import Image

from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.nodes import optimizer
from tomotactile_ros.nodes.running import PlainNode
from tomotactile_ros.optimizer.equalize import equalize

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)


def test_it_writes_the_layout_and_ends(start, tmp_path):
    out = tmp_path / "better.yaml"
    parameters = {"layout": "equal-4x4", "method": "equalize", "steps": 1}
    parameters |= {"out": out, "name": "better"}
    process = start("optimizer", parameters)
    assert process.wait() == 0, process.output
    layout = load_layout(out)
    assert layout.name == "better" and layout.electrodes == 16
    assert layout.provenance["algorithm"] == "equalize"
    assert "step 1 of 1" in process.output


def test_a_search_that_is_stopped_in_its_first_step_writes_nothing(probe, start, tmp_path):
    out = tmp_path / "free.yaml"
    process = start("optimizer", {"layout": "equal-4x4", "method": "free", "out": out})
    probe.until(lambda: "step 0 of" in process.output, "evaluation of the start")
    assert process.stop() == 0, process.output
    assert "no step was finished: nothing is written" in process.output
    assert not out.exists()


class Patient:
    """Stands for the steps of a search: two of them in turn until told, then one without an end."""

    def __init__(self):
        self.be_slow = threading.Event()
        self.end = threading.Event()
        self.waited_for = False

    def steps(self, request):
        start, better = equalize(request.layout, 1)
        yield start
        while not self.be_slow.wait(0.05):
            yield replace(start, best=False)
            yield better
        self.waited_for = not self.end.wait(LIMIT)


@pytest.fixture
def patient(monkeypatch):
    """Lets the optimizer do these steps."""
    search = Patient()
    monkeypatch.setattr(optimizer.Request, "steps_of", lambda request: search.steps(request))
    yield search
    search.end.set()


def test_it_shows_a_map_of_each_step_and_a_stop_keeps_the_best_so_far(patient, domain, tmp_path):
    out = tmp_path / "best.yaml"
    parameters = {"layout": "equal-4x4", "method": "equalize", "out": out}
    rclpy.init(args=ros_arguments(parameters), domain_id=domain)
    node = PlainNode(optimizer.Optimizer)
    probe = Probe(domain)
    maps = probe.listen(Image, "/resolution_map", LATCHED)
    probe.until(lambda: len({bytes(m.data) for m in maps}) == 2, "maps of two steps")
    patient.be_slow.set()
    node.destroy_node()
    probe.close()
    rclpy.try_shutdown()
    assert not patient.waited_for
    shown = maps[0]
    hwhm = np.frombuffer(shown.data, np.float32)
    assert shown.encoding == "32FC1" and shown.header.frame_id == "tactile_link"
    assert 0.0 < hwhm.min() < hwhm.max() < 0.2
    best = load_layout(out).provenance["metrics"]["after"]["hwhm"]["worst_region"]
    assert best < load_layout(out).provenance["metrics"]["before"]["hwhm"]["worst_region"]


@pytest.mark.parametrize(
    "parameters, reason",
    [
        ({"layout": "none"}, "'none': no such file"),
        ({"steps": -1}, "steps"),
        ({"resolution": 1}, "resolution: 1 is not"),
        ({"method": "equalize", "seed": 3}, "seed: only method free knows it"),
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
