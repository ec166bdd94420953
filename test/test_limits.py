"""What is too small, too large or too much: right, or refused in one line; never ghosts."""

import json
import tracemalloc

import numpy as np
import pytest
from contacts_support import DRIVE, disc, sensor

from tomotactile_ros.commands.reconstruct import results_writer
from tomotactile_ros.frames_file import load_frames, open_frames, save_arrays
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.settings import Result
from tomotactile_ros.scenes.contact import ContactLaw
from tomotactile_ros.support.errors import InputError

PLACE, PRESSURE, RADIUS = (0.026, -0.042), 30e3, 0.005
FORCE = PRESSURE * np.pi * RADIUS**2
SMALL = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)


def pressed(place=PLACE, radius=RADIUS):
    return disc(*place, radius, pressure=PRESSURE)


def frame_of(layout, *contacts, **how):
    return sensor(layout, *(contacts or [pressed()]), adc=None, **how).frame(0.0)


@pytest.fixture(scope="module")
def frame():
    return frame_of(SMALL)


def process(layout, frame, profile="fast", **settings):
    pipeline = Pipeline(layout, Settings(profile, resolution=20, **settings))
    return pipeline.process(frame, np.arange(layout.electrodes), DRIVE)


@pytest.mark.parametrize("profile", ["fast", "accurate"])
def test_a_regularization_makes_the_image_and_no_contacts(frame, profile):
    plain = process(SMALL, frame, profile)
    for level in (1e-30, 1.0, 1e30):
        result = process(SMALL, frame, profile, regularization=level)
        assert result.contacts == plain.contacts and len(result.contacts) == 1
        assert result.regularization == level
        assert np.isfinite(result.potential).all()
        assert not np.allclose(result.potential, plain.potential)


@pytest.mark.parametrize("profile", ["fast", "accurate"])
def test_noise_that_a_converter_cuts_off_is_no_touch(profile):
    """Of readings around 0 V half the noise is cut off; what is left has a mean."""
    layout = equal_grid(8, 8, (0.2, 0.2), 0.0025, 1e4)
    noise = np.random.default_rng(4).standard_normal((64, 64))
    idle = process(layout, np.clip(0.1 * noise, 0.0, DRIVE), profile, noise=0.1)
    assert idle.state == "valid" and not idle.contacts
    with pytest.raises(InputError, match=r"noise: 1 V is not from 0 V to 0.66 V.*3.3 V"):
        process(layout, np.clip(noise, 0.0, DRIVE), profile, noise=1.0)


@pytest.mark.parametrize("rows, cols", [(2, 2), (2, 3)])
def test_few_electrodes_are_enough_for_a_contact(rows, cols):
    layout = equal_grid(rows, cols, (0.2, 0.2), 0.005, 1e4)
    for profile in ("fast", "balanced", "accurate"):
        (found,) = process(layout, frame_of(layout), profile).contacts
        assert np.hypot(found.x - PLACE[0], found.y - PLACE[1]) < 0.005
        assert found.force == pytest.approx(FORCE, rel=0.1)


def test_few_electrodes_that_are_left_are_estimated_with_their_uncertainty(frame):
    damaged = frame.copy()
    damaged[:, 9:] = np.nan
    damaged[9:] = np.nan
    whole, left = process(SMALL, frame, "balanced"), process(SMALL, damaged)
    assert len(left.faults) == 7
    (expected,), (found,) = whole.contacts, left.contacts
    apart = np.array([found.x - expected.x, found.y - expected.y])
    covariance = np.reshape(found.position_covariance, (2, 2))
    assert apart @ np.linalg.solve(covariance, apart) < 16
    assert np.trace(covariance) > np.trace(np.reshape(expected.position_covariance, (2, 2)))
    damaged[:, 8] = damaged[8] = np.nan
    withheld = process(SMALL, damaged)
    assert withheld.state == "withheld" and "8 of 16 channels" in withheld.reason


@pytest.mark.parametrize("exponent", [0.5, 1.0])
def test_a_contact_over_the_rim(exponent):
    law = ContactLaw(3.0 / PRESSURE**exponent, exponent)
    layout = equal_grid(6, 6, (0.2, 0.2), 0.005, 1e4)
    voltages = frame_of(layout, pressed((0.1, 0.02)), law=law, noise=0.0)
    (found,) = process(layout, voltages, contact_law=law).contacts
    assert np.hypot(found.x - 0.1, found.y - 0.02) < 0.004
    # on an electrode the width hardly shows; with a square root the force goes with its square
    assert abs(found.force - FORCE / 2) < max(0.4 * FORCE / 2, found.force_std)


def test_too_much_is_refused():
    many = equal_grid(50, 50, (0.5, 0.5), 0.002, 1e4)
    with pytest.raises(InputError, match="has 2500 electrodes, at most 1024"):
        Pipeline(many, Settings())
    with pytest.raises(InputError, match="has 2500 electrodes, at most 1024 are simulated"):
        frame_of(many)
    with pytest.raises(InputError, match=r"contacts\[0\]: 2 m wide on a sheet of 0.2 m"):
        frame_of(SMALL, pressed((0, 0), 1.0))
    lattice = np.stack(np.meshgrid(*2 * [np.linspace(-0.09, 0.09, 14)]), -1).reshape(-1, 2)
    with pytest.raises(InputError, match="contacts: 196 at the same time, in .* at most 4000"):
        frame_of(SMALL, *(pressed(place, 0.003) for place in lattice))


def peak_of(work):
    """Bytes that `work()` holds at its worst."""
    tracemalloc.start()
    work()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak


def test_results_of_any_number_of_frames_take_little_memory(tmp_path):
    image = np.zeros((100, 100))  # 80 kB a frame in the file
    result = Result(image, image, [], (), False, 0.0)

    def write(count):
        with results_writer(tmp_path / "out.npz") as take:
            for _ in range(count):
                take(result, 0.001, 0.0)

    assert peak_of(lambda: write(400)) < 8e6
    with np.load(tmp_path / "out.npz") as file:
        assert file["pressure"].shape == file["potential"].shape == (400, 100, 100)
        assert json.loads(str(file["contacts"])) == [[]] * 400
        assert "reason" not in file


def test_frames_are_read_one_by_one(tmp_path):
    voltages = np.random.default_rng(0).random((600, 50, 50), np.float32)  # 6 MB
    save_arrays(tmp_path / "a.npz", {"voltages": voltages, "grounded": np.arange(50)})
    opened = open_frames(tmp_path / "a.npz")
    assert len(opened.voltages) == 600
    assert peak_of(lambda: [frame.mean() for frame in opened.voltages]) < 1e6
    for _ in range(2):  # as often as one likes
        assert all(map(np.array_equal, opened.voltages, load_frames(tmp_path / "a.npz").voltages))
