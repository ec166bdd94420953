"""Fake and replayed sensors, recordings and bags, and the choice between devices."""

import contextlib
import os
import signal
import sqlite3
import time
from dataclasses import replace
from pathlib import Path
from queue import Queue

import numpy as np
import pytest
from devices_support import PATIENCE, Watch, collect, opened, write_bag

from tomotactile_ros.devices import DeviceSettings, make_device
from tomotactile_ros.devices.bag import MESSAGE
from tomotactile_ros.devices.fake import FakeDevice
from tomotactile_ros.devices.recording import load_recording, read_frames
from tomotactile_ros.devices.replay import ReplayDevice
from tomotactile_ros.devices.scene_beside import SceneBeside
from tomotactile_ros.layouts.layout import equal_grid, load_layout
from tomotactile_ros.scenes.scene import Contact, Scene, load_scene
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.errors import InputError

LAYOUT = equal_grid(2, 2, (0.2, 0.2), radius=0.0025, sheet_resistance=1e4, inset=0.02)
SCENE = Scene(
    name="push", drive_voltage=3.3, contacts=(Contact("disc", center=(0.01, 0.02), radius=0.005),)
)
E = LAYOUT.electrodes


@pytest.mark.parametrize("live", [False, True])
def test_the_fake_device_hands_on_rows_of_any_order_while_they_are_taken(live):
    scene = replace(SCENE, contacts=(), live=True) if live else SCENE
    device, runs = FakeDevice(Simulator(LAYOUT, scene), rate=20.0), []
    device.run_length = 2
    device.set_scan((3, 0, 3, 1, 2))
    watch = Watch(device)
    device.open(watch, runs.append)
    watch.wait_for_frames(4)
    device.close()
    for frame in watch.frames[1:]:
        assert frame.voltages.dtype == np.float32 and frame.drive_voltage == 3.3
        mine = [run for run in runs if run.sequence == frame.sequence]
        assert [run.grounded.tolist() for run in mine] == [[3, 0], [3, 1], [2]]
        assert np.array_equal(
            np.concatenate([r.voltages for r in mine]), frame.voltages, equal_nan=True
        )
        assert [run.stamp - frame.stamp for run in mine] == pytest.approx([0, 0.02, 0.04], abs=1e-3)
        assert {run.row_period for run in mine} == {frame.row_period} == {0.01}
    if not live:
        expected = Simulator(LAYOUT, SCENE).frame(0.0)[[3, 0, 3, 1, 2]]
        assert np.allclose(watch.frames[2].voltages, expected, rtol=1e-6, equal_nan=True)
    with pytest.raises(InputError, match="scan: electrode 4 does not exist"):
        device.set_scan((4,))


def test_the_fake_device_pauses_resumes_and_changes_its_rate():
    device = FakeDevice(Simulator(LAYOUT, SCENE), rate=100.0)
    watch = opened(device)
    watch.wait_for_frames(2)
    device.set_streaming(False)
    watch.wait_for(lambda status: status.state == "stopped")
    before = len(watch.frames)
    device.set_rate(50.0)
    device.set_streaming(True)
    watch.wait_for_frames(4)
    device.close()
    assert np.diff([f.stamp for f in watch.frames[before:]]).min() >= 0.019


def test_a_scene_is_simulated_in_another_process_and_goes_on_without_it():
    given = load_layout("equal-4x4"), load_scene("slide"), "fem"
    order = tuple(range(15, -1, -1))
    beside, frames = SceneBeside(*given), Queue()
    assert beside.frame(2e-3, order, 1.5, 7) is None  # not there yet
    device = FakeDevice(Simulator(*given), beside=beside)
    for ends_by_itself in (True, False):
        device.open(frames.put)
        while beside.pid is None:
            frames.get()
        if ends_by_itself:
            os.kill(beside.pid, signal.SIGKILL)
            while beside.pid is not None:
                frames.get()
            before = frames.get().sequence
            assert frames.get().sequence > before
        device.close()
        assert beside.pid is None
    beside.start()
    try:
        while (found := beside.frame(2e-3, order, 1.5, 7)) is None:
            time.sleep(0.02)
        own = Simulator(*given, row_period=2e-3, order=order).frame(1.5, 7)
        np.testing.assert_allclose(found, own, atol=1e-9)
    finally:
        beside.stop()


