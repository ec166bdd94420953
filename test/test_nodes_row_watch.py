"""Rows that never came, were left out or came late."""

import time

import pytest

pytest.importorskip("rclpy")

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
