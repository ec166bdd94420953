"""The subscription to rows of frames, which a thread of its own serves.

An executor of rclpy asks everything that a node waits for whenever something comes, and gives it to a thread of its
pool: 2.4 ms for each message beside the work, more than most rows take (sampled stacks of two nodes at 1 kHz). Here
one thread waits for this subscription alone, as `rclpy.wait_for_message` does.
"""

import threading
from collections.abc import Callable

from rclpy.callback_groups import CallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from std_msgs.msg import Header

from tomotactile_ros.devices import Frame
from tomotactile_ros.msg import VoltageFrame
from tomotactile_ros.nodes.conversions import message_to_frame, stamp_of
from tomotactile_ros.nodes.qos_events import SubscriptionEventCallbacks
from tomotactile_ros.nodes.row_watch import fall_behind
from tomotactile_ros.support.errors import InputError

ROWS_DEPTH = 16  # messages of rows that may wait
_PATIENCE = 0.1  # s after which the thread looks whether it is to end


class _ByItself(CallbackGroup):
    """No executor serves what belongs to it."""

    def can_execute(self, entity: object) -> bool:
        return False


class RowSubscription:
    """Listens to `voltage_rows` between `start` and `stop`.

    Parameters
    ----------
    node : the node that listens.
    accept : called with rows, their layout's id and their header.
    skip : called with the number of a frame, and of its rows that are left out: those of more than 20 ms
        before others that wait behind them.
    refuse : called with the reason where a message holds no rows.
    """

    def __init__(
        self,
        node: Node,
        accept: Callable[[Frame, str, Header], None],
        skip: Callable[[int, int], None],
        refuse: Callable[[str], None],
    ):
        self._node, self._accept, self._skip, self._refuse = node, accept, skip, refuse
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None
        self._subscription = node.create_subscription(
            VoltageFrame,
            "voltage_rows",
            lambda message: None,
            QoSProfile(
                history=HistoryPolicy.KEEP_LAST,
                depth=ROWS_DEPTH,
                reliability=ReliabilityPolicy.BEST_EFFORT,
            ),
            callback_group=_ByItself(),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            event_callbacks=SubscriptionEventCallbacks(use_default_callbacks=False),
        )

    def start(self) -> None:
        """Begin to listen; what has waited until now is of before."""
        self._stopped.clear()
        self._thread = threading.Thread(target=self._listen, name="rows", daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End it; nothing is called any more afterwards."""
        self._stopped.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _listen(self) -> None:
        try:
            self._serve()
        except Exception as error:  # noqa: BLE001 - of a stop, or a defect that must end the node
            while self._node.context.ok() and not self._stopped.wait(_PATIENCE):
                executor = self._node.executor
                if executor is not None:  # otherwise the node is being made still
                    executor.create_task(_raised, error)
                    return

    def _serve(self) -> None:
        handle, context = self._subscription.handle, self._node.context
        waiting = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, 0, context.handle)
        _all(self._subscription)
        while not self._stopped.is_set() and context.ok():
            with handle:
                waiting.clear_entities()
                waiting.add_subscription(handle)
                waiting.wait(int(1e9 * _PATIENCE))
            messages = _all(self._subscription)
            behind = fall_behind([stamp_of(each.header) for each in messages])
            for message, left_out in zip(messages, behind, strict=True):
                if left_out:
                    self._skip(message.sequence, len(message.grounded))
                    continue
                try:
                    rows = message_to_frame(message)
                except InputError as error:
                    self._refuse(str(error))
                else:
                    self._accept(rows, message.layout_id, message.header)


def _all(subscription: Subscription) -> list[VoltageFrame]:
    """All that waits for a subscription."""
    out = []
    with subscription.handle:
        while taken := subscription.handle.take_message(subscription.msg_type, subscription.raw):
            out.append(taken[0])
    return out


async def _raised(error: Exception) -> None:
    raise error
