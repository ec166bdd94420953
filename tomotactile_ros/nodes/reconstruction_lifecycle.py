"""Node `reconstruction` as a managed node: configure, activate, deactivate, cleanup by services."""

from tomotactile_ros.nodes.life import ManagedNode, run
from tomotactile_ros.nodes.reconstruction import Reconstruction


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run(lambda: [ManagedNode(Reconstruction)], args)