def a_recording(number: int = 5) -> dict[str, np.ndarray]:
    """Arrays of frames.npz with readings that tell their frame."""
    voltages = np.arange(number * E * E, dtype=np.float32).reshape(number, E, E) / 100
    voltages[:, np.arange(E), np.arange(E)] = np.nan
    stamps = 100.0 + 0.01 * np.arange(number)
    return {"voltages": voltages, "grounded": np.arange(E), "stamps": stamps}


@pytest.fixture
def npz(tmp_path):
    """A recording as frames.npz."""
    np.savez(tmp_path / "frames.npz", truth="[]", **a_recording())
    return tmp_path / "frames.npz"


@pytest.mark.parametrize("storage", ["mcap", "sqlite3", "sqlite3 of Humble"])
def test_a_bag_of_their_layout_is_read_by_devices_and_commands_without_ros(tmp_path, storage):
    path, recording = a_bag(tmp_path / "bag", storage.split()[0]), a_recording()
    if storage.endswith("Humble"):
        forget_definitions(next(path.glob("*.db3")))
    frames = list(read_frames(path))
    assert [f.sequence for f in frames] == [10, 11, 12, 13, 14]
    loaded = load_recording(path, LAYOUT)
    for voltages in (loaded.voltages, [f.voltages for f in frames]):
        assert np.array_equal(voltages, recording["voltages"], equal_nan=True)
    for stamps in (loaded.stamps, [f.stamp for f in frames]):
        assert stamps == pytest.approx(recording["stamps"])
    for each in (loaded, frames[0]):
        assert each.grounded.tolist() == [0, 1, 2, 3]
        assert each.drive_voltage == 5.0 and each.row_period == pytest.approx(2.5e-3)
    assert load_recording(path, LAYOUT, drive_voltage=2.0).drive_voltage == 2.0
    assert loaded.truth is None
    (file,) = path.glob("*.mcap" if storage == "mcap" else "*.db3")
    assert len(list(read_frames(file))) == 5


def test_a_bag_of_another_layout_is_refused(tmp_path):
    path = a_bag(tmp_path / "bag")
    larger = equal_grid(3, 3, (0.2, 0.2), 0.0025, 1e4, inset=0.02, name=LAYOUT.name)
    for other in (replace(LAYOUT, name="other"), larger):
        words = f"bag: frame 10 is of layout '{LAYOUT.id}', not of '{other.id}'"
        with pytest.raises(InputError, match=words):
            load_recording(path, other)
        with pytest.raises(InputError, match="frame 10 is of layout"):
            ReplayDevice(path, E, layout_id=other.id)


@pytest.mark.parametrize(
    "change, complaint",
    [
        ({"drive_voltage": 3.0}, "frame 12 was driven with 3 V, the first one with 5 V"),
        ({"grounded": np.array([1, 0, 2, 3], np.uint16)}, "frame 12 has other ground conditions"),
        ({"voltages": np.full(16, np.inf, np.float32)}, "frame 12: a voltage is infinite"),
        ({"grounded": np.array([0, 1, 2, 4], np.uint16)}, "frame 12: grounded: must be"),
        ({"drive_voltage": np.nan}, "frame 12: drive_voltage: nan"),
        ({"row_period": -1e-3}, "frame 12: row_period: -0.001"),
        ({"row_period": np.nan}, "frame 12: row_period: nan"),
    ],
)
def test_a_bag_whose_frames_differ_is_no_recording_for_commands(tmp_path, change, complaint):
    path = a_bag(tmp_path / "bag", third=change)
    with pytest.raises(InputError, match=complaint):
        load_recording(path, LAYOUT)


def forget_definitions(file: Path) -> None:
    """Take the message definitions out of a bag: Humble does not write them."""
    with contextlib.closing(sqlite3.connect(file)) as bag, bag:
        assert bag.execute("DELETE FROM message_definitions").rowcount > 0


