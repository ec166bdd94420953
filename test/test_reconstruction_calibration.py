"""The contact law from presses of known force, its file, and the commands around it."""

import json
from argparse import ArgumentParser
from dataclasses import replace

import numpy as np
import pytest

from tomotactile_ros.commands import calibrate, reconstruct
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.frames_file import save_frames
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.learning.file import save_sensor
from tomotactile_ros.learning.state import SensorState
from tomotactile_ros.reconstruction.calibration import fit_contact_law, load_calibration
from tomotactile_ros.scenes.channels import Channels, Rms, Uniform
from tomotactile_ros.scenes.contact import Contact, ContactLaw
from tomotactile_ros.scenes.defects import Defects
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.errors import InputError

TRUE = ContactLaw(3e-4, 0.8)


def run(command, *words):
    parser = ArgumentParser()
    command.add_arguments(parser)
    return command.run(parser.parse_args([str(word) for word in words]))


def test_fit_recovers_coefficient_and_exponent():
    forces, areas = np.array([0.5, 1.0, 3.0, 8.0]), np.array([8e-5, 8e-5, 1e-4, 2e-4])
    conductances = areas * TRUE.conductance(forces / areas)
    fit = fit_contact_law(forces, conductances, areas)
    assert fit.law.coefficient == pytest.approx(TRUE.coefficient)
    assert fit.law.exponent == pytest.approx(TRUE.exponent)
    assert fit.error < 1e-9
    known = fit_contact_law([1.0], conductances[1:2], areas[1:2], exponent=0.8)
    assert known.law.coefficient == pytest.approx(TRUE.coefficient)


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


@pytest.fixture(scope="module")
def presses(tmp_path_factory):
    """Files of simulated presses with 1 and 4 N under the law TRUE."""
    folder, layout = tmp_path_factory.mktemp("presses"), load_layout("equal-4x4")
    paths = []
    for force in (1.0, 4.0):
        pressure = force / (np.pi * 0.005**2)
        contact = Contact("disc", center=(0.02, -0.035), radius=0.005, pressure=pressure)
        scene = Scene("press", 3.3, [contact], TRUE)
        simulator = Simulator(layout, scene, "closed_form")
        paths.append(folder / f"press-{force:g}.npz")
        voltages = simulator.frame(0.0)[None]
        save_frames(paths[-1], layout, scene, voltages, simulator.grounded, np.zeros(1))
    return paths


def test_calibrate_finds_the_law_and_reconstruct_uses_it(tmp_path, presses, capsys):
    out = tmp_path / "calibration.yaml"
    run(calibrate, presses[0], f"{presses[1]}=4", "--layout", "equal-4x4", "--out", out)
    law = load_calibration(out)
    assert law.exponent == pytest.approx(TRUE.exponent, abs=0.1)
    result = tmp_path / "result.npz"
    run(
        reconstruct,
        presses[1],
        "--layout",
        "equal-4x4",
        "--profile",
        "accurate",
        "--calibration",
        out,
        "--out",
        result,
    )
    assert "1 frames" in capsys.readouterr().out
    with np.load(result) as content:
        ((contact,),) = json.loads(str(content["contacts"]))
        assert content["pressure"].shape == content["potential"].shape == (1, 40, 40)
        assert content["latency"].shape == (1,)
    assert contact["force"] == pytest.approx(4.0, rel=0.05)
    assert set(contact) == {
        *("x", "y", "force", "pressure", "area", "radius", "id", "age"),
        *("vx", "vy", "position_std", "force_std", "probability"),
    }


def test_a_learned_sensor_and_a_known_foot_make_one_press_enough(tmp_path):
    """Gains off by 5 %, 200 ohm to ground: the frames tell both, what was learned tells them better."""
    layout, wrong = load_layout("equal-4x4"), Channels(Rms(0.05, 1), None, Uniform(200, 100, 2))
    operator = SheetOperator(layout)
    known = SensorState.unknown(operator)
    numbers, mean = wrong.of(layout.electrodes), known.mean.copy()
    mean[known.slice("gain")] = numbers.gain
    mean[known.slice("resistance")] = numbers.ground_resistance
    known = replace(known.learned(mean, 1e-4 * known.covariance), touches=9)
    save_sensor(tmp_path / "sensor.yaml", layout, operator, known)
    contact = Contact("disc", center=(0.02, -0.035), radius=0.008, pressure=2e4)
    scene = Scene("press", 3.3, [contact], TRUE, defects=Defects(channels=wrong))
    simulator = Simulator(layout, scene, "closed_form")
    path, out, drawn = (tmp_path / name for name in ("press.npz", "law.yaml", "fit.png"))
    save_frames(path, layout, scene, simulator.frame(0.0)[None], simulator.grounded, np.zeros(1))
    words = [path, "--layout", "equal-4x4", "--out", out, "--exponent", "0.8"]
    laws = []
    for more in ([], ["--sensor", tmp_path / "sensor.yaml", "--foot-radius", "0.008"]):
        run(calibrate, *words, *more, "--picture", drawn)
        laws.append(load_calibration(out).coefficient / TRUE.coefficient - 1)
    assert abs(laws[0]) < 0.15 and abs(laws[1]) < 0.02  # one press alone hardly tells its width
    assert drawn.read_bytes().startswith(b"\x89PNG")
    with pytest.raises(InputError, match="foot_radius"):
        run(calibrate, *words, "--foot-radius", "-1")
