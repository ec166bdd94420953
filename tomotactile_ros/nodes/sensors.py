"""Several sensors in one process: driver and reconstruction of each, in a namespace of its own.

    ros2 run tomotactile_ros sensors sensors:="[left, right]" --ros-args --params-file two.yaml

The node `sensors` only holds the list. Frames go from driver to reconstruction without DDS, as in
`tactile`. Parameters are those of /left/driver, /left/reconstruction and so on.
"""

import sys
from collections.abc import Iterator
from functools import partial
from itertools import chain

from rclpy.node import Node

from tomotactile_ros.nodes.namespaces import SENSORS, full_namespaces
from tomotactile_ros.nodes.running import Making, Part, PlainNode, run
from tomotactile_ros.nodes.tactile import PARAMETERS, PATIENCE, make_nodes


class Sensors(Part):
    """Holds the list of the sensors."""

    name, specs = "sensors", (SENSORS,)

    def configure(self) -> None:
        """Refuse a list that cannot be."""
        self.namespaces()

    def namespaces(self) -> list[str]:
        """Full namespaces, below that of this node; InputError for a list that cannot be."""
        return full_namespaces(self._node, self.parameters["sensors"])


def make_all(_: Making) -> Iterator[Node]:
    """The list, then both nodes of each sensor."""
    sensors = PlainNode(Sensors)
    yield sensors
    for namespace in sensors.part.namespaces():
        yield from make_nodes(partial(PlainNode, namespace=namespace))


def main(args: list[str] | None = None) -> int:
    """Run all nodes."""
    sys.setswitchinterval(PATIENCE)
    of_each = chain(*PARAMETERS.values())
    return run(make_all, args, __doc__, {Sensors.name: Sensors.specs}, also=of_each)
