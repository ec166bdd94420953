"""What people look at: `make run`'s program, which writes a picture and leaves nothing behind, and
the node `viewer` in a real browser."""

import math
import os
import re
import signal
import time

import numpy as np
import pytest

pytest.importorskip("rclpy")

from browser_support import Tab, browser
from ros_checks import NEAR, PRESSED, write_scene
from ros_support import ends_cleanly, processes_of, program

from tomotactile_ros import cli
from tomotactile_ros.nodes import live
from tomotactile_ros.support.processes import Child, stop_all


@pytest.fixture
def start_live(spawn, tmp_path):
    """Starts the program with a scene of one contact, and a picture p.png to write."""
    given = "--layout", "equal-4x4", "--scene", write_scene(tmp_path), "--out", tmp_path / "p.png"
    return lambda *words, warm=True: spawn(program("live"), *given, *words, warm=warm)


def children_of(domain):
    return processes_of("driver", domain) + processes_of("reconstruction", domain)


def test_contacts_are_near_the_truth_and_the_picture_is_written(domain, tmp_path, start_live):
    from PIL import Image

    process = start_live("--duration", "1", warm=False)
    assert process.wait() == 0, process.output
    said = r"contact \d+: \( *(\S+), *(\S+)\) mm .* off by +(\S+) mm, true "
    strongest = re.findall(said, process.output)
    assert strongest, process.output
    for x, y, off in strongest:
        assert np.hypot(float(x) / 1e3 - PRESSED[0], float(y) / 1e3 - PRESSED[1]) < NEAR
        assert float(off) < 1e3 * NEAR
    assert "\x1b" not in process.output
    with Image.open(tmp_path / "p.png") as picture:
        assert min(picture.size) > 300
    assert not children_of(domain)


def test_a_stop_is_clean_at_any_time(domain, tmp_path, probe, start_live):
    process = start_live("--duration", "600")
    probe.until(lambda: "contact " in process.output or not process.running(), "contact")
    assert process.stop(signal.SIGTERM) == 0, process.output
    assert "Traceback" not in process.output
    assert (tmp_path / "p.png").exists()
    assert not children_of(domain)


def test_children_end_with_a_parent_that_is_killed(domain, probe, start_live):
    process = start_live("--duration", "600")
    probe.until(lambda: len(children_of(domain)) == 2 or not process.running(), "children")
    os.kill(process.pid, signal.SIGKILL)
    probe.until(lambda: not children_of(domain), "end of the children")


def test_a_child_that_ends_is_named_with_its_last_words(domain, start_live):
    process = start_live("--rate", "20000")
    assert process.wait() == 1
    last = process.output.splitlines()[-1]
    assert last.startswith("live: driver ended with status 2: ")
    assert "parameter rate" in last and "out of range" in last
    assert not children_of(domain)


@pytest.mark.parametrize(
    "words, reason",
    [
        ("--layout none", "'none': no such file"),
        ("--duration nan", "--duration"),
        ("--profile best", "--profile"),
    ],
)
def test_bad_arguments_end_with_status_2_before_anything_starts(words, reason, mistake):
    assert reason in mistake(words, live.main)


def test_defaults_are_said_as_by_the_command_run(capsys):
    said = []
    for main, words in ((live.main, ["--help"]), (cli.main, ["run", "--help"])):
        with pytest.raises(SystemExit):
            main(words)
        text = " ".join(capsys.readouterr().out.split("options:")[1].split())
        options = re.findall(r"--(layout|scene|profile) .*?(default: [\w-]+)", text)
        said.append(dict(options))
    assert said[0] == said[1] and len(said[0]) == 3


def test_a_child_that_ignores_polite_signals_is_ended(monkeypatch):
    monkeypatch.setattr("tomotactile_ros.support.processes._PATIENCE", 0.2)
    stubborn = "trap '' INT TERM; echo ready; while :; do sleep 0.05; done"
    child = Child("stubborn", ["bash", "-c", stubborn])
    while child.last_words != "ready":
        time.sleep(0.01)
    stop_all([child])
    assert child.status == -signal.SIGKILL


@pytest.mark.skipif(browser() is None, reason="no Chromium is installed")
def test_two_sensors_are_seen_by_their_topics(probe, start, scene):
    pytest.importorskip("viser", reason="viser is not installed")
    both = {"sensors": "[left, right]"}
    start("sensors", {**both, "scene": scene, "layout": "equal-4x4", "rate": 10.0})
    viewer = start("viewer", {**both, "port": 0}, warm=False)
    address = re.compile(r"the page is (http://127\.0\.0\.1:\d+)")
    probe.until(lambda: address.search(viewer.output), "address of the page")
    tab = Tab(address.search(viewer.output)[1])
    try:
        tab.says("/left")
        tab.says("/right")
        tab.until(lambda: len(tab.contacts()) == 2, "contact of each")
        assert tab.text().index("/left") < tab.text().index("/right")
        for _, place, *_ in tab.contacts():
            found = [1e-3 * float(each) for each in place.split(",")]
            assert math.dist(found, PRESSED) < NEAR
    finally:
        tab.close()
    ends_cleanly(viewer)
