"""Publishers of what sensors say, all reliable, and subscriptions that take the newest of it.

None of them listens to events: an executor of rclpy asks everything that it waits for, one after the other, whenever a
message comes. What rclpy adds to each publisher by default only says in the log that somebody subscribes with another
quality of service, which the subscriber says as well; it is half of what the reconstruction node would wait for.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from rclpy.node import Node
from rclpy.publisher import Publisher
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription

try:
    from rclpy.event_handler import PublisherEventCallbacks, SubscriptionEventCallbacks
except ImportError:  # Humble
    from rclpy.qos_event import PublisherEventCallbacks, SubscriptionEventCallbacks

__all__ = ["SubscriptionEventCallbacks", "publisher", "subscription"]


def publisher(
    node: Node, kind: type, topic: str, depth: int = 2, latched: bool = False
) -> Publisher:
    """A publisher of messages of a `kind`; `latched`: who comes later gets the last one."""
    durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
    return node.create_publisher(
        kind,
        topic,
        QoSProfile(
            depth=1 if latched else depth,
            reliability=ReliabilityPolicy.RELIABLE,
            durability=durability,
        ),
        qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        event_callbacks=PublisherEventCallbacks(use_default_callbacks=False),
    )


def subscription(
    node: Node, kind: type, topic: str, take: Callable[[Any], None], latched: bool = False
) -> Subscription:
    """A subscription to the newest message of a `kind`; `latched`: also to one that was there before."""
    profile = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    if latched:
        profile.reliability = ReliabilityPolicy.RELIABLE
        profile.durability = DurabilityPolicy.TRANSIENT_LOCAL
    overrides = QoSOverridingOptions.with_default_policies()
    return node.create_subscription(kind, topic, take, profile, qos_overriding_options=overrides)
