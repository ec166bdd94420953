"""Driver and reconstruction in one process as managed nodes; frames go directly, as in
`tactile`."""

import sys

from tomotactile_ros.nodes.running import AUTOSTART, ManagedNode, run
from tomotactile_ros.nodes.tactile import PARAMETERS, PATIENCE, make_nodes


def main(args: list[str] | None = None) -> int:
    """Run both nodes."""
    sys.setswitchinterval(PATIENCE)
    specs = {name: (AUTOSTART, *found) for name, found in PARAMETERS.items()}
    return run(lambda: make_nodes(ManagedNode), args, __doc__, specs)
