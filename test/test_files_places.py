"""Files: found by name, written whole or not at all, refused early where that cannot be."""

import io
import os
import zipfile
from pathlib import Path

import numpy as np
import pytest
from process_support import python

from tomotactile_ros.devices.recording import read_frames
from tomotactile_ros.frames_file import load_arrays
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.support import files
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.yamlio import read_mapping


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


@pytest.mark.parametrize(
    ("name", "line"),
    [
        ("", "'': no such file, and none of the installed layouts: .*equal-4x4"),
        ("/", "'/': no such file"),
        ("equal8x8", "'equal8x8': no such file, .*; did you mean equal-8x8[?]$"),
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


@pytest.mark.parametrize("read", [read_mapping, load_arrays, lambda path: next(read_frames(path))])
@pytest.mark.parametrize("suffix", [".npz", ".db3"])
def test_what_would_never_end_is_not_read(tmp_path, read, suffix):
    fifo, zero = tmp_path / f"fifo{suffix}", tmp_path / f"zero{suffix}"
    os.mkfifo(fifo)
    zero.symlink_to("/dev/zero")
    for path in (fifo, zero):
        with pytest.raises(InputError, match="is not a plain file"):
            read(path)


def test_a_file_that_grows_while_it_is_read_or_takes_too_long_is_given_up(tmp_path, monkeypatch):
    path = tmp_path / "file"
    path.write_bytes(b"12345")
    with pytest.raises(InputError, match="larger than"):
        files.read_limited(path, 4)
    monkeypatch.setattr(files, "READ_TIME", -1.0)
    with pytest.raises(InputError, match="cannot be read within"):
        files.read_limited(path, 5)
    with pytest.raises(InputError, match="larger than"):  # says that it holds nothing
        files.read_limited("/proc/self/maps", 100)


SECRET = "c0rrect-h0rse"


TEXTS = "{0}|root:{0}:x|- {0}|{0}: 1\n{0}: 2|a: *{0}|a: !{0} 1|%{0}|format: {0}|password: {0}\n"


@pytest.mark.parametrize("text", TEXTS.format(SECRET).split("|"))
def test_a_refusal_does_not_tell_what_stands_in_the_file(tmp_path, text):
    from tomotactile_ros.scenes.scene import load_scene

    path = tmp_path / "file"
    path.write_text(text)
    for load in (read_mapping, load_layout, load_scene):
        try:
            load(path)
        except InputError as error:
            assert SECRET not in str(error)


def test_a_recording_that_grows_without_bounds_is_refused(tmp_path):
    bomb = tmp_path / "bomb.npz"
    large = np.zeros(150_000_000, np.uint8)
    np.savez_compressed(bomb, voltages=large, grounded=large)
    assert bomb.stat().st_size < 1e6
    with pytest.raises(InputError, match="would grow to 300 MB"):
        load_arrays(bomb)


@pytest.mark.parametrize("shape", [(10**10,), (2**62, 8)])
def test_an_array_that_declares_more_than_is_there_is_refused(tmp_path, shape):
    stream = io.BytesIO()
    header = {"descr": "<f2", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(stream, header)
    path = tmp_path / "large.npz"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("voltages.npy", stream.getvalue() + bytes(100))
    with pytest.raises(InputError, match="declared, "):
        load_arrays(path)


def test_what_is_written_has_the_permissions_that_the_umask_leaves(tmp_path):
    before = os.umask(0o027)
    try:
        files.write_atomic(tmp_path / "new", b"1")
    finally:
        os.umask(before)
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o640
    (tmp_path / "new").chmod(0o600)
    files.write_atomic(tmp_path / "new", b"2")
    assert (tmp_path / "new").stat().st_mode & 0o777 == 0o600


def test_a_link_stays_and_its_target_is_written(tmp_path):
    (tmp_path / "far").mkdir()
    target, link = tmp_path / "far" / "target", tmp_path / "link"
    target.write_text("old")
    link.symlink_to(target)
    files.write_atomic(link, b"new")
    assert link.is_symlink() and target.read_text() == "new"
    assert os.listdir(tmp_path / "far") == ["target"]


NAME = "\x1b[2J\x1b[H[INFO] all is well\n"


def test_names_from_files_reach_terminals_and_logs_escaped(tmp_path, capsys):
    from tomotactile_ros.cli import main

    layout = tmp_path / "layout.yaml"
    load_layout("equal-4x4").save(layout)
    layout.write_text(layout.read_text().replace("name: equal-4x4", f"name: {NAME!r}"))
    layout.write_text(layout.read_text().replace("'\\x1b", '"\\x1b').replace("\\n'", '\\n"'))
    assert main(["inspect", str(layout)]) == 2
    arrays = tmp_path / "arrays.npz"
    np.savez(arrays, **{NAME.replace("/", ""): np.zeros(3)})
    assert main(["inspect", str(arrays)]) == 0
    with zipfile.ZipFile(arrays, "w") as archive:
        archive.writestr(NAME, b"no array")
    assert main(["inspect", str(arrays)]) == 2
    told = capsys.readouterr()
    for line in (told.out + told.err).split("\n"):
        assert line.isprintable() and not line.startswith("[INFO]")
    assert "\\x1b[2J" in told.out and "\\x1b[2J" in told.err


@pytest.mark.parametrize("entries", [1, 4000])
def test_a_full_disk_is_told_with_the_name_of_the_file(tmp_path, entries):
    """Sizes of files are limited in a process of its own; what is buffered fails when it is closed."""
    program = f"""
import resource, signal, sys
import numpy as np
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.npz_writer import npz_writer
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (64, 64))
try:
    with npz_writer("out.npz") as writer:
        for number in range({entries}):
            writer.append(values=np.full(16, number, float))
except InputError as error:
    sys.exit(str(error))
"""
    done = python("-c", program, cwd=tmp_path)
    assert done.stderr == "out.npz: cannot be written: File too large\n"
    assert not list(tmp_path.iterdir())
