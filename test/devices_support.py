"""An emulated sensor, a line to it, and a watch over what arrives: for tests of devices.

Every wait is for an event; PATIENCE is only how long a broken program may take to fail.
"""

import contextlib
import itertools
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from tomotactile_ros.devices import emulator
from tomotactile_ros.devices.bag import MESSAGE
from tomotactile_ros.devices.serial import SerialDevice

PATIENCE = 30.0
E = 6


def readings(sequence: int) -> np.ndarray:
    """Counts (E, E) of frame `sequence`: no two frames within 500 agree anywhere."""
    return (sequence % 500) * 8 + (np.arange(E)[:, None] + np.arange(E)) % 8


def counted(time: float, sequence: int, order: np.ndarray) -> np.ndarray:
    """Source of frames whose readings tell their sequence."""
    return readings(sequence)[order] * 3.3 / 4096


def sensor(**settings) -> emulator.EmulatedDevice:
    """Small fast emulated device."""
    return emulator.EmulatedDevice(counted, E, **{"rate": 100.0, "name": "skin", **settings})


class Watch:
    """Collects frames, checks each of them, and waits for what the test wants."""

    def __init__(self, device: SerialDevice) -> None:
        self.device = device
        self.frames = []
        self._news = threading.Condition()

    def __call__(self, frame) -> None:
        with self._news:
            self.frames.append(frame)
            self._news.notify_all()

    def wait_for_frames(self, number: int) -> None:
        """Wait until `number` more frames are there."""
        with self._news:
            wanted = len(self.frames) + number
            assert self._news.wait_for(lambda: len(self.frames) >= wanted, PATIENCE), (
                self.device.status()
            )

    def wait_for(self, condition) -> None:
        """Wait until `condition(status)`, asked at each frame and every 10 ms."""
        deadline = time.monotonic() + PATIENCE
        with self._news:
            while not condition(self.device.status()):
                assert time.monotonic() < deadline, self.device.status()
                self._news.wait(0.01)

    def check(self) -> None:
        """Every whole frame is one that was sent, and stamps increase up to now."""
        for frame in self.frames:
            expected = readings(frame.sequence)[frame.grounded] * (3.3 / 4096)
            expected[np.arange(len(expected)), frame.grounded] = np.nan
            valid = ~np.isnan(frame.voltages)
            assert np.allclose(frame.voltages[valid], expected[valid], atol=1e-6)
        stamps = [frame.stamp for frame in self.frames]
        assert all(a < b for a, b in itertools.pairwise(stamps))
        assert not stamps or stamps[-1] <= time.time() + 1e-3


def opened(device) -> Watch:
    """The device, opened, with a watch over it."""
    watch = Watch(device)
    device.open(watch)
    return watch


def collect(device, number: int) -> list:
    """The first frames of a device, at least so many."""
    watch = opened(device)
    try:
        watch.wait_for(lambda status: len(watch.frames) >= number)
    finally:
        device.close()
    return watch.frames


@contextlib.contextmanager
def watched(device: SerialDevice):
    """The opened device, closed at the end and its frames checked."""
    watch = opened(device)
    try:
        yield watch
    finally:
        device.close()
    assert device.status().state == "closed"
    watch.check()


@contextlib.contextmanager
def plugged(simulated, make_port=emulator.PtyPort, **options):
    """The emulator plugged in."""
    running = emulator.Emulator(simulated, make_port, **options)
    running.plug()
    try:
        yield running
    finally:
        running.unplug()


@contextlib.contextmanager
def connected(simulated=None, make_port=emulator.PtyPort, mangle=bytes, **settings):
    """Emulator and serial device at both ends of one line: the running emulator and the watch."""
    with (
        plugged(simulated or sensor(), make_port, mangle=mangle) as port,
        watched(SerialDevice(port.path, E, **settings)) as watch,
    ):
        yield port, watch


def write_bag(path, kind, messages, topics, storage="mcap"):
    """A rosbag2, written without ROS: times, ns, and messages of a type, or their bytes, as `messages(types)`
    says."""
    rosbag2 = pytest.importorskip("rosbags.rosbag2")
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    store = get_typestore(Stores.ROS2_JAZZY)
    text = Path(__file__).resolve().parent.parent / "msg" / "VoltageFrame.msg"
    store.register(get_types_from_msg(text.read_text("utf-8"), MESSAGE))
    plugin = rosbag2.StoragePlugin[storage.upper()]
    with rosbag2.Writer(path, version=9, storage_plugin=plugin) as writer:
        for topic in topics:
            connection = writer.add_connection(topic, kind, typestore=store)
            for time, message in messages(store.types):
                as_bytes = isinstance(message, bytes)
                writer.write(
                    connection, time, message if as_bytes else store.serialize_cdr(message, kind)
                )
    return path
