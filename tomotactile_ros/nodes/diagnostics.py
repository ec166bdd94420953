"""/diagnostics of a node, once a second, without per-frame cost.

A status is named ``<node>: <task>`` with the node's full name, as diagnostic aggregators expect.

This is what `diagnostic_updater` does in a full ROS 2. It is not used: it does not come with the
wheels that the package also runs on, its timer follows simulated time, and stands still with it.
"""

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from rclpy.clock import Clock, ClockType
from rclpy.node import Node

from tomotactile_ros.devices.health import Trouble
from tomotactile_ros.nodes.stopping import unless_stopped

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


@dataclass
class Report:
    """How a task is doing: a level, one line for people, and figures."""

    level: bytes
    message: str
    values: dict[str, float | int | str] = field(default_factory=dict)


def level_of(trouble: Trouble) -> bytes:
    """Level of a status that has this trouble."""
    return ERROR if trouble.serious else WARN


def in_milliseconds(figures: dict[str, float]) -> dict[str, float]:
    """Figures whose times, ages and latencies in s become ms, with names that say so."""
    return {
        f"{key}_ms" if _is_time(key) else key: 1e3 * value if _is_time(key) else value
        for key, value in figures.items()
    }


def percentiles(entries: Iterable[tuple[float, ...]], *names: str) -> dict[str, float]:
    """Of entries, which are when, s, and a time, s, of each name: what a half and 99 % of these stay below, ms."""
    found: dict[str, float] = {}
    if table := list(entries):  # another thread may add to it
        for name, times in zip(names, np.transpose(table)[1:], strict=True):
            p50, p99 = (1e3 * np.quantile(times, (0.5, 0.99))).tolist()
            found |= {f"{name}_p50_ms": p50, f"{name}_p99_ms": p99}
    return found


def _is_time(key: str) -> bool:
    return key == "age" or key.startswith("latency")


class Diagnostics:
    """Asks for a report every second and publishes it.

    Parameters
    ----------
    node : publishes.
    task : what the status is about.
    hardware_id : gives the name of the sensor.
    report : gives the present report.
    """

    def __init__(
        self, node: Node, task: str, hardware_id: Callable[[], str], report: Callable[[], Report]
    ):
        self._node = node
        self._name = f"{node.get_fully_qualified_name().lstrip('/')}: {task}"
        self._hardware_id = hardware_id
        self._report = report
        self._publisher = node.create_publisher(DiagnosticArray, "/diagnostics", 10)
        # on a steady clock: with use_sim_time and no simulation running, it still speaks
        # and in a group of its own: while a parameter takes long to put into effect, too
        self._timer = node.create_timer(
            1.0,
            self.publish,
            callback_group=MutuallyExclusiveCallbackGroup(),
            clock=Clock(clock_type=ClockType.STEADY_TIME),
        )

    def publish(self) -> None:
        """Publish the present report."""
        report = self._report()
        status = DiagnosticStatus(
            level=report.level,
            name=self._name,
            message=report.message,
            hardware_id=self._hardware_id(),
            values=[KeyValue(key=key, value=_text(v)) for key, v in report.values.items()],
        )
        message = DiagnosticArray(status=[status])
        message.header.stamp = self._node.get_clock().now().to_msg()
        with unless_stopped(self._node):
            self._publisher.publish(message)


def _text(value: float | str) -> str:
    return f"{value:.6g}" if isinstance(value, float) else str(value)
