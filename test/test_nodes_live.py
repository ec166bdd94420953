"""`make run`'s program: shows contacts near the truth, writes the picture, leaves nothing
behind."""

import os
import re
import signal
import time

import numpy as np
import pytest

rclpy = pytest.importorskip("rclpy")

from ros_checks import NEAR, PRESSED, write_scene
from ros_support import Process, processes_of, program

from tomotactile_ros.support.processes import Child, stop_all


def test_contacts_do_not_wait_for_an_image(domain, probe):
    from sensor_msgs.msg import Image
    from std_msgs.msg import Header

    from tomotactile_ros.layouts.layout import load_layout
    from tomotactile_ros.msg import ContactArray, VoltageFrame
    from tomotactile_ros.nodes.conversions import image_to_message, make_header
    from tomotactile_ros.nodes.listener import Listener

    rclpy.init(args=[], domain_id=domain)
    listener = Listener(10.0, load_layout("equal-8x8"))
    try:
        publishers = {
            kind: probe.node.create_publisher(kind, topic, 2)
            for kind, topic in (
                (VoltageFrame, "voltage_frame"),
                (Image, "pressure"),
                (ContactArray, "contacts"),
            )
        }

        def at(seconds) -> Header:
            return make_header(1000.0 + seconds, "skin")

        def shot(suits, *messages):
            """The first shot that suits, while the messages are sent again and again."""
            found = []

            def come():
                for message in messages:
                    publishers[type(message)].publish(message)
                rclpy.spin_once(listener, timeout_sec=0.05)
                found.extend(each for each in [listener.take()] if each and suits(each))
                return found

            probe.until(come, "shot")
            return found[-1]

        frame = VoltageFrame(header=at(2.0), sequence=20, layout_id="equal-8x8")
        contacts = ContactArray(header=at(2.1), state=ContactArray.VALID)
        bare = shot(lambda s: True, frame, contacts)
        assert bare.pressure is None and bare.scene_time == pytest.approx(2.1)
        image = image_to_message(np.full((3, 3), 7.0), at(2.0))
        whole = shot(lambda s: s.pressure is not None, frame, image, contacts)
        assert whole.pressure.max() == 7.0 and whole.image_age == pytest.approx(0.1)
    finally:
        listener.destroy_node()
        rclpy.shutdown()


def start_live(domain, folder, *words):
    return Process(
        [program("live"), "--scene", write_scene(folder), "--out", str(folder / "p.png"), *words],
        domain,
    )


def children_of(domain):
    return processes_of("driver", domain) + processes_of("reconstruction", domain)


def test_contacts_are_near_the_truth_and_the_picture_is_written(domain, tmp_path):
    from PIL import Image

    live = start_live(domain, tmp_path, "--duration", "3")
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


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_a_stop_is_clean_at_any_time(domain, tmp_path, number, probe):
    live = start_live(domain, tmp_path, "--duration", "600")
    probe.until(lambda: "contact " in live.output or not live.running(), "contact")
    assert live.stop(number) == 0, live.output
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


def test_a_picture_that_cannot_be_written_is_said(domain, tmp_path):
    (tmp_path / "file").touch()
    live = start_live(domain, tmp_path, "--duration", "0.5", "--out", str(tmp_path / "file/p.png"))
    assert live.wait() == 2
    assert "Traceback" not in live.output
    assert live.output.splitlines()[-1].startswith(
        f"live: {tmp_path}/file/p.png: cannot be written"
    )


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


def test_a_child_that_ignores_polite_signals_is_ended(monkeypatch):
    monkeypatch.setattr("tomotactile_ros.support.processes._PATIENCE", 0.2)
    stubborn = "trap '' INT TERM; echo ready; while :; do sleep 0.05; done"
    child = Child("stubborn", ["bash", "-c", stubborn])
    while child.last_words != "ready":
        time.sleep(0.01)
    stop_all([child])
    assert child.status == -signal.SIGKILL


def test_a_stop_while_ros_is_being_set_up_is_a_stop(monkeypatch, tmp_path):
    """SIGTERM takes the context away while rclpy makes its executor, which then fails."""
    from types import SimpleNamespace

    from tomotactile_ros.layouts.layout import load_layout
    from tomotactile_ros.nodes import listener, live
    from tomotactile_ros.scenes.scene import load_scene

    def interrupted(*_):
        rclpy.shutdown()
        raise RuntimeError("context is not valid")

    options = SimpleNamespace(profile="fast", rate=10.0, duration=1.0, out=str(tmp_path / "p.png"))
    scene = load_scene(write_scene(tmp_path))
    monkeypatch.setattr(live, "_show", interrupted)
    monkeypatch.setattr(listener, "Listener", lambda *_: None)
    assert live._watch([], load_layout("equal-8x8"), scene, options) == 0
    monkeypatch.setattr(live, "_show", lambda *_: 1 / 0)
    with pytest.raises(ZeroDivisionError):
        live._watch([], load_layout("equal-8x8"), scene, options)
