"""The command line as its users meet it: what it writes, and a sensor without ROS that is emulated,
watched, recorded and shown."""

import json
import os
import re
import signal
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from process_support import python
from warm_start import begin

from tomotactile_ros import cli
from tomotactile_ros.commands import run as live
from tomotactile_ros.commands import watch
from tomotactile_ros.devices import Frame, Status, stream
from tomotactile_ros.devices.health import Health
from tomotactile_ros.devices.recording import load_recording, save_recording
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.simulation import Simulator

LAYOUT = load_layout("equal-4x4")
SMALL = "--layout", "equal-4x4"
SIMULATE = "simulate", *SMALL, "--scene", "default"


@pytest.fixture
def run(capsys):
    """The same as a process, without the second that it takes to begin."""

    def call(*words, status=0):
        assert cli.main([str(word) for word in words]) == status
        said = capsys.readouterr()
        return SimpleNamespace(stdout=said.out, stderr=said.err)

    return call


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    path = tmp_path_factory.mktemp("cli") / "frames.npz"
    done = python("-m", "tomotactile_ros.cli", *SIMULATE, "--frames", 3, "--out", path)
    assert done.returncode == 0, done.stderr
    return path


def test_simulate_writes_what_the_contract_says(frames):
    with np.load(frames, allow_pickle=False) as file:
        voltages, grounded, stamps = file["voltages"], file["grounded"], file["stamps"]
        truth = json.loads(str(file["truth"]))
    assert voltages.shape == (3, 16, 16) and grounded.tolist() == list(range(16))
    np.testing.assert_allclose(np.diff(stamps), 0.016)
    simulator = Simulator(LAYOUT, load_scene("default"))
    np.testing.assert_allclose(voltages[2], simulator.frame(stamps[2], 2), atol=1e-6)
    assert [len(contacts) for contacts in truth] == [2, 2, 2]
    assert set(truth[0][0]) == {"x", "y", "force", "pressure", "area", "radius"}


def test_simulate_writes_when_rows_were_taken(frames, tmp_path, run):
    with np.load(frames, allow_pickle=False) as file:
        assert file["row_period"].shape == () and file["row_period"] == 1e-3
        stamps, last = file["stamps"], json.loads(str(file["truth_last"]))
    scene = load_scene("default")
    assert last == [scene.truth(t + 15e-3) for t in stamps]
    assert "row i of a frame at its stamp + i x 1 ms" in run("inspect", frames).stdout
    out = tmp_path / "x.npz"
    for options, row_period, distance in [
        (("--row-period", 5e-4), 5e-4, 0.008),
        (("--rate", 250), 2.5e-4, 4e-3),
        (("--rate", 10), 1e-3, 0.1),
        (("--row-period", 0), 0.0, 0.016),
    ]:
        run(*SIMULATE, "--frames", 2, "--out", out, *options)
        with np.load(out, allow_pickle=False) as file:
            assert file["row_period"] == row_period
            np.testing.assert_allclose(np.diff(file["stamps"]), distance)
            assert ("truth_last" in file) == (row_period > 0)
    assert "rows of a frame all at once" in run("inspect", out).stdout


def test_reconstruct_writes_what_the_contract_says(frames, tmp_path, run):
    out = tmp_path / "result.npz"
    run("reconstruct", frames, *SMALL, "--profile", "fast", "--out", out)
    with np.load(out, allow_pickle=False) as file:
        assert file["pressure"].shape == file["potential"].shape == (3, 40, 40)
        assert file["latency"].shape == (3,)
        with np.load(frames) as taken:
            middle = 7.5 * float(taken["row_period"])
            assert np.allclose(file["stamps"], taken["stamps"] + middle)
        contacts = json.loads(str(file["contacts"]))
        others = json.loads(str(file["alternatives"]))
        assert not file["ambiguous"].any() and others == [[]] * 3
    assert len(contacts) == 3
    for contact in contacts[0]:
        figures = {"x", "y", "force", "pressure", "area", "radius"}
        certainty = {"position_std", "force_std", "probability"}
        assert set(contact) == figures | certainty | {"vx", "vy", "id", "age"}
        assert np.all(np.array(contact["position_std"]) > 0) and contact["force_std"] > 0
        assert 0.99 < contact["probability"] <= 1
    run("inspect", out)


@pytest.mark.parametrize("words", [(), ("--every-row",)])
def test_stamps_that_go_back_are_told_and_those_that_rise_are_not(frames, tmp_path, words, run):
    path, out = tmp_path / "changed.npz", tmp_path / "result.npz"
    with np.load(frames) as file:
        content = dict(file)
    said = []
    for set_back in (0.0, 7.0):
        content["stamps"] = 100.0 + np.array([0.0, 0.016, 0.032 - set_back])
        np.savez(path, **content)
        both = run("inspect", path), run("reconstruct", path, *SMALL, "--out", out, *words)
        said.append(" ".join(" ".join(each.stdout for each in both).split()))
    told = "stamps: 1 of 3 frames are not later than the one before, the first is frame 2, 6.98 s"
    assert "not later" not in said[0] and said[1].count(told) == 2
    with np.load(out) as file:
        ids = [{contact["id"] for contact in each} for each in json.loads(str(file["contacts"]))]
    frame = len(ids) // 3  # or the rows of one
    before, after = set().union(*ids[: 2 * frame]), set().union(*ids[2 * frame :])
    assert before and after and not before & after


