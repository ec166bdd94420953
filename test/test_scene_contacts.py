"""Contacts: their cells, their motion, when and where they touch; the contact law."""

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from tomotactile_ros.layouts.layout import Layout, Outline
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.support.errors import InputError

L_SHAPE = [[-4, -4], [4, -4], [4, -2], [-2, -2], [-2, 4], [-4, 4]]
U_SHAPE = [[0, 0], [9, 0], [9, 9], [8, 9], [8, 1], [1, 1], [1, 9], [0, 9]]
SQUARE = Layout("square", Outline.rectangle(0.2, 0.2), 1e4, 0.005, [[-0.1, 0.0], [0.1, 0.0]])


def by_place(points):
    """Points in an order that does not depend on rounding."""
    return points[np.lexsort(np.round(points, 9).T)]


@st.composite
def contacts(draw):
    scale = draw(st.floats(1e-4, 10.0))
    center = (draw(st.floats(-10, 10)), draw(st.floats(-10, 10)))
    shape = draw(st.sampled_from(["disc", "rectangle", "L", "U"]))
    if shape == "disc":
        return Contact("disc", center, radius=scale)
    if shape == "rectangle":
        size = (scale, scale * draw(st.floats(0.01, 1)))
        return Contact("rectangle", center, size=size, angle=draw(st.floats(-180, 180)))
    points = np.array(L_SHAPE if shape == "L" else U_SHAPE) * scale / 8 + center
    return Contact("polygon", points=points)


@settings(deadline=None)
@given(contact=contacts(), share=st.floats(0.04, 3.0))
def test_cells_fill_the_contact_and_lie_in_it(contact, share):
    spacing = share * np.sqrt(contact.area)
    points, areas = contact.sample(spacing)
    assert areas.sum() == pytest.approx(contact.area, rel=1e-12)
    assert (areas > 0).all() and areas.max() <= spacing**2 * (1 + 1e-3)
    rim = shapely.Polygon(contact.vertices)
    distance = shapely.distance(rim, shapely.points(points))
    # a centre far from the origin rounds away the last digits of a small contact
    assert distance.max() <= 1e-12 * np.abs(contact.vertices).max()


@settings(deadline=None)
@given(contact=contacts(), across=st.integers(4, 24))
def test_patches_fill_the_contact_and_follow_its_rim(contact, across):
    points, areas, radii = contact.patches(across)
    assert areas.sum() == pytest.approx(contact.area, rel=1e-12)
    assert (areas >= 0).all() and (radii > 0).all()
    outline = shapely.Polygon(contact.vertices)
    width = np.ptp(contact.vertices, axis=0).max()
    where = shapely.points(points)
    assert shapely.distance(outline, where).max() < 1e-9 * width + 1e-14
    on_rim = shapely.distance(outline.exterior, where) < 1e-4 * width
    # a point on the rim stands for a line 2 pi times its radius long
    assert 2 * np.pi * radii[on_rim].sum() == pytest.approx(outline.length, rel=1e-3)


@settings(deadline=None)
@given(share=st.floats(0.05, 1e6), radius=st.floats(1e-5, 10))
def test_disc_sample_is_symmetric_and_never_poor(share, radius):
    contact = Contact("disc", (0.0, 0.0), radius=radius)
    points, areas = contact.sample(share * radius)
    assert len(points) >= 7
    unit = points / radius
    for image in (unit * [-1, 1], unit * [1, -1], unit[:, ::-1]):
        np.testing.assert_allclose(by_place(image), by_place(unit), atol=1e-9)
    np.testing.assert_allclose(areas @ unit, 0, atol=1e-9 * contact.area)


def test_second_moment_of_a_disc_converges():
    """The polar moment of a uniform disc is r²/2 per area."""
    contact = Contact("disc", (0.0, 0.0), radius=1.0)
    errors = []
    for spacing in (0.25, 0.125, 0.0625):
        points, areas = contact.sample(spacing)
        errors.append(abs((areas @ (points**2).sum(axis=1)) / contact.area - 0.5))
    assert errors[0] < 0.01
    rates = np.log2(np.array(errors[:-1]) / errors[1:])
    assert (rates > 1.7).all()


def test_rectangle_cells_are_equal_and_turned():
    contact = Contact("rectangle", (1.0, 2.0), size=(0.4, 0.3), angle=90.0)
    points, areas = contact.sample(0.1)
    np.testing.assert_allclose(areas, 0.01)
    assert len(points) == 12
    np.testing.assert_allclose(np.ptp(points, axis=0), [0.2, 0.3])
    np.testing.assert_allclose(points.mean(axis=0), [1, 2])
    tilted = Contact("rectangle", (0, 0), size=(0.4, 0.3), angle=30.0).sample(0.1)[0]
    np.testing.assert_allclose(tilted[3] - tilted[0], 0.3 * np.array([np.cos(np.pi / 6), 0.5]))
    np.testing.assert_allclose(tilted[4] - tilted[0], 0.1 * np.array([-0.5, np.cos(np.pi / 6)]))


