"""The tare: kept over a crash, undone, refused while frames are stale, told of in diagnostics."""

import numpy as np
import pytest

pytest.importorskip("rclpy")

import ros_checks
from diagnostic_msgs.msg import DiagnosticArray
from ros_support import ends_cleanly
from std_srvs.srv import Trigger

from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.msg import ContactArray
from tomotactile_ros.reconstruction.tare_file import Tare

STATUS = "reconstruction: reconstruction"
LAYOUT = {"layout": "equal-4x4"}


def tare_is(probe, text: str) -> None:
    """Wait until the diagnostics say so of the tare."""
    probe.wait_for(
        DiagnosticArray,
        "/diagnostics",
        lambda m: any(
            v.key == "tare" and text in v.value
            for s in m.status
            if s.name == STATUS
            for v in s.values
        ),
    )


def pressed(probe, wanted: bool) -> None:
    probe.wait_for(ContactArray, "/contacts", lambda m: bool(m.contacts) == wanted)


@pytest.fixture
def light(tmp_path):
    """File of a scene with a touch so light (40 mN) that a tare doubts, but does not refuse it."""
    path = tmp_path / "light.yaml"
    path.write_text(ros_checks.SCENE.replace("pressure: 20000.0", "pressure: 200.0"))
    return str(path)


def files(tmp_path) -> list:
    return list((tmp_path / "ros").glob("tomotactile_ros/*.tare.npz"))


def test_a_tare_survives_a_crash_can_be_undone_and_is_not_of_stale_frames(
    probe, start, light, tmp_path
):
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


def test_a_named_tare_is_kept_from_start_to_start(probe, start, scene, tmp_path):
    file, layout = tmp_path / "kept.npz", load_layout("equal-4x4")
    Tare(layout.id, np.full((16, 16), 0.5), 16, 0.0, "another boot").save(file)
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
