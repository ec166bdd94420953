"""Lines and devices whose data look right and are not: whole packets that say what cannot be, from the
independent sensor of benchmark/fault_sensor.py, and lines that carry a little less than is sent, in
simulated time, which must not make old data fresh."""

import contextlib
import importlib
import math
import sys
from collections import deque
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from devices_support import E, Watch, counted

from tomotactile_ros.devices.firmware import EmulatedDevice
from tomotactile_ros.devices.serial import SerialDevice
from tomotactile_ros.devices.world import Settings

sys.path.insert(0, str(Path(__file__).resolve().parent.parent / "benchmark"))
fault_sensor = importlib.import_module("fault_sensor")

MANY = 16  # electrodes


@contextlib.contextmanager
def listening(tmp_path, fault: str, amount: float = 1.0):
    """A device at the sensor with a fault; its frames also go to the judge of the watch."""
    options = {"electrodes": MANY, "fault": fault, "amount": amount}
    with fault_sensor.Sensor(f"pty:{tmp_path}/port", **options) as source:
        device = SerialDevice(source.port, MANY, rate=100.0)
        watch = Watch(device)
        watch.source, watch.judge = source, fault_sensor.Judge(MANY)
        device.open(lambda frame: (watch.judge(frame), watch(frame)))
        try:
            yield watch
        finally:
            device.close()


def largest_stamp_error(watch) -> float:
    """Of the frames that came, s; to be asked when the sensor has ended."""
    return np.abs(watch.judge.times(watch.source)[1]).max()


def test_frames_of_the_independent_sensor_are_right(tmp_path):
    with listening(tmp_path, "none") as watch:
        watch.wait_for_frames(50)
        assert watch.device.status().troubles == ()
    assert watch.judge.wrong_readings == 0 and largest_stamp_error(watch) < 1.0


@pytest.mark.parametrize("fault", ["flip", "cut", "swap", "noise", "zeros"])
def test_a_bad_line_costs_frames_and_makes_none_wrong(tmp_path, fault):
    with listening(tmp_path, fault, 0.01) as watch:
        watch.wait_for(lambda s: s.counters["frames_incomplete"] > 3 or fault == "swap")
        watch.wait_for_frames(10)
    assert watch.judge.wrong_readings == 0


NONSENSE = {
    "drive-zero": ("above drive", True),
    "readings-none": ("no reading", True),
    "readings-same": ("all the same", True),
    "sequence-stands": ("sequence", True),
    "sequence-falls": ("sequence", True),
    "row-end-zero": ("times", False),
    "time-jumps": ("anew", True),
    "restart-streaming": ("anew", True),
    "grounded-other": ("rows", True),
}


@pytest.mark.parametrize("fault", NONSENSE)
def test_nonsense_that_looks_right_has_its_level(tmp_path, fault):
    with listening(tmp_path, fault) as watch:
        watch.wait_for(lambda s: NONSENSE[fault] in [(t.name, t.serious) for t in s.troubles])
    assert watch.judge.wrong_readings == 0 or NONSENSE[fault][0] != "anew"
    assert watch.judge.wrong_readings or fault != "readings-same"  # the judge sees them


def test_rows_with_impossible_times_move_no_stamps(tmp_path):
    with listening(tmp_path, "row-end-huge", 0.01) as watch:
        watch.wait_for(lambda s: s.counters["rows_ignored"] > 3)
        watch.wait_for_frames(5)
        assert watch.device.status().counters["clock_jumps"] == 0
    assert largest_stamp_error(watch) < 1.0


RATE = 10.0  # frames/s
STEP = 0.01  # s that a read takes


