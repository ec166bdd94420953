"""Whole packets that say what cannot be, from the independent sensor of benchmark/sensor.py.

The first tests make sure that the judge sees what is wrong, and nothing where nothing is.
"""

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest
from devices_support import Watch

from tomotactile_ros.devices.serial import SerialDevice

BENCHMARK = Path(__file__).resolve().parent.parent / "benchmark"
SIDE = 4
E = SIDE * SIDE

sys.path.insert(0, str(BENCHMARK))
fault_sensor = importlib.import_module("fault_sensor")


class Listener(Watch):
    """A watch whose frames also go to the judge."""

    def __init__(self, device: SerialDevice) -> None:
        super().__init__(device)
        self.judge = fault_sensor.Judge(E)

    def __call__(self, frame) -> None:
        self.judge(frame)
        super().__call__(frame)

    def end(self) -> None:
        """Close the device and end the sensor."""
        self.device.close()
        if self.sensor.process.returncode is None:
            self.sensor.stop()

    def largest_stamp_error(self) -> float:
        """Of the frames that came, s; ends everything."""
        self.end()
        return np.abs(self.judge.times(self.sensor)[1]).max()


@pytest.fixture
def listen(tmp_path):
    """Starts a sensor with a fault and a device; gives the listener."""
    started = []

    def start(fault: str, amount: float = 1.0, rate: float = 100.0) -> Listener:
        sensor = fault_sensor.Sensor(
            f"pty:{tmp_path}/port", electrodes=E, fault=fault, amount=amount
        )
        device = SerialDevice(sensor.port, E, rate=rate)
        listener = Listener(device)
        listener.sensor = sensor
        device.open(listener)
        started.append(listener)
        return listener

    yield start
    for listener in started:
        listener.end()


def test_frames_of_the_independent_sensor_are_right(listen):
    listener = listen("none")
    listener.wait_for_frames(50)
    assert listener.judge.wrong_readings == 0
    assert listener.device.status().troubles == ()
    assert listener.largest_stamp_error() < 1.0


def test_the_judge_sees_a_wrong_reading(listen):
    listener = listen("readings-same", 0.05)
    listener.wait_for(lambda s: listener.judge.wrong_readings > 0)


@pytest.mark.parametrize("fault", ["flip", "cut", "swap", "noise", "zeros"])
def test_a_bad_line_costs_frames_and_makes_none_wrong(listen, fault):
    listener = listen(fault, 0.01)
    listener.wait_for(lambda s: s.counters["frames_incomplete"] > 3 or fault == "swap")
    listener.wait_for_frames(10)
    assert listener.judge.wrong_readings == 0


NONSENSE = {
    "drive-zero": ("above drive", True),
    "readings-none": ("no reading", True),
    "readings-same": ("all the same", True),
    "sequence-stands": ("sequence", True),
    "sequence-falls": ("sequence", True),
    "row-end-zero": ("times", False),
    "time-jumps": ("anew", True),
    "grounded-other": ("rows", True),
}


@pytest.mark.parametrize("fault", NONSENSE)
def test_nonsense_that_looks_right_has_its_level(listen, fault):
    name, serious = NONSENSE[fault]
    listener = listen(fault)
    listener.wait_for(lambda s: (name, serious) in [(t.name, t.serious) for t in s.troubles])


def test_rows_with_impossible_times_move_no_stamps(listen):
    listener = listen("row-end-huge", 0.01)
    listener.wait_for(lambda s: s.counters["rows_ignored"] > 3)
    listener.wait_for_frames(5)
    assert listener.device.status().counters["clock_jumps"] == 0
    assert listener.largest_stamp_error() < 1.0


def test_a_device_that_begins_anew_is_told(listen):
    listener = listen("restart-streaming", 1.0)
    listener.wait_for(lambda s: "anew" in [trouble.name for trouble in s.troubles])
    assert listener.judge.wrong_readings == 0
