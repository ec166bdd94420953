"""What happens to a callback while ROS shuts down."""

from collections.abc import Iterator
from contextlib import contextmanager

from rclpy.node import Node


@contextmanager
def unless_stopped(node: Node) -> Iterator[None]:
    """Nothing can be published any more once ROS shuts down: what that raises is no mistake."""
    try:
        yield
    except Exception:
        if node.context.ok():
            raise
