"""A launch whose node refuses its parameters fails, and leaves nothing behind."""

import pytest

for package in ("launch", "launch_ros"):
    pytest.importorskip(package, reason=f"{package} comes with a full ROS 2")

from launch.actions import RegisterEventHandler, Shutdown, TimerAction
from launch.event_handlers import OnProcessExit
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


def test_a_refusal_can_be_left_to_itself():
    """The reconstruction refuses; the driver, and whatever else was launched, goes on."""
    ended = []

    def note(event, context):
        ended.append((event.process_name.split("-")[0], event.returncode, context.is_shutdown))
        return [] if context.is_shutdown else [TimerAction(period=3.0, actions=[Shutdown()])]

    arguments = {"profile": "best", "on_refusal": "ignore"}
    service = launch.LaunchService()
    service.include_launch_description(
        launch.LaunchDescription(
            [
                RegisterEventHandler(OnProcessExit(on_exit=note)),
                *include("tactile.launch.py", reserve_domain(), arguments),
            ]
        )
    )
    assert service.run() == 0
    assert ended[0] == ("reconstruction", 2, False)
    assert ended[1:] == [("driver", 0, True)]  # not started again, and the driver to the end
