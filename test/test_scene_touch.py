"""How contacts press: profiles, courses, closed paths, memory; shipped scenes stay on the sheet."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.integrate import quad, solve_ivp

from tomotactile_ros.layouts.layout import equal_grid, load_layout
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.contact_law import Creep, Hysteresis
from tomotactile_ros.scenes.course import Ramp, Sine, Tap
from tomotactile_ros.scenes.scene import Scene, load_scene
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.errors import InputError

LAW = ContactLaw(1e-4, 1.0)
LAYOUT = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
FORCE, RADIUS = 3.0, 0.008
MEAN = FORCE / (np.pi * RADIUS**2)
SCENES = sorted(p.stem for p in (Path(__file__).parent.parent / "config" / "scenes").glob("*.yaml"))


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


def test_mean_displacement_under_a_punch_is_flat():
    """What a punch is for: its pressures press an elastic half space down evenly (Boussinesq).

    Displacements are potentials: of the patches, by 1 / distance, against those of even pressure.
    """
    points, areas, p = pressures(disc(profile="punch"), 24)
    own = 2 * np.sqrt(np.pi * areas)  # integral of 1 / distance over a disc of that area, / area
    at = np.flatnonzero(np.hypot(*points.T) < 0.7)

    def sunk(p):
        apart = np.linalg.norm(points[at, None] - points[None], axis=2) * RADIUS
        apart[np.arange(len(at)), at] = np.inf
        return (p * areas / apart).sum(axis=1) + p[at] * own[at]

    even = sunk(np.full(len(p), MEAN))
    r = np.hypot(*points[at].T)
    assert even.max() / even.min() > 1.15
    flat = sunk(p)
    assert flat.max() / flat.min() < 1.02
    assert np.median(flat) == pytest.approx(np.pi**2 / 2 * MEAN * RADIUS, rel=0.05)
    assert even[r.argmin()] > even[r.argmax()]


def test_a_ramp_goes_up_stays_and_goes_down():
    contact = disc(course=Ramp(rise=0.4, fall=0.2), start=1.0, end=2.0)
    scene = Scene("s", 3.3, [contact], contact_law=LAW)
    forces = [sum(c["force"] for c in scene.truth(t)) for t in (0.9, 1.0, 1.1, 1.4, 1.7, 1.9, 2.0)]
    np.testing.assert_allclose(forces, [0, 0, 0.75, 3, 3, 1.5, 0], atol=1e-12)
    assert contact.at(1.1).conductance(LAW, 6) == pytest.approx(0.25 * MEAN * LAW.coefficient)


def test_impulse_of_a_tap():
    scene = Scene("s", 3.3, [disc(course=Tap(duration=0.05, period=0.4), start=0.3)])
    times = np.linspace(0, 1.5, 30001)
    force = np.array([sum(c["force"] for c in scene.truth(t)) for t in times])
    impulse = np.trapezoid(force, times) if hasattr(np, "trapezoid") else np.trapz(force, times)
    assert impulse == pytest.approx(3 * 2 / np.pi * FORCE * 0.05, rel=1e-5)  # at 0.3, 0.7, 1.1 s
    assert force.max() == pytest.approx(FORCE, rel=1e-4)
    assert scene.truth(0.36) == []
    once = Scene("s", 3.3, [disc(course=Tap(duration=0.05))])
    assert once.truth(0.025)[0]["force"] == pytest.approx(FORCE) and once.truth(0.41) == []


def test_a_sine_swings_about_its_mean():
    scene = Scene("s", 3.3, [disc(course=Sine(amplitude=2.0, frequency=4.0))])
    force = np.array([scene.truth(t)[0]["force"] for t in np.arange(0, 1, 1e-3)])
    assert force.mean() == pytest.approx(FORCE)
    assert np.ptp(force) == pytest.approx(4.0, rel=1e-3)
    spectrum = np.abs(np.fft.rfft(force))
    assert spectrum[1:].argmax() + 1 == 4


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


def test_every_row_is_of_its_own_time():
    """Ball, tap and way together: each row is that of a frozen sheet at the row's time."""
    contact = Contact("disc", (-0.03, 0.01), radius=0.006, force=2.0, profile="hertz",
                      course=Tap(0.03), path=[[0.03, 0.03], [0.03, -0.06]], speed=2.0)  # fmt: skip
    law = ContactLaw(1e-4, 1.0, Hysteresis(0.2), Creep(0.1, (0.01,)))
    scene = Scene("s", 3.3, [contact], contact_law=law)
    rows = Simulator(LAYOUT, scene).frame(0.01)
    frozen = Simulator(LAYOUT, scene, row_period=0.0)
    expected = [frozen.frame(0.01 + 1e-3 * row)[row] for row in range(16)]
    np.testing.assert_allclose(rows, expected, atol=1e-9)


