"""Messages hold what the arrays held: values, order, orientation, stamps; bad frames are refused.

Contacts, cloud, layout and markers in space: test_surfaces.py, and ros_checks.check_surface.
"""

from dataclasses import replace

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from visualization_msgs.msg import Marker

from tomotactile_ros.devices import Frame
from tomotactile_ros.devices.recording import frame_of
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.nodes import contact_messages, conversions
from tomotactile_ros.nodes.markers import ContactMarkers, layout_markers
from tomotactile_ros.reconstruction import ContactEstimate
from tomotactile_ros.spatial import in_space
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.surfaces import Cylinder

HEADER = conversions.make_header(12.25, "skin")
LAYOUT = load_layout("equal-4x4")
CURVED = replace(LAYOUT, surface=Cylinder(0.1))


def a_frame(rows: int = 16, electrodes: int = 16, **changes) -> Frame:
    voltages = np.random.default_rng(3).random((rows, electrodes), dtype=np.float32)
    voltages[np.arange(rows), np.arange(rows)] = np.nan
    frame = Frame(voltages, np.arange(rows, dtype=np.uint16), 7, 1.7e9 + 0.25, 3.3)
    return replace(frame, **changes)


def a_contact(x: float = 0.03, y: float = 0.02, force: float = 2.0, id: int = 0) -> ContactEstimate:
    return ContactEstimate(x, y, force, 2e4, 1e-4, 0.006, id=id)


def round_trip(message):
    """The message after its way through the middleware's serialisation."""
    from rclpy.serialization import deserialize_message, serialize_message

    return deserialize_message(serialize_message(message), type(message))


@settings(deadline=None, max_examples=30)
@given(
    arrays(np.float32, st.tuples(st.integers(1, 20), st.integers(1, 20)),
           elements=st.floats(width=32, allow_nan=True)),
    st.integers(0, 2**40),
    st.floats(0, 2e9),
    st.floats(0, 10, width=32),
)  # fmt: skip
def test_a_frame_survives_its_message(voltages, sequence, stamp, row_period):
    grounded = np.arange(len(voltages), dtype=np.uint16)[::-1]
    frame = Frame(voltages, grounded, sequence, stamp, 5.0, row_period)
    header = conversions.make_header(stamp, "skin")
    message = round_trip(conversions.frame_to_message(frame, "a layout", header))
    back = frame_of(message)
    np.testing.assert_array_equal(back.voltages, voltages)
    np.testing.assert_array_equal(back.grounded, grounded)
    assert message.electrodes == voltages.shape[1]
    assert (message.layout_id, message.header.frame_id) == ("a layout", "skin")
    assert back.sequence == sequence % 2**32
    assert abs(back.stamp - stamp) <= 1e-9 + np.spacing(stamp)
    assert (back.drive_voltage, back.row_period) == (5.0, row_period)


@pytest.mark.parametrize("voltages, grounded", [(7, 2), (0, 0), (5, 0), (0, 3)])
def test_a_message_of_a_wrong_size_is_refused(voltages, grounded):
    message = conversions.frame_to_message(a_frame(), "x", HEADER)
    message.voltages = message.voltages[:voltages]
    message.grounded = message.grounded[:grounded]
    with pytest.raises(InputError, match="voltages do not fit"):
        frame_of(message)


@pytest.mark.parametrize(
    "frame, reason",
    [
        (a_frame(8, 64), "64 electrodes"),
        (a_frame(grounded=np.full(16, 16, np.uint16)), "electrode 16 is said to be grounded"),
        (a_frame(voltages=np.full((16, 16), np.nan, np.float32)), "no voltage is valid"),
        (a_frame(voltages=np.full((16, 16), np.inf, np.float32)), "infinite"),
        (a_frame(drive_voltage=0.0), "drive voltage"),
        (a_frame(row_period=-1e-3), "row period is -0.001 s"),
        # contacts hold some row periods after the stamp: what overflowed there ended the node
        (a_frame(row_period=1e12), r"the row period is 1e\+12 s"),
        (a_frame(row_period=3e38), r"the row period is 3e\+38 s"),
        (a_frame(row_period=np.nan), "the row period is nan s"),
        (a_frame(stamp=2**31 - 1e-9), "is the latest a message can carry"),
    ],
)
def test_a_frame_of_something_else_is_refused_with_the_reason(frame, reason):
    conversions.check_frame(a_frame(), LAYOUT)
    with pytest.raises(InputError, match=reason):
        conversions.check_frame(frame, LAYOUT)


