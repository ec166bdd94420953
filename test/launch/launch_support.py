"""What tests of the launch files share."""

import importlib.util
from pathlib import Path

from domain_coordinator import domain_id
from launch.actions import IncludeLaunchDescription, SetEnvironmentVariable
from launch.launch_description_sources import PythonLaunchDescriptionSource

from launch import LaunchContext, LaunchDescription, LaunchService

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


def launched(name: str, domain: int, arguments: dict, *beside) -> int:
    """Exit status of a launch that ends by itself, with other actions before it."""
    service = LaunchService()
    service.include_launch_description(
        LaunchDescription([*beside, *include(name, domain, arguments)])
    )
    return service.run()


def module_of(name: str):
    """A launch file as a Python module."""
    spec = importlib.util.spec_from_file_location(name.replace(".", "_"), FOLDER / name)
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def actions_of(module, arguments: dict) -> tuple[list, LaunchContext]:
    """What a launch file would start with these arguments."""
    context = LaunchContext()
    context.launch_configurations.update(arguments)
    *declared, _ = module.generate_launch_description().entities
    for argument in declared:
        argument.execute(context)
    return module.start(context), context
