"""Launch files that run: the launch tests, launch_test_*.py, each by the program `launch_test` in a
process of its own; and launches that end by themselves, well or not.

The plugin of launch_testing for pytest knows only some versions of pytest; so it is left out
(pyproject.toml), and the tests run under all of them.
"""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

for package in ("launch", "launch_ros", "launch_testing"):
    pytest.importorskip(package, reason=f"{package} comes with a full ROS 2")

import yaml
from launch.actions import RegisterEventHandler, Shutdown, TimerAction
from launch.event_handlers import OnProcessExit
from launch_support import launched, reserve_domain
from ros_support import processes_of

from tomotactile_ros.layouts.layout import load_layout

FILES = sorted(Path(__file__).parent.glob("launch_test_*.py"))


def left_in(domain):
    programs = "driver", "reconstruction", "tactile", "skin", "optimizer"
    return [process for name in programs for process in processes_of(name, domain)]


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.stem)
def test_launch_test(file):
    command = [sys.executable, "-m", "launch_testing.launch_test", str(file)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-10_000:] + done.stderr[-10_000:]


def test_the_launch_of_the_optimizer_ends_with_the_layout_written(tmp_path):
    out = tmp_path / "better.yaml"
    arguments = {"layout": "equal-4x4", "method": "equalize", "out": str(out)}
    assert launched("optimize.launch.py", reserve_domain(), arguments) == 0
    assert load_layout(out).electrodes == 16


REFUSED = [
    ("optimize", {"method": "guess"}),
    ("optimize", {"layout": "nowhere"}),
    ("optimize", {"out": "/nowhere/better.yaml"}),
    ("optimize", {"namespace": "left-hand"}),
    ("optimize", {"params_file": "/none.yaml"}),
    ("tactile", {"scene": "nothing"}),
    ("tactile", {"profile": "best"}),
    ("tactile", {"params_file": "/none.yaml"}),
    ("two_sensors", {"robot": "false", "right_device": "seriel"}),
    ("two_sensors", {"robot": "maybe"}),
    ("two_sensors", {"robot": "false", "viz": "1"}),
]


@pytest.mark.parametrize("name, arguments", REFUSED)
def test_a_refused_argument_fails_the_launch_and_leaves_nothing_behind(name, arguments):
    domain = reserve_domain()
    assert launched(f"{name}.launch.py", domain, arguments) == 1
    assert left_in(domain) == []


def test_a_refusal_can_be_left_to_itself():
    """The reconstruction refuses; the driver, and whatever else was launched, goes on."""
    ended = []

    def note(event, context):
        ended.append((event.process_name.split("-")[0], event.returncode, context.is_shutdown))
        return [] if context.is_shutdown else [TimerAction(period=3.0, actions=[Shutdown()])]

    arguments = {"profile": "best", "on_refusal": "ignore"}
    noted = RegisterEventHandler(OnProcessExit(on_exit=note))
    assert launched("tactile.launch.py", reserve_domain(), arguments, noted) == 0
    assert ended[0] == ("reconstruction", 2, False)
    assert ended[1:] == [("driver", 0, True)]  # not started again, and the driver to the end


STUB = """#!{python}
import json, sys
json.dump(sys.argv[1:], open({out!r}, "w"))
"""


@pytest.fixture
def arguments_of_rviz(tmp_path, monkeypatch):
    """File to which a stub, installed as package rviz2, writes its command line."""
    out, program = tmp_path / "arguments.json", tmp_path / "lib" / "rviz2" / "rviz2"
    marker = tmp_path / "share" / "ament_index" / "resource_index" / "packages" / "rviz2"
    for path, text in ((program, STUB.format(python=sys.executable, out=str(out))), (marker, "")):
        path.parent.mkdir(parents=True)
        path.write_text(text)
    program.chmod(0o755)
    known = os.environ["AMENT_PREFIX_PATH"]
    monkeypatch.setenv("AMENT_PREFIX_PATH", f"{tmp_path}{os.pathsep}{known}")
    return out


def test_rviz_gets_its_configuration_and_the_topics_of_the_namespace(arguments_of_rviz):
    def end(event, context):
        return [Shutdown()] if event.process_name.startswith("rviz2") else []

    arguments = {"viz": "true", "namespace": "skin"}
    ends = RegisterEventHandler(OnProcessExit(on_exit=end))
    assert launched("tactile.launch.py", reserve_domain(), arguments, ends) == 0
    words = json.loads(arguments_of_rviz.read_text())
    config = words[words.index("-d") + 1]
    content = yaml.safe_load(Path(config).read_text("utf-8"))
    displays = content["Visualization Manager"]["Displays"]
    for topic in (d["Topic"]["Value"] for d in displays if "Topic" in d):
        assert f"{topic}:={topic[1:]}" in words
    assert "__ns:=/skin" in words


def test_without_rviz_the_launch_fails_and_leaves_nothing_behind(arguments_of_rviz):
    (arguments_of_rviz.parent / "lib" / "rviz2" / "rviz2").unlink()
    domain = reserve_domain()
    assert launched("tactile.launch.py", domain, {"viz": "true"}) == 1
    assert left_in(domain) == []
