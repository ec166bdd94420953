"""What is wrong is in the log at the level that it has in the diagnostics, once, and so is its end."""

import itertools
import re
from dataclasses import replace
from types import SimpleNamespace
from unittest.mock import Mock

import pytest

rclpy = pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticStatus
from ros_support import ros_arguments

from tomotactile_ros.devices import Status
from tomotactile_ros.devices.health import Trouble
from tomotactile_ros.nodes.conditions import Conditions
from tomotactile_ros.nodes.driver import Driver
from tomotactile_ros.nodes.running import PlainNode

LOST = Trouble("loss", False, "5 % are lost")
MOST_LOST = Trouble("loss", True, "50 % are lost")
DEAD = Trouble("dead", False, "dead: 5", which="5")


def new(log):
    """Level and text of what has been logged since the last time."""
    lines = [(level, text) for level, (text,), _ in log.method_calls]
    log.reset_mock()
    return lines


def test_a_trouble_is_logged_when_it_begins_changes_its_level_and_ends():
    log = Mock()
    conditions = Conditions(log)
    more, both = replace(LOST, text="6 % are lost"), replace(DEAD, text="dead: 5, 6", which="5, 6")
    for troubles, logged in (
        ([LOST], [("warning", "5 % are lost")]),
        ([more, DEAD], [("warning", "dead: 5")]),
        ([MOST_LOST, both], [("error", "50 % are lost"), ("warning", "dead: 5, 6")]),
        ([MOST_LOST], [("info", "no longer the case: dead: 5, 6")]),
        ([LOST], [("warning", "5 % are lost")]),
        ([], [("info", "no longer the case: 5 % are lost")]),
    ):
        conditions.say(troubles)
        assert new(log) == logged


def test_what_comes_and_goes_does_not_fill_the_log_and_is_not_hidden():
    """A share of lost frames about its limit was two lines each other second, for hours."""
    log, seconds = Mock(), [1000.0]
    conditions = Conditions(log, lambda: seconds[0])
    lines = []
    for second in range(3600):
        seconds[0] += 1.0
        conditions.say([] if second % 2 else [LOST])
        lines += [(second, *line) for line in new(log)]
    assert [line[0] for line in lines[:6]] == list(range(6))  # at first each as it comes
    assert len(lines) < 3600 / 10 + 7
    assert max(after[0] - before[0] for before, after in itertools.pairwise(lines)) <= 10
    told = [re.search(r"changed (\d+) times", text) for _, _, text in lines]
    changes = sum(int(each.group(1)) if each else 1 for each in told)
    assert 3600 - 10 <= changes <= 3600  # none is left uncounted
    conditions.say([LOST, DEAD])  # another trouble does not wait for it
    assert ("warning", "dead: 5") in new(log)
    conditions.say([MOST_LOST, DEAD])  # nor what becomes an error
    assert [level for level, _ in new(log)] == ["error"]


LEVELS = {
    "info": (DiagnosticStatus.OK, "streaming finished"),
    "warning": (DiagnosticStatus.WARN, "stopped identifying"),
    "error": (DiagnosticStatus.ERROR, "disconnected silent garbled late refused failed"),
}
FINE, DEAD_LINE = Status("streaming", "fine"), Status("disconnected", "no port")
LOSSY = Status("streaming", "fine; 50 % are lost", troubles=(MOST_LOST,))


def test_the_driver_logs_states_and_troubles_at_the_level_of_its_diagnostics(domain):
    """Each once; troubles of a stream apart, and they are not over when the line is dead."""
    rclpy.init(args=ros_arguments({"layout": "equal-4x4"}), domain_id=domain)
    node, log = PlainNode(Driver), Mock()
    part = node.part
    part._device.close()
    part._log, part._conditions = log, Conditions(log)
    states = [
        (Status(state, "why"), level, f"{state}: .*why.*")
        for level, (_, names) in LEVELS.items()
        for state in names.split()
    ]
    for status, level, said in (
        *states,
        (FINE, "info", "streaming: .*fine"),
        (LOSSY, "error", "50 % are lost"),
        (DEAD_LINE, "error", ".*no port"),
        (LOSSY, "error", ".*50 % are lost"),
        (FINE, "info", "no longer the case: 50 % are lost"),
    ):
        part._device = SimpleNamespace(status=lambda status=status: status, close=lambda: None)
        assert [part.report().level for _ in range(2)] == [LEVELS[level][0]] * 2
        ((found, text),) = new(log)
        assert found == level and re.fullmatch(said, text)
    node.destroy_node()
    rclpy.shutdown()
