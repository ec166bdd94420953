"""`tomotactile optimize` as a user runs it."""

import re
import signal
import subprocess
import sys
import time

import pytest
from process_support import descendants, running
from warm_start import begin

from tomotactile_ros.cli import main
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.optimizer.options import OPTIONS
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.errors import InputError

PATIENCE = 60.0
PNG = b"\x89PNG\r\n\x1a\n"


def test_equalize_writes_a_layout_and_a_picture(tmp_path, capsys):
    out = tmp_path / "better.yaml"
    command = ["optimize", "--rows", "4", "--cols", "4", "--size", "0.2", "0.2"]
    command += ["--method", "paper", "--select", "worst", "--steps", "2"]
    assert main([*command, "--out", str(out)]) == 0
    layout = load_layout(out)
    assert (layout.name, layout.electrodes, layout.radius) == ("better", 16, 0.005)
    assert layout.provenance["algorithm"] == "equalize"
    again = "--method equalize --rows 4 --cols 4 --size 0.2 0.2 --select worst --steps 2"
    assert layout.provenance["settings"]["command"] == f"tomotactile optimize {again}"
    assert len(layout.provenance["steps"]) == 3
    after = layout.provenance["metrics"]["after"]["hwhm"]["worst_region"]
    assert after < 0.9 * layout.provenance["metrics"]["before"]["hwhm"]["worst_region"]
    assert out.with_suffix(".png").read_bytes().startswith(PNG)
    said = capsys.readouterr().out
    assert "HWHM of the worst region" in said
    assert "mm beyond the rim: --method touch --margin 0.005 keeps them on the sheet" in said


def test_grounding_writes_the_conditions(tmp_path, capsys):
    out = tmp_path / "few.yaml"
    command = ["optimize", "--rows", "3", "--cols", "3", "--method", "scan"]
    assert main([*command, "--conditions", "9", "4", "--resolution", "10", "--out", str(out)]) == 0
    layout = load_layout(out)
    assert len(layout.scan) == 4 and list(layout.scan) == layout.provenance["grounding"]["4"]
    assert out.with_suffix(".png").read_bytes().startswith(PNG)
    assert "conditions" in capsys.readouterr().out


def test_zones_to_keep_out_of_are_three_numbers_each():
    """As parameters of the node; that all others mean what the command means: test_nodes_optimizer.py."""
    (keep_out,) = (o for o in OPTIONS if o.name == "keep_out")
    assert keep_out.given((0.0, 0.1, 0.2, 0.3, 0.4, 0.5)) == [[0.0, 0.1, 0.2], [0.3, 0.4, 0.5]]
    with pytest.raises(InputError, match="keep_out: 4 numbers, X, Y, R of each are needed"):
        keep_out.given((0.0, 0.1, 0.02, 0.05))


def test_what_needs_more_memory_than_there_is_is_refused_before_it_is_taken(monkeypatch):
    monkeypatch.setattr("tomotactile_ros.support.memory.free_bytes", lambda: 1e6)
    with pytest.raises(InputError, match="16 electrodes at resolution 40 would take about"):
        Pipeline(load_layout("equal-4x4"), Settings())
    simulator = Simulator(load_layout("equal-4x4"), load_scene("wide"), "closed_form")
    with pytest.raises(InputError, match="patches, would take about"):
        simulator.frame(0.0, 0)


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP, signal.SIGKILL])
def test_a_stopped_optimizer_writes_its_best_and_leaves_nobody_behind(tmp_path, number):
    out = tmp_path / "best.yaml"
    command = "-m tomotactile_ros.cli optimize --rows 3 --cols 3 --method free --steps 100000 --resolution 6 --starts 2 --workers 2 --out"
    command = [sys.executable, *command.split(), str(out)]
    process = begin(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True)
    assert any(re.match("free: [1-9]", line) for line in process.stderr)
    left = descendants(process.pid)
    assert len(left) >= 2
    process.send_signal(number)
    process.communicate(timeout=PATIENCE)
    if number == signal.SIGKILL:
        assert process.returncode == -signal.SIGKILL and not out.exists()
    else:
        assert process.returncode == 0
        assert len(load_layout(out).provenance["steps"]) >= 2
        assert out.with_suffix(".png").read_bytes().startswith(PNG)
    deadline = time.monotonic() + PATIENCE
    while any(map(running, left)):
        assert time.monotonic() < deadline, "somebody was left behind"
        time.sleep(0.01)