def test_overlapping_contacts_conduct_side_by_side():
    """Two in one place are one of the sum of their forces, where g ~ p; next to each other, two."""

    def frame(*contacts):
        scene = Scene("s", 3.3, contacts, contact_law=LAW)
        return Simulator(LAYOUT, scene, "closed_form").frame(0.0)

    half = Contact("disc", (0.02, -0.01), radius=RADIUS, force=FORCE / 2, profile="hertz")
    whole = Contact("disc", (0.02, -0.01), radius=RADIUS, force=FORCE, profile="hertz")
    np.testing.assert_allclose(frame(half, half), frame(whole), rtol=1e-9)
    # two halves of a square, once side by side, once overlapping by their whole area
    square = Contact("rectangle", (0.02, 0.03), size=(0.02, 0.02), force=4.0)
    left, right = (
        Contact("rectangle", (x, 0.03), size=(0.015, 0.02), force=3.0) for x in (0.0175, 0.0225)
    )
    lower, upper = (
        Contact("rectangle", (x, 0.03), size=(w, 0.02), pressure=p)
        for x, w, p in ((0.02, 0.02, 1e4), (0.02, 0.01, 1e4))
    )  # overlap: the middle centimetre counts twice
    off = ~np.eye(16, dtype=bool)
    both = frame(left, right)
    assert np.abs(both - frame(lower, upper))[off].max() < 0.01  # 1 kPa = 3 N / 3 cm2, twice
    assert np.abs(both - frame(square))[off].max() > 0.02


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


@settings(deadline=None)
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


@settings(deadline=None)
@given(st.lists(st.floats(0, 10), min_size=1, max_size=12), st.floats(1e-3, 1e3))
def test_loops_of_any_size_are_alike(turns, factor):
    hysteresis = Hysteresis(0.4)
    scaled = hysteresis.response([factor * p for p in turns])
    assert scaled == pytest.approx(factor * hysteresis.response(turns), rel=1e-9, abs=1e-12)


def test_when_a_contact_changes():
    ends = disc(start=1.0, end=2.0)
    spans = [(0, 0.9), (0, 1), (1, 1.9), (1.5, 2), (2, 3)]
    assert [ends.changes(*span) for span in spans] == [False, True, False, True, False]
    remembers = disc().under(ContactLaw(1e-4, 1.0, creep=Creep(0.1, (1.0,))))
    for other in (disc(course=Tap(1.0)), disc(path=[[0, 0]], speed=1e-3), remembers):
        assert other.changes(0.0, 0.1) and not other.changes(0.1, 0.1)


@pytest.mark.parametrize("course", [None, *COURSES], ids=lambda c: type(c).__name__)
def test_what_presses_and_moves_survives_its_file(tmp_path, course):
    way = {"path": [[0.05, 0.0], [0.0, 0.07]], "speed": 0.03, "loop": True}
    first = disc(profile="punch", course=course, start=0.5, end=3.5, **way)
    second = Contact("polygon", points=[[0, 0], [0.02, 0], [0, 0.02]], force=3.0, course=course,
                     end=4.0, path=[[0.05, 0.05]], speed=1.0)  # fmt: skip
    law = ContactLaw(1e-4, 1.2, Hysteresis(0.1), Creep(0.05, (0.5, 5.0)))
    scene = Scene("any", 3.3, [first, second], contact_law=law)
    scene.save(tmp_path / "any.yaml")
    again = load_scene(tmp_path / "any.yaml")
    assert again.contact_law == law
    for t in np.linspace(0, 5, 41):
        assert again.truth(t) == scene.truth(t)
        for mine, theirs in zip(scene.contacts, again.contacts, strict=True):
            mine, theirs = mine.at(t), theirs.at(t)
            if mine is not None:
                np.testing.assert_array_equal(mine.conductance(law, 6), theirs.conductance(law, 6))


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ("course: {kind: hop}", "contacts[0].course.kind: 'hop' is none of ramp, tap, sine"),
        ("course: {kind: tap, rise: 1}", "contacts[0].course.rise: unknown key"),
        ("course: {kind: sine, amplitude: 9, frequency: 1}", "contacts[0].course.amplitude: 9 N"),
        ("path: [[0, x]], speed: 1", "contacts[0].path[0][1]: 'x' is not a number"),
    ],
)
def test_mistakes_in_files_get_one_line_with_file_and_key(tmp_path, keys, line):
    text = "format: tomotactile-scene/1\ndrive_voltage: 3.3\ncontacts:\n"
    text += f"  - {{shape: disc, center: [0, 0], radius: 0.01, force: 1.0, {keys}}}\n"
    (tmp_path / "s.yaml").write_text(text)
    with pytest.raises(InputError) as error:
        load_scene(tmp_path / "s.yaml")
    assert "\n" not in str(error.value)
    assert str(error.value).startswith(f"{tmp_path / 's.yaml'}: {line}")


