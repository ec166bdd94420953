"""Frames carry their times, from wherever they come; voltages alone are taken for read at once, and it
is said where they were not."""

import math
import warnings
from dataclasses import replace

import numpy as np
import pytest

import tomotactile_ros as tt
from tomotactile_ros.cli import main
from tomotactile_ros.frame import stacked
from tomotactile_ros.frames_file import save_arrays, save_frames
from tomotactile_ros.support.errors import Doubt

LAYOUT = tt.load_layout("equal-4x4")
SCENE = tt.load_scene("tap")
SIMULATOR = tt.Simulator(LAYOUT, SCENE)
LASTS = len(SIMULATOR.grounded) * SIMULATOR.row_period  # s
COUNT = 12  # frames, from shortly before a tap begins


@pytest.fixture(scope="module")
def frames():
    start = next(t for t in np.arange(0, 5, LASTS) if SCENE.truth(t + LASTS))
    return [SIMULATOR.measure(start + n * LASTS, n) for n in range(COUNT)]


@pytest.fixture
def pipeline():
    return tt.Pipeline(LAYOUT, tt.Settings("balanced", contact_law=SCENE.contact_law))


def test_a_tap_is_withheld_in_no_frame_that_has_its_times(pipeline, frames):
    with warnings.catch_warnings():
        warnings.simplefilter("error", Doubt)
        results = [pipeline.process(frame) for frame in frames]
    assert [result.reason for result in results if result.reason] == []
    assert any(result.contacts for result in results)
    assert {contact.id for result in results for contact in result.contacts} == {1}


def test_rows_that_contradict_each_other_without_times_are_told_once(pipeline, frames):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        for one, other in zip(frames[::2], frames[1::2]):
            pipeline.process(one.voltages, one.grounded, one.drive_voltage)
            pipeline.process(replace(other, row_period=0.0))
    (doubt,) = [str(each.message) for each in said if each.category is Doubt]
    assert doubt.startswith("row_period: 0 says that all rows are read at once")
    assert "Frame(..., stamp=..., row_period=...)" in doubt


def test_frames_read_at_once_are_not_doubted(pipeline):
    """Withheld for another reason: channels in a random order."""
    once = tt.Simulator(LAYOUT, SCENE, row_period=0.0)
    order = np.random.default_rng(3).permutation(LAYOUT.electrodes)
    with warnings.catch_warnings():
        warnings.simplefilter("error", Doubt)
        frame = once.measure(0.4)
        assert pipeline.process(replace(frame, voltages=frame.voltages[:, order])).reason


def test_files_hand_on_times(tmp_path, frames, capsys):
    voltages, grounded, drive = stacked(frames)
    path, out = tmp_path / "frames.npz", tmp_path / "result.npz"
    stamps = np.array([frame.stamp for frame in frames])
    save_frames(path, LAYOUT, SCENE, voltages, grounded, stamps, SIMULATOR.row_period)
    loaded = tt.load_frames(path)
    assert len(loaded) == COUNT and drive == SCENE.drive_voltage
    for ours, theirs in zip(frames, loaded):
        assert (theirs.stamp, theirs.row_period) == (ours.stamp, ours.row_period)
        assert (theirs.sequence, theirs.drive_voltage) == (ours.sequence, ours.drive_voltage)
        np.testing.assert_allclose(theirs.voltages, ours.voltages, atol=1e-6)
    words = [str(path), "--layout", "equal-4x4", "--profile", "fast", "--out", str(out)]
    assert main(["reconstruct", *words]) == 0
    assert "row_period" not in capsys.readouterr().err
    with np.load(path) as file:
        save_arrays(path, {name: file[name] for name in ("voltages", "grounded", "drive_voltage")})
    assert math.isnan(next(iter(tt.load_frames(path))).stamp)
    assert main(["reconstruct", *words]) == 0
    line = capsys.readouterr().err
    assert line.count("row_period: 0 says") == 1


def test_learning_takes_frames(frames):
    still = [tt.Simulator(LAYOUT, SCENE, row_period=0.0).measure(0.4, n) for n in range(2)]
    ours = tt.learn(LAYOUT, still, noise=1e-3)
    theirs = tt.learn(LAYOUT, *stacked(still), noise=1e-3)
    np.testing.assert_array_equal(ours.state.mean, theirs.state.mean)


def test_what_is_no_frame_is_refused(pipeline, frames):
    frame = frames[0]
    turned = replace(frame, grounded=frame.grounded[::-1])
    for made, complaint in (
        (lambda: pipeline.process(frame.voltages), "grounded: is missing; a Frame has it"),
        (lambda: pipeline.process(frame, frame.grounded), "grounded: the frame has its own"),
        (
            lambda: tt.learn(LAYOUT, np.zeros((2, 16, 16)), noise=1e-3),
            "at least one Frame is needed",
        ),
        (
            lambda: stacked([frame, replace(frame, drive_voltage=5.0)]),
            "frames.1.: was driven with 5 V",
        ),
        (lambda: stacked([frame, turned]), "frames.1.: has other ground conditions"),
    ):
        with pytest.raises(tt.InputError, match=complaint):
            made()
