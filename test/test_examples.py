"""The examples run and do what they say."""

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from process_support import python

rclpy = pytest.importorskip("rclpy")

from ros_support import Process, ends_cleanly

from tomotactile_ros.msg import ContactArray
from tomotactile_ros.nodes.conversions import stamp_of

EXAMPLE = Path(__file__).resolve().parent.parent / "examples" / "press_from_mujoco.py"


def test_without_mujoco_the_example_says_what_to_install(tmp_path):
    (tmp_path / "mujoco.py").write_text("raise ImportError")
    search = os.pathsep.join([str(tmp_path), os.environ["PYTHONPATH"]])
    done = python(EXAMPLE, warm=False, env=dict(os.environ, PYTHONPATH=search))
    assert done.returncode == 1 and done.stdout == ""
    assert done.stderr.splitlines() == [
        "press_from_mujoco: MuJoCo is missing, install it with: python3 -m pip install mujoco"
    ]


def test_the_image_follows_a_finger_in_mujoco(probe, start, domain):
    pytest.importorskip("mujoco")
    driver = start("driver", {"scene": "live"})
    reconstruction = start("reconstruction", {"profile": "accurate"})
    touches = probe.listen(ContactArray, "touches", 100)
    contacts = probe.listen(ContactArray, "contacts", 100)
    finger = Process([sys.executable, str(EXAMPLE)], domain)
    try:
        probe.until(lambda: span(follows(touches, contacts)) > 0.06, "contacts that follow")
        assert "finger (" in finger.output and "sensor (" in finger.output
        ends_cleanly(finger)
    finally:
        finger.kill()
        print(finger.output)
    seen = len(contacts)
    probe.until(lambda: any(not c.contacts for c in contacts[seen:]), "release after its end")
    ends_cleanly(driver)
    ends_cleanly(reconstruction)


def follows(touches, contacts):
    """(N, 2) places of contacts that are where the finger was at their stamp, with its force."""
    pressed = [(stamp_of(m.header), m.contacts[0]) for m in touches if m.contacts]
    times = np.array([t for t, _ in pressed])
    places = []
    for message in contacts:
        stamp = stamp_of(message.header)
        if len(message.contacts) != 1 or not len(times) or not times[0] < stamp <= times[-1]:
            continue
        found, true = message.contacts[0], pressed[np.searchsorted(times, stamp) - 1][1]
        off = np.hypot(found.position.x - true.position.x, found.position.y - true.position.y)
        if off < 0.006 and abs(found.force / true.force - 1) < 0.4:
            places.append((found.position.x, found.position.y))
    return np.array(places).reshape(-1, 2)


def span(places):
    """Longest way between two of them along x or y, m."""
    return np.ptp(places, axis=0).max() if len(places) else 0.0
