"""Contacts: cells, motion, when and where they touch; how they press; the law and its memory."""

import numpy as np
import pytest
import shapely
from hypothesis import given
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from tomotactile_ros.layouts.layout import Layout, Outline, equal_grid
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.contact_law import Creep, Hysteresis
from tomotactile_ros.scenes.course import Ramp, Sine, Tap
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.errors import InputError

L_SHAPE = [[-4, -4], [4, -4], [4, -2], [-2, -2], [-2, 4], [-4, 4]]
U_SHAPE = [[0, 0], [9, 0], [9, 9], [8, 9], [8, 1], [1, 1], [1, 9], [0, 9]]
SQUARE = Layout("square", Outline.rectangle(0.2, 0.2), 1e4, 0.005, [[-0.1, 0.0], [0.1, 0.0]])


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


@pytest.mark.parametrize(
    "shape, form",
    [
        ("disc", {"center": (0.01, 0.02), "radius": 0.008}),
        ("rectangle", {"center": (0.01, 0.02), "size": (0.03, 0.01), "angle": 20.0}),
        ("polygon", {"points": np.array(L_SHAPE) / 100}),
    ],
)
def test_patches_move_rigidly_with_the_contact(shape, form):
    contact = Contact(shape, **form, start=1.0, end=9.0, velocity=(0.02, -0.01))
    first, later = contact.at(1.0), contact.at(6.0)
    (points, areas, _), (moved, same, _) = first.patches(), later.patches()
    np.testing.assert_array_equal(areas, same)
    for before, after in ((points, moved), (contact.vertices, later.vertices)):
        np.testing.assert_allclose(after - before - [0.1, -0.05], 0, atol=1e-15)
    np.testing.assert_allclose(later.centroid - contact.centroid, [0.1, -0.05])
    np.testing.assert_allclose(contact.at(2.0).at(6.0).center, later.center)


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
    moving = Contact("disc", (0, 0), radius=0.01, pressure=1e4, velocity=(0.01, 0), end=5.0)
    later = Contact("rectangle", (0.02, 0.03), size=(0.02, 0.01), start=2.0)
    scene = Scene("s", 3.3, [moving, later])
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


@given(coefficient=st.floats(1e-9, 1e3), exponent=st.floats(0.3, 3), pressure=st.floats(1e-3, 1e8))
def test_contact_law_and_its_inverse(coefficient, exponent, pressure):
    law = ContactLaw(coefficient, exponent)
    assert law.conductance(pressure) == pytest.approx(coefficient * pressure**exponent)
    assert law.pressure(law.conductance(pressure)) == pytest.approx(pressure, rel=1e-9)


LAW = ContactLaw(1e-4, 1.0)
FORCE, RADIUS = 3.0, 0.008
MEAN = FORCE / (np.pi * RADIUS**2)


def disc(**keys):
    return Contact("disc", (0.02, -0.01), radius=RADIUS, force=FORCE, **keys)


def pressures(contact, across):
    """(Q, 2) patches about the centre in radii, (Q,) areas and (Q,) pressures on them."""
    points, areas, _ = contact.patches(across)
    per_area = np.broadcast_to(contact.conductance(LAW, across), areas.shape)
    return (points - contact.center) / RADIUS, areas, per_area / LAW.coefficient


@pytest.mark.parametrize("profile", ["even", "hertz", "punch"])
@pytest.mark.parametrize("across", [4, 6, 13, 24])
def test_pressures_on_patches_add_up_to_the_force(profile, across):
    points, areas, p = pressures(disc(profile=profile), across)
    assert p @ areas == pytest.approx(FORCE, rel=1e-12)
    assert (p >= 0).all()
    np.testing.assert_allclose((p * areas) @ points, 0, atol=1e-9 * FORCE)
    polar = (p * areas) @ (points**2).sum(axis=1) / FORCE
    assert polar == pytest.approx(
        {"even": 1 / 2, "hertz": 2 / 5, "punch": 2 / 3}[profile], rel=0.06
    )


