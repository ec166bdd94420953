"""Several sensors: in one process, and their contacts as one list in a robot's frame."""

import itertools
import re
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("rclpy")

import numpy as np
import ros_checks
from diagnostic_msgs.msg import DiagnosticStatus
from geometry_msgs.msg import Point, Quaternion, TransformStamped, Vector3, WrenchStamped
from ros_support import ends_cleanly

from tomotactile_ros.msg import Contact, ContactArray
from tomotactile_ros.nodes.conversions import make_header
from tomotactile_ros.nodes.poses import make_locator
from tomotactile_ros.nodes.skin import check_contacts
from tomotactile_ros.support.errors import InputError

DOCS = Path(__file__).resolve().parent.parent / "docs" / "robots.md"
POSES = """
format: tomotactile-poses/1
frame_id: base_link
poses:
  left_link: {xyz: [0.1, 0.0, 0.5]}
  right_link: {xyz: [0.0, -0.2, 0.5], rpy: [1.5707963267948966, 0.0, 0.0]}
"""
CONTACT = {
    "position": Point(x=0.01, y=0.02),
    "normal": Vector3(z=1.0),
    "tangent": Vector3(x=1.0),
    "velocity": Vector3(y=0.5),
    "force": 2.0,
    "id": 7,
}


@pytest.fixture
def poses(tmp_path):
    file = tmp_path / "poses.yaml"
    file.write_text(POSES)
    return file


class Sensor:
    """Publishes the same contact over and over, from now or the time `begin`, s, until it is told to
    be silent."""

    def __init__(self, probe, name, frame_id, begin=None, **changes):
        self._publisher = probe.node.create_publisher(ContactArray, f"/{name}/contacts", 2)
        self._frame_id, self.changes, self._numbers = frame_id, changes, itertools.count()
        self._begin = time.time() if begin is None else begin
        self.timer = probe.node.create_timer(0.05, self._publish)

    def _publish(self):
        header = make_header(self._begin + 0.05 * next(self._numbers), self._frame_id)
        known = {"contacts": [Contact(**CONTACT)], "complete": True, **self.changes}
        self._publisher.publish(ContactArray(header=header, **known))


def merged(probe, suits):
    return probe.wait_for(ContactArray, "/skin/contacts", suits)


def test_contacts_of_two_sensors_become_one_list_in_the_robots_frame(probe, start, poses):
    left, right = Sensor(probe, "left", "left_link"), Sensor(probe, "right", "right_link")
    skin = start("skin", {"sensors": "[left, right]", "poses": poses}, warm=False)
    both = merged(probe, lambda m: m.state == ContactArray.VALID and len(m.contacts) == 2)
    assert both.header.frame_id == "base_link" and both.header.stamp.sec >= 1000
    first, turned = sorted(both.contacts, key=lambda contact: contact.id)
    assert (first.id, turned.id) == ((1 << 24) + 7, (2 << 24) + 7)
    wrench = probe.wait_for(WrenchStamped, "/skin/wrench", lambda m: m.wrench.force.x == 0).wrench
    places = [0.11, 0.02, 0.5], [0.01, -0.2, 0.52]
    for found, expected in (
        (first.position, places[0]),
        (turned.position, places[1]),
        (turned.normal, [0, -1, 0]),
        (turned.velocity, [0, 0, 0.5]),
        (wrench.force, [0, 2, -2]),
        (wrench.torque, np.cross(places[0], [0, 0, -2]) + np.cross(places[1], [0, 2, 0])),
    ):
        np.testing.assert_allclose(ros_checks.xyz(found), expected, atol=1e-12)
    ros_checks.check_diagnostics(probe, "skin: sensors", DiagnosticStatus.OK, "all sensors")
    left.changes["complete"] = False
    merged(probe, lambda m: len(m.contacts) == 2 and not m.complete)
    left.changes.update(complete=True, ambiguous=True)  # perhaps nothing touches the left one
    maybe = merged(probe, lambda m: len(m.contacts) == 2 and m.complete and m.ambiguous)
    assert [each.id >> 24 for each in maybe.alternative] == [2]
    left.changes["ambiguous"] = False
    assert not merged(probe, lambda m: not m.ambiguous).alternative
    right.timer.cancel()
    left_only = merged(probe, lambda m: m.state == ContactArray.STALE)
    assert [c.id >> 24 for c in left_only.contacts] == [1]
    assert left_only.reason.startswith("right: no contacts for")
    probe.wait_for(WrenchStamped, "/skin/wrench", lambda m: np.isnan(m.wrench.force.z))
    left.timer.cancel()
    merged(probe, lambda m: "left: no contacts" in m.reason and not m.contacts)
    silent = DiagnosticStatus.ERROR, "right: no contacts for"
    ros_checks.check_diagnostics(probe, "skin: sensors", *silent)
    ros_checks.has_logged(probe, skin, "ERROR", silent[1])
    ends_cleanly(skin)


