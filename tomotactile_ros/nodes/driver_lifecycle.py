"""Node `driver` as a managed node: configure, activate, deactivate, cleanup by services."""

from tomotactile_ros.nodes.driver import Driver
from tomotactile_ros.nodes.life import ManagedNode, run


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run(lambda: [ManagedNode(Driver)], args)