def a_bag(path: Path, storage="mcap", topics=("/voltage_frame",), third=()) -> Path:
    """The recording as a rosbag2; `third`: fields that differ in the third frame."""
    recording = a_recording()

    def messages(types):
        for k, stamp in enumerate(recording["stamps"]):
            nanoseconds = round(1e9 * stamp)
            time = types["builtin_interfaces/msg/Time"](*divmod(nanoseconds, 10**9))
            fields = {
                "header": types["std_msgs/msg/Header"](time, "tactile_link"),
                "sequence": 10 + k,
                "layout_id": LAYOUT.id,
                "drive_voltage": 5.0,
                "electrodes": E,
                "grounded": recording["grounded"].astype(np.uint16),
                "voltages": recording["voltages"][k].ravel(),
                "row_period": 2.5e-3,
            }
            yield nanoseconds, types[MESSAGE](**fields | dict(third if k == 2 else ()))

    return write_bag(path, MESSAGE, messages, topics, storage)


def test_replay_keeps_the_recorded_distances_and_ends(npz):
    device = ReplayDevice(npz, E)
    watch = opened(device)
    watch.wait_for(lambda status: status.state == "finished")
    device.close()
    frames = watch.frames
    assert len(frames) == 5
    assert np.array_equal([f.voltages for f in frames], a_recording()["voltages"], equal_nan=True)
    assert [f.sequence for f in frames] == [0, 1, 2, 3, 4]
    assert np.diff([f.stamp for f in frames]) == pytest.approx(0.01, abs=1e-3)
    assert abs(frames[4].stamp - time.time()) < PATIENCE


@pytest.mark.parametrize("stamps", [[7.0], [7.0, 7.0, 5.0, 5.0]])
def test_a_recording_without_distances_in_time_is_played_at_a_thousand_rows_a_second(
    tmp_path, stamps
):
    recording = {**a_recording(len(stamps)), "stamps": np.array(stamps)}
    frames = collect(ReplayDevice(changed(tmp_path, **recording), E, loop=True), 10)
    assert np.diff([f.stamp for f in frames]).min() == pytest.approx(0.001 * E, abs=1e-4)


def test_a_replay_pauses_and_does_not_wait_for_an_old_rate(npz):
    device = ReplayDevice(npz, E, rate=0.001, loop=True)
    device.BEHIND = PATIENCE
    watch = opened(device)
    watch.wait_for(lambda status: watch.frames)
    device.set_rate(500.0)
    watch.wait_for_frames(8)
    device.set_streaming(False)
    watch.wait_for(lambda status: status.state == "stopped")
    device.set_streaming(True)
    watch.wait_for_frames(3)
    device.close()
    assert np.diff([f.stamp for f in watch.frames[1:7]]) == pytest.approx(0.002, abs=1e-3)
    assert [f.sequence for f in watch.frames] == list(range(len(watch.frames)))
    again, first = watch.frames[6].voltages, a_recording()["voltages"][1]
    assert np.array_equal(again, first, equal_nan=True)


def changed(tmp_path: Path, **changes) -> Path:
    """frames.npz with some arrays changed; None takes one away."""
    arrays = {k: v for k, v in {**a_recording(), **changes}.items() if v is not None}
    np.savez(tmp_path / "changed.npz", **arrays)
    return tmp_path / "changed.npz"


