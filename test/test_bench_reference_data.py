"""Reference data: what the files hold is what the model gives, and they say what presses."""

from dataclasses import replace

import numpy as np
import pytest

from tomotactile_ros.bench import reference_slides
from tomotactile_ros.bench.reference import reference_frame
from tomotactile_ros.bench.reference_cases import FAMILIES, family, truth
from tomotactile_ros.bench.sensor.states import solved, states
from tomotactile_ros.bench.trials import LAW
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.errors import InputError


@pytest.mark.parametrize("name", FAMILIES)
def test_a_file_holds_its_family(name):
    """States and layout as their maker says them, and physical admittances."""
    data, made = states(name), family(name)
    assert len(data.seen) == len(made.states)
    np.testing.assert_allclose(data.layout.positions, made.layout.positions)
    assert data.layout.outline.area == pytest.approx(made.layout.outline.area)
    assert data.cases == [state.case for state in made.states]
    for contacts, state in zip(data.truths, made.states, strict=True):
        for contact, press in zip(contacts, state.contacts, strict=True):
            expected = truth(press, made.layout.outline)
            assert contact.keys() == expected.keys() and contact["shape"] == expected["shape"]
            for key in expected.keys() - {"shape"}:
                np.testing.assert_allclose(contact[key], expected[key], rtol=1e-9, atol=1e-12)
            assert contact["force"] > 0 and contact["area"] > 0
            assert data.layout.outline.contains(np.array([[contact["x"], contact["y"]]])).all()
    for number in (0, -1):
        # through the contacts flows no more than their area passes
        most = sum(each["area"] * each["conductance"] for each in data.truths[number])
        assert 0 < data.seen[number].drive.sum() <= most * (1 + 1e-3)
        frame = reference_frame(data.seen[number], 3.3)
        off = ~np.eye(len(frame), dtype=bool)
        assert (frame[off] > 0).all() and (frame[off] < 3.3).all()


def test_made_again_and_through_a_file(tmp_path, reference_model):
    whole = family("textbook-4x4")
    solved(replace(whole, states=whole.states[:2])).save(tmp_path / "two.npz")
    made, kept = states(tmp_path / "two.npz"), states("textbook-4x4", most=2)
    for one, other in zip(made.seen, kept.seen, strict=True):
        difference = reference_frame(one, 3.3) - reference_frame(other, 3.3)
        assert np.nanmax(np.abs(difference)) < 1e-3
    assert (made.truths, made.cases) == (kept.truths, kept.cases)


def test_what_is_no_data(tmp_path):
    with pytest.raises(InputError, match="no such file of reference data, and none of "):
        states("nothing")
    (tmp_path / "bad.npz").write_bytes(b"no archive")
    with pytest.raises(InputError, match="is not a file of reference data"):
        states(tmp_path / "bad.npz")


@pytest.fixture(scope="module")
def slides():
    return reference_slides.load("equal-8x8")


def test_a_file_holds_its_slides(slides):
    """Slides as their maker says them, wholly on the sheet, and rows of voltages."""
    layout, made = reference_slides.slides("equal-8x8")
    np.testing.assert_allclose(slides.layout.positions, layout.positions)
    rows = reference_slides.SCANS * layout.electrodes
    assert slides.rows.shape == (len(made), len(slides.speeds), rows, layout.electrodes)
    own = np.arange(rows) % layout.electrodes
    assert np.isnan(slides.rows[:, :, np.arange(rows), own]).all()
    others = slides.rows[~np.isnan(slides.rows)]
    assert len(others) == slides.rows.size * (1 - 1 / layout.electrodes)
    assert (others > 0).all() and (others < 1).all()
    for found, slide in zip(slides.slides, made, strict=True):
        assert found["contact"]["conductance"] == pytest.approx(slide.press.conductance)
        last = slide.at(max(slides.speeds) * slides.made["row_period"] * (rows - 1)).shape
        for center in (slide.press.shape.center, last.center):
            assert layout.outline.rim_distance(np.array([center]))[0] > last.semi_axes[0]


@pytest.mark.parametrize("speed", reference_slides.SPEEDS)
def test_rows_of_a_slide_are_those_of_the_simulator_within_a_hundredth(slides, speed):
    """A row-true frame by two models that share nothing, of 1 V; frozen it is far off."""
    slide, told = slides.slides[0], slides.slides[0]["contact"]
    velocity = speed * np.array(slide["direction"])
    contact = Contact(
        "disc", told["center"], told["disc_radius"], pressure=told["pressure"], velocity=velocity
    )
    scene, period = Scene("slide", 1.0, [contact], LAW), slides.made["row_period"]
    expected = slides.rows[0, slides.speeds.index(speed)][:64]
    true_rows, frozen = (
        Simulator(slides.layout, scene, row_period=each).frame(0.0) for each in (period, 0.0)
    )
    assert np.nanmax(np.abs(true_rows - expected)) < 0.01
    assert np.nanmax(np.abs(frozen - expected)) > 0.05


def test_slides_made_again_and_through_a_file(tmp_path, monkeypatch, reference_model):
    """One scan of one slide on a coarse mesh, and rows at one place share a solution."""
    monkeypatch.setattr(reference_slides, "SCANS", 1)
    monkeypatch.setattr(reference_slides, "SPEEDS", (0.5, 1.0))
    reference_slides.make("equal-4x4", tmp_path / "one.npz", h=0.02, most=1)
    data = reference_slides.load(tmp_path / "one.npz")
    assert data.rows.shape == (1, 2, 16, 16) and data.speeds == [0.5, 1.0]
    slow, fast = data.rows[0]
    np.testing.assert_array_equal(slow[0], fast[0])
    assert np.nanmax(np.abs(slow[15] - fast[15])) > 0.01
