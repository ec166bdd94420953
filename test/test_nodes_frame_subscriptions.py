"""The threads that frames and rows come to: what waits too long is left out, and a defect ends the node."""

import queue

import pytest

rclpy = pytest.importorskip("rclpy")

from process_support import python

from tomotactile_ros.msg import VoltageFrame
from tomotactile_ros.nodes import frame_subscriptions

DEFECT = """
import sys
from rclpy.node import Node
from tomotactile_ros.msg import VoltageFrame
from tomotactile_ros.nodes import frame_subscriptions
from tomotactile_ros.nodes.running import run

rows = VoltageFrame(electrodes=2, voltages=[0.0, 1.0], grounded=[0])
frame_subscriptions._all = lambda _: [rows]

def accept(*_):
    raise ArithmeticError("a defect")

class Defect(Node):
    def __init__(self):
        super().__init__("defect", namespace="a_defect")
        frame_subscriptions.of_rows(self, accept, print, print).start()

sys.exit(run(lambda: [Defect()], [], "", {}))
"""


def rows_at(milliseconds):
    message = VoltageFrame(electrodes=2, voltages=[0.0, 1.0], grounded=[0], sequence=milliseconds)
    message.header.stamp.nanosec = 10**6 * milliseconds
    return message


def test_rows_behind_which_others_wait_are_skipped(monkeypatch):
    """Those of more than 20 ms before the last one; what has waited before the start is of before."""
    waiting = [[rows_at(1)], [rows_at(each) for each in (10, 20, 30, 45)], [rows_at(50)]]
    monkeypatch.setattr(frame_subscriptions, "_all", lambda _: waiting.pop(0) if waiting else [])
    rclpy.init()
    done = queue.Queue()
    try:
        node = rclpy.create_node("rows")
        listening = frame_subscriptions.of_rows(
            node,
            lambda rows, layout, header: done.put(("followed", rows.sequence)),
            lambda sequence, count: done.put(("skipped", sequence)),
            lambda reason: done.put(("refused", reason)),
        )
        listening.start()
        got = [done.get(timeout=60) for _ in range(5)]
        listening.stop()
        node.destroy_node()
    finally:
        rclpy.shutdown()
    skipped, followed = [("skipped", each) for each in (10, 20)], [30, 45, 50]
    assert got == skipped + [("followed", each) for each in followed]


def test_a_defect_in_the_thread_of_rows_ends_the_node():
    done = python("-c", DEFECT)
    assert done.returncode == 1 and done.stderr.endswith("ArithmeticError: a defect\n"), done
