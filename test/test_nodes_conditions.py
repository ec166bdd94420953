"""What is wrong is in the log at the level that it has in the diagnostics, once, and so is its end."""

import itertools
import re

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


class Log:
    """Keeps (level, text) of what is logged."""

    def __init__(self):
        self.lines = []

    def info(self, text):
        self.lines.append(("INFO", text))

    def warning(self, text):
        self.lines.append(("WARN", text))

    def error(self, text):
        self.lines.append(("ERROR", text))

    def new(self):
        lines, self.lines = self.lines, []
        return lines


def test_a_trouble_is_logged_when_it_begins_changes_its_level_and_ends():
    log = Log()
    conditions = Conditions(log)
    conditions.say([LOST])
    assert log.new() == [("WARN", "5 % are lost")]
    conditions.say([Trouble("loss", False, "6 % are lost"), DEAD])
    assert log.new() == [("WARN", "dead: 5")]
    conditions.say([MOST_LOST, Trouble("dead", False, "dead: 5, 6", which="5, 6")])
    assert log.new() == [("ERROR", "50 % are lost"), ("WARN", "dead: 5, 6")]
    conditions.say([MOST_LOST])
    assert log.new() == [("INFO", "no longer the case: dead: 5, 6")]
    conditions.say([LOST])
    assert log.new() == [("WARN", "5 % are lost")]
    conditions.say([])
    assert log.new() == [("INFO", "no longer the case: 5 % are lost")]


class Clock:
    """Tells the time that the test sets."""

    now = 1000.0

    def __call__(self):
        return self.now


def test_what_comes_and_goes_does_not_fill_the_log_and_is_not_hidden():
    """A share of lost frames about its limit was two lines each other second, for hours."""
    log, clock = Log(), Clock()
    conditions = Conditions(log, clock)
    lines = []
    for second in range(3600):
        clock.now += 1.0
        conditions.say([] if second % 2 else [LOST])
        lines += [(second, *line) for line in log.new()]
    assert [line[0] for line in lines[:6]] == list(range(6))  # at first each as it comes
    assert len(lines) < 3600 / 10 + 7
    assert max(after[0] - before[0] for before, after in itertools.pairwise(lines)) <= 10
    told = [re.search(r"changed (\d+) times", text) for _, _, text in lines]
    changes = sum(int(each.group(1)) if each else 1 for each in told)
    assert 3600 - 10 <= changes <= 3600  # none is left uncounted
    conditions.say([LOST, DEAD])  # another trouble does not wait for it
    assert ("WARN", "dead: 5") in log.new()
    conditions.say([MOST_LOST, DEAD])  # nor what becomes an error
    assert [level for level, _ in log.new()] == ["ERROR"]


class Told:
    """A device whose status the test tells."""

    now = Status("streaming", "fine")

    def status(self):
        return self.now

    def close(self):
        """There is nothing to close."""


@pytest.fixture
def part(domain):
    """A driver whose device and log are the test's."""
    rclpy.init(args=ros_arguments({"layout": "equal-4x4"}), domain_id=domain)
    node = PlainNode(Driver)
    node.part._device.close()
    node.part._device, node.part._log = Told(), Log()
    node.part._conditions = Conditions(node.part._log)
    yield node.part
    node.destroy_node()
    rclpy.shutdown()


LEVELS = {
    DiagnosticStatus.OK: "INFO",
    DiagnosticStatus.WARN: "WARN",
    DiagnosticStatus.ERROR: "ERROR",
}
STATES = {
    "streaming": "INFO",
    "finished": "INFO",
    "stopped": "WARN",
    "identifying": "WARN",
    "disconnected": "ERROR",
    "silent": "ERROR",
    "garbled": "ERROR",
    "late": "ERROR",
    "refused": "ERROR",
    "failed": "ERROR",
}


def test_the_driver_logs_each_state_at_the_level_of_its_diagnostics(part):
    for state, level in STATES.items():
        part._device.now = Status(state, "why")
        assert LEVELS[part.report().level] == level
        ((logged, text),) = part._log.new()
        assert logged == level and text.startswith(f"{state}: ") and "why" in text
        part.report()
        assert part._log.new() == []


def test_troubles_of_a_stream_are_logged_apart_and_not_over_when_the_line_is_dead(part):
    part._device.now = Status("streaming", "fine")
    part.report()
    part._log.new()
    part._device.now = Status("streaming", "fine; 50 % are lost", troubles=(MOST_LOST,))
    assert part.report().level == DiagnosticStatus.ERROR
    assert part._log.new() == [("ERROR", "50 % are lost")]
    part._device.now = Status("disconnected", "no port")
    part.report()
    ((level, text),) = part._log.new()
    assert level == "ERROR" and "no port" in text
    part._device.now = Status("streaming", "fine; 50 % are lost", troubles=(MOST_LOST,))
    part.report()
    ((level, text),) = part._log.new()
    assert level == "ERROR" and "50 % are lost" in text
    part._device.now = Status("streaming", "fine")
    part.report()
    assert part._log.new() == [("INFO", "no longer the case: 50 % are lost")]
