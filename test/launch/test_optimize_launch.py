"""launch/optimize.launch.py ends well with a layout, or with an error."""

import pytest

for package in ("launch", "launch_ros"):
    pytest.importorskip(package, reason=f"{package} comes with a full ROS 2")

from launch_support import include, reserve_domain

import launch
from tomotactile_ros.layouts.layout import load_layout


def run(arguments: dict) -> int:
    service = launch.LaunchService()
    actions = include("optimize.launch.py", reserve_domain(), arguments)
    service.include_launch_description(launch.LaunchDescription(actions))
    return service.run()


def test_the_launch_ends_with_the_layout_written(tmp_path):
    out = tmp_path / "better.yaml"
    assert run({"layout": "equal-4x4", "out": str(out)}) == 0
    assert load_layout(out).electrodes == 16


@pytest.mark.parametrize(
    "bad",
    [
        {"method": "guess"},
        {"layout": "nowhere"},
        {"out": "/nowhere/better.yaml"},
        {"namespace": "left-hand"},
        {"params_file": "/none.yaml"},
    ],
)
def test_a_refused_parameter_fails_the_launch(bad):
    assert run(bad) == 1
