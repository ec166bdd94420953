"""A sensor without ROS: emulate, watch, record, tare and run, as a person uses them."""

import os
import re
import signal
import subprocess
import sys
from contextlib import contextmanager
from dataclasses import replace

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


def test_a_sensor_on_a_port_is_watched_recorded_and_shown(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(
        stream, "PATIENCE", 300.0
    )  # only how long a broken program may take to fail
    sensor = ["--layout", "equal-4x4"]
    out, picture = tmp_path / "frames.npz", tmp_path / "last.png"
    with emulated("--scene", "two-points", "--rate", "50", "--port", "tcp:0") as port:
        sensor += ["--port", port]
        assert cli.main(["watch", *sensor, "--duration", "1.2"]) == 0
        assert re.search(
            r"(streaming|late) +\d+\.\d frames/s  .* V, median", capsys.readouterr().out
        )
        assert cli.main(["record", *sensor, "--frames", "5", "--out", str(out)]) == 0
        assert f"{out}: 5 frames of equal-4x4 from {port}" in capsys.readouterr().out
        assert cli.main(["run", *sensor, "--duration", "0.1", "--out", str(picture)]) == 0
    shown = capsys.readouterr().out
    assert "contact" in shown and " N" not in shown  # nobody has calibrated it
    assert picture.read_bytes().startswith(b"\x89PNG")
    recorded = load_recording(out, LAYOUT)
    assert recorded.voltages.shape == (5, 16, 16) and recorded.row_period > 0
    assert cli.main(["run", "--layout", "equal-4x4", "--recording", str(out)]) == 0


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


@pytest.mark.parametrize(("profile", "after"), [("fast", 0.075), ("accurate", 0.15)])
def test_truth_is_that_of_the_time_for_which_contacts_hold(profile, after):
    """Of 16 rows, 10 ms apart: the middle where they are taken for one state, else the last."""
    (frame,) = frames_of("idle", 1)
    first = replace(frame, row_period=0.01)
    frames = [first, replace(first, sequence=1, stamp=0.2)]

    class Stream:
        ended = property(lambda self: not frames)

        def take(self, newest):
            return frames.pop(0)

    pipeline = Pipeline(LAYOUT, Settings(profile))
    times = [shot.scene_time for shot in live.shots(Stream(), pipeline, None)]
    assert times == pytest.approx([after, 0.2 + after])


def test_a_tare_is_taken_off_and_never_under_load(tmp_path, capsys):
    recording, out = tmp_path / "idle.npz", tmp_path / "tare.npz"
    offset = np.linspace(0.0, 0.02, 16, dtype=np.float32)
    idle = [
        Frame(f.voltages + offset, f.grounded, f.sequence, f.stamp, 3.3) for f in frames_of("idle")
    ]
    save_recording(recording, LAYOUT, idle)
    words = ["tare", "--layout", "equal-4x4", "--out", str(out)]
    assert cli.main([*words, "--recording", str(recording)]) == 0
    result = tmp_path / "result.npz"
    for tare, contacts in ((["--tare", str(out)], "[[], [], [], []]"), ([], None)):
        command = ["reconstruct", str(recording), "--layout", "equal-4x4", *tare]
        assert cli.main([*command, "--out", str(result)]) == 0
        with np.load(result) as file:
            assert (str(file["contacts"]) == contacts) == bool(tare)
    save_recording(recording, LAYOUT, frames_of("default"))
    assert cli.main([*words, "--recording", str(recording)]) == 2
    assert "something presses on the sheet" in capsys.readouterr().err
    save_recording(recording, LAYOUT, [*frames_of("idle"), *frames_of("default")])
    assert cli.main([*words, "--recording", str(recording)]) == 2
    assert "something moves on the sheet" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("words", "complaint"),
    [
        (["record", "--port", "spy:///x", "--out", "x.npz"], "is none of /dev/"),
        (["record", "--port", "/etc/passwd", "--out", "x.npz"], "/etc/passwd is no device"),
        (["record", "--frames", "0", "--out", "x.npz"], "0 is not a whole number above 0"),
        (["record", "--scene", "idle", "--port", "x", "--out", "x.npz"], "not allowed with"),
        (["watch", "--port", ""], "argument --port: is empty; leave it out"),
        (["tare", "--scene", "idle", "--out", ""], "argument --out: is empty"),
        (["watch", "--recording", "nowhere.npz"], "nowhere.npz: no such recording"),
        (["run", "--out", "x.txt"], "x.txt: this file is written as .png"),
        (["tare", "--out", "tare"], "tare: this file is written as .npz; call it tare.npz"),
        (["record", "--out", "x.csv"], "call it x.npz"),
        (["simulate", "--scene", "idle", "--frames", "1", "--out", "x.csv"], "call it x.npz"),
        (["layout", "--rows", "3", "--cols", "3", "--out", "x.json"], "x.yaml"),
        (["calibrate", "x=1", "--out", "x.npz"], "call it x.yaml"),
    ],
)
def test_mistakes_end_with_one_line(words, complaint, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    if words[0] != "layout":
        words = [words[0], *words[1:], "--layout", "equal-4x4"]
    try:
        status = cli.main(words)
    except SystemExit as exit_:
        status = exit_.code
    (line,) = capsys.readouterr().err.strip().splitlines()
    assert status == 2 and complaint in line
    assert not list(tmp_path.iterdir())


def test_watch_ends_where_no_frame_comes_and_says_where_a_name_is_looked_for(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "skin").touch()
    monkeypatch.setattr(watch, "_PATIENCE", 0.5)
    words = "--layout", "equal-4x4", "--port", "skin", "--duration", "1"
    assert cli.main(["watch", *words]) == 2
    said = capsys.readouterr()
    assert "no frame has come" in said.err
    assert "/dev/skin does not exist" in said.out and "write ./skin" in said.out


def test_a_shell_completes_options_and_their_values():
    pytest.importorskip("argcomplete")
    line = "tomotactile reconstruct --profile bal"
    environment = {
        **os.environ,
        "_ARGCOMPLETE": "1",
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    program = "import os, sys; os.dup2(1, 8); from tomotactile_ros.cli import main; main()"
    assert python("-c", program, env=environment).stdout.strip() == "balanced"