@pytest.mark.parametrize(
    ("changes", "words"),
    [
        ({"stamps": None}, "stamps: is missing"),
        ({"voltages": np.zeros((5, E))}, r"voltages: shape \(5, 4\)"),
        ({"voltages": np.full((5, E, E), "x")}, "voltages: holds '<U1', volts are real numbers"),
        ({"stamps": np.arange(4.0)}, "stamps: a finite time is needed for each of 5 frames"),
        ({"grounded": np.array([0, 1, 2, 2.5])}, "grounded: one of the electrodes 0 ... 3"),
        ({"voltages": np.full((5, E, E), -np.inf)}, "voltages: one is infinite"),
        ({"layout_id": "other"}, f"frames of 'other', not of '{LAYOUT.id}'"),
        ({"voltages": np.zeros((0, E, E)), "stamps": np.zeros(0)}, "no frame"),
        ({"voltages": np.zeros((5, E, 9))}, "9 electrodes, the layout 4"),
        ({"drive_voltage": np.array([1.0, 2.0])}, "drive_voltage"),
        ({"row_period": -1e-3}, "row_period: "),
        ({"row_period": "1 ms"}, "row_period: "),
        ({"contact_law": ["a", "b"]}, "changed.npz: contact_law"),
    ],
)
def test_what_is_wrong_with_a_recording_is_told_at_once(tmp_path, changes, words):
    with pytest.raises(InputError, match=words):
        ReplayDevice(changed(tmp_path, **changes), E, layout_id=LAYOUT.id)


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_a_damaged_bag_is_refused_in_one_line(tmp_path, storage):
    path, random = a_bag(tmp_path / "bag", storage), np.random.default_rng(0)
    file, description = next(path.glob("bag.*")), path / "metadata.yaml"
    for damaged in [file] * 30 + [description] * 10:
        whole = damaged.read_bytes()
        data = bytearray(whole)
        if random.random() < 0.5:
            del data[random.integers(len(data)) :]
        else:
            data[random.integers(len(data))] ^= 0x80
        damaged.write_bytes(data)
        try:
            list(read_frames(path, electrodes=E))
        except InputError as error:
            assert "\n" not in str(error)
        damaged.write_bytes(whole)


@pytest.mark.parametrize(
    "text", ["root:$6$SECRET:1\n- x: [\n", "a: [" + "1, " * 150_000 + "1]\n", "a: &a [1]\nb: *a\n"]
)
def test_the_metadata_of_a_bag_are_limited_and_not_repeated(tmp_path, text):
    (tmp_path / "metadata.yaml").write_text(text)
    with pytest.raises(InputError, match="metadata.yaml: line .: not valid YAML") as refusal:
        list(read_frames(tmp_path))
    assert "SECRET" not in str(refusal.value) and "x:" not in str(refusal.value)


def test_files_that_are_no_recordings_are_refused(tmp_path):
    (tmp_path / "text.npz").write_text("hello")
    (tmp_path / "text.mcap").write_text("hello")
    (tmp_path / "folder").mkdir()
    for name in ("none.npz", "text.npz", "text.mcap", "folder"):
        with pytest.raises(InputError, match=name):
            ReplayDevice(tmp_path / name, E)


def test_rows_in_a_bag_are_left_out_where_their_frames_are_there(tmp_path):
    both = a_bag(tmp_path / "both", topics=("/skin/voltage_rows", "/skin/voltage_frame"))
    assert len(list(read_frames(both))) == 5
    rows = a_bag(tmp_path / "rows", topics=("/skin/voltage_rows",))
    assert len(list(read_frames(rows))) == 5


def test_a_bag_of_two_sensors_needs_a_topic_and_one_of_none_is_refused(tmp_path):
    two = a_bag(tmp_path / "two", topics=("/left", "/right"))
    with pytest.raises(InputError, match="several topics.*/left.*/right"):
        ReplayDevice(two, E)
    for name in ("/left", "right"):
        assert len(collect(ReplayDevice(two, E, topic=name), 5)) == 5
    with pytest.raises(InputError, match="no frames on middle, but on /left, /right"):
        ReplayDevice(two, E, topic="middle")
    with pytest.raises(InputError, match="only bags have topics"):
        list(read_frames(changed(tmp_path), topic="/left"))
    with pytest.raises(InputError, match="holds no"):
        ReplayDevice(a_bag(tmp_path / "empty", topics=()), E)


@pytest.mark.parametrize(
    ("settings", "words"),
    [
        ({"device": "fake"}, "scene: missing"),
        ({"device": "serial", "port": "x", "baud": 0}, "baud: 0"),
        ({"device": "serial", "port": "x", "rate": -1.0}, "rate: -1"),
        ({"device": "serial", "port": "x", "rate": float("nan")}, "rate: nan"),
        ({"device": "replay"}, "recording: missing"),
    ],
)
def test_impossible_settings_are_refused(settings, words):
    with pytest.raises(InputError, match=words):
        make_device(DeviceSettings(LAYOUT, **settings))
