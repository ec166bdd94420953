"""Live touches on a simulated sheet: what counts when, what is refused, from any thread."""

import threading
from dataclasses import replace

import numpy as np
import pytest
from devices_support import opened

from tomotactile_ros.devices.fake import FakeDevice
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.scenes.touches import HOLD, MOST, Touch, Touches
from tomotactile_ros.simulation import Simulator

LAYOUT = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
LIVE = replace(load_scene("live"), noise=None, adc=None)
ONE, OTHER = Touch(0.03, 0.02, 2.0, 0.006), Touch(-0.05, 0.0, 1.0, 0.008)


def assert_are(contacts, *touches):
    """These contacts are those of these touches, in this order."""
    found = [(*contact.center, contact.total_force, contact.radius) for contact in contacts]
    np.testing.assert_allclose(found, [(t.x, t.y, t.force, t.radius) for t in touches])


def test_a_message_replaces_all_and_holds_for_a_while():
    touches = Touches(LAYOUT)
    assert touches.at(0.0) == ()
    assert touches.press([ONE], 1.0) == [] == touches.press([OTHER, ONE], 1.2)
    assert touches.at(0.99) == ()
    assert_are(touches.at(1.0), ONE)
    assert_are(touches.at(1.1999), ONE)
    assert_are(touches.at(1.2), OTHER, ONE)
    assert len(touches.at(1.2 + 0.999 * HOLD)) == 2 and touches.at(1.2 + HOLD) == ()
    touches.press([], 1.3)
    assert touches.at(1.3) == () != touches.at(1.25)


FORCE = "touches[1]: force: "
BAD = [
    ({"x": 0.2}, "touches[1]: position: (0.2, 0.02) m is off the sheet"),
    ({"x": np.nan}, "touches[1]: center[0]: nan is not a finite position in m"),
    ({"force": -1.0}, FORCE + "-1.0 is negative, it must be 0 or a posit"),
    ({"force": np.nan}, FORCE + "nan is not a finite force in N"),
    ({"force": np.inf}, FORCE + "inf is not a finite force in N"),
    ({"radius": 0.0}, "touches[1]: radius: 0.0 is not a positive length in m"),
    ({"radius": 0.11}, "touches[1]: radius: 0.11 m is wider than the sheet"),
]


@pytest.mark.parametrize(("bad", "line"), BAD)
def test_a_bad_touch_gets_a_line_and_the_others_count(bad, line):
    touches = Touches(LAYOUT)
    (complaint,) = touches.press([ONE, replace(ONE, **bad), OTHER], 0.0)
    assert complaint.startswith(line) and "\n" not in complaint
    assert_are(touches.at(0.0), ONE, OTHER)


def test_a_touch_without_force_is_none_and_too_many_are_cut():
    touches = Touches(LAYOUT)
    assert touches.press([Touch(0, 0, 0.0, 0.0)], 0.0) == [] and touches.at(0.0) == ()
    (complaint,) = touches.press([ONE] * (MOST + 5), 0.1)
    assert complaint == f"touches: {MOST + 5} of them, only the first {MOST} are taken"
    assert len(touches.at(0.1)) == MOST


def test_a_live_frame_is_that_of_a_scene_with_the_same_contact():
    simulator = Simulator(LAYOUT, LIVE)
    simulator.live = Touches(LAYOUT)
    simulator.live.press([ONE], 1.0)
    contact = Contact("disc", (0.03, 0.02), radius=0.006, force=2.0)
    same = Simulator(LAYOUT, replace(LIVE, contacts=(contact,))).frame(0.0)
    np.testing.assert_allclose(simulator.frame(1.1), same)
    assert np.nanmax(simulator.frame(2.0)) == 0.0


def test_the_device_feels_touches_of_other_threads_and_forgets_them():
    device = FakeDevice(Simulator(LAYOUT, LIVE, "closed_form"), rate=200.0)
    watch = opened(device)
    stop = threading.Event()

    def peak() -> float:
        return np.nanmax(watch.frames[-1].voltages)

    def keep_pressing():
        while not stop.is_set():
            device.press([OTHER])

    threads = [threading.Thread(target=keep_pressing) for _ in range(2)]
    watch.wait_for_frames(1)
    (complaint,) = device.press([ONE, replace(ONE, x=9.0)])
    assert complaint == "touches[1]: position: (9, 0.02) m is off the sheet"
    watch.wait_for(lambda status: peak() > 0.3)
    watch.wait_for(lambda status: peak() == 0.0)  # nobody has said it again
    for thread in threads:
        thread.start()
    try:
        watch.wait_for(lambda status: peak() > 0.1)
        assert device.status().state == "streaming"
    finally:
        stop.set()
        for thread in threads:
            thread.join()
        device.close()


def test_a_scene_that_is_not_live_takes_no_touches():
    device = FakeDevice(Simulator(LAYOUT, replace(LIVE, live=False), "closed_form"))
    assert device.press([ONE]) == ["touches: the scene is not live, it takes none from outside"]