@pytest.mark.parametrize("shape", ["disc", "rectangle", "polygon"])
def test_sample_moves_rigidly_with_the_contact(shape):
    form = {
        "disc": {"center": (0.01, 0.02), "radius": 0.008},
        "rectangle": {"center": (0.01, 0.02), "size": (0.03, 0.01), "angle": 20.0},
        "polygon": {"points": np.array(L_SHAPE) / 100},
    }[shape]
    contact = Contact(shape, **form, start=1.0, end=9.0, velocity=(0.02, -0.01))
    points, areas = contact.at(1.0).sample(0.003)
    later, same = contact.at(6.0).sample(0.003)
    np.testing.assert_allclose(later - points, np.tile([0.1, -0.05], (len(points), 1)), atol=1e-15)
    np.testing.assert_array_equal(areas, same)
    np.testing.assert_allclose(contact.at(6.0).centroid - contact.centroid, [0.1, -0.05])
    np.testing.assert_allclose(contact.at(2.0).at(6.0).center, contact.at(6.0).center)
    moved = contact.at(6.0).vertices - contact.vertices
    np.testing.assert_allclose(moved, np.tile([0.1, -0.05], (len(moved), 1)))


def test_contact_is_there_from_start_until_just_before_end():
    contact = Contact("disc", (0, 0), radius=1, start=1.0, end=2.0)
    there = [contact.at(t) is not None for t in (0.999, 1.0, 1.999, 2.0)]
    assert there == [False, True, True, False]
    assert Contact("disc", (0, 0), radius=1).at(1e9) is not None


@pytest.mark.parametrize(
    ("contact", "reaches"),
    [
        (Contact("disc", (0.105, 0), radius=0.01), True),
        (Contact("disc", (0.115, 0), radius=0.01), False),
        (Contact("disc", (1.0, 0), radius=0.01, velocity=(-0.1, 0)), True),
        (Contact("disc", (1.0, 0), radius=0.01, velocity=(-0.1, 0), end=8.8), False),
        (Contact("disc", (1.0, 0), radius=0.01, velocity=(-0.1, 0), end=9.2), True),
        (Contact("disc", (1.0, 0), radius=0.01, velocity=(0.1, 0)), False),
        (Contact("disc", (9.0, 0.3), radius=0.01, velocity=(-1e6, 0)), False),
        (Contact("disc", (9.0, 0.3), radius=0.201, velocity=(-1e-9, 0)), True),
        (Contact("rectangle", (0.15, 0.15), size=(0.2, 0.02), angle=-45), False),
        (Contact("rectangle", (0.15, 0.15), size=(0.2, 0.02), angle=134), False),
        (Contact("rectangle", (0.15, 0.15), size=(0.2, 0.02), angle=45), True),
        # a U around the sheet surrounds it without touching; then it moves up, and its foot hits
        (Contact("polygon", points=(np.array(U_SHAPE) - 4.5)), False),
        (Contact("polygon", points=(np.array(U_SHAPE) - 4.5), velocity=(0, 1)), True),
        (Contact("polygon", points=(np.array(U_SHAPE) - 4.5), velocity=(0, -1)), False),
    ],
)
def test_only_a_contact_that_never_touches_is_refused(contact, reaches):
    scene = Scene("s", 3.3, [contact])
    if reaches:
        scene.check(SQUARE)
    else:
        with pytest.raises(InputError, match=r"contacts\[0\]: never touches the sheet of square"):
            scene.check(SQUARE)


def test_truth_is_what_touches_now():
    scene = Scene(
        "s",
        3.3,
        [
            Contact("disc", (0, 0), radius=0.01, pressure=1e4, velocity=(0.01, 0), end=5.0),
            Contact("rectangle", (0.02, 0.03), size=(0.02, 0.01), start=2.0),
        ],
    )
    (disc,) = scene.truth(1.0)
    area = np.pi * 1e-4
    assert disc == pytest.approx(
        {"x": 0.01, "y": 0.0, "force": 1e4 * area, "pressure": 1e4, "area": area, "radius": 0.01}
    )
    bare = scene.truth(6.0)[0]
    assert (bare["force"], bare["pressure"]) == (None, None)
    assert bare["area"] == pytest.approx(2e-4)
    assert np.pi * bare["radius"] ** 2 == pytest.approx(2e-4)
    assert len(scene.truth(3.0)) == 2 and scene.truth(-1.0) == []


@settings(deadline=None)
@given(coefficient=st.floats(1e-9, 1e3), exponent=st.floats(0.3, 3), pressure=st.floats(1e-3, 1e8))
def test_contact_law_and_its_inverse(coefficient, exponent, pressure):
    law = ContactLaw(coefficient, exponent)
    assert law.conductance(pressure) == pytest.approx(coefficient * pressure**exponent)
    assert law.pressure(law.conductance(pressure)) == pytest.approx(pressure, rel=1e-9)
