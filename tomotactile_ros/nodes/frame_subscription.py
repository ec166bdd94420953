"""The subscriptions to voltage frames and rows of them: messages in, frames out, and word of a
publisher that does not suit."""

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.exceptions import InvalidHandle
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from std_msgs.msg import Header

from tomotactile_ros.devices import Frame
from tomotactile_ros.msg import VoltageFrame
from tomotactile_ros.nodes.conversions import message_to_frame
from tomotactile_ros.support.errors import InputError

try:
    from rclpy.event_handler import SubscriptionEventCallbacks
except ImportError:  # Humble
    from rclpy.qos_event import SubscriptionEventCallbacks

Accept = Callable[[Frame, str, Header], None]
ROWS_DEPTH = 16  # messages of rows that may wait


def subscribe_to_frames(
    node: Node,
    accept: Accept,
    refuse: Callable[[str], None],
    incompatible: Callable[[str], None],
) -> None:
    """Listen to `voltage_frame`: a late frame is dropped, not queued; and see `_subscribe`."""
    _subscribe(node, "voltage_frame", 1, accept, refuse, incompatible)


def subscribe_to_rows(node: Node, accept: Accept, refuse: Callable[[str], None]) -> None:
    """Listen to `voltage_rows`: some wait, as none should be missed; and see `_subscribe`."""
    _subscribe(node, "voltage_rows", ROWS_DEPTH, accept, refuse, lambda policy: None)


def _subscribe(
    node: Node,
    topic: str,
    depth: int,
    accept: Accept,
    refuse: Callable[[str], None],
    incompatible: Callable[[str], None],
) -> None:
    """Listen to a topic of `VoltageFrame`.

    Frames go on while parameters or services take long: they have a callback group of their own.

    Parameters
    ----------
    node : the node that listens.
    accept : called with each frame, its layout's id and its header.
    refuse : called with the reason where a message holds no frame.
    incompatible : called with the policy by which a publisher's quality of service does not suit.
    """

    def on_message(message: VoltageFrame | None) -> None:
        while message is not None:
            try:
                frame = message_to_frame(message)
            except InputError as error:
                refuse(str(error))
            else:
                accept(frame, message.layout_id, message.header)
            message = _next(subscription)

    subscription = node.create_subscription(
        VoltageFrame,
        topic,
        on_message,
        QoSProfile(
            history=HistoryPolicy.KEEP_LAST, depth=depth, reliability=ReliabilityPolicy.BEST_EFFORT
        ),
        callback_group=MutuallyExclusiveCallbackGroup(),
        qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        event_callbacks=SubscriptionEventCallbacks(
            incompatible_qos=lambda event: incompatible(_policy_name(event))
        ),
    )


def _next(subscription: Subscription) -> VoltageFrame | None:
    """What waits for a subscription, if anything: an executor asks all that it waits for, before each message
    that it brings, and takes longer for that than some rows do."""
    try:
        with subscription.handle:
            taken = subscription.handle.take_message(subscription.msg_type, subscription.raw)
    except InvalidHandle:  # a stop came in between
        return None
    return taken[0] if taken else None


def _policy_name(event: Any) -> str:
    try:
        return QoSPolicyKind(int(event.last_policy_kind)).name.lower()
    except ValueError:
        return str(event.last_policy_kind)
