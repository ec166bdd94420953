"""The command line as its users meet it: a process, an exit status, a line for every mistake."""

import io
import json
import os
import signal
import subprocess
from contextlib import redirect_stderr, redirect_stdout

import numpy as np
import pytest
from process_support import python

from tomotactile_ros import cli
from tomotactile_ros.cli import COMMANDS
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.simulation import Simulator


def run(*words):
    """The same as a process, without the second that it takes to begin."""
    said, told = (io.TextIOWrapper(io.BytesIO(), encoding="utf-8") for _ in range(2))
    with redirect_stdout(said), redirect_stderr(told):
        try:
            status = cli.main([str(word) for word in words])
        except SystemExit as end:
            status = end.code
    for each in (said, told):
        each.seek(0)
    return subprocess.CompletedProcess(words, status, said.read(), told.read())


@pytest.fixture(scope="module")
def frames(tmp_path_factory):
    path = tmp_path_factory.mktemp("cli") / "frames.npz"
    layout, scene = ("--layout", "equal-4x4"), ("--scene", "default")
    done = python(
        "-m", "tomotactile_ros.cli", "simulate", *layout, *scene, "--frames", 3, "--out", path
    )
    assert done.returncode == 0, done.stderr
    return path


def test_simulate_writes_what_the_contract_says(frames):
    with np.load(frames, allow_pickle=False) as file:
        voltages, grounded, stamps = file["voltages"], file["grounded"], file["stamps"]
        truth = json.loads(str(file["truth"]))
    assert voltages.shape == (3, 16, 16) and grounded.tolist() == list(range(16))
    np.testing.assert_allclose(np.diff(stamps), 0.016)
    simulator = Simulator(load_layout("equal-4x4"), load_scene("default"))
    np.testing.assert_allclose(voltages[2], simulator.frame(stamps[2], 2), atol=1e-6)
    assert [len(contacts) for contacts in truth] == [2, 2, 2]
    assert set(truth[0][0]) == {"x", "y", "force", "pressure", "area", "radius"}


def test_simulate_writes_when_rows_were_taken(frames, tmp_path):
    with np.load(frames, allow_pickle=False) as file:
        assert file["row_period"].shape == () and file["row_period"] == 1e-3
        stamps, last = file["stamps"], json.loads(str(file["truth_last"]))
    scene = load_scene("default")
    assert last == [scene.truth(t + 15e-3) for t in stamps]
    assert "row i of a frame at its stamp + i x 1 ms" in run("inspect", frames).stdout
    out, common = tmp_path / "x.npz", ("simulate", "--layout", "equal-4x4", "--scene", "default")
    for options, row_period, distance in [
        (("--row-period", 0), 0.0, 0.016),
        (("--row-period", 5e-4), 5e-4, 0.008),
        (("--rate", 250), 2.5e-4, 4e-3),
        (("--rate", 10), 1e-3, 0.1),
    ]:
        done = run(*common, "--frames", 2, "--out", out, *options)
        assert done.returncode == 0, done.stderr
        with np.load(out, allow_pickle=False) as file:
            assert file["row_period"] == row_period
            np.testing.assert_allclose(np.diff(file["stamps"]), distance)
            assert ("truth_last" in file) == (row_period > 0)
    run(*common, "--frames", 1, "--out", out, "--row-period", 0)
    assert "rows of a frame all at once" in run("inspect", out).stdout


def test_reconstruct_writes_what_the_contract_says(frames, tmp_path):
    out = tmp_path / "result.npz"
    done = run("reconstruct", frames, "--layout", "equal-4x4", "--profile", "fast", "--out", out)
    assert done.returncode == 0, done.stderr
    with np.load(out, allow_pickle=False) as file:
        assert file["pressure"].shape == file["potential"].shape == (3, 40, 40)
        assert file["latency"].shape == (3,)
        with np.load(frames) as taken:
            middle = 7.5 * float(taken["row_period"])
            assert np.allclose(file["stamps"], taken["stamps"] + middle)
        contacts = json.loads(str(file["contacts"]))
    assert len(contacts) == 3
    for contact in contacts[0]:
        figures = {"x", "y", "force", "pressure", "area", "radius"}
        certainty = {"position_std", "force_std", "probability"}
        assert set(contact) == figures | certainty | {"vx", "vy", "id", "age"}
        assert np.all(np.array(contact["position_std"]) > 0) and contact["force_std"] > 0
        assert 0.99 < contact["probability"] <= 1
    assert run("inspect", out).returncode == 0


@pytest.mark.parametrize("words", [(), ("--every-row",)])
def test_stamps_that_go_back_are_told_and_those_that_rise_are_not(frames, tmp_path, words, capsys):
    with np.load(frames) as file:
        content = dict(file)
    said = []
    for set_back in (0.0, 7.0):
        content["stamps"] = 100.0 + np.array([0.0, 0.016, 0.032 - set_back])
        path, out = tmp_path / "changed.npz", tmp_path / "result.npz"
        np.savez(path, **content)
        cli.main(["inspect", str(path)])
        cli.main(["reconstruct", str(path), "--layout", "equal-4x4", "--out", str(out), *words])
        said.append(capsys.readouterr().out)
    told = "stamps: 1 of 3 frames are not later than the one before, the first is frame 2, 6.98 s"
    assert "not later" not in said[0] and " ".join(said[1].split()).count(told) == 2
    with np.load(out) as file:
        ids = [{contact["id"] for contact in each} for each in json.loads(str(file["contacts"]))]
    frame = len(ids) // 3  # or the rows of one
    before, after = set().union(*ids[: 2 * frame]), set().union(*ids[2 * frame :])
    assert before and after and not before & after


