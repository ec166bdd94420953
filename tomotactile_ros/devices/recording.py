"""Recorded frames: `frames.npz` in and out, a rosbag2 (mcap, sqlite3) in.

Bags are read by `tomotactile_ros.devices.bag`.
"""

from __future__ import annotations

import math
import os
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tomotactile_ros.devices.bag import read_bag
from tomotactile_ros.frame import Frame
from tomotactile_ros.frames_file import (
    DEFAULT_DRIVE,
    FramesFile,
    StoredFrames,
    law_entry,
    load_frames,
    open_frames,
)
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.layout_ids import matches, note_bare
from tomotactile_ros.scenes.contact_law import ContactLaw
from tomotactile_ros.support import checks
from tomotactile_ros.support.checks import plain
from tomotactile_ros.support.errors import InputError, complaints_at
from tomotactile_ros.support.npz_writer import npz_writer

BAGS = (".mcap", ".db3")  # files of rosbag2; it may also be a folder
_ABOVE, _OFTEN = 1.1, 0.1  # times the drive voltage; of the readings
_BELOW = 0.1  # times the drive voltage: no offset, hum or drift of a working input is that large
_TO_IMPORT = (".csv", ".tsv", ".txt", ".dat", ".mat", ".npy")  # files of other programs
_WRONG_DRIVE = 10.0  # times the drive voltage, up to which that is what is wrong


