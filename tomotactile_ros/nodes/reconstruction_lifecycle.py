"""Node `reconstruction` as a managed node: configure, activate, deactivate, cleanup by services."""

import sys

from tomotactile_ros.nodes.reconstruction import PATIENCE, Reconstruction
from tomotactile_ros.nodes.reconstruction_parameters import SPECS
from tomotactile_ros.nodes.running import AUTOSTART, ManagedNode, run


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    sys.setswitchinterval(PATIENCE)
    specs = {Reconstruction.name: (AUTOSTART, *SPECS)}
    return run(lambda: [ManagedNode(Reconstruction)], args, __doc__, specs)
