"""benchmark/fault_kills.py sees what a killed program leaves behind, and nothing where nothing
is."""

import importlib.util
import signal
import sys
from pathlib import Path

BENCHMARK = Path(__file__).resolve().parent.parent / "benchmark"


def _fault_kills():
    spec = importlib.util.spec_from_file_location("fault_kills", BENCHMARK / "fault_kills.py")
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # for its dataclass
    spec.loader.exec_module(module)
    return module


fault_kills = _fault_kills()


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
    script = "sleep 60 & printf 'half: [' > out.yaml; echo Traceback >&2"
    assert left_by(script) == {"strays": 1, "broken files": 1, "tracebacks": 1}


def test_what_a_kill_may_leave():
    assert left_by("touch .out.yaml.tmp") == {"broken files": 1}
    assert left_by("touch .out.yaml.tmp", signal.SIGKILL) == {}
