"""The reconstruction refuses frames that do not fit, goes on, and says why there is no image."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

import ros_checks
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from ros_checks import LATCHED
from ros_support import ends_cleanly, ros_arguments
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from tomotactile_ros.devices import Frame
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.msg import ContactArray, VoltageFrame
from tomotactile_ros.nodes.conversions import frame_to_message, make_header, stamp_of
from tomotactile_ros.nodes.reconstruction import Reconstruction
from tomotactile_ros.nodes.running import PlainNode
from tomotactile_ros.nodes.watch import TYPE, FrameWatch


def a_frame(stamp: float = 0.0) -> Frame:
    voltages = np.zeros((16, 16), np.float32)  # nothing touches
    np.fill_diagonal(voltages, np.nan)
    return Frame(voltages, np.arange(16, dtype=np.uint16), int(stamp), stamp, 3.3)


class Source:
    """Publishes frames of the test's making ten times a second."""

    def __init__(self, probe, **qos):
        self._node, profile = probe.node, QoSProfile(depth=2, **qos)
        self._publisher = self._node.create_publisher(VoltageFrame, "/voltage_frame", profile)
        self._message = None
        self.stamp = 1_700_000_000  # s
        self._timer = self._node.create_timer(
            0.1, lambda: self._message and self._publisher.publish(self._message)
        )

    def send(self, layout_id="equal-4x4", **changes):
        """Publish this frame from now on; returns its stamp (s)."""
        self.stamp += 1
        header = make_header(self.stamp, "skin")
        header.stamp.nanosec = 123_456_789  # more digits than a float has
        self._message = frame_to_message(a_frame(self.stamp), layout_id, header)
        for name, value in changes.items():
            setattr(self._message, name, value)
        return self.stamp

    def close(self):
        """Publish nothing any more."""
        self._node.destroy_timer(self._timer)
        self._node.destroy_publisher(self._publisher)


def reports(probe, level, text):
    """The reconstruction says so in its diagnostics, soon at least."""
    levels = {"WARN": DiagnosticStatus.WARN, "ERROR": DiagnosticStatus.ERROR}
    status = "reconstruction: reconstruction"
    ros_checks.check_diagnostics(probe, status, levels[level], text)


def test_bad_frames_are_refused_and_the_next_good_one_is_used(probe, start):
    reconstruction = start("reconstruction", {"layout": "equal-4x4"})
    silent = "nobody publishes /voltage_frame"
    reports(probe, "ERROR", silent)
    answer = probe.call(Trigger, "/reconstruction/tare")
    assert not answer.success and silent in answer.message
    other = probe.node.create_publisher(String, "/voltage_frame", 1)
    reports(probe, "ERROR", "/voltage_frame carries std_msgs/msg/String")
    probe.node.destroy_publisher(other)
    source = Source(probe)
    for changes, reason in (
        ({"layout_id": "equal-8x8"}, "its layout is 'equal-8x8', this node has 'equal-4x4#"),
        ({"electrodes": 15}, "do not fit"),
        ({"grounded": [1] * 16}, "named twice"),
    ):
        source.send(**changes)
        reports(probe, "ERROR", reason)
        ros_checks.has_logged(probe, reconstruction, "ERROR", "is refused: ")
        sent = source.send(), 123_456_789
        header = probe.wait_for(
            ContactArray,
            "/contacts",
            lambda m, sent=sent: (m.header.stamp.sec, m.header.stamp.nanosec) == sent,
        ).header
        assert header.frame_id == "skin"
    ros_checks.has_logged(probe, reconstruction, "INFO", "images are made again")
    source.send(**changes)
    reports(probe, "ERROR", reason)
    source.close()
    reports(probe, "ERROR", silent)
    ros_checks.has_logged(probe, reconstruction, "ERROR", silent)
    ends_cleanly(reconstruction)