def test_evaluate_gives_every_figure_in_m_and_in_percent_of_the_side():
    done = run("evaluate", "--layout", "equal-4x4", "--resolution", 12, "--json")
    assert done.returncode == 0, done.stderr
    content = json.loads(done.stdout)
    assert content["side"] == 0.2 and len(content["regions"]) == 9
    for key in ("hwhm", "position_error"):
        for value in ("mean", "worst_tenth", "worst"):
            percent = content["percent"][key][value]
            assert percent == pytest.approx(100 * content["metrics"][key][value] / 0.2)
        for region in content["regions"]:
            assert region["percent"][key] == pytest.approx(100 * region[key] / 0.2)


def test_inspect_draws_the_y_axis_upwards(tmp_path):
    scene = tmp_path / "corner.yaml"
    scene.write_text(
        "format: tomotactile-scene/1\ndrive_voltage: 3.3\ncontacts:\n"
        "  - {shape: disc, center: [0.08, 0.08], radius: 0.01, pressure: 1000.0}\n"
    )
    lines = [line for line in run("inspect", scene).stdout.splitlines() if line.startswith("    ")]
    marked = [i for i, line in enumerate(lines) if "#" in line]
    assert max(marked) < len(lines) / 2 and lines[marked[0]].index("#") > len(lines[0]) / 2


def test_inspect_draws_noise_dark_and_readings_bright(tmp_path, capsys):
    noise = 1e-3 * np.random.default_rng(1).standard_normal((2, 16, 16))
    for readings, shown in ((noise, False), (noise + 0.03 * np.eye(16), True)):
        np.savez(tmp_path / "frames.npz", voltages=readings.astype(np.float32))
        assert cli.main(["inspect", str(tmp_path / "frames.npz")]) == 0
        picture = capsys.readouterr().out.split("bright = 0.06 V:")[1]
        assert any(c in picture.split("  nothing")[0] for c in "=+*#%@") == shown


SIMULATE = "simulate --layout equal-4x4"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        ("simulate --layout nowhere --scene default --frames 1", "nowhere"),
        (f"{SIMULATE} --scene defects --frames 1", "equal-4x4"),
        (f"{SIMULATE} --scene idle --frames 0", "--frames"),
        (f"{SIMULATE} --scene idle --frames 1 --rate 0", "--rate"),
        ("evaluate --layout equal-4x4 --profile fast --model fem", "--model"),
        ("optimize --layout equal-4x4 --rows 4 --method free --out x", "--rows"),
        ("dance", "dance"),
        ("", "COMMAND"),
    ],
)
def test_bad_input_is_one_line_and_exit_2(words, said, tmp_path):
    words = words.split()
    if "simulate" in words:
        words += ["--out", tmp_path / "out.npz"]
    done = run(*words)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1 and said in done.stderr and "Traceback" not in done.stderr


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"layout_id": "equal-8x8"}, "layout_id"),
        ({"contact_law": ["a", "b"]}, "contact_law"),
        ({"voltages": np.full((3, 16, 16), np.inf)}, "voltages: one of frame 0 is infinite"),
        ({"grounded": np.zeros(3, int)}, "grounded"),
    ],
)
def test_frames_that_are_none_are_refused(frames, tmp_path, changed, said):
    with np.load(frames) as file:
        np.savez(tmp_path / "bad.npz", **{**file, **changed})
    bad, out = tmp_path / "bad.npz", tmp_path / "r"
    done = run("reconstruct", bad, "--layout", "equal-4x4", "--out", out)
    assert done.returncode == 2
    assert done.stderr.count("\n") == 1 and f"bad.npz: {said}" in done.stderr


def test_a_reader_that_has_enough_ends_the_command_quietly():
    read, write = os.pipe()
    os.close(read)
    with os.fdopen(write, "w") as closed:
        done = python("-m", "tomotactile_ros.cli", "inspect", "equal-8x8", stdout=closed)
    assert done.returncode == 128 + signal.SIGPIPE and done.stderr == ""


@pytest.mark.parametrize("name", COMMANDS)
def test_every_command_has_help(name, capsys):
    with pytest.raises(SystemExit) as end:
        cli.main([name, "--help"])
    assert end.value.code == 0
    assert capsys.readouterr().out.startswith(f"usage: tomotactile {name} ")


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
def test_nothing_is_written_over_what_is_read(frames, tmp_path, words, capsys):
    """A slip of the hand does not cost a recording, also not by another name of its file."""
    mine = tmp_path / "mine.npz"
    mine.write_bytes(frames.read_bytes())
    (tmp_path / "link.npz").symlink_to(mine)
    layout = tmp_path / "layout.yaml"
    load_layout("equal-4x4").save(layout)
    before = mine.read_bytes(), layout.read_bytes()
    names = {"F": mine, "L": layout, "LINK": tmp_path / "link.npz", "F=1.0": f"{mine}=1.0"}
    assert cli.main([str(names.get(word, word)) for word in words]) == 2
    assert "take another name" in capsys.readouterr().err
    assert (mine.read_bytes(), layout.read_bytes()) == before


def test_frames_of_a_pressed_sheet_are_no_tare(frames, capsys):
    """They would take the contact off all that follows, and nothing would be seen of it."""
    words = ["run", "--layout", "equal-4x4", "--recording", frames, "--tare", frames]
    assert cli.main([*map(str, words), "--duration", "1"]) == 2
    assert "something presses on the sheet" in capsys.readouterr().err
