"""The reconstruction refuses frames that do not fit, goes on, and says why there is no image."""

import itertools
import re
import time
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

import ros_checks
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import WrenchStamped
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from ros_support import ends_cleanly, ros_arguments
from sensor_msgs.msg import Image
from std_msgs.msg import Bool, String
from std_srvs.srv import Trigger

from tomotactile_ros.devices import Frame
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.msg import ContactArray, VoltageFrame
from tomotactile_ros.nodes.conversions import check_frame, frame_to_message, make_header, stamp_of
from tomotactile_ros.nodes.reconstruction import Reconstruction
from tomotactile_ros.nodes.running import PlainNode
from tomotactile_ros.nodes.watch import TYPE, FrameWatch
from tomotactile_ros.support.errors import InputError

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
STATUS = "reconstruction: reconstruction"


def a_frame(stamp: float = 0.0) -> Frame:
    voltages = np.zeros((16, 16), np.float32)  # nothing touches
    np.fill_diagonal(voltages, np.nan)
    return Frame(voltages, np.arange(16, dtype=np.uint16), int(stamp), stamp, 3.3)


class Source:
    """Publishes frames of the test's making, until an answer comes."""

    def __init__(self, probe, **qos):
        self._probe = probe
        self._publisher = probe.node.create_publisher(
            VoltageFrame, "/voltage_frame", QoSProfile(depth=2, **qos)
        )
        self._message = None
        self.stamp = 1_700_000_000  # s
        probe.node.create_timer(0.1, self._publish)

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
        self._message = None
        self._probe.node.destroy_publisher(self._publisher)

    def _publish(self):
        if self._message is not None:
            self._publisher.publish(self._message)


BAD_FRAMES = [
    ({"layout_id": "equal-8x8"}, "its layout is 'equal-8x8', this node has 'equal-4x4#"),
    ({"electrodes": 15}, "do not fit"),
    ({"grounded": [1] * 16}, "named twice"),
]


def test_bad_frames_are_refused_and_the_next_good_one_is_used(probe, start):
    reconstruction = start("reconstruction", {"layout": "equal-4x4"})
    silent = "nobody publishes /voltage_frame"
    ros_checks.check_diagnostics(probe, STATUS, DiagnosticStatus.ERROR, silent)
    answer = probe.call(Trigger, "/reconstruction/tare")
    assert not answer.success and silent in answer.message
    other = probe.node.create_publisher(String, "/voltage_frame", 1)
    ros_checks.check_diagnostics(
        probe, STATUS, DiagnosticStatus.ERROR, "/voltage_frame carries std_msgs/msg/String"
    )
    probe.node.destroy_publisher(other)
    source = Source(probe)
    for changes, reason in BAD_FRAMES:
        source.send(**changes)
        ros_checks.check_diagnostics(probe, STATUS, DiagnosticStatus.ERROR, reason)
        ros_checks.has_logged(probe, reconstruction, "ERROR", "is refused: ")
        stamp = source.send()
        contacts = probe.wait_for(
            ContactArray, "/contacts", lambda m, stamp=stamp: m.header.stamp.sec == stamp
        )
        assert contacts.header.frame_id == "skin"
        assert contacts.header.stamp.nanosec == 123_456_789
    warnings = [line for line in reconstruction.output.splitlines() if "frame refused" in line]
    assert warnings
    ros_checks.has_logged(probe, reconstruction, "INFO", "images are made again")
    source.send(**changes)
    ros_checks.check_diagnostics(probe, STATUS, DiagnosticStatus.ERROR, reason)
    source.close()
    ros_checks.check_diagnostics(probe, STATUS, DiagnosticStatus.ERROR, silent)
    ros_checks.has_logged(probe, reconstruction, "ERROR", silent)
    ends_cleanly(reconstruction)


def test_frames_that_have_become_old_are_an_error_at_once(domain, monkeypatch):
    """A median over the last 1000 frames said for minutes that all was well; and for ever where
    `max_age` is less than a second."""
    now = [1000.0]
    passing = SimpleNamespace(now=lambda: now[0])
    monkeypatch.setattr("tomotactile_ros.nodes.watch.PassingTime", lambda node: passing)
    rclpy.init(args=None, domain_id=domain)
    node = rclpy.create_node("probe")
    watch = FrameWatch(node, "/voltage_frame")
    for number in range(1000):
        watch.accepted(number, float(number), 0.01, 0.01)
    now[0] += 20.0
    for number in range(1000, 1005):
        watch.accepted(number, float(number), 3.0, 0.01)
    found = [each for each in watch.troubles(2.0) if each.name == "old"]
    now[0] += 20.0
    watch.accepted(1005, 1005.0, 0.5, 0.01)
    strict = [each for each in watch.troubles(0.3) if each.name == "old"]
    lenient = [each for each in watch.troubles(2.0) if each.name == "old"]
    now[0] += 20.0
    watch.accepted(1006, 1006.0, 5.0, 4.8)  # a palm: the work took so long, and no message
    slow = [each.text for each in watch.troubles(2.0) if each.name == "old"]
    node.destroy_node()
    rclpy.shutdown()
    assert len(found) == 1 and found[0].serious
    assert "clocks differ" in found[0].text
    assert len(strict) == 1 and strict[0].serious and not lenient
    assert slow == ["frames are 5 s old: an image takes 4.8 s"]


