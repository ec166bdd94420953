"""benchmark/fault_kills.py sees what a killed program leaves behind, and nothing where nothing
is; benchmark/faults.py judges frames, over RFC 2217, too."""

import importlib.util
import shutil
import signal
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

BENCHMARK = Path(__file__).resolve().parent.parent / "benchmark"


def _load(name: str):
    spec = importlib.util.spec_from_file_location(name, BENCHMARK / f"{name}.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # for its dataclass
    spec.loader.exec_module(module)
    return module


fault_kills = _load("fault_kills")


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


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")  # of pyserial, about its own thread
def test_frames_arrive_over_rfc2217_and_are_judged(monkeypatch):
    """Every reading is compared, and the level is the driver's."""
    pytest.importorskip("diagnostic_msgs")
    monkeypatch.syspath_prepend(str(BENCHMARK))
    faults = _load("faults")
    judge = faults.Judge(9)
    with faults.workshop() as (folder, program):
        sensor = faults.sensor(program, f"pty:{folder}/port", electrodes=9)
        with sensor as source, faults.terminal_server(source.port) as url:
            device = faults.SerialDevice(url, 9, rate=60.0)
            device.open(judge)
            waited = judge.wait_for_frame()
            status = device.status()
            device.close()
    assert np.isfinite(waited) and judge.frames > 0 and judge.wrong_readings == 0
    assert faults.level_of(status) == 0
    assert faults.level_of(replace(status, dead=(3,))) == 1
    assert faults.level_of(replace(status, state="silent")) == 2


@pytest.mark.skipif(shutil.which("cc") is None, reason="no C compiler")
def test_a_sensor_whose_plug_is_pulled_is_an_error(monkeypatch):
    """The level counts while nothing is there, not only while frames arrive."""
    pytest.importorskip("diagnostic_msgs")
    monkeypatch.syspath_prepend(str(BENCHMARK))
    faults = _load("faults")
    with faults.workshop() as (folder, program):
        row = faults.plug_pulled(program, f"pty:{folder}/port", times=2)
    assert row[1:4] == ["2", "2", "0"] and row[-1] == "ERROR"
