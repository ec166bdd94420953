"""Live touches over DDS: published here, pressed in the driver, found by the reconstruction."""

from itertools import pairwise

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

import ros_checks
from geometry_msgs.msg import Point
from rclpy.qos import DurabilityPolicy, QoSProfile
from ros_support import ends_cleanly
from sensor_msgs.msg import Image
from std_msgs.msg import Bool, Header

from tomotactile_ros.msg import Contact, ContactArray
from tomotactile_ros.nodes.conversions import stamp_of

LATCHED = QoSProfile(depth=1, durability=DurabilityPolicy.TRANSIENT_LOCAL)
NEAR = 0.005  # m
FIRST, SECOND = (0.052, 0.031), (-0.047, -0.022)


def message(*touches, frame_id=""):
    """Touches (x, y, force, radius) as a message."""
    return ContactArray(
        header=Header(frame_id=frame_id),
        contacts=[
            Contact(position=Point(x=float(x), y=float(y)), force=float(f), radius=float(r))
            for x, y, f, r in touches
        ],
    )


@pytest.fixture
def press(probe):
    """Sets the message that is published ten times a second; None: nobody publishes."""
    publisher = probe.node.create_publisher(ContactArray, "touches", 1)
    wanted = [None]
    timer = probe.node.create_timer(0.1, lambda: wanted[0] and publisher.publish(wanted[0]))
    yield lambda touches: wanted.__setitem__(0, touches)
    probe.node.destroy_timer(timer)


def are_at(*places):
    """Whether a message holds contacts within a few mm of these places, and no others."""

    def suits(found):
        if len(found.contacts) != len(places):
            return False
        at = np.array([(c.position.x, c.position.y) for c in found.contacts]).reshape(-1, 2)
        return all(np.linalg.norm(at - place, axis=1).min() < NEAR for place in places)

    return suits


def test_touches_are_pressed_moved_and_let_go(probe, start, press):
    driver = start("driver", {"scene": "live"})
    reconstruction = start("reconstruction", {"profile": "accurate"})
    press(message((*FIRST, 2.0, 0.006), frame_id="tactile_link"))
    found = probe.wait_for(ContactArray, "contacts", are_at(FIRST))
    (contact,) = found.contacts
    assert contact.force == pytest.approx(2.0, rel=0.25)
    probe.wait_for(
        ContactArray, "contacts", lambda m: any(c.id and c.age > 0.3 for c in m.contacts)
    )
    press(message((*FIRST, 2.0, 0.006), (*SECOND, 1.5, 0.006)))
    both = probe.wait_for(ContactArray, "contacts", are_at(FIRST, SECOND))
    assert len({contact.id for contact in both.contacts} - {0}) == 2
    press(message((*SECOND, 1.5, 0.006)))
    probe.wait_for(ContactArray, "contacts", are_at(SECOND))
    press(None)  # the publisher dies: nothing presses for ever
    probe.wait_for(ContactArray, "contacts", are_at())
    ends_cleanly(reconstruction)
    ends_cleanly(driver)


def test_a_touch_on_a_curved_sensor_is_given_and_found_in_space(probe, start, press, tmp_path):
    layout = ros_checks.write_curved_layout(tmp_path)
    start("driver", {"scene": "live", "layout": layout})
    start("reconstruction", {"profile": "accurate", "layout": layout})
    angle, bend = FIRST[0] / ros_checks.BEND, ros_checks.BEND
    outwards = np.array([np.sin(angle), 0.0, np.cos(angle)])
    place = bend * outwards + [0.0, FIRST[1], -bend]
    touch = Contact(force=2.0, radius=0.006)
    above = place + 0.004 * outwards  # the nearest point of the sheet is meant
    touch.position.x, touch.position.y, touch.position.z = above.tolist()
    press(ContactArray(contacts=[touch]))

    def is_there(found):
        at = [np.array([c.position.x, c.position.y, c.position.z]) for c in found.contacts]
        return len(at) == 1 and np.linalg.norm(at[0] - place) < NEAR

    (contact,) = probe.wait_for(ContactArray, "contacts", is_there).contacts
    assert contact.force == pytest.approx(2.0, rel=0.25)
    normal = [contact.normal.x, contact.normal.y, contact.normal.z]
    assert np.dot(normal, outwards) > np.cos(NEAR / bend)


def test_rows_tell_of_a_touch_and_its_end(probe, start, press):
    parameters = {"layout": "equal-4x4", "scene": "live", "delivery": "rows", "rows_per_message": 4}
    parameters |= {"publish_every": 8, "contact_radius": 0.006}
    start("tactile", parameters)
    touched = probe.listen(Bool, "touched", LATCHED)
    probe.until(lambda: touched and not touched[-1].data, "word of an untouched sheet")
    press(message((*FIRST, 2.0, 0.006)))
    probe.until(lambda: touched[-1].data, "word of a touch")
    arrays = probe.listen(ContactArray, "contacts", 10)

    def are_of_rows():
        """Whether one contact, there twice, was told of twice within a frame of 16 ms."""
        for one, other in pairwise(arrays):
            apart = stamp_of(other.header) - stamp_of(one.header)
            if are_at(FIRST)(one) and are_at(FIRST)(other) and 0 < apart < 0.012:
                return one.contacts[0].id == other.contacts[0].id > 0
        return False

    probe.until(are_of_rows, "contacts of rows")
    assert probe.wait_for(Bool, "touched", qos=LATCHED).data  # also for who comes later
    found = ros_checks.figures_of(probe, "reconstruction: reconstruction")
    assert int(found["rows_followed"]) > 0 and float(found["rows_per_second"]) > 0
    assert int(found["frames_processed"]) > 0
    probe.wait_for(Image, "pressure")
    press(message())
    probe.until(lambda: not touched[-1].data, "word of its end")
    probe.until(lambda: are_at()(arrays[-1]), "no contact")
