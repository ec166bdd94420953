"""The threads that frames and rows come to and compute in, and what is said of rows that do not come."""

import queue
import threading
import time
from collections import Counter

import pytest

rclpy = pytest.importorskip("rclpy")

from process_support import python
from rclpy.executors import SingleThreadedExecutor

from tomotactile_ros.msg import VoltageFrame
from tomotactile_ros.nodes import frame_subscriptions
from tomotactile_ros.nodes.row_watch import RowWatch
from tomotactile_ros.nodes.turns import FairLock, Turns

LONG = 60.0  # s
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

sys.exit(run(lambda make: [Defect()], [], "", {}))
"""


def rows_at(milliseconds):
    message = VoltageFrame(electrodes=2, voltages=[0.0, 1.0], grounded=[0], sequence=milliseconds)
    message.header.stamp.nanosec = 10**6 * milliseconds
    return message


def test_rows_behind_which_others_wait_are_skipped(monkeypatch, domain):
    """Those of more than 20 ms before the last one; what has waited before the start is of before."""
    waiting = [[rows_at(1)], [rows_at(each) for each in (10, 20, 30, 45)], [rows_at(50)]]
    monkeypatch.setattr(frame_subscriptions, "_all", lambda _: waiting.pop(0) if waiting else [])
    rclpy.init(domain_id=domain)
    node, done = rclpy.create_node("rows"), queue.Queue()
    listening = frame_subscriptions.of_rows(
        node,
        lambda rows, layout, header: done.put(("followed", rows.sequence)),
        lambda sequence, count: done.put(("skipped", sequence)),
        lambda reason: done.put(("refused", reason)),
    )
    listening.start()
    try:
        got = [done.get(timeout=LONG) for _ in range(5)]
    finally:
        listening.stop()
        node.destroy_node()
        rclpy.shutdown()
    skipped, followed = [("skipped", each) for each in (10, 20)], [30, 45, 50]
    assert got == skipped + [("followed", each) for each in followed]


def test_a_frame_that_waits_awakes_no_executor(domain):
    """While the frame before is worked on, as long as that takes."""
    rclpy.init(domain_id=domain)
    node, works, goes_on = rclpy.create_node("frames"), threading.Event(), threading.Event()

    def accept(*_):
        works.set()
        goes_on.wait(LONG)

    listening = frame_subscriptions.of_frames(node, accept, print, print)
    publisher = node.create_publisher(VoltageFrame, "voltage_frame", 1)
    listening.start()
    asked = Counter()

    class Executor(SingleThreadedExecutor):
        def can_execute(self, entity):
            asked[entity] += 1
            return super().can_execute(entity)

    executor = Executor()
    executor.add_node(node)
    try:
        while not works.wait(0.1):
            publisher.publish(rows_at(1))
        publisher.publish(rows_at(2))
        executor.spin_once(timeout_sec=1.0)
    finally:
        goes_on.set()
        listening.stop()
        executor.shutdown()
        node.destroy_node()
        rclpy.shutdown()
    assert max(asked.values()) < 20  # thousands where a waiting message awakes it


def test_a_defect_in_the_thread_of_rows_ends_the_node():
    done = python("-c", DEFECT)
    assert done.returncode == 1 and done.stderr.endswith("ArithmeticError: a defect\n"), done


@pytest.mark.parametrize(
    ("rows", "lost", "skipped", "late", "told"),
    [
        ([(0, 16)], 0, 0, 0.001, []),
        # of 5 the beginning was not waited for, 7 lacks half, 8 and 9 lack all
        ([(5, 8), (6, 8), (6, 8), (7, 8), (10, 8), (10, 8), (11, 8)], 40, 0, 0.001, ["rows lost"]),
        ([(0, 16), (1, 8), (1, -8), (2, 16)], 0, 8, 0.001, ["rows skipped"]),
        ([(0, 16)], 0, 0, 0.5, ["rows late"]),
    ],
    ids=["well", "lost", "skipped", "late"],
)
def test_rows_that_never_came_were_left_out_or_came_late_are_told(rows, lost, skipped, late, told):
    """Of frames of 16 rows: (sequence, rows that came), negative where they were left out."""
    watch = RowWatch(time.monotonic)
    watch.frame_has(16)
    for sequence, number in rows:
        if number < 0:
            watch.skip(sequence, -number)
        else:
            watch.followed(sequence, number, late, 0.001)
    figures = watch.figures()
    assert (figures["rows_lost"], figures["rows_skipped"]) == (lost, skipped)
    assert figures["row_latency_p50_ms"] == 1e3 * late
    assert [trouble.name for trouble in watch.troubles()] == told
    serious = {trouble.name for trouble in watch.troubles(2, 0.1) if trouble.serious}
    assert serious == {"rows publishers", *(["rows old"] if late > 0.1 else [])}


def test_a_slow_one_does_not_stop_the_others():
    turns, slow_has_it, other_was_there = Turns(0.01), threading.Event(), threading.Event()
    ends = []

    def slow():
        with turns.mine():
            slow_has_it.set()
            ends.append(other_was_there.wait(LONG))
        ends.append("given back")  # by nobody else before

    thread = threading.Thread(target=slow)
    thread.start()
    assert slow_has_it.wait(LONG)
    with turns.mine():
        other_was_there.set()
    thread.join(LONG)
    assert ends == [True, "given back"]


def test_whoever_waits_for_a_lock_gets_it_before_it_is_taken_again():
    lock, order = FairLock(), []

    def wait():
        with lock:
            order.append("waited")

    with lock:
        waiting = threading.Thread(target=wait)
        waiting.start()
        while not lock._door.locked():
            pass
    with lock:
        order.append("again")
    waiting.join(LONG)
    assert order == ["waited", "again"] and not lock.locked()