@pytest.mark.parametrize(
    ("profile", "density"),
    [("hertz", lambda r: 1.5 * np.sqrt(1 - r**2)), ("punch", lambda r: 0.5 / np.sqrt(1 - r**2))],
)
def test_profiles_are_those_of_contact_mechanics(profile, density):
    """Patches against the formula, within a radius where it is finite, and the force within it."""
    points, areas, p = pressures(disc(profile=profile), 24)
    r = np.hypot(*points.T)
    inner = r < 0.85
    np.testing.assert_allclose(p[inner] / MEAN, density(r[inner]), rtol=0.03)
    for within in (0.3, 0.6, 0.9):
        force = quad(lambda s: density(s) * 2 * s, 0, within)[0]
        # a circle through a lattice of cells: the cells on it count by halves, at most
        assert (p * areas)[r < within].sum() / FORCE == pytest.approx(force, abs=0.06)


def half_sine(t, lasts):
    return FORCE * np.sin(np.pi * t / lasts) * ((t > 0) & (t < lasts))


@pytest.mark.parametrize(
    "course, end, force",
    [
        (Ramp(0.4, 0.2), 1.0, lambda t: FORCE * np.interp(t, [0, 0.4, 0.8, 1.0], [0, 1, 1, 0])),
        (Tap(0.05, 0.4), np.inf, lambda t: half_sine(t % 0.4, 0.05) * (t > 0)),
        (Tap(0.05), np.inf, lambda t: half_sine(t, 0.05)),
        (Sine(2.0, 4.0), np.inf, lambda t: (FORCE + 2 * np.sin(8 * np.pi * t)) * (t > 0)),
    ],
    ids=["ramp", "taps", "tap", "sine"],
)
def test_the_force_in_time_is_that_of_the_course(course, end, force):
    contact = disc(course=course, start=1.0, end=1.0 + end)
    scene = Scene("s", 3.3, [contact], contact_law=LAW)
    for t in np.random.default_rng(0).uniform(0.5, 3.5, 1000):
        truth, there = scene.truth(t), contact.at(t)
        assert sum(each["force"] for each in truth) == pytest.approx(force(t - 1), abs=1e-9)
        assert truth == [] if there is None or force(t - 1) == 0 else len(truth) == 1
        if there is not None:
            g = force(t - 1) / FORCE * MEAN * LAW.coefficient
            assert there.conductance(LAW, 6) == pytest.approx(g)


def test_a_contact_follows_its_way_points_and_rests_or_goes_round():
    way = {"path": [[0.02, 0.02], [0.06, 0.02]], "speed": 0.01}
    contact = disc(**way, start=1.0)
    places = [contact.at(t).center for t in (1.0, 2.5, 4.0, 6.0, 8.0, 99.0)]
    corners = [[0.02, -0.01], [0.02, 0.005], [0.02, 0.02], [0.04, 0.02], [0.06, 0.02], [0.06, 0.02]]
    np.testing.assert_allclose(places, corners, atol=1e-15)
    round_ = disc(**way, loop=True)
    period = (0.03 + 0.04 + 0.05) / 0.01
    for t in (0.0, 2.2, 6.9, 11.0):
        np.testing.assert_allclose(round_.at(t + 7 * period).center, round_.at(t).center)
    np.testing.assert_allclose(round_.at(9.5).center, [0.04, 0.005])
    np.testing.assert_allclose(contact.at(2.0).at(6.0).center, contact.at(6.0).center)
    steps = np.array([round_.at(t).center for t in np.arange(0, 24, 0.05)])
    assert np.linalg.norm(np.diff(steps, axis=0), axis=1).max() <= 0.01 * 0.05 * (1 + 1e-9)