def test_most_frames_refused_is_an_error_although_there_are_images(probe, start):
    """A good frame every second among ten bad ones: formerly OK."""
    reconstruction = start("reconstruction", {"layout": "equal-4x4"})
    publisher = probe.node.create_publisher(VoltageFrame, "/voltage_frame", 2)
    count = itertools.count()

    def publish():
        number = next(count)
        now = probe.node.get_clock().now().nanoseconds * 1e-9
        name = "equal-4x4" if number % 10 == 0 else "equal-8x8"
        publisher.publish(frame_to_message(a_frame(now), name, make_header(now, "skin")))

    probe.node.create_timer(0.05, publish)
    probe.wait_for(Image, "/pressure")
    ros_checks.check_diagnostics(
        probe, STATUS, DiagnosticStatus.ERROR, "% of the frames are refused: its layout"
    )
    ros_checks.has_logged(probe, reconstruction, "ERROR", "% of the frames are refused")


def test_two_publishers_and_stamps_that_cannot_be_are_told(probe, start):
    reconstruction = start("reconstruction", {"layout": "equal-4x4"})
    first, second = Source(probe), Source(probe)
    first.send()  # of 2023
    probe.wait_for(Image, "/pressure")
    ros_checks.check_diagnostics(
        probe, STATUS, DiagnosticStatus.ERROR, "2 publishers of /voltage_frame: frames are mixed"
    )
    ros_checks.has_logged(probe, reconstruction, "ERROR", "2 publishers of /voltage_frame")
    second.close()
    ros_checks.has_logged(
        probe, reconstruction, "INFO", "no longer the case: 2 publishers of /voltage_frame"
    )
    ros_checks.has_logged(probe, reconstruction, "ERROR", " s old: clocks differ")
    ros_checks.check_diagnostics(probe, STATUS, DiagnosticStatus.ERROR, " s old: clocks differ")
    message = probe.wait_for(ContactArray, "/contacts")
    assert message.state == ContactArray.STALE and "(max_age 2 s)" in message.reason
    assert probe.wait_for(Bool, "/touched", qos=LATCHED).data  # for what anybody knows
    first.stamp = 2_100_000_000  # of 2036
    first.send()
    ros_checks.check_diagnostics(
        probe, STATUS, DiagnosticStatus.WARN, "s ahead of the time here: clocks differ"
    )
    first.stamp -= 1000
    first.send()
    ros_checks.check_diagnostics(
        probe,
        STATUS,
        DiagnosticStatus.WARN,
        "the stamps of 1 frames lie before those of the frames",
    )


def test_what_was_valid_is_taken_back_where_nothing_follows(probe, start):
    """Who believes the last message would go on pressing while the driver is dead."""
    start("reconstruction", {"layout": "equal-4x4", "max_age": 0.5})
    assert probe.wait_for(Bool, "/touched", qos=LATCHED).data  # nothing is known yet
    source = Source(probe)
    source.stamp = int(time.time()) + 3600  # valid as long as it comes
    source.send()
    contacts, wrenches = (
        probe.listen(ContactArray, "/contacts"),
        probe.listen(WrenchStamped, "/wrench"),
    )
    touched = probe.listen(Bool, "/touched", LATCHED)
    probe.until(
        lambda: contacts and wrenches and contacts[-1].state == ContactArray.VALID, "contacts"
    )
    probe.until(lambda: touched and not touched[-1].data, "untouched sheet")
    source.close()
    probe.until(lambda: contacts[-1].state == ContactArray.STALE, "word that they are old")
    assert contacts[-1].reason == "no contacts for 0.5 s (max_age)" and not contacts[-1].contacts
    probe.until(lambda: np.isnan(wrenches[-1].wrench.force.z), "unknown wrench")
    probe.until(lambda: touched[-1].data, "touch, for what anybody knows")


@pytest.mark.parametrize(
    "changes, complaint",
    [
        ({"row_period": 1e12}, "the row period is 1e+12 s"),
        ({"row_period": 3e38}, "the row period is 3e+38 s"),
        ({"row_period": float("nan")}, "the row period is nan s"),
        ({"stamp": 2**31 - 1e-9}, "is the latest a message can carry"),
    ],
)
def test_times_that_no_message_can_hold_are_refused(changes, complaint):
    """Contacts hold some row periods after the stamp: what overflowed there ended the node."""
    layout = load_layout("equal-4x4")
    check_frame(a_frame(), layout)
    with pytest.raises(InputError, match=re.escape(complaint)):
        check_frame(replace(a_frame(), **changes), layout)


