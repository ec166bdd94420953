"""The subscription to touches from outside, for a simulated sensor."""

from collections.abc import Callable

from rclpy.node import Node
from rclpy.subscription import Subscription

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.msg import ContactArray
from tomotactile_ros.nodes.contact_messages import message_to_touches
from tomotactile_ros.nodes.topics import subscription
from tomotactile_ros.scenes.touches import Touch

_PATIENCE = 5.0  # s between two complaints


class TouchListener:
    """Listens to `touches` while it is asked to; complains of bad ones in one line now and then.

    Parameters
    ----------
    node : the node that listens.
    frame_id : the sensor's frame; touches in another one are refused.
    press : takes all touches of a message and returns complaints.
    """

    def __init__(self, node: Node, frame_id: str, press: Callable[[list[Touch]], list[str]]):
        self._node, self._frame_id, self._press = node, frame_id, press
        self._layout: Layout | None = None
        self._subscription: Subscription | None = None

    def listen(self, layout: Layout | None) -> None:
        """Listen from now on for touches of the sheet of a layout, or no longer."""
        self._layout = layout
        if layout is None:
            if self._subscription is not None:
                self._node.destroy_subscription(self._subscription)
            self._subscription = None
        elif self._subscription is None:
            self._subscription = subscription(self._node, ContactArray, "touches", self._on_message)

    def _on_message(self, message: ContactArray) -> None:
        frame_id, layout = message.header.frame_id, self._layout
        if layout is None:
            return
        if frame_id not in ("", self._frame_id):
            complaints = [f"touches: in frame '{frame_id}', the sensor's is '{self._frame_id}'"]
        else:
            complaints = self._press(message_to_touches(message, layout))
        if complaints:
            more = f" (and {len(complaints) - 1} more)" if len(complaints) > 1 else ""
            self._node.get_logger().warning(
                f"{complaints[0]}{more}", throttle_duration_sec=_PATIENCE
            )