def test_contacts_that_nobody_vouches_for_are_none_and_each_sensor_is_named(probe, start, poses):
    """Withheld without a reason, and forces that are no numbers, were felt as they came; contacts that
    are old by their stamps may have waited on a slow way."""
    withheld, link = {"state": ContactArray.WITHHELD}, "left_link"
    Sensor(probe, "torn", link, reason="a tear", **withheld)
    Sensor(probe, "mute", link, **withheld)
    Sensor(probe, "lost", "elsewhere")
    Sensor(probe, "wild", link, contacts=[Contact(**{**CONTACT, "force": float("nan")})])
    Sensor(probe, "late", link, begin=1000.0)
    start("skin", {"sensors": "[torn, mute, lost, wild, late]", "poses": poses})
    reasons = (
        "torn: a tear",
        "mute: its",
        "lost: poses: none of frame 'elsewhere'",
        "wild: a contact",
        "late: its contacts are too old",
    )
    message = merged(probe, lambda m: all(reason in m.reason for reason in reasons))
    assert message.state == ContactArray.STALE and not message.contacts
    probe.wait_for(WrenchStamped, "/skin/wrench", lambda m: np.isnan(m.wrench.force.z))
    Sensor(probe, "mute", link)
    mixed = DiagnosticStatus.ERROR, "mute: 2 publishers of /mute/contacts"
    ros_checks.check_diagnostics(probe, "skin: sensors", *mixed)
    assert probe.set_parameter("/skin", "max_age", 0.0).successful
    merged(probe, lambda m: (5 << 24) + 7 in {c.id for c in m.contacts})


def test_who_is_silent_is_named_though_simulated_time_has_ended(probe, start, poses):
    left = Sensor(probe, "left", "left_link")
    start("skin", {"sensors": "[left]", "poses": poses, "use_sim_time": "true"})
    merged(probe, lambda m: "is not known" in m.reason and not m.contacts)
    left.timer.cancel()
    merged(probe, lambda m: "left: no contacts for" in m.reason)


@pytest.mark.parametrize(
    "changes, complaint",
    [
        ({"force": -1.0}, "a contact of -1 N at"),
        ({"force": 3e38}, "a contact of 3e+38 N at"),
        ({"position": Point(x=1e300)}, "a contact of 2 N at"),
        ({"normal": Vector3()}, "the normal of a contact is no direction"),
        ({"normal": Vector3(z=1e308)}, "the normal of a contact is no direction"),
    ],
)
def test_contacts_that_cannot_be_are_refused(changes, complaint):
    """The wrench of a contact without a normal was 0."""
    check_contacts([Contact(**CONTACT)])
    with pytest.raises(InputError, match=complaint.replace("+", r"\+")):
        check_contacts([Contact(**{**CONTACT, **changes})])


def test_transforms_are_taken_at_the_stamp_or_the_newest_or_missed(monkeypatch):
    monkeypatch.setitem(sys.modules, "tf2_ros", None)
    with pytest.raises(InputError, match="tf2_ros is not installed here: name a file"):
        make_locator(None, "base_link", "")
    known = {}  # s of the newest transform to base_link

    class Missing(Exception):
        pass

    def look_up(target, source, time):
        if source not in known or time.nanoseconds > 1e9 * known[source]:
            raise Missing("extrapolation" if source in known else f"{source} does not exist")
        transform = TransformStamped(header=make_header(known[source], target))
        transform.transform.translation.z = 0.5
        transform.transform.rotation.z = transform.transform.rotation.w = 0.5**0.5
        return transform

    stand_in = SimpleNamespace(
        Buffer=lambda node: SimpleNamespace(lookup_transform=look_up),
        TransformListener=lambda buffer, node: None,
        TransformException=Missing,
    )
    monkeypatch.setitem(sys.modules, "tf2_ros", stand_in)
    locate = make_locator(None, "base_link", "")
    with pytest.raises(InputError, match="no transform from left_link to base_link: left_link"):
        locate(make_header(5.0, "left_link"))
    known["left_link"] = 10.0
    for stamp in (5.0, 10.3):  # the second is after the newest transform
        pose = locate(make_header(stamp, "left_link"))
        np.testing.assert_allclose(pose.positions([0.1, 0.0, 0.0]), [0.0, 0.1, 0.5], atol=1e-12)
    with pytest.raises(InputError, match="transform of left_link is 3.0 s older than its contacts"):
        locate(make_header(13.0, "left_link"))


def test_a_sensors_place_comes_from_tf2(probe, start):
    tf2_ros = pytest.importorskip("tf2_ros", reason="tf2_ros comes with a full ROS 2")
    Sensor(probe, "left", "left_link")
    start("skin", {"sensors": "[left]"})
    transform = TransformStamped(header=make_header(0.0, "base_link"), child_frame_id="left_link")
    transform.transform.translation = Vector3(z=0.5)
    transform.transform.rotation = Quaternion(w=1.0)
    tf2_ros.StaticTransformBroadcaster(probe.node).sendTransform(transform)
    (contact,) = merged(probe, lambda m: m.state == ContactArray.VALID).contacts
    assert contact.position.z == pytest.approx(0.5)


def test_two_sensors_in_one_process_have_their_own_parameters_and_topics(
    probe, start, scene, tmp_path
):
    file = tmp_path / "two.yaml"
    (given,) = re.findall(r"```yaml\n(/left.*?)```", DOCS.read_text("utf-8"), re.DOTALL)
    file.write_text(given.replace("scene: tap", f"scene: {scene}"))
    sensors = start("sensors", {"sensors": "[left, right]"}, warm=False, files=[file])
    ros_checks.check_contact(probe, "/left")
    idle = probe.wait_for(ContactArray, "/right/contacts")
    assert (idle.header.frame_id, list(idle.contacts)) == ("right_link", [])
    assert "unknown" not in sensors.output  # `sensors` is given to all nodes, which have a `sensor`
    ends_cleanly(sensors)
