"""The log says each trouble when it begins, at the level of the diagnostics, and when it is over."""

import itertools
import logging

import pytest

rclpy = pytest.importorskip("rclpy")

from diagnostic_msgs.msg import DiagnosticStatus
from ros_support import ros_arguments

from tomotactile_ros.devices import Status
from tomotactile_ros.devices.health import Trouble
from tomotactile_ros.nodes.data_source import FLOWING, LEVELS
from tomotactile_ros.nodes.diagnostics import level_of
from tomotactile_ros.nodes.driver import Driver
from tomotactile_ros.nodes.running import PlainNode
from tomotactile_ros.nodes.telling import OVER, Teller

INFO, WARNING, ERROR = "INFO", "WARNING", "ERROR"
LOST = Trouble("loss", False, "5 % lost")
MOST_LOST = Trouble("loss", True, "60 % lost")
OLD = Trouble("old", True, "frames are 3 s old")


@pytest.fixture
def lines(caplog):
    """The log so far as (level, text); asked again, what came since."""
    caplog.set_level(logging.INFO)

    def new():
        found = [(record.levelname, record.getMessage()) for record in caplog.records]
        caplog.clear()
        return found

    return new


@pytest.fixture
def teller():
    return Teller(logging.getLogger("node"))


def test_each_trouble_is_said_once_at_its_level(teller, lines):
    teller.tell([LOST, OLD])
    assert lines() == [(WARNING, "5 % lost"), (ERROR, "frames are 3 s old")]
    teller.tell([LOST, OLD])
    assert lines() == []


def test_what_becomes_serious_is_said_again_and_what_flickers_is_not(teller, lines):
    for trouble in (LOST, MOST_LOST):
        teller.tell([trouble])
    assert lines() == [(WARNING, "5 % lost"), (ERROR, "60 % lost")]
    for trouble in (LOST, MOST_LOST, LOST, MOST_LOST):
        teller.tell([trouble])
        teller.tell([])
    assert lines() == []


def test_a_trouble_is_over_once_and_can_begin_again(teller, lines):
    teller.tell([MOST_LOST])
    lines()
    for _ in range(OVER - 1):
        teller.tell([])
    assert lines() == []
    teller.tell([])
    teller.tell([])
    assert [level for level, _ in lines()] == [INFO]
    teller.tell([LOST])
    assert lines() == [(WARNING, "5 % lost")]


def test_nothing_is_over_where_nothing_can_be_judged(teller, lines):
    teller.tell([OLD])
    lines()
    for _ in range(3 * OVER):
        teller.tell([], none_over=True)
    assert lines() == []


STATES = (*LEVELS, "disconnected", "silent", "late", "garbled", "refused", "failed")


class Scripted:
    """A device in whatever state the test wants."""

    temperature = None
    status_now = Status("closed", "not opened")

    def status(self):
        return self.status_now

    def close(self):
        """Nothing is open."""


def test_the_driver_logs_states_and_troubles_at_the_level_of_its_diagnostics(domain, lines):
    rclpy.init(args=ros_arguments({"scene": "idle"}), domain_id=domain)
    node = PlainNode(Driver)
    try:
        driver = node.part
        driver._device.close()
        driver._device = device = Scripted()
        driver._log = logging.getLogger("driver")
        driver._teller = Teller(driver._log)
        driver._said = ""
        levels = {
            DiagnosticStatus.OK: INFO,
            DiagnosticStatus.WARN: WARNING,
            DiagnosticStatus.ERROR: ERROR,
        }
        for state, others in itertools.product(STATES, [(), (LOST,), (OLD,), (LOST, OLD)]):
            if state == "closed" or (others and state not in FLOWING):
                continue
            driver._said, driver._teller = "", Teller(driver._log)
            texts = "; ".join(["why", *(trouble.text for trouble in others)])
            device.status_now = Status(state, texts, {}, (), others, "why")
            report = driver.report()
            said = lines()
            assert said[0][1].startswith(f"{state}: ") and said[0][1].endswith("why")
            assert said[1:] == [(levels[level_of(trouble)], trouble.text) for trouble in others]
            worst = max((level for level, _ in said), key=[INFO, WARNING, ERROR].index)
            assert levels[report.level] == worst, state
    finally:
        node.destroy_node()
        rclpy.shutdown()
