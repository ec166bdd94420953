"""A fake device whose scene is simulated in another process: the same frames, and none is missing."""

import os
import signal
import time
from queue import Queue

import numpy as np

from tomotactile_ros.devices.fake import FakeDevice
from tomotactile_ros.devices.scene_beside import SceneBeside
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.scenes.scene import load_scene
from tomotactile_ros.simulation import Simulator

GIVEN = load_layout("equal-4x4"), load_scene("slide"), "fem"
ORDER = tuple(range(15, -1, -1))


def until_it_answers(beside, *words):
    while (found := beside.frame(*words)) is None:
        time.sleep(0.02)
    return found


def test_it_makes_the_frames_of_the_simulator_and_none_once_it_is_killed():
    beside, words = SceneBeside(*GIVEN), (2e-3, ORDER, 1.5, 7)
    assert beside.frame(*words) is None
    beside.start()
    try:
        found = until_it_answers(beside, *words)
        own = Simulator(*GIVEN, row_period=2e-3, order=ORDER).frame(1.5, 7)
        np.testing.assert_allclose(found, own, atol=1e-9)
        os.kill(beside.pid, signal.SIGKILL)
        assert beside.frame(*words) is None
        assert beside.pid is None
    finally:
        beside.stop()


def test_a_device_goes_on_when_the_process_is_killed_and_ends_it_when_it_closes():
    beside, frames = SceneBeside(*GIVEN), Queue()
    device = FakeDevice(Simulator(*GIVEN), beside=beside)
    device.open(frames.put)
    try:
        first = frames.get()
        while beside.pid is None:
            frames.get()
        os.kill(beside.pid, signal.SIGKILL)
        while beside.pid is not None:
            frames.get()
        after = [frames.get() for _ in range(3)]
        assert after[-1].sequence > first.sequence
    finally:
        device.close()
    device.open(frames.put)
    try:
        while beside.pid is None:
            frames.get()
    finally:
        device.close()
    assert beside.pid is None
