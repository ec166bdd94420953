"""The contact law from presses of known force, its file, and the commands around it; and without one, where
nobody knows a force: places and conductances are there, newtons are not."""

import json
from dataclasses import replace

import numpy as np
import pytest
from contacts_support import DRIVE, disc, off, sensor

from tomotactile_ros import cli
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.frames_file import save_frames
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.learning.file import save_sensor
from tomotactile_ros.learning.state import SensorState
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.reconstruction.calibration import fit_contact_law, load_calibration
from tomotactile_ros.scenes.channels import Channels, Rms, Uniform
from tomotactile_ros.scenes.contact import ContactLaw
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.errors import InputError

TRUE = ContactLaw(3e-4, 0.8)
LAYOUT = load_layout("equal-4x4")


def run(*words):
    return cli.main([str(word) for word in words])


def press(path, radius=0.005, **pressed):
    """Frames of a press under the law TRUE, in a file."""
    defects = pressed.pop("defects", Defects())
    touch, how = disc(0.02, -0.035, radius, **pressed), {"noise": 0.0, "adc": None}
    made = sensor(LAYOUT, touch, law=TRUE, model="closed_form", defects=defects, **how)
    voltages = made.frame(0.0)[None]
    save_frames(path, LAYOUT, made.scene, voltages, made.grounded, np.zeros(1))
    return path


@pytest.mark.parametrize(
    "forces, conductances, message",
    [
        ([1.0, 1.1], [1e-4, 1e-4], "--exponent"),
        ([], [], "above 0 N"),
        ([0.0, 1.0], [1e-4, 1e-4], "above 0 N"),
        ([1.0, 2.0], [1e-4, 0.0], "no conductance"),
        ([1.0, 2.0], [2e-4, 1e-4], "does not grow"),
    ],
)
def test_presses_that_say_nothing_are_refused(forces, conductances, message):
    with pytest.raises(InputError, match=message):
        fit_contact_law(forces, conductances, np.full(len(forces), 1e-4))


def test_calibrate_finds_the_law_and_reconstruct_uses_it(tmp_path, capsys):
    presses = [press(tmp_path / f"press-{force:g}.npz", force=force) for force in (1.0, 4.0)]
    out, layout = tmp_path / "calibration.yaml", ("--layout", "equal-4x4")
    assert run("calibrate", presses[0], f"{presses[1]}=4", *layout, "--out", out) == 0
    law = load_calibration(out)
    assert law.exponent == pytest.approx(TRUE.exponent, abs=0.1)
    result = tmp_path / "result.npz"
    more = "--profile", "accurate", "--calibration", out, "--out", result
    assert run("reconstruct", presses[1], *layout, *more) == 0
    assert "1 frames" in capsys.readouterr().out
    with np.load(result) as content:
        ((contact,),) = json.loads(str(content["contacts"]))
        assert content["pressure"].shape == content["potential"].shape == (1, 40, 40)
        assert content["latency"].shape == (1,)
    assert contact["force"] == pytest.approx(4.0, rel=0.05)


def test_a_learned_sensor_and_a_known_foot_make_one_press_enough(tmp_path, capsys):
    """Gains off by 5 %, 200 ohm to ground: the frames tell both, what was learned tells them better."""
    wrong, operator = Channels(Rms(0.05, 1), None, Uniform(200, 100, 2)), SheetOperator(LAYOUT)
    known = SensorState.unknown(operator)
    numbers, mean = wrong.of(LAYOUT.electrodes), known.mean.copy()
    mean[known.slice("gain")] = numbers.gain
    mean[known.slice("resistance")] = numbers.ground_resistance
    known = replace(known.learned(mean, 1e-4 * known.covariance), touches=9)
    save_sensor(tmp_path / "sensor.yaml", LAYOUT, operator, known)
    out, drawn = tmp_path / "law.yaml", tmp_path / "fit.png"
    path = press(tmp_path / "press.npz", 0.008, pressure=2e4, defects=Defects(channels=wrong))
    words = ["calibrate", path, "--layout", "equal-4x4", "--out", out, "--exponent", "0.8"]
    laws = []
    for more in ([], ["--sensor", tmp_path / "sensor.yaml", "--foot-radius", "0.008"]):
        assert run(*words, *more, "--picture", drawn) == 0
        laws.append(load_calibration(out).coefficient / TRUE.coefficient - 1)
    assert abs(laws[0]) < 0.15 and abs(laws[1]) < 0.02  # one press alone hardly tells its width
    assert drawn.read_bytes().startswith(b"\x89PNG")
    assert run(*words, "--foot-radius", "-1") == 2 and "foot_radius" in capsys.readouterr().err


# -- without a law ---------------------------------------------------------------------------------

UNTOLD = ContactLaw(2e-4, 1.0)
PLACE = (0.02, -0.03)


@pytest.fixture(scope="module")
def frame():
    """A disc of 20 kPa whose law only the simulator knows: (voltages, grounded, drive voltage)."""
    made = sensor(LAYOUT, disc(*PLACE, 0.005, pressure=2e4), law=UNTOLD, noise=0.0, adc=None)
    return made.frame(0.0), made.grounded, DRIVE


@pytest.mark.parametrize("profile", ["fast", "balanced"])
def test_what_a_law_makes_forces_of_is_what_there_is_without_it(frame, profile):
    known, bare = (
        Pipeline(LAYOUT, Settings(profile, contact_law=law)).process(*frame)
        for law in (UNTOLD, None)
    )
    assert known.calibrated and not bare.calibrated
    (contact,), (same,) = known.contacts, bare.contacts
    assert off(same, PLACE) < 1e-3
    assert np.isnan([same.force, same.pressure, same.force_std]).all()
    np.testing.assert_allclose(UNTOLD.coefficient * contact.force, contact.conductance, rtol=1e-6)
    np.testing.assert_allclose(same.conductance, contact.conductance, rtol=1e-6)
    assert np.isnan(bare.pressure).all()
    np.testing.assert_allclose(bare.conductance, UNTOLD.coefficient * known.pressure, rtol=1e-6)
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
    assert run("reconstruct", frames, "--layout", "equal-8x8", "--out", out) == 0
    with np.load(out) as stored:
        arrays = dict(stored)
    return json.loads(str(arrays["contacts"]))[-1], arrays, capsys.readouterr().out


def test_a_bare_conductor_has_a_place_and_no_newtons(tmp_path, capsys):
    frames = tmp_path / "frames.npz"
    words = "--layout", "equal-8x8", "--scene", "experiment-centre", "--frames", "2"
    assert run("simulate", *words, "--out", frames) == 0
    (contact,), arrays, said = reconstruct(tmp_path, frames, capsys)
    assert np.hypot(contact["x"], contact["y"]) < 1e-3
    assert contact["force"] is contact["pressure"] is contact["force_std"] is None
    assert contact["conductance"] > 0
    assert np.isnan(arrays["pressure"]).all() and np.nanmax(arrays["conductance"]) > 0
    assert "no contact law: places and conductances, but no forces" in said
    assert run("inspect", tmp_path / "result.npz") == 0
    shown = capsys.readouterr().out
    assert "forces and pressures are not known" in shown
    assert " N" not in shown.split("last image")[1]


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
    words = "record", "--layout", "equal-8x8", "--frames", "2", "--out", frames, "--scene"
    for scene, law in (("experiment-centre", []), ("default", [1e-4, 1.0])):
        assert run(*words, scene) == 0
        with np.load(frames) as stored:
            np.testing.assert_array_equal(stored["contact_law"], law)
