"""benchmark/fault_kills.py sees what a killed program leaves behind, and nothing where nothing is;
benchmark/faults.py judges frames."""

import importlib
import signal
import sys
from dataclasses import replace
from pathlib import Path

import pytest

from tomotactile_ros.devices.base import Status

pytest.importorskip("diagnostic_msgs")
sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmark"))
fault_kills, faults = map(importlib.import_module, ("fault_kills", "faults"))


def left_by(script: str, how: signal.Signals = signal.SIGTERM) -> dict[str, int]:
    """What is wrong behind a program that has ended by itself before the signal came."""
    program = fault_kills.Program(["sh", "-c", script], 60.0)
    seen = fault_kills.kill_once(program, program.span, how)
    assert seen.pop("over before") == 1
    return {what: number for what, number in seen.items() if number}


def test_a_program_that_leaves_nothing():
    assert left_by("printf 'format: x/1\\n' > out.yaml") == {}


def test_strays_and_broken_files_are_seen(monkeypatch):
    monkeypatch.setattr(fault_kills, "GRACE", 0.1)
    script = "sleep 60 & until grep -q sleep /proc/$!/comm; do :; done; "  # while it starts it has no name
    script += "printf 'half: [' > out.yaml; echo Traceback >&2"
    assert left_by(script) == {"strays": 1, "broken files": 1, "tracebacks": 1}


def test_what_a_kill_may_leave():
    assert left_by("touch .out.yaml.tmp") == {"broken files": 1}
    assert left_by("touch .out.yaml.tmp", signal.SIGKILL) == {}


def test_a_sensor_whose_plug_is_pulled_is_an_error(tmp_path):
    """The level counts while nothing is there, not only while frames arrive."""
    said = faults.plug_pulled(f"pty:{tmp_path}/port", times=2)
    row = faults.run("none", f"pty:{tmp_path}/port", 2.0)
    frames, _, rest = said.partition(" ")  # one for each plug, more before a slow machine pulls it
    assert int(frames) >= 2 and rest.startswith("frames, 0 wrong readings, ERROR")
    found = dict(zip(faults.HEADER, row, strict=True))
    assert int(found["published"]) > 0 and found["wrong readings"] == "0"
    status = Status("streaming", "", {})
    assert faults.level_of(replace(status, dead=(3,))) == 1
    assert faults.level_of(replace(status, state="silent")) == 2
