"""Raw captures: what the device saw is written down, and lived again to the bit."""

import itertools
import json
import operator
import re
import struct

import numpy as np
import pytest
from devices_support import E, Watch, connected, plugged, sensor

from tomotactile_ros.cli import main
from tomotactile_ros.devices import capture as capture_module
from tomotactile_ros.devices.capture import FORMAT
from tomotactile_ros.devices.firmware import EmulatedDevice, idle_source
from tomotactile_ros.devices.relive import relive
from tomotactile_ros.devices.serial import SerialDevice
from tomotactile_ros.frames_file import load_frames
from tomotactile_ros.support.errors import InputError


def bits(frames) -> list:
    """What frames are, to the last bit."""
    timing = operator.attrgetter("sequence", "stamp", "drive_voltage", "row_period")
    return [(f.voltages.tobytes(), f.voltages.shape, tuple(f.grounded), timing(f)) for f in frames]


def a_capture(path, act=None, rows=False):
    """Capture a while of a device; return the frames and the rows that it delivered."""
    with plugged(sensor()) as port:
        device = SerialDevice(port.path, E, capture=str(path))
        device.run_length = 4
        watch, runs = Watch(device), []
        device.open(watch, runs.append if rows else None)
        watch.wait_for_frames(10)
        if act is not None:
            act(port, watch)
        device.close()
    return watch.frames, runs


def losing_some(port, watch) -> None:
    """Lose packets, change settings, unplug and plug in again."""
    count = itertools.count()
    port._mangle = lambda data: data if next(count) % 7 else data[:-20]
    watch.wait_for_frames(20)
    watch.device.set_scan((3, 1, 3))
    watch.wait_for(lambda s: len(watch.frames[-1].grounded) == 3)
    watch.device.set_rate(50.0)
    watch.wait_for_frames(5)
    port.unplug()
    watch.wait_for(lambda s: s.state == "disconnected")
    watch.device.set_scan(())


@pytest.mark.parametrize("rows", [False, True])
def test_a_capture_lived_again_gives_the_same_frames_to_the_bit(tmp_path, rows):
    frames, runs = a_capture(tmp_path / "a.raw", losing_some, rows)
    again, runs_again = [], []
    device = relive(tmp_path / "a.raw", again.append, runs_again.append)
    assert bits(again) == bits(frames) and bits(runs_again) == bits(runs)
    assert bool(runs) == rows
    assert device.status().counters["frames_incomplete"] > 0
    data = (tmp_path / "a.raw").read_bytes()
    for length in (len(data) - 1, len(data) // 2, len(data) // 7):  # cut, it is good up to there
        (tmp_path / "cut.raw").write_bytes(data[:length])
        part = []
        relive(tmp_path / "cut.raw", part.append)
        assert bits(part) == bits(frames)[: len(part)]


def test_a_capture_never_touches_a_file_that_is_there(tmp_path):
    (tmp_path / "a.raw").write_text("precious")
    a_capture(tmp_path / "a.raw")
    assert (tmp_path / "a.raw").read_text() == "precious"
    assert (tmp_path / "a-2.raw").read_bytes().startswith(FORMAT)
    (tmp_path / "link.raw").symlink_to(tmp_path / "victim")
    a_capture(tmp_path / "link.raw")
    assert not (tmp_path / "victim").exists()
    with pytest.raises(InputError, match="capture: .*cannot be made"):
        SerialDevice("/dev/null", E, capture=str(tmp_path / "no" / "a.raw")).open(print)


def test_a_capture_goes_no_further_than_its_largest_size(tmp_path, monkeypatch):
    monkeypatch.setattr(capture_module, "MAX_BYTES", 4000)
    with connected(capture=str(tmp_path / "a.raw")) as (_, watch):
        watch.wait_for(lambda s: any(trouble.name == "capture" for trouble in s.troubles))
        watch.wait_for_frames(3)
    assert (tmp_path / "a.raw").stat().st_size <= 4000
    relive(tmp_path / "a.raw", lambda frame: None)  # good up to there


def with_first_tag(data, content):
    """The capture with something else than the first tag in the record that tells it."""
    record = b"G" + struct.pack("<dI", 0.0, len(content)) + content
    return re.sub(rb"G\0{8}.\0{3}\d+", lambda _: record, data, count=1, flags=re.DOTALL)


DAMAGES = [
    (lambda data: b"#!/bin/sh\n", "is no raw capture"),
    (lambda data: FORMAT + b"{\n", "line 2: is no JSON"),
    (lambda data: FORMAT + b"[]\n", "line 2: is no mapping"),
    (lambda data: FORMAT + json.dumps({"port": 3}).encode() + b"\n", "line 2: "),
    (lambda data: data.replace(b"O", b"?", 1), "the device"),
    (lambda data: data + 13 * b"\xff", "longer than any record"),
    (lambda data: FORMAT + 9000 * b"[" + b"\n", "line 2: is no JSON"),
    (lambda data: data.replace(b'"usual_order": []', b'"usual_order": 3', 1), "list of electr"),
    (lambda data: data.replace(b'"address": 0', b'"address": 999', 1), "is damaged"),
    (lambda data: with_first_tag(data, b"1e999"), "is damaged"),
    (lambda data: with_first_tag(data, 9000 * b"["), "is no JSON"),
]


def test_a_file_that_is_no_capture_or_another_one_is_refused_in_one_line(tmp_path, mistake):
    a_capture(tmp_path / "a.raw")
    for damage, words in DAMAGES:
        (tmp_path / "b.raw").write_bytes(damage((tmp_path / "a.raw").read_bytes()))
        line = mistake("replay --raw b.raw")
        assert words in line and "b.raw" in line


def test_record_writes_the_frames_and_the_capture_that_gives_them_again(
    tmp_path, capsys, monkeypatch
):
    monkeypatch.setattr("tomotactile_ros.devices.stream.PATIENCE", 30.0)
    raw, out, again = (str(tmp_path / name) for name in ("line.raw", "live.npz", "again.npz"))
    device = EmulatedDevice(idle_source(16), 16, rate=100.0)
    with plugged(device) as port:
        words = ["record", "--port", port.path, "--layout", "equal-4x4", "--frames", "12"]
        assert main([*words, "--raw", raw, "--out", out]) == 0
        assert "live.npz and" in capsys.readouterr().out
        assert main(words) == 2
        assert "--out: is missing" in capsys.readouterr().err
        port.device.streaming = False
    assert main(["replay", "--raw", raw, "--layout", "equal-4x4", "--out", again]) == 0
    live, relived = load_frames(out), load_frames(again)
    assert len(live.stamps) == 12
    assert np.array_equal(relived.stamps[:12], live.stamps)
    assert relived.voltages[:12].tobytes() == live.voltages.tobytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["again.npz", "line.raw", "live.npz"]
