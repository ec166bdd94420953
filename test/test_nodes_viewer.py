"""The node `viewer`: two sensors that others publish, seen in a real browser."""

import math
import re

import pytest

pytest.importorskip("rclpy")
pytest.importorskip("viser", reason="viser is not installed")

from browser_support import Tab, browser
from ros_checks import NEAR, PRESSED
from ros_support import ends_cleanly


@pytest.mark.skipif(browser() is None, reason="no Chromium is installed")
def test_two_sensors_are_seen_by_their_topics(probe, start, scene):
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
