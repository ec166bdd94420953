"""Messages hold what the arrays held: values, order, orientation, stamps; bad frames are
refused."""

from dataclasses import replace

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays
from visualization_msgs.msg import Marker

from tomotactile_ros.devices import Frame
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.nodes import contact_messages, conversions
from tomotactile_ros.nodes.markers import ContactMarkers, layout_markers
from tomotactile_ros.reconstruction import ContactEstimate
from tomotactile_ros.spatial import in_space
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.surfaces import Cylinder

HEADER = conversions.make_header(12.25, "skin")
LAYOUT = load_layout("equal-4x4")


def a_frame(rows: int = 16, electrodes: int = 16) -> Frame:
    voltages = np.random.default_rng(3).random((rows, electrodes), dtype=np.float32)
    voltages[np.arange(rows), np.arange(rows)] = np.nan
    return Frame(voltages, np.arange(rows, dtype=np.uint16), 7, 1.7e9 + 0.25, 3.3)


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
    back = conversions.message_to_frame(message)
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
        conversions.message_to_frame(message)


def spoilt(**changes) -> Frame:
    frame = a_frame()
    return Frame(**{**vars(frame), **changes})


@pytest.mark.parametrize(
    "frame, reason",
    [
        (a_frame(8, 64), "64 electrodes"),
        (spoilt(grounded=np.full(16, 16, np.uint16)), "electrode 16 is said to be grounded"),
        (spoilt(voltages=np.full((16, 16), np.nan, np.float32)), "no voltage is valid"),
        (spoilt(voltages=np.full((16, 16), np.inf, np.float32)), "infinite"),
        (spoilt(drive_voltage=0.0), "drive voltage"),
        (spoilt(row_period=-1e-3), "row period is -0.001 s"),
    ],
)
def test_a_frame_of_something_else_is_refused_with_the_reason(frame, reason):
    conversions.check_frame(a_frame(), LAYOUT)
    with pytest.raises(InputError, match=reason):
        conversions.check_frame(frame, LAYOUT)


def decode(message):
    """The image as an independent reader understands it."""
    try:
        from rosbags.image import message_to_cvimage
    except ImportError:  # installed, perhaps, without the libraries of OpenCV
        pytest.skip("rosbags.image is not to be had")
    return message_to_cvimage(message)


def test_an_independent_reader_sees_the_numbers_that_were_published():
    numbers = np.random.default_rng(1).random((5, 7), dtype=np.float32)
    numbers[0, 0] = np.nan
    message = round_trip(conversions.image_to_message(numbers, HEADER))
    np.testing.assert_array_equal(decode(message), numbers)
    np.testing.assert_array_equal(conversions.message_to_image(message), numbers)
    assert (message.height, message.width, message.step) == (5, 7, 28)
    assert message.header == HEADER


def test_a_contact_at_plus_x_plus_y_is_in_the_upper_right_of_the_image():
    grid = Grid.for_outline(LAYOUT.outline, 10)
    near = np.linalg.norm(grid.pixels - (0.05, 0.07), axis=1)
    message = conversions.image_to_message(grid.fill((near < 0.02).astype(float)), HEADER)
    rows, columns = np.nonzero(decode(message))
    assert rows.max() < 5 <= columns.min()


CURVED = replace(LAYOUT, surface=Cylinder(0.1))


@pytest.mark.parametrize("layout", [LAYOUT, CURVED], ids=["flat", "curved"])
def test_contacts_survive_their_message(layout):
    followed = replace(
        a_contact(force=3.0), id=7, age=1.5, velocity=(0.1, 0.2), probability=0.9, force_std=0.1
    )
    contacts = [followed, a_contact(x=-0.01)]
    placed = in_space(layout.surface, contacts)
    message = round_trip(contact_messages.contacts_to_message(contacts, placed, HEADER))
    assert message.header == HEADER
    found = contact_messages.message_to_contacts(message, layout)
    for one, other in zip(found, contacts, strict=True):
        np.testing.assert_allclose((one.x, one.y), (other.x, other.y), atol=1e-9)
        assert (one.force, one.id, one.age) == (other.force, other.id, other.age)
    first = message.contacts[0]
    for field, expected in (
        (first.position, placed.positions[0]),
        (first.velocity, placed.velocities[0]),
        (first.normal, placed.frames[0][:, 2]),
        (first.tangent, placed.frames[0][:, 0]),
    ):
        np.testing.assert_array_equal((field.x, field.y, field.z), expected)


def test_the_layout_message_says_where_cells_and_electrodes_are():
    grid = Grid.for_outline(LAYOUT.outline, 10)
    message = round_trip(contact_messages.layout_to_message(CURVED, grid, HEADER))
    assert (message.layout_id, message.surface) == (CURVED.id, "cylinder")
    row, column = 3, 7
    x = message.first_x + column * message.cell_width
    y = message.first_y - row * message.cell_height
    np.testing.assert_allclose((x, y), grid.centres[row * message.width + column])
    cell = message.cells[row * message.width + column]
    expected = CURVED.surface.to_3d([(x, y)])[0]
    np.testing.assert_allclose((cell.x, cell.y, cell.z), expected, atol=1e-7)
    assert len(message.cells) == message.height * message.width
    places = np.array([(e.x, e.y, e.z) for e in message.electrodes])
    np.testing.assert_allclose(places, CURVED.surface.to_3d(LAYOUT.positions), atol=1e-7)