def read_frames(
    path: str | os.PathLike[str],
    drive_voltage: float = DEFAULT_DRIVE,
    electrodes: int | None = None,
    layout_id: str | None = None,
    topic: str | None = None,
) -> Iterator[Frame]:
    """Frames of a recording in its order, with their recorded stamps.

    Parameters
    ----------
    path : path
        A ``.npz`` file, a bag's folder, or a ``.mcap`` or ``.db3`` file.
    drive_voltage : float, V
        For ``.npz`` files, which may hold their own as ``drive_voltage``.
    electrodes : int
        That every frame must have; any number if None.
    layout_id : str
        Of the layout that the frames must be of, where they name one; any if None.
    topic : str
        Of a bag with frames on several.

    Raises
    ------
    InputError
        Missing or damaged file, wrong keys or shapes, impossible values, no library for bags,
        another layout.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such recording; expected frames.npz or a rosbag2")
    refuse_to_import(path)
    if path.suffix != ".npz":
        return _checked(path, _bag_frames(path, layout_id, topic), electrodes)
    if topic:
        raise InputError(f"{path}: topic: only bags have topics")
    return _checked(path, _npz_frames(path, drive_voltage, layout_id), electrodes)


def refuse_to_import(path: Path) -> None:
    """Say how a file of another program becomes a recording."""
    if path.suffix.lower() in _TO_IMPORT:
        raise InputError(
            f"{path}: is no recording yet: 'tomotactile import {path} --layout LAYOUT --out frames.npz' makes "
            "one of it"
        )


def load_recording(
    path: str | os.PathLike[str],
    layout: Layout,
    drive_voltage: float | None = None,
    topic: str | None = None,
    stored: bool = False,
) -> FramesFile:
    """All frames of a recording of a layout, for the commands; InputError for anything else.

    `drive_voltage` (V) stands for the recording's own, `topic` names one of a bag with several. The
    frames of a bag must agree in their ground conditions and drive voltage. `stored` : any length, in
    little memory: they are `StoredFrames`, without truth.
    """
    if Path(path).suffix == ".npz" and not topic:
        found = open_frames(path, layout.id) if stored else load_frames(path, layout.id)
        return _driven(path, found, drive_voltage)
    read = partial(
        read_frames, path, electrodes=layout.electrodes, layout_id=layout.id, topic=topic
    )
    frames = read()
    first = next(frames)
    stamps, row_periods = [first.stamp], [first.row_period]
    for frame in frames:
        _check_alike(path, frame, first, drive_voltage is None)
        stamps.append(frame.stamp)
        row_periods.append(frame.row_period)
    voltages = StoredFrames(
        lambda: (frame.voltages for frame in read()), (len(stamps), *first.voltages.shape)
    )
    return FramesFile(
        voltages if stored else np.array(list(voltages)),
        first.grounded,
        first.drive_voltage if drive_voltage is None else drive_voltage,
        np.array(stamps),
        row_period=float(np.median(row_periods)),
    )


def _driven(path, found: FramesFile, drive_voltage: float | None) -> FramesFile:
    """The file with its drive voltage, or another, V; InputError where readings cannot be in V."""
    if drive_voltage is None:
        drive_voltage = found.drive_voltage or DEFAULT_DRIVE
    checks.positive(drive_voltage, f"{path}: drive_voltage", "voltage in V")
    check_unit(f"{path}: ", found.voltages, drive_voltage)
    return replace(found, drive_voltage=drive_voltage)


def save_recording(
    path: str | os.PathLike[str],
    layout: Layout,
    frames: Iterable[Frame],
    law: ContactLaw | None = None,
) -> None:
    """Write frames as `frames.npz`, of contacts with this law or with none that is known; InputError
    where more than readings and times differ."""
    with frames_writer(path, layout.id, law) as take:
        for frame in frames:
            take(frame)


def _checked(path: Path, frames: Iterator[Frame], electrodes: int | None) -> Iterator[Frame]:
    frame = None
    for frame in frames:
        where, found = f"{path}: frame {frame.sequence}", frame.voltages.shape[1]
        if electrodes not in (None, found):
            raise InputError(f"{where} has {found} electrodes, the layout {electrodes}")
        if frame.grounded.max(initial=0) >= found:
            raise InputError(f"{where}: grounded: must be electrodes 0 ... {found - 1}")
        if np.isinf(frame.voltages).any():
            raise InputError(f"{where}: a voltage is infinite; NaN marks an invalid reading")
        checks.positive(frame.drive_voltage, f"{where}: drive_voltage", "voltage in V")
        checks.not_negative(frame.row_period, f"{where}: row_period", "time in s")
        yield frame
    if frame is None:
        raise InputError(f"{path}: holds no frame")


def check_unit(place: str, frames: Iterable[np.ndarray], drive_voltage: float) -> None:
    """Refuse readings that are not in V: many are above what drives them, most below zero, or none
    is valid. `place` is the start of the complaint."""
    count, above, below, highest, whole = 0, 0, 0, 0.0, True
    for frame in frames:
        valid = frame[np.isfinite(frame)]
        below += int(np.count_nonzero(valid < -_BELOW * drive_voltage))
        valid = np.abs(valid)
        count += valid.size
        above += int(np.count_nonzero(valid > _ABOVE * drive_voltage))
        highest = max(highest, float(valid.max(initial=0.0)))
        whole = whole and bool((valid == np.round(valid)).all())
    if not count:
        raise InputError(f"{place}voltages: none is a valid reading, all are NaN")
    if below > count / 2:
        raise InputError(
            f"{place}voltages: most are far below 0 V, and nothing drives the sheet below it: "
            "are two inputs exchanged?"
        )
    if above <= _OFTEN * count:
        return
    if highest < _WRONG_DRIVE * drive_voltage:
        meant = "is the drive voltage right (--drive-voltage)?"
    elif highest <= 65535 and whole:
        meant = "are they counts of a converter? Multiply by its volts per count"
    elif highest <= 1e3 * _ABOVE * drive_voltage:
        meant = "are they in mV? Divide by 1000"
    else:
        meant = "are they in V?"
    raise InputError(
        f"{place}voltages: readings up to {plain(highest, 4)} V at a drive voltage of {drive_voltage:g} V: "
        f"{meant}"
    )


def _check_alike(path, frame: Frame, first: Frame, driven_alike: bool = True) -> None:
    where = f"{path}: frame {frame.sequence}"
    if not np.array_equal(frame.grounded, first.grounded):
        same = np.array_equal(np.sort(frame.grounded), np.sort(first.grounded))
        how = "the same electrodes in another order" if same else "it grounds other electrodes"
        raise InputError(f"{where} has other ground conditions than the first one: {how}")
    if driven_alike and frame.drive_voltage != first.drive_voltage:
        raise InputError(
            f"{where} was driven with {frame.drive_voltage:g} V, the first one with "
            f"{first.drive_voltage:g} V"
        )


def _npz_frames(path: Path, drive_voltage: float, layout_id: str | None) -> Iterator[Frame]:
    loaded = load_frames(path, layout_id)
    if loaded.stamps is None:
        raise InputError(f"{path}: stamps: is missing, the time of each frame in s is needed")
    for frame in replace(loaded, drive_voltage=loaded.drive_voltage or drive_voltage):
        yield replace(frame, voltages=frame.voltages.astype(np.float32))


def _bag_frames(path: Path, layout_id: str | None, topic: str | None) -> Iterator[Frame]:
    for number, message in enumerate(read_bag(path, topic)):
        _check_layout(path, message, layout_id, first=number == 0)
        with complaints_at(f"{path}: frame {message.sequence}: "):
            frame = frame_of(message)
        yield frame


def _check_layout(path: Path, message: Any, layout_id: str | None, first: bool) -> None:
    if layout_id is None:
        return
    if not matches(message.layout_id, layout_id):
        raise InputError(
            f"{path}: frame {message.sequence} is of layout '{message.layout_id}', "
            f"not of '{layout_id}'"
        )
    if first:
        note_bare(message.layout_id, layout_id, path)


def frame_of(message: Any) -> Frame:
    """What a message with the fields of VoltageFrame holds; older ones have no `row_period`. Arrays share its
    memory. InputError where the number of voltages does not fit."""
    rows, electrodes = len(message.grounded), message.electrodes
    if rows == 0 or len(message.voltages) != rows * electrodes:
        raise InputError(
            f"{len(message.voltages)} voltages do not fit: {rows} rows (grounded) of {electrodes} electrodes need "
            f"{rows * electrodes}"
        )
    stamp = message.header.stamp
    return Frame(
        np.asarray(message.voltages, np.float32).reshape(rows, electrodes),
        np.asarray(message.grounded, np.uint16),
        int(message.sequence),
        stamp.sec + stamp.nanosec / 1e9,
        float(message.drive_voltage),
        float(getattr(message, "row_period", 0.0)),
    )


@contextmanager
def frames_writer(
    path: str | os.PathLike[str], layout_id: str | None = None, law: ContactLaw | None = None
) -> Iterator[Callable[[Frame], None]]:
    """A function that takes frames into a `frames.npz`, in little memory however many there are.

    The file is there at the end, whole or not at all. Frames whose ground conditions or drive
    voltage differ from those of the first one are refused with InputError, and so is none.
    """
    first: list[Frame] = []
    row_periods: list[float] = []

    def take(frame: Frame) -> None:
        first.extend([frame][len(first) :])
        _check_alike(Path(path), frame, first[0])
        row_periods.append(frame.row_period)
        writer.append(voltages=np.asarray(frame.voltages, np.float32))
        if math.isfinite(first[0].stamp):  # otherwise nobody knows the times of any
            writer.append(stamps=float(frame.stamp))

    with npz_writer(path) as writer:
        yield take
        if not first:
            raise InputError(f"{path}: no frame came, nothing is written")
        writer.put(
            grounded=np.asarray(first[0].grounded, np.uint16),
            drive_voltage=float(first[0].drive_voltage),
            row_period=float(np.median(row_periods)),
            contact_law=np.array(law_entry(law)),
        )
        if layout_id is not None:
            writer.put(layout_id=layout_id)
