"""Reference data: what the files hold is what the model gives, and they say what presses."""

import numpy as np
import pytest

from tomotactile_ros.bench import reference_data, reference_slides
from tomotactile_ros.bench.reference_cases import families, truth
from tomotactile_ros.bench.trials import LAW
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.errors import InputError

FAMILIES = families()


@pytest.mark.parametrize("name", reference_data.names())
def test_a_file_holds_its_family(name):
    """States, layout and sheets as their maker says them, and physical admittances."""
    data, family = reference_data.load(name), FAMILIES[name]()
    assert len(data) == len(data.states) == len(family.states) == len(data.sheet)
    np.testing.assert_allclose(data.layout.positions, family.layout.positions)
    assert data.layout.outline.area == pytest.approx(family.layout.outline.area)
    assert len(data.sheets) == len(data.untouched) == len(family.sheets)
    for found, state in zip(data.states, family.states):
        assert found["case"] == state.case
        for contact, press in zip(found["contacts"], state.contacts, strict=True):
            expected = truth(press, family.layout.outline)
            assert contact.pop("shape") == expected.pop("shape")
            assert contact.keys() == expected.keys()
            for key, value in expected.items():
                np.testing.assert_allclose(contact[key], value, rtol=1e-9, atol=1e-12)
    for number in (0, len(data) - 1):
        # through the contacts flows no more than their area passes
        most = sum(each["area"] * each["conductance"] for each in data.states[number]["contacts"])
        assert 0 < data.state(number).drive.sum() <= most * (1 + 1e-3)
        frame = data.frame(number, 3.3)
        off = ~np.eye(len(frame), dtype=bool)
        assert (frame[off] > 0).all() and (frame[off] < 3.3).all()


def test_contacts_lie_on_the_sheet():
    for name, make in FAMILIES.items():
        family = make()
        for state in family.states:
            for press in state.contacts:
                found = truth(press, family.layout.outline)
                assert found["force"] > 0 and found["area"] > 0, name
                assert family.layout.outline.contains(np.array([[found["x"], found["y"]]])).all()


def test_made_again_and_through_a_file(tmp_path):
    pytest.importorskip("skfem")
    try:
        import gmsh  # noqa: F401
    except (ImportError, OSError) as error:
        pytest.skip(f"no Gmsh: {error}")
    from dataclasses import replace

    family = FAMILIES["textbook-4x4"]()
    made = reference_data.make(replace(family, states=family.states[:2]))
    reference_data.save(made, tmp_path / "two.npz")
    data = reference_data.load(tmp_path / "two.npz")
    kept = reference_data.load("textbook-4x4")
    for number in range(2):
        difference = data.frame(number, 3.3) - kept.frame(number, 3.3)
        assert np.nanmax(np.abs(difference)) < 1e-3
    assert data.states == kept.states[:2]


def test_what_is_no_data(tmp_path):
    with pytest.raises(InputError, match="no such file of reference data, and none of "):
        reference_data.load("nothing")
    (tmp_path / "bad.npz").write_bytes(b"no archive")
    with pytest.raises(InputError, match="is not a file of reference data"):
        reference_data.load(tmp_path / "bad.npz")


@pytest.fixture(scope="module")
def slides():
    try:
        return reference_slides.load("equal-8x8")
    except InputError as error:
        pytest.skip(f"no reference data: {error}")


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
    slide = slides.slides[0]
    contact = Contact(
        "disc",
        center=slide["contact"]["center"],
        radius=slide["contact"]["disc_radius"],
        pressure=slide["contact"]["pressure"],
        velocity=speed * np.array(slide["direction"]),
    )
    scene, period = Scene("slide", 1.0, [contact], LAW), slides.made["row_period"]
    expected = slides.rows[0, slides.speeds.index(speed)][:64]
    true_rows, frozen = (
        Simulator(slides.layout, scene, row_period=each).frame(0.0) for each in (period, 0.0)
    )
    assert np.nanmax(np.abs(true_rows - expected)) < 0.01
    assert np.nanmax(np.abs(frozen - expected)) > 0.05


def test_slides_made_again_and_through_a_file(tmp_path, monkeypatch):
    """One scan of one slide on a coarse mesh, and rows at one place share a solution."""
    pytest.importorskip("skfem")
    try:
        import gmsh  # noqa: F401
    except (ImportError, OSError) as error:
        pytest.skip(f"no Gmsh: {error}")
    monkeypatch.setattr(reference_slides, "SCANS", 1)
    monkeypatch.setattr(reference_slides, "SPEEDS", (0.5, 1.0))
    made = reference_slides.make("equal-4x4", h=0.02, most=1)
    reference_slides.save(made, tmp_path / "one.npz")
    data = reference_slides.load(tmp_path / "one.npz")
    np.testing.assert_array_equal(data.rows, made.rows)
    assert data.slides == made.slides and data.speeds == [0.5, 1.0]
    slow, fast = data.rows[0]
    np.testing.assert_array_equal(slow[0], fast[0])
    assert np.nanmax(np.abs(slow[15] - fast[15])) > 0.01