def test_what_was_valid_is_taken_back_where_nothing_follows_or_stamps_are_old(probe, start):
    """Who believes the last message would go on pressing while the driver is dead."""
    reconstruction = start("reconstruction", {"layout": "equal-4x4", "max_age": 0.5})
    assert probe.wait_for(Bool, "/touched", qos=LATCHED).data  # nothing is known yet
    source = Source(probe)
    source.send()  # of 2023
    contacts = probe.listen(ContactArray, "/contacts")
    wrenches = probe.listen(WrenchStamped, "/wrench")
    touched = probe.listen(Bool, "/touched", LATCHED)
    probe.until(lambda: contacts and contacts[-1].state == ContactArray.STALE, "old contacts")
    assert "(max_age 0.5 s)" in contacts[-1].reason and touched[-1].data
    reports(probe, "ERROR", " s old: clocks differ")
    ros_checks.has_logged(probe, reconstruction, "ERROR", " s old: clocks differ")
    source.stamp = int(time.time()) + 3600  # valid as long as it comes
    source.send()
    probe.until(lambda: contacts[-1].state == ContactArray.VALID, "contacts")
    probe.until(lambda: wrenches, "wrench")
    probe.until(lambda: not touched[-1].data, "untouched sheet")
    source.close()
    probe.until(lambda: contacts[-1].state == ContactArray.STALE, "word that they are old")
    assert contacts[-1].reason == "no contacts for 0.5 s (max_age)" and not contacts[-1].contacts
    probe.until(lambda: np.isnan(wrenches[-1].wrench.force.z), "unknown wrench")
    probe.until(lambda: touched[-1].data, "touch, for what anybody knows")


@pytest.fixture
def clock(monkeypatch):
    """The time that passes for nodes of this process, s; the test sets it."""
    time = SimpleNamespace(s=1000.0, now=lambda: time.s, stands_still=lambda: False)
    monkeypatch.setattr("tomotactile_ros.nodes.watch.PassingTime", lambda node: time)
    return time


@pytest.fixture
def watch(domain, clock):
    """A watch on frames that the test tells it of."""
    rclpy.init(args=[], domain_id=domain)
    node = rclpy.create_node("waiting")
    yield FrameWatch(node, "/voltage_frame")
    node.destroy_node()
    rclpy.shutdown()


def told(watch, name, max_age=0.0):
    """What the watch says of that, if anything."""
    return [each for each in watch.troubles(max_age) if each.name == name]


def test_frames_that_have_become_old_are_an_error_at_once(watch, clock):
    """A median over the last 1000 frames said for minutes that all was well; and for ever where
    `max_age` is less than a second."""
    for number in range(1000):
        watch.accepted(number, float(number), 0.01, 0.01)
    clock.s += 20.0
    for number in range(1000, 1005):
        watch.accepted(number, float(number), 3.0, 0.01)
    (found,) = told(watch, "old", 2.0)
    assert found.serious and "clocks differ" in found.text
    clock.s += 20.0
    watch.accepted(1005, 1005.0, 0.5, 0.01)
    (strict,) = told(watch, "old", 0.3)
    assert strict.serious and not told(watch, "old", 2.0)
    clock.s += 20.0
    watch.accepted(1006, 1006.0, 5.0, 4.8)  # a palm: the work took so long, and no message
    (slow,) = told(watch, "old", 2.0)
    assert slow.text == "frames are 5 s old: an image takes 4.8 s"


def test_what_is_late_is_one_number(watch):
    """Each frame once, though it is told late because its deadline was missed, or was skipped before."""
    for number, latency, complete in (
        (0, 0.1, True),
        (1, 0.1, False),
        (3, 0.2, True),
        (4, 0.2, False),
    ):
        watch.accepted(number, float(number), latency, 0.1, 0.064, 0.05, complete)
    assert (watch.late(), watch.cut()) == ("4 of 5 frames", "2 of 4 frames")


def test_stamps_ahead_and_going_back_and_rows_longer_than_their_frames_are_told(watch, clock):
    """A row_period in ms: contacts would hold, as their stamps say, a minute after their frames."""
    for lasts, latency, step, found in (
        (0.064, 0.0, 0.064, {}),
        (64.0, 0.0, 0.064, {"row period": True}),
        (0.064, -5.0, 0.064, {"ahead": False}),
        (0.064, 0.0, -0.064, {"stamps": True}),
    ):
        clock.s += 20.0
        watch.restart()
        for sequence in range(20):
            watch.accepted(sequence, clock.s + step * sequence, latency, 0.0, lasts)
        assert {each.name: each.serious for each in watch.troubles(2.0)} == found