def test_rows_that_take_longer_than_their_frames_are_told(domain):
    """A row_period in ms: contacts would hold, as their stamps say, a minute after their frames."""
    rclpy.init(args=[], domain_id=domain)
    watch = FrameWatch(rclpy.create_node("waiting"), "/voltage_frame")
    for lasts, expected in ((0.064, []), (64.0, ["row period"])):
        watch.restart()
        for sequence in range(20):
            watch.accepted(sequence, 0.064 * sequence, 0.0, 0.0, lasts)
        assert [trouble.name for trouble in watch.troubles() if trouble.serious] == expected
    rclpy.shutdown()


def test_a_driver_that_was_started_again_mixes_nothing(domain, monkeypatch):
    """For 18 s the dead one is still known as a publisher."""
    monkeypatch.setattr("rclpy.node.Node.count_publishers", lambda *_: 2)
    rclpy.init(args=[], domain_id=domain)
    watch = FrameWatch(rclpy.create_node("waiting"), "/voltage_frame")
    for numbers, mixed in (((70, 71, 0, 1, 2), False), ((70, 0, 71, 1, 72, 2), True)):
        watch.restart()
        for number, sequence in enumerate(numbers):
            watch.accepted(sequence, float(number), 0.0, 0.0)
        (found,) = [each for each in watch.troubles() if each.name == "publishers"]
        assert found.serious == mixed and ("just died" in found.text) != mixed
    rclpy.shutdown()


def test_nothing_is_well_before_the_first_frame(domain, monkeypatch):
    now = [1000.0]
    passing = SimpleNamespace(now=lambda: now[0], stands_still=lambda: False)
    monkeypatch.setattr("tomotactile_ros.nodes.watch.PassingTime", lambda node: passing)
    rclpy.init(args=ros_arguments({"layout": "equal-4x4"}), domain_id=domain)
    node = PlainNode(Reconstruction)
    first = node.part.report()
    now[0] += 1.0
    header = make_header(node.get_clock().now().nanoseconds * 1e-9, "skin")
    node.part.accept(a_frame(stamp_of(header)), node.part._pipeline.layout.id, header)
    then = node.part.report()
    node.destroy_node()
    rclpy.shutdown()
    assert (first.level, first.message) == (DiagnosticStatus.WARN, "waiting for the first frame")
    assert (then.level, then.message) == (DiagnosticStatus.OK, "images are made")


def test_why_frames_were_refused_is_told_as_long_as_that_they_were(domain):
    rclpy.init(args=[], domain_id=domain)
    watch = FrameWatch(rclpy.create_node("waiting"), "/voltage_frame")
    watch.refuse("its layout is another")
    watch._since -= 10.0
    assert "nobody publishes" in watch.complaint()
    watch.accepted(0, 0.0, 0.0, 0.0)
    (found,) = [each.text for each in watch.troubles() if each.name == "refused"]
    assert found == "50 % of the frames are refused: its layout is another"
    rclpy.shutdown()


def test_a_driver_of_which_no_name_is_known_is_just_starting(domain, monkeypatch):
    unknown = SimpleNamespace(
        node_name="_NODE_NAME_UNKNOWN_", node_namespace="_NODE_NAMESPACE_UNKNOWN_", topic_type=TYPE
    )
    monkeypatch.setattr("rclpy.node.Node.get_publishers_info_by_topic", lambda *_: [unknown])
    rclpy.init(args=[], domain_id=domain)
    watch = FrameWatch(rclpy.create_node("waiting"), "/voltage_frame")
    watch._since -= 10.0
    assert "no frames: a driver that is just starting publishes" in watch.complaint()
    rclpy.shutdown()


def test_missed_frames_are_counted_across_the_wrap_of_their_numbers(domain):
    rclpy.init(args=[], domain_id=domain)
    watch = FrameWatch(rclpy.create_node("waiting"), "/voltage_frame")
    for sequence in (2**32 - 3, 2**32 - 1, 2, 3, 1_000_000, 1_000_002, 5):
        watch.accepted(sequence, float(sequence), 0.0, 0.0)
    rclpy.shutdown()
    assert watch.missed == 1 + 2 + 1


def test_the_quality_of_service_can_be_overridden_and_a_mismatch_is_named(probe, start):
    reliable = {"qos_overrides./voltage_frame.subscription.reliability": "reliable"}
    not_so = {"qos_overrides./contacts.publisher.reliability": "best_effort"}
    start("reconstruction", {"layout": "equal-4x4", **reliable, **not_so})
    lossy = Source(probe, reliability=ReliabilityPolicy.BEST_EFFORT)
    lossy.send()
    ros_checks.check_diagnostics(
        probe, STATUS, DiagnosticStatus.ERROR, "quality of service does not match"
    )
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
    reconstruction = start("reconstruction", {"noise": 0.001, "profile": "accurate"})
    text = " mV rms, not 1 mV (noise)"
    ros_checks.check_diagnostics(probe, STATUS, DiagnosticStatus.WARN, text)
    ros_checks.has_logged(probe, reconstruction, "WARN", text)
