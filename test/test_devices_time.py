"""Sources without hardware live in the time that they are given: slow, fast, at rest, set back. Live touches
on a simulated sheet: what counts when, what is refused, from any thread."""

import threading
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from tomotactile_ros.devices.fake import FakeDevice
from tomotactile_ros.devices.replay import ReplayDevice
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.scenes.scene import Contact, Scene, load_scene
from tomotactile_ros.scenes.touches import HOLD, MOST, Touch, Touches
from tomotactile_ros.simulation import Simulator

PATIENCE = 60.0  # s
LAYOUT = equal_grid(2, 2, (0.2, 0.2), radius=0.0025, sheet_resistance=1e4, inset=0.02)
RATE = 10.0  # frames/s of four rows
SLIDING = Contact("disc", center=(-0.05, 0.02), radius=0.005, velocity=(0.02, 0.0))
SCENE = Scene("slides", 3.3, contacts=(SLIDING,))


class Steps:
    """Time that goes on when a test says so; stamps are its times."""

    def __init__(self):
        self._now = self._before = 0.0
        self._since = -np.inf
        self.waits, self._news = 0, None  # how often the device has waited, and for what
        self._waiting = threading.Condition()

    def now(self):
        return self._now

    def before(self):
        return self._before

    def since(self):
        return self._since

    def stamp(self, when):
        return when

    def wait(self, until, news):
        with self._waiting:
            if self._now >= until:
                return
            self.waits, self._news = self.waits + 1, news
            self._waiting.notify_all()
        news.wait(PATIENCE)

    def go(self, *times, wait=True):
        """Go on to these times, and to each next one when the device has nothing left to do."""
        for to in times:
            with self._waiting:
                waits, self._before, self._now = self.waits, self._now, to
                if self._news is not None:
                    self._news.set()
            if wait:
                self.settle(waits)

    def set_ahead(self, to):
        """Go on as a clock that is set."""
        self._since = to
        self.go(to)

    def settle(self, waits=0):
        """Until the device waits, for more than the `waits`-th time."""
        with self._waiting:
            assert self._waiting.wait_for(lambda: self.waits > waits, PATIENCE)


def stamps(frames):
    return [frame.stamp for frame in frames]


@pytest.fixture
def run():
    """A device in stepped time, with what it has handed over."""
    devices = []

    def make(device, rows=False):
        devices.append(device)
        device.time, device.run_length = Steps(), 2
        made = SimpleNamespace(device=device, time=device.time, frames=[], rows=[])
        device.open(made.frames.append, made.rows.append if rows else None)
        made.time.settle()
        return made

    yield make
    for device in devices:
        device.close()


def fake():
    return FakeDevice(Simulator(LAYOUT, SCENE), rate=RATE)


@pytest.mark.parametrize("step", [0.01, 0.25])
def test_motion_rows_and_rate_are_those_of_the_time(run, step):
    """In small steps, and in such as hold several frames: none is left out, none is late."""
    sensor = run(fake(), rows=True)
    sensor.time.go(*np.arange(50.0, 51.1, step))
    assert [f.sequence for f in sensor.frames[:9]] == list(range(9))
    assert stamps(sensor.frames[:9]) == pytest.approx([50.0 + 0.1 * k for k in range(9)])
    assert stamps(sensor.rows[:18]) == pytest.approx([50.0 + 0.05 * k for k in range(18)])
    assert {f.row_period for f in sensor.frames} == {0.025}
    simulator = Simulator(LAYOUT, SCENE, row_period=0.025)
    assert np.allclose(sensor.frames[8].voltages, simulator.frame(0.8), rtol=1e-4, equal_nan=True)
    counters = sensor.device.status().counters
    assert counters["frames_skipped"] == 0 and counters["latency_max"] <= step + 1e-6
    assert counters["rate_seen"] == pytest.approx(RATE, rel=0.3)


def test_it_begins_anew_where_time_is_set_back(run):
    sensor = run(fake())
    sensor.time.go(50.0, 50.11, 20.0, 20.11)
    first, again = sensor.frames
    assert (first.stamp, again.stamp, again.sequence) == (50.0, 20.0, 1)
    assert np.allclose(again.voltages, first.voltages, rtol=1e-4, equal_nan=True)


@pytest.mark.parametrize("rows", [False, True])
def test_time_that_is_set_ahead_is_not_lost(run, rows):
    """All frames of 5000 s were, and the one under way was told as old as that."""
    sensor = run(fake(), rows)
    sensor.time.go(50.0, 50.11)
    sensor.time.set_ahead(5000.0)
    sensor.time.go(5000.06, 5000.11, 5000.22)
    assert stamps(sensor.frames) == pytest.approx([50.0, 5000.0, 5000.1])
    assert [frame.sequence for frame in sensor.frames] == [0, 1, 2]
    assert not any(50.09 < stamp < 5000.0 for stamp in stamps(sensor.rows))
    status = sensor.device.status()
    assert status.counters["frames_skipped"] == 0 and status.counters["latency_max"] < 0.1
    assert not status.troubles


