"""What tests of the launch files share."""

from pathlib import Path

from domain_coordinator import domain_id
from launch.actions import IncludeLaunchDescription, SetEnvironmentVariable
from launch.launch_description_sources import PythonLaunchDescriptionSource

FOLDER = Path(__file__).resolve().parents[2] / "launch"
RESERVED = []  # domains are held as long as this process lives


def reserve_domain() -> int:
    """A ROS domain of this test's own."""
    RESERVED.append(domain_id())
    return RESERVED[-1].__enter__()


def include(name: str, domain: int, arguments: dict) -> list:
    """Actions that launch a file in a domain."""
    source = PythonLaunchDescriptionSource(str(FOLDER / name))
    return [
        SetEnvironmentVariable("ROS_DOMAIN_ID", str(domain)),
        IncludeLaunchDescription(source, launch_arguments=arguments.items()),
    ]
