"""Without a contact law nobody knows a force: places and conductances are there, newtons are not."""

import json

import numpy as np
import pytest

from tomotactile_ros import cli
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.scene import Scene, load_scene
from tomotactile_ros.simulation import Simulator

LAYOUT = load_layout("equal-4x4")
LAW = ContactLaw(2e-4, 1.0)
PLACE = (0.02, -0.03)


@pytest.fixture(scope="module")
def frame():
    """A disc of 20 kPa whose law only the simulator knows: (voltages, grounded, drive voltage)."""
    disc = Contact("disc", center=PLACE, radius=0.005, pressure=2e4)
    simulator = Simulator(LAYOUT, Scene("s", 3.3, (disc,), contact_law=LAW), row_period=0.0)
    return simulator.frame(0.0), simulator.grounded, 3.3


def reconstructed(frame, profile, law):
    return Pipeline(LAYOUT, Settings(profile, contact_law=law)).process(*frame)


@pytest.mark.parametrize("profile", ["fast", "balanced"])
def test_what_a_law_makes_forces_of_is_what_there_is_without_it(frame, profile):
    known, bare = (reconstructed(frame, profile, law) for law in (LAW, None))
    assert known.calibrated and not bare.calibrated
    (contact,), (same,) = known.contacts, bare.contacts
    assert np.hypot(same.x - PLACE[0], same.y - PLACE[1]) < 1e-3
    assert np.isnan([same.force, same.pressure, same.force_std]).all()
    np.testing.assert_allclose(LAW.coefficient * contact.force, contact.conductance, rtol=1e-6)
    np.testing.assert_allclose(same.conductance, contact.conductance, rtol=1e-6)
    assert np.isnan(bare.pressure).all()
    np.testing.assert_allclose(bare.conductance, LAW.coefficient * known.pressure, rtol=1e-6)
    cell = LAYOUT.outline.area / bare.conductance.size
    np.testing.assert_allclose(bare.conductance.sum() * cell, same.conductance, rtol=1e-6)


def test_rows_have_no_forces_either(frame):
    voltages, grounded, drive = frame
    pipeline = Pipeline(LAYOUT, Settings("balanced", contact_law=None))
    state = pipeline.rows()
    for i, ground in enumerate(grounded):
        result = pipeline.process_row(voltages[i], ground, drive, 1e-3 * i, state)
    (contact,) = result.contacts
    assert np.isnan(contact.force) and contact.conductance > 0
    shown = pipeline.image_after_row(state)
    assert np.isnan(shown.pressure).all() and np.nanmax(shown.conductance) > 0


def reconstruct(tmp_path, frames, capsys):
    """Contacts of the last frame in the result file, its arrays, and what the command said."""
    out = tmp_path / "result.npz"
    words = ["reconstruct", str(frames), "--layout", "equal-8x8", "--out", str(out)]
    assert cli.main(words) == 0
    with np.load(out) as stored:
        arrays = dict(stored)
    return json.loads(str(arrays["contacts"]))[-1], arrays, capsys.readouterr().out


def test_a_bare_conductor_has_a_place_and_no_newtons(tmp_path, capsys):
    frames = tmp_path / "frames.npz"
    words = ["simulate", "--layout", "equal-8x8", "--scene", "experiment-centre", "--frames", "2"]
    assert cli.main([*words, "--out", str(frames)]) == 0
    (contact,), arrays, said = reconstruct(tmp_path, frames, capsys)
    assert np.hypot(contact["x"], contact["y"]) < 1e-3
    assert contact["force"] is contact["pressure"] is contact["force_std"] is None
    assert contact["conductance"] > 0
    assert np.isnan(arrays["pressure"]).all() and np.nanmax(arrays["conductance"]) > 0
    assert "no contact law: places and conductances, but no forces" in said
    assert cli.main(["inspect", str(tmp_path / "result.npz")]) == 0
    shown = capsys.readouterr().out
    assert (
        "forces and pressures are not known" in shown and " N" not in shown.split("last image")[1]
    )


def test_frames_that_say_nothing_of_a_law_are_read_with_one_that_is_named(tmp_path, capsys):
    layout, scene = load_layout("equal-8x8"), load_scene("default")
    simulator = Simulator(layout, scene, row_period=0.0)
    frames = tmp_path / "frames.npz"
    np.savez(frames, voltages=simulator.frame(0.0)[None], grounded=simulator.grounded)
    contacts, arrays, said = reconstruct(tmp_path, frames, capsys)
    assert contacts[0]["force"] > 0
    assert "conductance" not in contacts[0] and "conductance" not in arrays
    assert "forces and pressures assume 0.0001 S/m^2 per Pa" in said


def test_a_recording_of_a_sensor_says_that_no_law_is_known(tmp_path, capsys):
    frames = tmp_path / "frames.npz"
    words = ["record", "--layout", "equal-8x8", "--frames", "2", "--out", str(frames), "--scene"]
    for scene, law in (("experiment-centre", []), ("default", [1e-4, 1.0])):
        assert cli.main([*words, scene]) == 0
        with np.load(frames) as stored:
            np.testing.assert_array_equal(stored["contact_law"], law)