def test_evaluate_gives_every_figure_in_m_and_in_percent_of_the_side(run):
    content = json.loads(run("evaluate", *SMALL, "--resolution", 12, "--json").stdout)
    assert content["side"] == 0.2 and len(content["regions"]) == 9
    for key in ("hwhm", "position_error"):
        figures, percent = content["metrics"][key], content["percent"][key]
        pairs = [(figures[name], percent[name]) for name in ("mean", "worst_tenth", "worst")]
        pairs += [(region[key], region["percent"][key]) for region in content["regions"]]
        for metres, of_the_side in pairs:
            assert of_the_side == pytest.approx(100 * metres / 0.2)


def test_inspect_draws_the_y_axis_upwards_noise_dark_and_readings_bright(tmp_path, run):
    scene = tmp_path / "corner.yaml"
    scene.write_text(
        "format: tomotactile-scene/1\ndrive_voltage: 3.3\ncontacts:\n"
        "  - {shape: disc, center: [0.08, 0.08], radius: 0.01, pressure: 1000.0}\n"
    )
    lines = [line for line in run("inspect", scene).stdout.splitlines() if line.startswith("    ")]
    marked = [i for i, line in enumerate(lines) if "#" in line]
    assert max(marked) < len(lines) / 2 and lines[marked[0]].index("#") > len(lines[0]) / 2
    noise = 1e-3 * np.random.default_rng(1).standard_normal((2, 16, 16))
    for readings, shown in ((noise, False), (noise + 0.03 * np.eye(16), True)):
        np.savez(tmp_path / "frames.npz", voltages=readings.astype(np.float32))
        picture = run("inspect", tmp_path / "frames.npz").stdout.split("bright = 0.06 V:")[1]
        assert any(c in picture.split("  nothing")[0] for c in "=+*#%@") == shown


@pytest.mark.parametrize("words", ["inspect equal-8x8", "--help", "run --help"])
def test_a_reader_that_has_enough_ends_the_command_quietly(words):
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as closed:
        done = python("-m", "tomotactile_ros.cli", *words.split(), stdout=closed)
    assert done.returncode == 128 + signal.SIGPIPE and done.stderr == ""


@pytest.mark.parametrize(
    "words",
    [
        ("reconstruct", "F", "--layout", "L", "--out", "F"),
        ("reconstruct", "F", "--layout", "L", "--out", "LINK"),
        ("learn", "F", "F", "--layout", "L", "--out", "L"),
        ("calibrate", "F=1.0", "--layout", "L", "--out", "L"),
        ("tare", "--layout", "L", "--recording", "F", "--out", "F"),
        ("optimize", "--layout", "L", "--out", "L"),
    ],
)
def test_nothing_is_written_over_what_is_read(frames, tmp_path, words, run):
    """A slip of the hand does not cost a recording, also not by another name of its file."""
    mine = tmp_path / "mine.npz"
    mine.write_bytes(frames.read_bytes())
    (tmp_path / "link.npz").symlink_to(mine)
    layout = tmp_path / "layout.yaml"
    LAYOUT.save(layout)
    before = mine.read_bytes(), layout.read_bytes()
    names = {"F": mine, "L": layout, "LINK": tmp_path / "link.npz", "F=1.0": f"{mine}=1.0"}
    told = run(*(names.get(word, word) for word in words), status=2)
    assert "take another name" in told.stderr
    assert (mine.read_bytes(), layout.read_bytes()) == before


def test_frames_of_a_pressed_sheet_are_no_tare(frames, run):
    """They would take the contact off all that follows, and nothing would be seen of it."""
    words = "--recording", frames, "--tare", frames, "--duration", 1
    assert "something presses on the sheet" in run("run", *SMALL, *words, status=2).stderr


@contextmanager
def emulated(*words):
    """`tomotactile emulate` in a process of its own; the port that it prints."""
    command = [sys.executable, "-m", "tomotactile_ros.cli", "emulate", "--layout", "equal-4x4"]
    process = begin([*command, *words], stdout=subprocess.PIPE, text=True)
    try:
        yield process.stdout.readline().strip()
        process.send_signal(signal.SIGINT)
        assert process.wait(30) == 0
    finally:
        process.kill()
        process.wait()
        process.stdout.close()


def frames_of(scene, number=4):
    simulator = Simulator(LAYOUT, load_scene(scene), "closed_form")
    return [
        Frame(simulator.frame(0.1 * n, n).astype(np.float32), simulator.grounded, n, 0.1 * n, 3.3)
        for n in range(number)
    ]


