"""Rows that never came, were left out or came late."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

pytest.importorskip("rclpy")

from tomotactile_ros.devices import Frame
from tomotactile_ros.nodes import row_contacts
from tomotactile_ros.nodes.row_watch import RowWatch


def watched(*messages, late=0.001):
    """A watch that was told of (sequence, rows) of frames of 16 rows."""
    watch = RowWatch(time.monotonic)
    watch.frame_has(16)
    for sequence, rows in messages:
        watch.followed(sequence, rows, late, 0.001)
    return watch


def names(watch):
    return [trouble.name for trouble in watch.troubles()]


def test_rows_that_never_came_are_counted_by_frame():
    # of 5 the beginning was not waited for, 7 lacks half, 8 and 9 lack all
    watch = watched((5, 8), (6, 8), (6, 8), (7, 8), (10, 8), (10, 8), (11, 8))
    assert (watch.rows, watch.lost) == (56, 8 + 2 * 16)
    assert names(watch) == ["rows lost"]
    assert watch.figures()["rows_lost"] == 40


def test_another_start_of_the_device_is_no_loss():
    watch = watched((70_000, 16), (70_001, 16), (0, 16), (1, 16))
    assert watch.lost == 0 and not names(watch)


def test_rows_that_were_left_out_are_not_lost():
    watch = watched((0, 16), (1, 8))
    watch.skip(1, 8)
    watch.followed(2, 16, 0.001, 0.001)
    assert (watch.lost, watch.skipped) == (0, 8)
    assert names(watch) == ["rows skipped"]


def test_rows_that_are_known_late_are_told():
    assert names(watched((0, 16), late=0.5)) == ["rows late"]
    assert watched((0, 16), late=0.5).figures()["row_latency_p50_ms"] == 500.0


def test_rows_of_several_publishers_and_rows_beyond_max_age_are_errors():
    assert names(watched((0, 16))) == []
    assert [t.name for t in watched((0, 16)).troubles(2) if t.serious] == ["rows publishers"]
    late = watched((0, 16), late=10.0)
    assert [t.name for t in late.troubles(1, 2.0) if t.serious] == ["rows old"]


def test_a_message_of_very_many_rows_does_not_keep_the_node(monkeypatch):
    """Anybody can send 65535 rows at once; a minute of work for them would be one of silence."""
    now = [100.0]
    monkeypatch.setattr(row_contacts, "time", SimpleNamespace(monotonic=lambda: now[0]))
    clock = SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=0), ros_time_is_active=False)

    def follow_row(*row):
        now[0] += 0.3

    pipeline = SimpleNamespace(
        baseline=None,
        follows=True,
        rows=lambda **_: SimpleNamespace(touching=False),
        follow_row=follow_row,
        after_row=lambda state: SimpleNamespace(idle=True, reason="none here"),
    )
    outputs = SimpleNamespace(say_touched=lambda *_: None, withhold=lambda *_: None)
    rows = row_contacts.Rows(
        SimpleNamespace(get_clock=lambda: clock), lambda: {"publish_every": 8}, outputs
    )
    rows.take(pipeline, Frame(np.zeros((100, 4)), np.arange(100), 0, 0.0, 3.3), "skin")
    assert rows.watch.rows < 10 and rows.watch.rows + rows.watch.skipped == 100
