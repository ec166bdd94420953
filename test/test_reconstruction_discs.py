"""Place, size and conductance of single discs, from frames of finite elements."""

import numpy as np
import pytest

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.layouts.region import enclosed
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.discs import Shares
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Adc, Defects, Noise, SheetVariation
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import Simulator

DRIVE, LAW, GROUNDED = 3.3, ContactLaw(1e-4, 1.0), np.arange(64)
OUTLINES = [
    Outline.rectangle(0.2, 0.2),
    Outline.rectangle(0.21, 0.1),
    Outline.circle(0.1),
    Outline.rectangle(
        0.2, 0.2, holes=[[(-0.02, -0.02), (0.03, -0.02), (0.03, 0.03), (-0.02, 0.03)]]
    ),
]
PLACES = [(0.001, 0.002), (0.015, -0.001), (-0.027, 0.031), (0.062, 0.024), (-0.055, -0.06)]


@pytest.fixture(scope="module")
def pipelines():
    first = Pipeline(load_layout("equal-8x8"), Settings("fast"))
    return {p: first.with_settings(Settings(p)) for p in ("fast", "balanced", "accurate")}


def frames_of(layout, discs, variation=None):
    """(N, E, E) frames of single discs (x, y, radius, pressure or None)."""
    contacts = [
        Contact("disc", center=(x, y), radius=r, pressure=p, start=float(i), end=i + 1.0)
        for i, (x, y, r, p) in enumerate(discs)
    ]
    defects = Defects(sheet_variation=variation)
    scene = Scene("single", DRIVE, contacts, LAW, Noise(1e-3), Adc(12, DRIVE), defects)
    simulator = Simulator(layout, scene)
    return [simulator.frame(i + 0.5, i) for i in range(len(discs))]