def test_a_sensor_on_a_port_is_watched_recorded_and_shown(tmp_path, run, monkeypatch):
    # only how long a broken program may take to fail
    monkeypatch.setattr(stream, "PATIENCE", 300.0)
    out, picture = tmp_path / "frames.npz", tmp_path / "last.png"
    with emulated("--scene", "two-points", "--rate", "50", "--port", "tcp:0") as port:
        sensor = *SMALL, "--port", port
        watched = r"(streaming|late) +\d+\.\d frames/s  .* V, median"
        assert re.search(watched, run("watch", *sensor, "--duration", 1.2).stdout)
        recorded = run("record", *sensor, "--frames", 5, "--out", out).stdout
        assert f"{out}: 5 frames of equal-4x4 from {port}" in recorded
        shown = run("run", *sensor, "--duration", 0.1, "--out", picture).stdout
    assert "contact" in shown and " N" not in shown  # nobody has calibrated it
    assert picture.read_bytes().startswith(b"\x89PNG")
    recorded = load_recording(out, LAYOUT)
    assert recorded.voltages.shape == (5, 16, 16) and recorded.row_period > 0
    run("run", *SMALL, "--recording", out)


@pytest.mark.parametrize("floating", [[], [6], [3, 9], list(range(16))])
def test_watch_names_the_electrode_that_is_not_grounded(floating):
    """All electrodes at a star of resistors: half the drive, but for rows in which nothing is grounded."""
    health, readings = Health(), np.full((16, 16), 1.65, np.float32)
    readings[floating] = 3.3
    np.fill_diagonal(readings, np.nan)
    health.frame_delivered(readings, 3.3, None)
    status = Status("streaming", "", {"rate_seen": 1.0}, (), health.troubles())
    text = watch.line(1.0, status, [Frame(readings, np.arange(16), 0, 0.0, 3.3)], LAYOUT)
    assert ("all readings are the same" in text) == (len(floating) == 16)
    told = f"while electrode {', '.join(map(str, floating))} should be grounded"
    assert (told in text) == (len(floating) in (1, 2))
    assert "should be grounded" not in text or told in text


@pytest.mark.parametrize(("profile", "after"), [("fast", 7.5), ("accurate", 15.0)])
def test_truth_is_that_of_the_time_for_which_contacts_hold(profile, after):
    """Of 16 rows, 1 s apart, a time in which any machine is ready: the middle where they are taken for
    one state, else the last."""
    (frame,) = frames_of("idle", 1)
    first = replace(frame, row_period=1.0)
    frames = [first, replace(first, sequence=1, stamp=20.0)]

    class Stream:
        ended = property(lambda self: not frames)

        def take(self, newest):
            return frames.pop(0)

    pipeline = Pipeline(LAYOUT, Settings(profile))
    times = [shot.scene_time for shot in live.shots(Stream(), pipeline, None)]
    assert times == pytest.approx([after, 20.0 + after])


def test_a_tare_is_taken_off_and_never_under_load(tmp_path, run):
    recording, out, result = (tmp_path / f"{name}.npz" for name in ("idle", "tare", "result"))
    offset = np.linspace(0.0, 0.02, 16, dtype=np.float32)
    idle, pressed = frames_of("idle"), frames_of("default")
    worn = [replace(frame, voltages=frame.voltages + offset) for frame in idle]
    save_recording(recording, LAYOUT, worn)
    words = "tare", *SMALL, "--out", out, "--recording", recording
    run(*words)
    for tare, contacts in ((["--tare", out], "[[], [], [], []]"), ([], None)):
        run("reconstruct", recording, *SMALL, *tare, "--out", result)
        with np.load(result) as file:
            assert (str(file["contacts"]) == contacts) == bool(tare)
    for frames, why in ((pressed, "presses"), ([*idle, *pressed], "moves")):
        save_recording(recording, LAYOUT, frames)
        assert f"something {why} on the sheet" in run(*words, status=2).stderr


def test_watch_ends_where_no_frame_comes_and_says_where_a_name_is_looked_for(
    tmp_path, run, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "skin").touch()
    monkeypatch.setattr(watch, "_PATIENCE", 0.5)
    said = run("watch", *SMALL, "--port", "skin", "--duration", 1, status=2)
    assert "no frame has come" in said.stderr
    assert "/dev/skin does not exist" in said.stdout and "write ./skin" in said.stdout


def test_a_shell_completes_options_and_their_values():
    pytest.importorskip("argcomplete")
    line = "tomotactile reconstruct --profile bal"
    asked = {"_ARGCOMPLETE": "1", "COMP_LINE": line, "COMP_POINT": str(len(line))}
    program = "import os, sys; os.dup2(1, 8); from tomotactile_ros.cli import main; main()"
    assert python("-c", program, env={**os.environ, **asked}).stdout.strip() == "balanced"
