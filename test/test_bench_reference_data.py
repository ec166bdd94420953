"""Reference data: what the files hold is what the model gives, and they say what presses."""

import numpy as np
import pytest

from tomotactile_ros.bench import reference_data
from tomotactile_ros.bench.reference_cases import families, truth
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
