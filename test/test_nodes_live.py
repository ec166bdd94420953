"""`make run`'s program: shows contacts near the truth, writes the picture, leaves nothing
behind."""

import os
import re
import signal
import time

import numpy as np
import pytest

pytest.importorskip("rclpy")

from ros_checks import NEAR, PRESSED, write_scene
from ros_support import Process, processes_of, program

from tomotactile_ros.support.processes import Child, stop_all


def start_live(domain, folder, *words, warm=True):
    given = [
        "--layout",
        "equal-4x4",
        "--scene",
        write_scene(folder),
        "--out",
        str(folder / "p.png"),
    ]
    return Process([program("live"), *given, *words], domain, warm)


def children_of(domain):
    return processes_of("driver", domain) + processes_of("reconstruction", domain)


def test_contacts_are_near_the_truth_and_the_picture_is_written(domain, tmp_path):
    from PIL import Image

    live = start_live(domain, tmp_path, "--duration", "1", warm=False)
    assert live.wait() == 0, live.output
    strongest = re.findall(
        r"contact \d+: \( *(\S+), *(\S+)\) mm .* off by +(\S+) mm, true ", live.output
    )
    assert strongest, live.output
    for x, y, off in strongest:
        assert np.hypot(float(x) / 1e3 - PRESSED[0], float(y) / 1e3 - PRESSED[1]) < NEAR
        assert float(off) < 1e3 * NEAR
    assert "\x1b" not in live.output
    with Image.open(tmp_path / "p.png") as picture:
        assert min(picture.size) > 300
    assert not children_of(domain)


def test_a_stop_is_clean_at_any_time(domain, tmp_path, probe):
    live = start_live(domain, tmp_path, "--duration", "600")
    probe.until(lambda: "contact " in live.output or not live.running(), "contact")
    assert live.stop(signal.SIGTERM) == 0, live.output
    assert "Traceback" not in live.output
    assert (tmp_path / "p.png").exists()
    assert not children_of(domain)


def test_children_end_with_a_parent_that_is_killed(domain, tmp_path, probe):
    live = start_live(domain, tmp_path, "--duration", "600")
    probe.until(lambda: len(children_of(domain)) == 2 or not live.running(), "children")
    os.kill(live.pid, signal.SIGKILL)
    probe.until(lambda: not children_of(domain), "end of the children")


def test_a_child_that_ends_is_named_with_its_last_words(domain, tmp_path):
    live = start_live(domain, tmp_path, "--rate", "20000")
    assert live.wait() == 1
    last = live.output.splitlines()[-1]
    assert last.startswith("live: driver ended with status 2: ")
    assert "parameter rate" in last and "out of range" in last
    assert not children_of(domain)


@pytest.mark.parametrize(
    "words, reason",
    [
        (["--layout", "none"], "'none': no such file"),
        (["--scene", "none"], "'none': no such file"),
        (["--duration", "nan"], "--duration"),
        (["--duration", "-1"], "--duration"),
        (["--duration", "x"], "--duration"),
        (["--rate", "0"], "--rate"),
        (["--profile", "best"], "--profile"),
    ],
)
def test_bad_arguments_end_with_status_2_before_anything_starts(words, reason, capsys):
    from tomotactile_ros.nodes import live

    try:
        status = live.main(words)
    except SystemExit as exit_:
        status = exit_.code
    assert status == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert reason in line


@pytest.mark.parametrize("option", ["layout", "scene", "profile"])
def test_defaults_are_said_as_by_the_command_run(option, capsys):
    from tomotactile_ros import cli
    from tomotactile_ros.nodes import live

    said = []
    for show in (lambda: live.main(["--help"]), lambda: cli.main(["run", "--help"])):
        with pytest.raises(SystemExit):
            show()
        text = " ".join(capsys.readouterr().out.split("options:")[1].split())
        said.append(re.search(rf"--{option} .*?(default: [\w-]+)", text).group(1))
    assert said[0] == said[1]


def test_a_child_that_ignores_polite_signals_is_ended(monkeypatch):
    monkeypatch.setattr("tomotactile_ros.support.processes._PATIENCE", 0.2)
    stubborn = "trap '' INT TERM; echo ready; while :; do sleep 0.05; done"
    child = Child("stubborn", ["bash", "-c", stubborn])
    while child.last_words != "ready":
        time.sleep(0.01)
    stop_all([child])
    assert child.status == -signal.SIGKILL