def test_two_publishers_mix_frames_unless_one_was_started_again(watch, monkeypatch):
    """For 18 s the dead one is still known as a publisher."""
    monkeypatch.setattr("rclpy.node.Node.count_publishers", lambda *_: 2)
    for numbers, mixed in (((70, 71, 0, 1, 2), False), ((70, 0, 71, 1, 72, 2), True)):
        watch.restart()
        for number, sequence in enumerate(numbers):
            watch.accepted(sequence, float(number), 0.0, 0.0)
        (found,) = told(watch, "publishers")
        assert found.serious == mixed and ("just died" in found.text) != mixed


def test_most_frames_refused_is_an_error_and_why_is_told_as_long_as_that(watch, clock):
    """A good frame every second among ten bad ones: formerly OK."""
    for number in range(10):
        watch.refuse("its layout is another")
    clock.s += 3.0
    assert "nobody publishes" in watch.complaint()
    watch.accepted(0, 0.0, 0.0, 0.0)
    (found,) = told(watch, "refused")
    assert found.serious
    assert found.text == "91 % of the frames are refused: its layout is another"


def test_a_driver_of_which_no_name_is_known_is_just_starting(watch, clock, monkeypatch):
    unknown = SimpleNamespace(
        node_name="_NODE_NAME_UNKNOWN_", node_namespace="_NODE_NAMESPACE_UNKNOWN_", topic_type=TYPE
    )
    monkeypatch.setattr("rclpy.node.Node.get_publishers_info_by_topic", lambda *_: [unknown])
    clock.s += 10.0
    assert "no frames: a driver that is just starting publishes" in watch.complaint()


def test_missed_frames_are_counted_across_the_wrap_of_their_numbers(watch):
    for sequence in (2**32 - 3, 2**32 - 1, 2, 3, 1_000_000, 1_000_002, 5):
        watch.accepted(sequence, float(sequence), 0.0, 0.0)
    assert watch.missed == 1 + 2 + 1


def test_nothing_is_well_before_the_first_frame(domain, clock):
    rclpy.init(args=ros_arguments({"layout": "equal-4x4"}), domain_id=domain)
    node = PlainNode(Reconstruction)
    first = node.part.report()
    clock.s += 1.0
    header = make_header(node.get_clock().now().nanoseconds * 1e-9, "skin")
    node.part.accept(a_frame(stamp_of(header)), load_layout("equal-4x4").id, header)
    then = node.part.report()
    node.destroy_node()
    rclpy.shutdown()
    assert (first.level, first.message) == (DiagnosticStatus.WARN, "waiting for the first frame")
    assert (then.level, then.message) == (DiagnosticStatus.OK, "images are made")


def test_the_quality_of_service_can_be_overridden_and_a_mismatch_is_named(probe, start):
    reliable = {"qos_overrides./voltage_frame.subscription.reliability": "reliable"}
    not_so = {"qos_overrides./contacts.publisher.reliability": "best_effort"}
    start("reconstruction", {"layout": "equal-4x4", **reliable, **not_so})
    lossy = Source(probe, reliability=ReliabilityPolicy.BEST_EFFORT)
    lossy.send()
    reports(probe, "ERROR", "quality of service does not match")
    lossy.close()
    Source(probe).send()
    best_effort = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
    probe.wait_for(ContactArray, "/contacts", qos=best_effort)
    (publisher,) = probe.node.get_publishers_info_by_topic("/contacts")
    assert publisher.qos_profile.reliability == ReliabilityPolicy.BEST_EFFORT


def test_readings_that_scatter_more_than_was_said_are_a_warning(probe, start, tmp_path):
    """The scene has 6 mV rms, the reconstruction is told 1 mV: places stay right, and it says so."""
    scene = tmp_path / "noisy.yaml"
    scene.write_text(ros_checks.SCENE.replace("rms: 0.001", "rms: 0.006"))
    start("driver", {"scene": str(scene), "rate": 10})
    start("reconstruction", {"noise": 0.001, "profile": "accurate"})
    reports(probe, "WARN", " mV rms, not 1 mV (noise)")
