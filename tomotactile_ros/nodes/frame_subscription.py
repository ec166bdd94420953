"""The subscription to voltage frames: messages in, frames out, and word of a publisher that does not suit."""

from collections.abc import Callable
from typing import Any

from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from std_msgs.msg import Header

from tomotactile_ros.devices import Frame
from tomotactile_ros.msg import VoltageFrame
from tomotactile_ros.nodes.conversions import message_to_frame
from tomotactile_ros.nodes.qos_events import SubscriptionEventCallbacks
from tomotactile_ros.support.errors import InputError

Accept = Callable[[Frame, str, Header], None]


def subscribe_to_frames(
    node: Node,
    accept: Accept,
    refuse: Callable[[str], None],
    incompatible: Callable[[str], None],
) -> None:
    """Listen to `voltage_frame`: a late frame is dropped, not queued.

    Frames go on while parameters or services take long: they have a callback group of their own.

    Parameters
    ----------
    node : the node that listens.
    accept : called with each frame, its layout's id and its header.
    refuse : called with the reason where a message holds no frame.
    incompatible : called with the policy by which a publisher's quality of service does not suit.
    """

    def on_message(message: VoltageFrame) -> None:
        try:
            frame = message_to_frame(message)
        except InputError as error:
            refuse(str(error))
        else:
            accept(frame, message.layout_id, message.header)

    node.create_subscription(
        VoltageFrame,
        "voltage_frame",
        on_message,
        QoSProfile(
            history=HistoryPolicy.KEEP_LAST, depth=1, reliability=ReliabilityPolicy.BEST_EFFORT
        ),
        callback_group=MutuallyExclusiveCallbackGroup(),
        qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        event_callbacks=SubscriptionEventCallbacks(
            incompatible_qos=lambda event: incompatible(_policy_name(event))
        ),
    )


def _policy_name(event: Any) -> str:
    try:
        return QoSPolicyKind(int(event.last_policy_kind)).name.lower()
    except ValueError:
        return str(event.last_policy_kind)