class SlowWorld:
    """A device behind a line that carries `speed` bytes/s and stores the rest, in simulated time.

    `device_clock` is the device's time at a time, s; `answering` how long the device takes to hear
    a command, s.
    """

    def __init__(self, versions, speed, seconds, device_clock=float, answering=0.0):
        self.t, self._end, self._speed, self._answering = 0.0, seconds, speed, answering
        self.begun: dict[int, float] = {}
        self._line = b""  # on the way to the host
        self._commands: deque[tuple[float, bytes]] = deque()
        self._room = 0.0
        settings = {"rate": RATE, "versions": versions, "clock": device_clock}
        self.device = EmulatedDevice(self._source, E, **settings)

    def _source(self, elapsed, sequence, order):
        self.begun[sequence] = self.device._start
        return counted(elapsed, sequence, order)

    def _goes_on(self, seconds):
        self.t += seconds
        while self._commands and self._commands[0][0] <= self.t:
            self._line += self.device.receive(self._commands.popleft()[1], self.t)
        self._line += self.device.rows_due(self.t)
        self._room = min(self._room + seconds * self._speed, max(len(self._line), 1.0))
        carried = self._line[: int(self._room)]
        self._room -= len(carried)
        self._line = self._line[len(carried) :]
        return carried

    def now(self):
        return self.t

    def unix_time(self, monotonic):
        return monotonic

    def first_tag(self):
        return 1

    def stopped(self):
        return self.t > self._end

    def changed(self):
        return False

    def settings(self):
        return Settings()

    def wait(self, seconds):
        self._goes_on(seconds)

    def open(self, port, baud):
        return SimpleNamespace(name=port, baud=baud, low_latency=False, close=lambda: None)

    def read(self, line, timeout):
        return self._goes_on(STEP), self.t

    def write(self, line, data):
        self._commands.append((self.t + self._answering, data))


def bytes_per_second(versions):
    """What a device sends in a second, so that a line can carry a part of it."""
    world = SlowWorld(versions, math.inf, 10.0)
    heard = []
    read = world.read
    world.read = lambda *words: heard.append(read(*words)) or heard[-1]
    SerialDevice("/dev/null", E).relive(world, lambda frame: None)
    return sum(len(data) for data, _ in heard) / 10.0


def lived(world, max_age=math.inf):
    """The device afterwards; true age of each frame when it came, and what its stamp says, s; what
    was told meanwhile."""
    device = SerialDevice("/dev/null", E)
    device.max_age = max_age
    ages, told = [], set()

    def take(frame):
        ages.append((world.t - world.begun[frame.sequence], world.t - frame.stamp))
        if len(ages) % 20 == 0:
            told.update(trouble.text for trouble in device.status().troubles)

    device.relive(world, take)
    return device, np.array(ages).T, " ".join(told)


@pytest.mark.parametrize("fast, versions", [(0.0, (1,)), (0.002, (2,)), (0.05, (1,)), (0.05, (2,))])
def test_a_delay_that_grows_as_the_devices_clock_gains_is_found(fast, versions):
    """The clock hides what waits on the line: frames would be seconds old and stamped now."""
    lack = fast or 0.002
    speed = bytes_per_second(versions) * (1.0 - lack)
    world = SlowWorld(versions, speed, 1.0 / lack, lambda t: t * (1.0 + fast))
    device, (true, stamped), told = lived(world)
    assert len(true) > 0.9 * RATE / lack
    assert (true - stamped).max() < 0.6
    assert device.status().counters["reconnects"] >= 1
    assert "had waited 0." in told


@pytest.mark.parametrize("versions", [(1,), (2,)])
@pytest.mark.parametrize("answering", [0.0, 0.08])
def test_a_line_that_is_fast_enough_is_left_alone(versions, answering):
    world = SlowWorld(versions, 2.0 * bytes_per_second(versions), 60.0, answering=answering)
    device, (true, stamped), told = lived(world)
    assert len(true) > 0.99 * RATE * 59.0
    assert np.abs(true - stamped).max() < 0.02
    assert "waited" not in told
    assert device.status().counters["reconnects"] == 0


@pytest.mark.parametrize("versions", [(1,), (2,)])
def test_a_line_that_carries_half_of_it_makes_nothing_old_fresh(versions):
    world = SlowWorld(versions, 0.5 * bytes_per_second(versions), 60.0)
    device, (true, stamped), _ = lived(world, max_age=0.3)
    assert np.abs(true - stamped).max() < 0.05
    assert len(true) > 20 and true.max() < 0.3 + 2 / RATE
    counters = device.status().counters
    assert counters["frames_stale"] > 20 and counters["clock_jumps"] == 0