def test_an_independent_reader_sees_the_numbers_that_were_published():
    try:
        from rosbags.image import message_to_cvimage
    except ImportError:  # installed, perhaps, without the libraries of OpenCV
        pytest.skip("rosbags.image is not to be had")
    numbers = np.random.default_rng(1).random((5, 7), dtype=np.float32)
    numbers[0, 0] = np.nan
    message = round_trip(conversions.image_to_message(numbers, HEADER))
    np.testing.assert_array_equal(message_to_cvimage(message), numbers)
    np.testing.assert_array_equal(conversions.message_to_image(message), numbers)
    assert (message.height, message.width, message.step) == (5, 7, 28)
    assert message.header == HEADER


@pytest.mark.parametrize("layout", [LAYOUT, CURVED], ids=["flat", "curved"])
def test_contacts_survive_their_message(layout):
    followed = replace(
        a_contact(force=3.0), id=7, age=1.5, velocity=(0.1, 0.2), probability=0.9, force_std=0.1
    )
    contacts = [followed, a_contact(x=-0.01)]
    placed = in_space(layout.surface, contacts)
    beside = [a_contact(x=0.02)], in_space(layout.surface, [a_contact(x=0.02)])
    sure = contact_messages.contacts_to_message(contacts, placed, HEADER)
    assert contact_messages.message_to_alternative(round_trip(sure), layout) is None
    told = contact_messages.contacts_to_message(contacts, placed, HEADER, alternative=beside)
    message = round_trip(told)
    assert message.header == HEADER
    (other,) = contact_messages.message_to_alternative(message, layout)
    assert other.x == pytest.approx(0.02)
    found = contact_messages.message_to_contacts(message, layout)
    for one, other in zip(found, contacts, strict=True):
        np.testing.assert_allclose((one.x, one.y), (other.x, other.y), atol=1e-9)
        assert (one.force, one.id, one.age) == (other.force, other.id, other.age)
    for contact in message.contacts:  # touches: the nearest point of the sheet is meant
        for axis in "xyz":
            lifted = getattr(contact.position, axis) + 0.004 * getattr(contact.normal, axis)
            setattr(contact.position, axis, lifted)
    for touch, other in zip(
        contact_messages.message_to_touches(message, layout), contacts, strict=True
    ):
        np.testing.assert_allclose((touch.x, touch.y), (other.x, other.y), atol=1e-9)
        assert (touch.force, touch.radius) == pytest.approx((other.force, other.radius))


def test_markers_follow_their_contacts_and_are_deleted_with_them():
    markers = ContactMarkers()

    def shown(time, *contacts):
        header = conversions.make_header(time, "skin")
        return markers.of(contacts, in_space(LAYOUT.surface, contacts), header).markers

    def names(found, action):
        return {(m.ns, m.id) for m in found if m.action == action}

    first = shown(12.25, a_contact(id=9), a_contact(id=4, x=-0.05))
    both = {(ns, k) for ns in ("force", "contact", "id") for k in (4, 9)}
    assert names(first, Marker.ADD) == both
    moved = shown(12.35, a_contact(id=4, x=-0.04))
    (trail,) = (m for m in moved if m.ns == "trail")
    assert trail.type == Marker.LINE_STRIP and trail.id == 4
    assert [p.x for p in trail.points] == [-0.05, -0.04]
    (text,) = (m for m in moved if m.ns == "id" and m.action == Marker.ADD)
    assert (text.id, text.text, text.pose.position.x) == (4, "#4", -0.04)
    assert text.pose.position.z > 0.02  # above the arrow of 2 N
    assert names(moved, Marker.DELETE) == {name for name in both if name[1] == 9}
    for time in (12.45, 13.0):  # one message may be lost
        assert names(shown(time), Marker.DELETE) == both
    assert not names(shown(13.7), Marker.DELETE)  # they do not live so long


def test_the_outline_of_the_layout_is_drawn_closed():
    (outline,) = (m for m in layout_markers(LAYOUT, HEADER).markers if m.ns == "outline")
    assert outline.points[0] == outline.points[-1]
    assert max(p.x for p in outline.points) == 0.1