def test_overlapping_contacts_conduct_side_by_side():
    """Two in one place are one of the sum of their forces, where g ~ p; next to each other, two."""
    layout = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)

    def frame(*contacts):
        scene = Scene("s", 3.3, contacts, contact_law=LAW)
        return Simulator(layout, scene, "closed_form").frame(0.0)

    half, whole = (
        Contact("disc", (0.02, -0.01), radius=RADIUS, force=force, profile="hertz")
        for force in (FORCE / 2, FORCE)
    )
    np.testing.assert_allclose(frame(half, half), frame(whole), rtol=1e-9)

    def bar(x, width, force):
        return Contact("rectangle", (x, 0.03), size=(width, 0.02), force=force)

    # 10 kPa, in the middle centimetre twice: two that overlap there, or one more on that of a square
    both = frame(bar(0.0175, 0.015, 3.0), bar(0.0225, 0.015, 3.0))
    off = ~np.eye(16, dtype=bool)
    assert np.abs(both - frame(bar(0.02, 0.02, 4.0), bar(0.02, 0.01, 2.0)))[off].max() < 0.01
    assert np.abs(both - frame(bar(0.02, 0.02, 4.0)))[off].max() > 0.02


def respond(law, forces_in_time, times):
    """What the law feels at ``times``, by small steps: an independent evaluation."""
    widths = [2 * law.hysteresis.relative * (i + 0.5) / 8 for i in range(8)]
    state, felt = np.zeros(8), []
    for t in times:
        for i, h in enumerate(widths):
            p = forces_in_time(t)
            state[i] = min(max(state[i], p), (1 + h) * p)
        felt.append(state.mean())
    return np.array(felt)


COURSES = [Ramp(rise=0.7, fall=0.9), Tap(0.3, 0.5), Tap(0.5, 0.5), Tap(0.8), Sine(2.0, 1.7)]


@pytest.mark.parametrize("course", COURSES, ids=lambda c: type(c).__name__)
def test_hysteresis_by_turning_points_is_that_of_small_steps(course):
    law = ContactLaw(1e-4, 1.0, hysteresis=Hysteresis(0.3))
    signal = course.signal(FORCE, 3.0)
    times = np.linspace(0, 2.999, 12000)
    stepped = respond(law, signal.value, times)
    felt = np.array([law.felt(signal, t) for t in times])
    there = np.array([signal.value(t) for t in times]) > 0
    np.testing.assert_allclose(felt[there], stepped[there], atol=2e-3)


@pytest.mark.parametrize("course", COURSES, ids=lambda c: type(c).__name__)
def test_creep_is_the_answer_of_its_lags(course):
    law = ContactLaw(1e-4, 1.0, creep=Creep(0.2, (0.1, 2.0)))
    signal = course.signal(FORCE, 3.0)
    times = np.linspace(0, 2.99, 200)

    def slope(t, z):
        return (signal.value(t) - z) / np.array(law.creep.times)

    z = solve_ivp(slope, (0, 3), [0, 0], t_eval=times, max_step=2e-3, rtol=1e-8).y
    now = np.array([signal.value(t) for t in times])
    expected = np.where(now > 0, now + 0.2 * z.mean(axis=0), 0)
    np.testing.assert_allclose([law.felt(signal, t) for t in times], expected, atol=2e-4)


@given(st.lists(st.floats(0, 10), min_size=1, max_size=12), st.floats(0.1, 10), st.floats(0.1, 10))
def test_return_point_memory(turns, one, other):
    """A small excursion that comes back leaves nothing behind, whatever was before."""
    hysteresis = Hysteresis(0.4)
    low, high = sorted((one, other))
    closed = [*turns, low, high, low]
    excursion = (high + low) / 2
    # into the loop, and back to the turn from which it began
    inside = [*closed, excursion, low]
    assert hysteresis.response(inside) == pytest.approx(hysteresis.response(closed), abs=1e-12)
    # a larger turn wipes out what was before
    largest = max(turns) + 1
    assert hysteresis.response([*turns, largest, low]) == pytest.approx(
        hysteresis.response([0.0, largest, low]), abs=1e-12
    )