@pytest.mark.parametrize("outline", OUTLINES)
def test_interpolation_is_exact_for_harmonic_polynomials_up_to_the_rim(outline):
    grid, random = Grid.for_outline(outline, 37), np.random.default_rng(1)
    shares, unit = Shares(grid), np.sqrt(grid.cell_area)
    cubic = random.normal(size=4) + 1j * random.normal(size=4)

    def derivative(order, z):
        return np.polyval(np.polyder(cubic, order), z)

    values = np.polyval(cubic, grid.pixels @ [10, 10j]).real
    for place in grid.pixels[:: len(grid.pixels) // 50] + random.uniform(-0.4, 0.4) * unit:
        pixels, weights = shares.at(*place)
        z = complex(*place) * 10
        first, second = derivative(1, z) * 10 * unit, derivative(2, z) * (10 * unit) ** 2 / 2
        expected = [np.polyval(cubic, z).real, first.real, -first.imag, second.real, -second.imag]
        assert values[pixels] @ weights == pytest.approx(expected, rel=1e-9, abs=1e-9)


@pytest.mark.parametrize("profile", ["fast", "balanced", "accurate"])
@pytest.mark.parametrize("radius", [0.004, 0.012])
def test_force_of_fingertips_of_all_sizes(pipelines, profile, radius):
    discs = [(x, y, radius, 10e3) for x, y in PLACES]
    errors = []
    for (x, y), frame in zip(PLACES, frames_of(pipelines[profile].layout, discs)):
        (contact,) = pipelines[profile].process(frame, GROUNDED, DRIVE).contacts
        assert np.hypot(contact.x - x, contact.y - y) < 0.0015
        errors.append(abs(contact.force / (10e3 * np.pi * radius**2) - 1))
    assert np.median(errors) < 0.15 and max(errors) < 0.25


def test_a_force_that_is_known_from_below_is_at_least_that(pipelines):
    layout, random = pipelines["fast"].layout, np.random.default_rng(5)
    beside = layout.positions[random.choice(64, 30, False)] + random.normal(0, 0.004, (30, 2))
    radii = random.uniform(0.003, 0.012, 30)
    forces = np.exp(random.uniform(np.log(2.0), np.log(60.0), 30))
    discs = list(zip(*np.clip(beside, -0.085, 0.085).T, radii, forces / (np.pi * radii**2)))
    bounded = 0
    for force, frame in zip(forces, frames_of(layout, discs)):
        (contact,) = pipelines["fast"].process(frame, GROUNDED, DRIVE).contacts
        if np.isinf(contact.force_std):
            bounded += 1
            assert contact.force < force, (contact, force)
        else:
            assert abs(contact.force - force) < 2.5 * contact.force_std, (contact, force)
    assert 0 < bounded < 10


def test_what_lies_upon_an_electrode_of_a_coarse_grid_is_there():
    layout = load_layout("equal-4x4")
    x, y = layout.positions[10]
    frames = frames_of(layout, [(x + 0.001, y - 0.001, 0.0055, 12.0 / (np.pi * 0.0055**2))])
    result = Pipeline(layout, Settings("fast", contact_law=LAW)).process(
        frames[0], np.arange(16), DRIVE
    )
    assert result.state == "valid", result.reason
    (contact,) = result.contacts
    assert np.hypot(contact.x - x, contact.y - y) < 0.006
    if np.isfinite(contact.force_std):
        assert abs(contact.force - 12.0) < 3 * contact.force_std
    else:
        assert contact.force < 12.0


def test_how_strong_a_press_on_an_electrode_is_takes_more_than_one_step(pipelines):
    fast, (x, y) = pipelines["fast"], pipelines["fast"].layout.positions[27]
    (frame,) = frames_of(fast.layout, [(x + 0.001, y, 0.006, 15.0 / (np.pi * 0.006**2))])
    (contact,) = fast.process(frame, GROUNDED, DRIVE).contacts
    assert contact.force == pytest.approx(15.0, rel=0.15) and contact.force_std < 3.0


@pytest.mark.parametrize("radius", [0.008])
def test_force_on_an_uneven_sheet(pipelines, radius):
    layout, variation = pipelines["fast"].layout, SheetVariation(0.1, 0.05, 3)
    frames = frames_of(layout, [(x, y, radius, 20e3) for x, y in PLACES], variation)
    for pipeline in pipelines.values():
        errors = []
        for frame in frames:
            (contact,) = pipeline.process(frame, GROUNDED, DRIVE).contacts
            errors.append(abs(contact.force / (20e3 * np.pi * radius**2) - 1))
        assert np.median(errors) < 0.2 and max(errors) < 0.35


@pytest.mark.parametrize("radius, error", [(0.002, 0.012), (0.005, 0.005)])
def test_a_weak_touch_is_one_contact(pipelines, radius, error):
    frames = frames_of(pipelines["fast"].layout, [(x, y, radius, 2e3) for x, y in PLACES])
    for pipeline in pipelines.values():
        for (x, y), frame in zip(PLACES, frames):
            result = pipeline.process(frame, GROUNDED, DRIVE)
            if result.state != "valid":  # so weak that nobody knows where
                assert "too weakly" in result.reason and radius == 0.002
                continue
            (contact,) = result.contacts
            assert np.hypot(contact.x - x, contact.y - y) < error
            assert contact.force == pytest.approx(2e3 * np.pi * radius**2, rel=0.1)


@pytest.mark.parametrize("profile", ["fast", "balanced"])
def test_bare_conductors_have_bounded_forces_and_places_on_the_sheet(pipelines, profile):
    discs = [
        (x, y, r, None) for x, y in [(0, 0), (0.0857, 0.0857), (0.014, 0.03)] for r in (1e-3, 0.012)
    ]
    discs += [(0.099, 0.01, 1e-3, None), (-0.0995, -0.0995, 5e-4, None)]
    if profile == "balanced":  # in the middle, between electrodes, in the corner
        discs = discs[1::3]
    for frame in frames_of(pipelines[profile].layout, discs):
        result = pipelines[profile].process(frame, GROUNDED, DRIVE)
        assert bool(result.contacts) == (result.state == "valid")
        for contact in result.contacts:
            assert contact.force > 0
            if profile == "fast":  # where it is the image's
                assert contact.force <= 100 / 1e4 / 1e-4 * 1.001  # 100 / R at this contact law
            assert max(abs(contact.x), abs(contact.y)) <= 0.1


def test_deviations_of_fast_hold_what_is_true(pipelines):
    """On frames of finite elements, on electrodes as well, where forces were up to 60 % off."""
    random = np.random.default_rng(5)
    discs = [
        (
            *random.uniform(-0.08, 0.08, 2),
            random.uniform(4e-3, 8e-3),
            10 ** random.uniform(3.7, 4.5),
        )
        for _ in range(20)
    ]
    held, strong = [], []
    for frame, (x, y, radius, pressure) in zip(frames_of(load_layout("equal-8x8"), discs), discs):
        (contact,) = pipelines["fast"].process(frame, GROUNDED, DRIVE).contacts
        apart = np.array([contact.x - x, contact.y - y])
        covariance = np.reshape(contact.position_covariance, (2, 2))
        held.append(apart @ np.linalg.solve(covariance, apart) < 5.99)
        force = pressure * np.pi * radius**2
        strong.append(abs(contact.force - force) < 2 * contact.force_std)
        assert contact.probability > 0.999
    assert np.mean(held) >= 0.9 and np.mean(strong) >= 0.9


@pytest.mark.parametrize("pressure", [1e7, 1e13])
def test_the_force_of_a_bare_conductor_is_at_least_what_fast_says(pipelines, pressure):
    """It was 98 % low and known to 13 %."""
    places = [(0.001, 0.002), (0.03, 0.01), (-0.05, 0.045)]  # the last on an electrode
    discs = [(x, y, 5e-3, pressure) for x, y in places]
    for frame in frames_of(load_layout("equal-8x8"), discs):
        (contact,) = pipelines["fast"].process(frame, GROUNDED, DRIVE).contacts
        assert not np.isfinite(contact.force_std)  # not known at all of what is wider than a disc
        assert contact.force < pressure * np.pi * 25e-6


def test_where_one_step_does_not_tell_the_force_the_estimator_does(pipelines):
    """Of 18.4 N, `fast` said at least 6.6 N."""
    radius = 0.0115
    (frame,) = frames_of(
        load_layout("equal-8x8"), [(0.001, 0.002, radius, 18.4 / (np.pi * radius**2))]
    )
    (contact,) = pipelines["fast"].process(frame, GROUNDED, DRIVE).contacts
    assert abs(contact.force - 18.4) < 2 * contact.force_std < 6.0


def test_places_beyond_the_outermost_electrodes_are_as_uncertain_as_they_say():
    """There, a contact and its mirror image behind the electrode leave the same over: 48 µS were 16 mm off, known
    to 1.7 mm."""
    layout, random = load_layout("balanced-4x4"), np.random.default_rng(3)
    fast = Pipeline(layout, Settings("fast", contact_law=LAW))
    places = random.uniform(-0.097, 0.097, (200, 2))
    places = np.vstack([[-0.094, 0.084], places[~enclosed(places, layout.positions)][:29]])
    forces = np.exp(random.uniform(np.log(0.3), np.log(5.0), len(places)))
    discs = [(*place, 0.005, force / (np.pi * 25e-6)) for place, force in zip(places, forces)]
    for pipeline in fast, fast.with_settings(Settings("accurate", contact_law=LAW)):
        held = []
        for place, frame in zip(places, frames_of(layout, discs)):
            (contact,) = pipeline.process(frame, np.arange(16), DRIVE).contacts
            apart = place - [contact.x, contact.y]
            covariance = np.reshape(contact.position_covariance, (2, 2))
            held.append(apart @ np.linalg.solve(covariance, apart) < 5.99)
        assert np.mean(held) >= 0.9
