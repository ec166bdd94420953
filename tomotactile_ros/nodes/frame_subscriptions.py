"""The subscriptions to frames and to their rows, each of which a thread of its own serves.

An executor of rclpy asks everything that a node waits for, three times for whatever comes, and gives it to a thread of
its pool: 2.4 ms for each message beside the work, more than most rows take (sampled stacks of two nodes at 1 kHz), in
which nothing else in the process runs. Here one thread waits for one subscription, as `rclpy.wait_for_message` does,
and for what is said of its publishers: an executor that waits for that alone is awakened again and again while a message
lies unread, and takes a processor for it (Fast DDS: one condition of a reader for both).
"""

import threading
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node
from rclpy.qos import HistoryPolicy, QoSPolicyKind, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from rclpy.subscription import Subscription
from std_msgs.msg import Header

from tomotactile_ros.devices import Frame
from tomotactile_ros.devices.recording import frame_of
from tomotactile_ros.msg import VoltageFrame
from tomotactile_ros.nodes.row_watch import LATE
from tomotactile_ros.nodes.topics import SubscriptionEventCallbacks
from tomotactile_ros.support.errors import InputError

ROWS_DEPTH = 16  # messages of rows that may wait
_PATIENCE = 0.1  # s after which the thread looks whether it is to end

Item = tuple[Frame, str, Header]  # with its layout's id
Accept = Callable[[Frame, str, Header], None]
Take = Callable[[list[Item]], None]  # what has come, oldest first
Refuse = Callable[[str], None]


class Source:
    """Frames or rows that a thread of its own takes, between `start` and `stop`."""

    def __init__(self, name: str, take: Take):
        self._name, self._take = name, take
        self._stopped = threading.Event()
        self._thread: threading.Thread | None = None

    def start(self) -> None:
        """Begin; what has waited until now is of before."""
        self._stopped.clear()
        self._thread = threading.Thread(target=self._work, name=self._name, daemon=True)
        self._thread.start()

    def stop(self) -> None:
        """End it; nothing is taken any more afterwards."""
        self._stopped.set()
        if self._thread is not None:
            self._thread.join()
            self._thread = None

    def _work(self) -> None:
        raise NotImplementedError


class _ByItself(ReentrantCallbackGroup):
    """No executor takes anything of what belongs to it."""

    def can_execute(self, entity: object) -> bool:
        return False


class FrameSubscription(Source):
    """Those of a topic.

    Parameters
    ----------
    node : the node that listens; topic : to what.
    depth : messages that may wait.
    take : called with those that have come; refuse : with the reason where a message holds no frame.
    incompatible : called with the policy by which a publisher's quality of service does not suit; None: nobody
        is told.
    """

    def __init__(
        self,
        node: Node,
        topic: str,
        depth: int,
        take: Take,
        refuse: Refuse,
        incompatible: Refuse | None = None,
    ):
        super().__init__(topic, take)
        self._node, self._refuse = node, refuse
        if incompatible is None:
            events = SubscriptionEventCallbacks(use_default_callbacks=False)
        else:
            events = SubscriptionEventCallbacks(
                incompatible_qos=lambda event: incompatible(_policy_name(event))
            )
        self._subscription = node.create_subscription(
            VoltageFrame,
            topic,
            lambda message: None,
            QoSProfile(
                history=HistoryPolicy.KEEP_LAST,
                depth=depth,
                reliability=ReliabilityPolicy.BEST_EFFORT,
            ),
            callback_group=_ByItself(),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
            event_callbacks=events,
        )

    def _work(self) -> None:
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
        events: Any = self._subscription.event_handlers  # a list, whatever rclpy says of its type
        waiting = rclpy_implementation.WaitSet(1, 0, 0, 0, 0, len(events), context.handle)
        _all(self._subscription)
        while not self._stopped.is_set() and context.ok():
            with ExitStack() as held:
                for each in (handle, *events):
                    held.enter_context(each)
                waiting.clear_entities()
                waiting.add_subscription(handle)
                for event in events:
                    event.add_to_wait_set(waiting)
                waiting.wait(int(1e9 * _PATIENCE))
                said = [(each, each.take_data()) for each in events if each.is_ready(waiting)]
            for event, data in said:
                if data is not None:
                    event.callback(data)
            if items := list(self._items(_all(self._subscription))):
                self._take(items)

    def _items(self, messages: list[VoltageFrame]) -> Iterator[Item]:
        for message in messages:
            try:
                yield frame_of(message), message.layout_id, message.header
            except InputError as error:
                self._refuse(str(error))


def newest(accept: Accept) -> Take:
    """Takes the last one: a late frame is dropped, not queued."""
    return lambda items: accept(*items[-1])


def in_turn(accept: Accept, skip: Callable[[int, int], None]) -> Take:
    """Takes rows one after the other; `skip` is called with the number of a frame, and of its rows that are left out:
    those of more than 20 ms before others that wait behind them, which would be late."""

    def take(items: list[Item]) -> None:
        for rows, *where in items:
            if rows.stamp < items[-1][0].stamp - LATE:
                skip(rows.sequence, len(rows.grounded))
            else:
                accept(rows, *where)

    return take


def of_frames(
    node: Node, accept: Accept, refuse: Refuse, incompatible: Refuse
) -> FrameSubscription:
    """Listens to `voltage_frame`; `accept` is called with each frame, its layout's id and its header."""
    return FrameSubscription(node, "voltage_frame", 1, newest(accept), refuse, incompatible)


def of_rows(
    node: Node, accept: Accept, skip: Callable[[int, int], None], refuse: Refuse
) -> FrameSubscription:
    """Listens to `voltage_rows`; `accept` as of `of_frames`, `skip` as of `in_turn`."""
    return FrameSubscription(node, "voltage_rows", ROWS_DEPTH, in_turn(accept, skip), refuse)


def _all(subscription: Subscription) -> list[VoltageFrame]:
    """All that waits for a subscription."""
    out = []
    with subscription.handle:
        while taken := subscription.handle.take_message(subscription.msg_type, subscription.raw):
            out.append(taken[0])
    return out


async def _raised(error: Exception) -> None:
    raise error


def _policy_name(event: Any) -> str:
    try:
        return QoSPolicyKind(int(event.last_policy_kind)).name.lower()
    except ValueError:
        return str(event.last_policy_kind)
