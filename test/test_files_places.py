"""Files: found by name, written whole or not at all, refused early where that cannot be."""

import os
from pathlib import Path

import pytest

from tomotactile_ros import files
from tomotactile_ros.errors import InputError


def test_installed_file_is_found_in_a_ros_prefix_first(tmp_path, monkeypatch):
    folder = tmp_path / "share/tomotactile_ros/config/layouts"
    folder.mkdir(parents=True)
    for name in ("equal-8x8.yaml", "mine.yaml"):
        (folder / name).touch()
    before = os.environ.get("AMENT_PREFIX_PATH", "")
    prefixes = [str(tmp_path / "no"), str(tmp_path), before]
    monkeypatch.setenv("AMENT_PREFIX_PATH", os.pathsep.join(prefixes))
    assert files.find_config("layouts", "mine") == folder / "mine.yaml"
    assert files.find_config("layouts", "mine.yaml") == folder / "mine.yaml"
    assert files.find_config("layouts", "equal-8x8") == folder / "equal-8x8.yaml"
    assert files.find_config("layouts", "equal-4x4").parent != folder


def test_a_file_of_that_name_here_comes_before_an_installed_one(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("equal-8x8").touch()
    assert files.find_config("layouts", "equal-8x8") == Path("equal-8x8")


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("", "'': no such file, and none of the installed layouts: .*equal-4x4"),
        ("/", "'/': no such file"),
        ("x" * 5000, "'xxx.*…: cannot be read: File name too long"),
    ],
)
def test_what_is_no_file_is_one_line(name, line):
    with pytest.raises(InputError, match=f"^{line}") as error:
        files.find_config("layouts", name)
    assert "\n" not in str(error.value)


@pytest.mark.parametrize("step", ["fsync", "replace"])
def test_a_failing_write_leaves_the_old_file(tmp_path, monkeypatch, step):
    path = tmp_path / "layout.yaml"
    path.write_text("old")

    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(files.os, step, full)
    with pytest.raises(InputError, match="layout.yaml: cannot be written: No space left"):
        files.write_atomic(path, b"new")
    assert path.read_text() == "old"
    assert os.listdir(tmp_path) == ["layout.yaml"]


@pytest.mark.parametrize(
    ("place", "reason"),
    [
        ("/dev/null", "is a device"),
        ("/", "is a folder"),
        ("/no/where/out.npz", "there is no folder /no/where"),
        ("/proc/out.npz", ""),
    ],
)
def test_a_place_that_takes_no_file_is_refused_and_left_alone(place, reason):
    for work in (files.check_folder, lambda path: files.write_atomic(path, b"new")):
        with pytest.raises(InputError, match=f"^{place}: cannot be written: {reason}"):
            work(place)
    assert Path("/dev/null").is_char_device()
