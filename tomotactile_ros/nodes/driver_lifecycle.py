"""Node `driver` as a managed node: configure, activate, deactivate, cleanup by services."""

from tomotactile_ros.nodes.driver import SPECS, Driver
from tomotactile_ros.nodes.running import AUTOSTART, ManagedNode, run


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    specs = {Driver.name: (AUTOSTART, *SPECS)}
    return run(lambda: [ManagedNode(Driver)], args, __doc__, specs)