def test_a_simulation_that_cannot_keep_up_leaves_frames_out(run):
    device, held, begun = fake(), threading.Event(), threading.Event()
    original = device._simulator.frame
    device._simulator.frame = lambda *which: (begun.set(), held.wait(), original(*which))[2]
    sensor = run(device)
    sensor.time.go(50.0)
    sensor.time.go(50.09, wait=False)
    assert begun.wait(PATIENCE)
    for now in (50.3, 50.55, 50.58):  # goes by while the first frame is computed
        sensor.time.go(now, wait=False)
    waits = sensor.time.waits
    held.set()
    sensor.time.settle(waits)
    sensor.time.go(50.61)
    assert stamps(sensor.frames[:2]) == pytest.approx([50.0, 50.5])
    assert device.status().counters["frames_skipped"] == 4


@pytest.fixture
def recording(tmp_path):
    """Six frames of 0.1 s, 0.1 s apart."""
    frame = Simulator(LAYOUT, SCENE, row_period=0.025).frame(0.0)
    path = tmp_path / "frames.npz"
    times = {"stamps": 7.0 + 0.1 * np.arange(6), "row_period": 0.025}
    np.savez(path, voltages=[frame] * 6, grounded=np.arange(4), drive_voltage=3.3, **times)
    return path


@pytest.mark.parametrize("rows", [False, True])
def test_a_recording_keeps_its_distances_in_the_time(run, recording, rows):
    sensor = run(ReplayDevice(recording, 4), rows)
    sensor.time.go(100.0, 100.05, 100.12, 100.19)
    assert stamps(sensor.frames) == pytest.approx([100.0] if rows else [99.9, 100.0])
    assert stamps(sensor.rows) == pytest.approx([100.0, 100.05, 100.1] if rows else [])
    sensor.time.go(30.0, 30.05, 30.11, 30.22, 30.33)  # and goes on from there
    anew = [stamp for stamp in stamps(sensor.frames) if stamp < 99.0]
    assert anew == pytest.approx([30.1, 30.2] if rows else [30.0, 30.1, 30.2])


def test_a_recording_goes_on_where_the_time_is_set_ahead(run, recording):
    sensor = run(ReplayDevice(recording, 4))
    sensor.time.go(100.0, 100.11)
    sensor.time.set_ahead(5000.0)
    sensor.time.go(5000.11, 5000.22)
    assert stamps(sensor.frames) == pytest.approx([99.9, 100.0, 4999.9, 5000.0, 5000.1])


@pytest.mark.parametrize("rows", [False, True])
def test_no_row_of_a_recording_is_of_the_future(run, recording, rows):
    """Also where it is played faster than it was scanned."""
    sensor = run(ReplayDevice(recording, 4, rate=20.0), rows)
    sensor.time.go(100.0, 100.11, 100.16, 100.21)
    ends = [frame.stamp + 4 * frame.row_period for frame in sensor.frames]
    assert ends == pytest.approx(
        [100.1, 100.1, 100.15, 100.2] if rows else [100.0, 100.05, 100.1, 100.15, 100.2]
    )


TOUCHED = equal_grid(4, 4, (0.2, 0.2), 0.005, 1e4)
LIVE = replace(load_scene("live"), noise=None, adc=None)
ONE, OTHER = Touch(0.03, 0.02, 2.0, 0.006), Touch(-0.05, 0.0, 1.0, 0.008)


def assert_are(contacts, *touches):
    """These contacts are those of these touches, in this order."""
    found = [(*contact.center, contact.total_force, contact.radius) for contact in contacts]
    np.testing.assert_allclose(found, [(t.x, t.y, t.force, t.radius) for t in touches])


def test_a_message_replaces_all_and_holds_for_a_while():
    touches = Touches(TOUCHED)
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
    touches = Touches(TOUCHED)
    (complaint,) = touches.press([ONE, replace(ONE, **bad), OTHER], 0.0)
    assert complaint.startswith(line) and "\n" not in complaint
    assert_are(touches.at(0.0), ONE, OTHER)


def test_a_touch_without_force_is_none_and_too_many_are_cut():
    touches = Touches(TOUCHED)
    assert touches.press([Touch(0, 0, 0.0, 0.0)], 0.0) == [] and touches.at(0.0) == ()
    (complaint,) = touches.press([ONE] * (MOST + 5), 0.1)
    assert complaint == f"touches: {MOST + 5} of them, only the first {MOST} are taken"
    assert len(touches.at(0.1)) == MOST


def test_a_live_frame_is_that_of_a_scene_with_the_same_contact():
    simulator = Simulator(TOUCHED, LIVE)
    simulator.live = Touches(TOUCHED)
    simulator.live.press([ONE], 1.0)
    contact = Contact("disc", (0.03, 0.02), radius=0.006, force=2.0)
    same = Simulator(TOUCHED, replace(LIVE, contacts=(contact,))).frame(0.0)
    np.testing.assert_allclose(simulator.frame(1.1), same)
    assert np.nanmax(simulator.frame(2.0)) == 0.0


def test_a_scene_that_is_not_live_takes_no_touches():
    device = FakeDevice(Simulator(TOUCHED, replace(LIVE, live=False), "closed_form"))
    assert device.press([ONE]) == ["touches: the scene is not live, it takes none from outside"]
