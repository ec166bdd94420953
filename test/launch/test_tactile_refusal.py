"""A launch whose node refuses its parameters fails, and leaves nothing behind."""

import pytest

for package in ("launch", "launch_ros"):
    pytest.importorskip(package, reason=f"{package} comes with a full ROS 2")

from launch_support import include, reserve_domain

import launch


@pytest.mark.parametrize(
    "bad", [{"scene": "nothing"}, {"profile": "best"}, {"params_file": "/none.yaml"}]
)
def test_a_refused_parameter_fails_the_launch(bad):
    service = launch.LaunchService()
    service.include_launch_description(
        launch.LaunchDescription(include("tactile.launch.py", reserve_domain(), bad))
    )
    assert service.run() == 1