@pytest.mark.parametrize("name", SCENES)
def test_shipped_scenes_never_leave_the_sheet(name):
    """At 10,000 times of ten hours: every contact wholly on the sheet; none further than it
    says."""
    scene = load_scene(name)
    outline = load_layout(scene.layout or "equal-8x8").outline
    moving = [c for c in scene.contacts if c.moves]
    times = np.random.default_rng(0).uniform(0, 36000, 10_000)
    for contact in scene.contacts:
        centers = [contact.center]
        if contact in moving:
            found = [now for t in times if (now := contact.at(t)) is not None]
            assert len(found) > 1000
            centers = [now.center for now in found]
        form = contact.vertices - contact.center
        low, high = np.min(centers, axis=0) + form.min(0), np.max(centers, axis=0) + form.max(0)
        assert outline.contains(np.array([low, high, [low[0], high[1]], [high[0], low[1]]])).all()


@pytest.mark.parametrize(
    ("keys", "line"),
    [
        ({"profile": "hertz"}, "force: is missing, profile hertz needs it"),
        ({"profile": "dome", "force": 1.0}, "profile: 'dome' is none of even, hertz, punch"),
        ({"force": 1.0, "pressure": 1.0}, "force: is given, and so is pressure"),
        (
            {"force": 1.0, "course": Sine(2.0, 1.0)},
            r"course\.amplitude: 2 N is above the mean of 1 N",
        ),
        ({"force": 1.0, "course": Ramp(0.0, 1.0)}, r"course\.fall: needs 'to'"),
        (
            {"force": 1.0, "course": Ramp(2.0, 1.0), "end": 2.0},
            r"course\.rise: rise and fall take 3 s",
        ),
        ({"path": [[0, 1]]}, "speed: is missing, a path needs it"),
        ({"path": [[0, 1]], "speed": 1.0, "velocity": (1, 0)}, "path: is given, and so is velo"),
        ({"path": [[0, 0]], "speed": 1.0}, "path: leads nowhere"),
        ({"speed": 1.0}, "speed: is that of a path, and there is no path"),
    ],
)
def test_mistakes_in_contacts_get_one_line(keys, line):
    with pytest.raises(InputError, match=line):
        Contact("disc", (0, 0), radius=0.01, **keys)


@pytest.mark.parametrize(
    ("make", "line"),
    [
        (lambda: Ramp(), "rise: 0, and so is fall"),
        (lambda: Ramp(rise=-1.0), "rise: -1.0 is negative"),
        (lambda: Tap(0.0), "duration: 0.0 is not a positive time"),
        (lambda: Tap(1.0, 0.5), "period: 0.5 s is shorter than the tap"),
        (lambda: Sine(1.0, 0.0), "frequency: 0.0 is not a positive"),
        (lambda: Hysteresis(-0.1), "relative: -0.1 is negative"),
        (lambda: Creep(0.1, ()), "times: is empty"),
        (lambda: Creep(0.1, (1.0, 0.0)), r"times\[1\]: 0.0 is not a positive time"),
    ],
)
def test_mistakes_in_courses_and_laws_get_one_line(make, line):
    with pytest.raises(InputError, match=line):
        make()
