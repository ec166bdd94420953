"""Live touches over DDS: published here, pressed in the driver, found by the reconstruction; ids."""

import math
import os
import signal
import time
from functools import partial
from itertools import pairwise

import pytest

rclpy = pytest.importorskip("rclpy")

import ros_checks
from geometry_msgs.msg import Point
from ros_checks import LATCHED
from ros_support import ends_cleanly
from sensor_msgs.msg import Image
from std_msgs.msg import Bool, Header

from tomotactile_ros.msg import Contact, ContactArray
from tomotactile_ros.nodes.conversions import stamp_of

NEAR = 0.005  # m
FIRST, SECOND = (0.052, 0.031), (-0.047, -0.022)


STOPPED = 0.6, 1.2  # s: less than rows are waited for before contacts come from frames, and more


def message(*touches, frame_id=""):
    """Touches (x, y, force, radius) as a message."""
    contacts = [
        Contact(position=Point(x=x, y=y), force=force, radius=radius)
        for x, y, force, radius in touches
    ]
    return ContactArray(header=Header(frame_id=frame_id), contacts=contacts)


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
        at = [(c.position.x, c.position.y) for c in found.contacts]
        apart = [min(math.dist(place, each) for each in at) for place in places if at]
        return len(at) == len(places) and all(each < NEAR for each in apart)

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


def test_ids_outlast_an_estimator_that_is_stopped(probe, start):
    """A second in which nothing is estimated ends no contact: two discs move slowly meanwhile."""
    given = {"scene": "default", "delivery": "rows", "profile": "accurate"}
    start("driver", given)
    estimator = start("reconstruction", given)
    heard = probe.listen(ContactArray, "contacts", 500)

    def both(since=0.0):
        """Ids of the first message after that which has both."""
        for message in heard:
            if stamp_of(message.header) > since and len(message.contacts) == 2:
                return {contact.id for contact in message.contacts}
        return set()

    probe.until(lambda: both(), "two contacts")
    first = both()
    for stopped in STOPPED:
        os.kill(estimator.pid, signal.SIGSTOP)
        time.sleep(stopped)
        os.kill(estimator.pid, signal.SIGCONT)
        ready = partial(both, time.time() + 0.5)
        probe.until(ready, "two contacts of half a second later")
    ids = [{c.id for c in m.contacts} for m in heard if m.state == ContactArray.VALID]
    assert set().union(*ids[ids.index(first) :]) == first
    # where something touched already when rows began, contacts are those of frames until one has told
    assert not any("already touched" in message.reason for message in heard)
    last = [m for m in heard if m.contacts][-1]
    assert min(contact.age for contact in last.contacts) > sum(STOPPED)
