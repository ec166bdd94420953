"""The order of the scan that follows contacts: those that are known say what the next frame looks at."""

from collections.abc import Callable

import numpy as np
from rclpy.node import Node
from rclpy.subscription import Subscription

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.scan_order import AdaptiveOrder
from tomotactile_ros.msg import ContactArray
from tomotactile_ros.nodes.contact_messages import message_to_touches
from tomotactile_ros.nodes.node_time import PassingTime
from tomotactile_ros.nodes.topics import subscription

_PATIENCE = 1.0  # s without a message after which no contact is known


class ScanOrder:
    """Listens to `contacts` while it is asked to, and gives `set_scan` an order for each frame.

    Parameters
    ----------
    node : the node that listens.
    set_scan : takes electrodes to ground, row after row; from any thread.
    """

    def __init__(self, node: Node, set_scan: Callable[[tuple[int, ...]], None]):
        self._node, self._set_scan = node, set_scan
        self._subscription: Subscription | None = None
        self._layout: Layout | None = None
        self._order: AdaptiveOrder | None = None
        self._places, self._heard = np.empty((0, 2)), 0.0
        self._now = PassingTime(node).now

    def follow(self, layout: Layout | None) -> None:
        """Choose orders for the electrodes of a layout from now on; None: no longer."""
        if self._subscription is not None:
            self._node.destroy_subscription(self._subscription)
            self._subscription = None
        self._layout, self._order = layout, None
        if layout is None:
            return
        self._order = AdaptiveOrder(layout.positions)
        self._subscription = subscription(self._node, ContactArray, "contacts", self._on_message)
        self.next()

    def next(self) -> None:
        """Choose the order of the next frame."""
        order = self._order  # another thread may take it away
        if order is not None:
            late = self._now() - self._heard > _PATIENCE
            self._set_scan(order.frame(np.empty((0, 2)) if late else self._places))

    def _on_message(self, message: ContactArray) -> None:
        if self._layout is None or message.state != ContactArray.VALID:
            return
        touches = message_to_touches(message, self._layout)
        self._places = np.array([(t.x, t.y) for t in touches]).reshape(-1, 2)
        self._heard = self._now()
