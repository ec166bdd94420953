"""The optimizer node: maps while it works, a layout at its end, a reason when it cannot."""

import threading
from argparse import ArgumentParser
from dataclasses import replace

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from process_support import descendants, running
from ros_checks import LATCHED
from ros_support import LIMIT, Probe, ros_arguments
from sensor_msgs.msg import Image

from tomotactile_ros.commands.optimize import add_arguments
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.nodes import optimizer
from tomotactile_ros.nodes.running import PlainNode
from tomotactile_ros.optimizer.equalize import equalize
from tomotactile_ros.optimizer.options import OPTIONS
from tomotactile_ros.optimizer.request import Request


def test_every_option_of_the_command_is_a_parameter_and_means_the_same():
    """Names, kinds, choices, and what they are where nobody gives them."""
    parser = ArgumentParser(add_help=False)
    add_arguments(parser)
    actions = {action.dest: action for action in parser._actions}
    specs = {spec.name: spec for spec in optimizer.SPECS if spec.name != "frame_id"}
    table = {option.name: option for option in OPTIONS}
    assert set(actions) == set(specs)
    for name, action in actions.items():
        spec, option = specs[name], table[name]
        kind = bool if action.nargs == 0 else action.type
        assert (spec.items if option.is_list else type(spec.default)) is kind, name
        assert isinstance(spec.default, tuple) == (action.nargs not in (None, 0)), name
        assert spec.choices == tuple(action.choices or ()), name
        assert spec.description.lower() == action.help.lower(), name
        if name != "out":  # the command has to be told
            assert option.given(spec.default) == action.default, name


GRID = {"layout": "equal-4x4"}


@pytest.mark.parametrize(
    "parameters, electrodes, rows, said",
    [
        ({**GRID, "method": "equalize", "steps": 1}, 16, 0, "step 1 of 1"),
        ({**GRID, "method": "scan", "frame_time": 0.004, "resolution": 10}, 16, 4, "4 rows"),
        ({"explore": "[4, 9]", "place": 0.1}, 4, 0, "are the fewest"),
    ],
    ids=["places", "rows", "number"],
)
def test_it_writes_the_layout_and_ends(start, tmp_path, parameters, electrodes, rows, said):
    out = tmp_path / "better.yaml"
    process = start("optimizer", {**parameters, "out": out}, warm=False)
    assert process.wait() == 0, process.output
    layout = load_layout(out)
    assert layout.electrodes == electrodes and said in process.output
    assert len(layout.scan or ()) == rows or not rows


def test_a_stop_ends_the_processes_of_the_search(probe, start, tmp_path):
    """Which load the installed program's file anew, and do not run it."""
    out = tmp_path / "free.yaml"
    given = {"rows": 3, "cols": 3, "method": "free", "steps": 100000, "resolution": 6}
    given |= {"starts": 2, "workers": 2, "out": out}
    process = start("optimizer", given, warm=False)
    probe.until(lambda: "step 1 of" in process.output, "first round")
    children = descendants(process.pid)
    assert len(children) >= 2
    assert process.stop() == 0, process.output
    probe.until(lambda: not any(map(running, children)), "end of the processes")
    assert load_layout(out).electrodes == 9


class Patient:
    """Stands for the steps of a search: two of them in turn until told, then one without an end."""

    def __init__(self):
        self.be_slow, self.end = threading.Event(), threading.Event()
        self.waited_for = False

    def steps(self, request, _):
        start, better = equalize(request.layout, 1)
        yield start
        while not self.be_slow.wait(0.05):
            yield replace(start, best=False)
            yield better
        self.waited_for = not self.end.wait(LIMIT)


def test_it_shows_a_map_of_each_step_and_a_stop_keeps_the_best_so_far(
    domain, tmp_path, monkeypatch
):
    patient, out = Patient(), tmp_path / "best.yaml"
    monkeypatch.setattr(Request, "steps_of", lambda *words: patient.steps(*words))
    parameters = {**GRID, "method": "equalize", "out": out}
    rclpy.init(args=ros_arguments(parameters), domain_id=domain)
    node = PlainNode(optimizer.Optimizer)
    probe = Probe(domain)
    maps = probe.listen(Image, "/resolution_map", LATCHED)
    probe.until(lambda: len({bytes(m.data) for m in maps}) == 2, "maps of two steps")
    patient.be_slow.set()
    node.destroy_node()
    probe.close()
    rclpy.try_shutdown()
    patient.end.set()
    assert not patient.waited_for
    shown = maps[0]
    hwhm = np.frombuffer(shown.data, np.float32)
    assert shown.encoding == "32FC1" and shown.header.frame_id == "tactile_link"
    assert 0.0 < hwhm.min() < hwhm.max() < 0.2
    metrics = load_layout(out).provenance["metrics"]
    after, before = (metrics[when]["hwhm"]["worst_region"] for when in ("after", "before"))
    assert after < before
