"""`viz:=true` starts rviz2 on the topics of the sensor; a stub stands in for rviz2."""

import json
import os
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parent.parent))

for package in ("launch", "launch_ros"):
    pytest.importorskip(package, reason=f"{package} comes with a full ROS 2")

import yaml
from launch.actions import RegisterEventHandler, Shutdown
from launch.event_handlers import OnProcessExit
from launch_support import include, reserve_domain
from ros_support import processes_of

import launch

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

    actions = include("tactile.launch.py", reserve_domain(), {"viz": "true", "namespace": "skin"})
    service = launch.LaunchService()
    service.include_launch_description(
        launch.LaunchDescription([RegisterEventHandler(OnProcessExit(on_exit=end)), *actions])
    )
    assert service.run() == 0
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
    service = launch.LaunchService()
    actions = include("tactile.launch.py", domain, {"viz": "true"})
    service.include_launch_description(launch.LaunchDescription(actions))
    assert service.run() == 1
    assert processes_of("driver", domain) + processes_of("reconstruction", domain) == []
