"""Lists of sensors by namespace: complete, different from each other, and names that ROS takes."""

from collections.abc import Sequence

from rclpy.exceptions import InvalidNamespaceException
from rclpy.node import Node
from rclpy.validate_namespace import validate_namespace

from tomotactile_ros.nodes.parameters import Spec
from tomotactile_ros.support.errors import InputError, printable

SENSORS = Spec(
    "sensors", (), "Namespaces of the sensors, e.g. [left, right]", items=str, read_only=True
)
MOST = 255  # sensors: the number of one is in the ids of its contacts


def full_namespaces(node: Node, names: Sequence[str]) -> list[str]:
    """Namespaces from the root on, in their order; those without a leading / are below the node's.

    InputError where there are none, too many, one that is no namespace, or one twice.
    """
    own = node.get_namespace().rstrip("/")
    full = [
        (name if name.startswith("/") else f"{own}/{name}").rstrip("/") or "/" for name in names
    ]
    for name, namespace in zip(names, full, strict=True):
        try:
            validate_namespace(namespace)
        except InvalidNamespaceException:
            raise InputError(
                f"sensors: '{printable(name)}' is no namespace: letters, digits and _ make names, "
                "and / parts them"
            ) from None
    if not 1 <= len(full) <= MOST or len(set(full)) < len(full):
        raise InputError(f"sensors: needs 1 to {MOST} different namespaces, e.g. [left, right]")
    return full
