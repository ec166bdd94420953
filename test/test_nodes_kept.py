"""What the reconstruction keeps over a crash: the tare, which is undone, refused while frames are
stale and told of in diagnostics, and what it has learned of its sensor."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

import ros_checks
from ros_checks import LATCHED
from ros_support import ends_cleanly
from std_srvs.srv import Trigger
from test_learning import layout, simulator, truth

from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.msg import ContactArray, SensorState
from tomotactile_ros.reconstruction.tare_file import Tare

STATUS = "reconstruction: reconstruction"
LAYOUT = {"layout": "equal-4x4"}


def tare_is(probe, text: str) -> None:
    """The diagnostics say so of the tare, soon at least."""
    probe.until(lambda: text in ros_checks.figures_of(probe, STATUS).get("tare", ""), text)


def pressed(probe, wanted: bool) -> None:
    probe.wait_for(ContactArray, "/contacts", lambda m: bool(m.contacts) == wanted)


def files(tmp_path) -> list:
    return list((tmp_path / "ros").glob("tomotactile_ros/*.tare.npz"))


def test_a_tare_survives_a_crash_can_be_undone_and_is_not_of_stale_frames(probe, start, tmp_path):
    """Of a touch so light (40 mN) that a tare doubts, but does not refuse it."""
    light = tmp_path / "light.yaml"
    light.write_text(ros_checks.SCENE.replace("pressure: 20000.0", "pressure: 200.0"))
    driver = start("driver", {"scene": light, "rate": 30, **LAYOUT})
    first = start("reconstruction", LAYOUT)
    pressed(probe, True)
    tare_is(probe, "none")
    answer = probe.call(Trigger, "/reconstruction/tare")
    assert answer.success and "V is much for a sheet that nothing touches" in answer.message
    pressed(probe, False)
    first.kill()
    second = start("reconstruction", LAYOUT)
    tare_is(probe, "restored")
    pressed(probe, False)
    assert "restored from" in second.output
    answer = probe.call(Trigger, "/reconstruction/untare")
    assert answer.success and "zero is 0 V again" in answer.message
    pressed(probe, True)
    assert files(tmp_path) == []
    assert "there was no tare" in probe.call(Trigger, "/reconstruction/untare").message

    assert probe.call(Trigger, "/reconstruction/tare").success
    assert len(files(tmp_path)) == 1
    driver.kill()

    def refused():
        answer = probe.call(Trigger, "/reconstruction/tare")
        return not answer.success and "s old: " in answer.message

    probe.until(refused, "refusal")
    ends_cleanly(second)
    assert files(tmp_path) == []  # a clean end is no crash


def test_a_named_tare_is_kept_from_start_to_start(probe, start, tmp_path):
    file = tmp_path / "kept.npz"
    Tare(load_layout("equal-4x4").id, np.full((16, 16), 0.5), 16, 0.0, "another boot").save(file)
    reconstruction = start("reconstruction", {"tare_file": file, **LAYOUT})
    tare_is(probe, "16 frames at 1970-01-01")
    ends_cleanly(reconstruction)
    assert file.exists()


def test_a_file_that_is_no_tare_is_never_replaced_nor_removed(probe, start, tmp_path):
    """Whoever names a recording by mistake must not lose it to a service that anybody may call."""
    recording = tmp_path / "frames.npz"
    np.savez(recording, voltages=np.zeros((2, 16, 16)), grounded=np.arange(16))
    before = recording.read_bytes()
    start("driver", {"scene": "idle", "rate": 30, **LAYOUT})
    start("reconstruction", {"tare_file": recording, **LAYOUT})
    pressed(probe, False)
    answer = probe.call(Trigger, "/reconstruction/tare")
    assert answer.success and "is no file of a tare and stays as it is" in answer.message
    tare_is(probe, "frames at")
    assert probe.call(Trigger, "/reconstruction/untare").success
    assert recording.read_bytes() == before


def test_it_learns_publishes_and_keeps_what_it_knows(probe, start, tmp_path):
    def known():
        """What it has learned of three touches."""
        return probe.wait_for(SensorState, "/sensor_state", lambda m: m.touches >= 3, LATCHED)

    layout().save(tmp_path / "layout.yaml")
    simulator(60).scene.save(tmp_path / "scene.yaml")
    file = tmp_path / "sensor.yaml"
    common = {"layout": tmp_path / "layout.yaml"}
    start("driver", {**common, "scene": tmp_path / "scene.yaml", "rate": 10})
    own = {**common, "profile": "accurate", "resolution": 16, "sensor": file}
    first = start("reconstruction", {**own, "learn": "all"})
    message = known()
    ratio = np.array(message.gain) / truth().gain
    assert (ratio / ratio.mean()).std() < 1e-3
    assert message.layout_id == layout().id and len(message.places) == len(message.logarithm)
    evidence = dict(zip(message.unknown, message.evidence, strict=True))
    assert evidence["gains"] > 100 and evidence["gains"] > evidence["places"]
    assert message.radius == pytest.approx(layout().radius, rel=0.2) and not message.tears
    assert max(message.gain_deviation) < 0.02 and message.header.stamp.sec > 0
    probe.until(file.exists, "file of the sensor")
    first.kill()
    second = start("reconstruction", {**own, "learn": "off"})
    again = known()
    assert np.array(again.gain) == pytest.approx(message.gain, abs=2e-3)
    probe.wait_for(ContactArray, "/contacts", lambda m: m.state == m.VALID and len(m.contacts) == 1)
    ends_cleanly(second)