def markers_of(markers, contacts, surface=LAYOUT.surface):
    return markers.of(contacts, in_space(surface, contacts), HEADER).markers


def test_markers_of_contacts_that_ended_are_deleted():
    markers = ContactMarkers()
    both = markers_of(markers, [a_contact(), a_contact(force=1.0)])
    assert {(m.ns, m.id, m.action) for m in both} == {
        ("force", 0, Marker.ADD), ("contact", 0, Marker.ADD),
        ("force", 1, Marker.ADD), ("contact", 1, Marker.ADD),
    }  # fmt: skip
    one = markers_of(markers, [a_contact()])
    assert {(m.ns, m.id) for m in one if m.action == Marker.DELETE} == {
        ("force", 1), ("contact", 1)
    }  # fmt: skip
    for header in (HEADER, conversions.make_header(13.0, "skin")):  # one message may be lost
        gone = markers.of([], in_space(LAYOUT.surface, []), header).markers
        assert {(m.ns, m.id, m.action) for m in gone} == {
            (ns, k, Marker.DELETE) for ns in ("force", "contact") for k in (0, 1)
        }
    later = conversions.make_header(13.5, "skin")  # they do not live so long
    assert markers.of([], in_space(LAYOUT.surface, []), later).markers == []


def test_a_contact_that_is_followed_keeps_its_markers_and_has_its_id_and_a_trail():
    markers, later = ContactMarkers(), conversions.make_header(12.35, "skin")
    kinds = {m.ns: m for m in markers_of(markers, [a_contact(id=9), a_contact(id=4, x=-0.05)])}
    assert sorted(kinds) == ["contact", "force", "id"]
    surface, moved = LAYOUT.surface, [a_contact(id=4, x=-0.04)]
    shown = markers.of(moved, in_space(surface, moved), later).markers
    trail = next(m for m in shown if m.ns == "trail")
    assert trail.type == Marker.LINE_STRIP and trail.id == 4
    assert [p.x for p in trail.points] == [-0.05, -0.04]
    text = next(m for m in shown if m.ns == "id" and m.action == Marker.ADD)
    assert (text.id, text.text, text.pose.position.x) == (4, "#4", -0.04)
    assert text.pose.position.z > 0.02  # above the arrow of 2 N
    gone = {(m.ns, m.id) for m in shown if m.action == Marker.DELETE}
    assert gone == {("force", 9), ("contact", 9), ("id", 9)}


def test_an_arrow_points_onto_the_contact_and_is_as_long_as_the_force():
    arrow, disc = markers_of(ContactMarkers(), [a_contact(force=3.0)])
    tail, head = arrow.points
    assert (head.x, head.y, head.z) == (0.03, 0.02, 0.0)
    assert tail.z == pytest.approx(0.03)
    assert (disc.scale.x, disc.scale.y) == (0.012, 0.012)


def test_markers_stand_upright_on_a_curved_sheet():
    contacts = [a_contact(x=0.05 * np.pi, y=0.0)]
    arrow, disc = markers_of(ContactMarkers(), contacts, Cylinder(0.1))
    tail, head = arrow.points
    assert (head.x, head.z) == (pytest.approx(0.1), pytest.approx(-0.1))
    assert (tail.x, tail.z) == (pytest.approx(0.12), pytest.approx(-0.1))
    turn = disc.pose.orientation
    assert np.hypot(turn.y, turn.w) == pytest.approx(1.0)
    assert turn.y == pytest.approx(np.sqrt(0.5))


def test_the_layout_is_drawn_with_every_electrode_where_it_is():
    markers = layout_markers(LAYOUT, HEADER).markers
    discs = {m.id: m.pose.position for m in markers if m.ns == "electrode"}
    places = np.array([(discs[e].x, discs[e].y) for e in range(16)])
    np.testing.assert_array_equal(places, LAYOUT.positions)
    (outline,) = (m for m in markers if m.ns == "outline")
    assert outline.points[0] == outline.points[-1]
    assert max(p.x for p in outline.points) == 0.1


def test_a_cloud_holds_positions_and_pressures():
    points = np.random.default_rng(4).random((6, 3)).astype(np.float32)
    message = round_trip(conversions.cloud_to_message(points, np.arange(6.0), HEADER))
    names = [field.name for field in message.fields]
    table = np.frombuffer(message.data, np.float32).reshape(6, 4)
    assert names == ["x", "y", "z", "pressure"]
    np.testing.assert_array_equal(table[:, :3], points)
    np.testing.assert_array_equal(table[:, 3], np.arange(6.0))
    assert message.row_step == len(message.data) == message.width * message.point_step
