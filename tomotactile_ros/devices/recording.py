"""Reads recorded frames: `frames.npz` of `tomotactile simulate`, or a rosbag2 (mcap, sqlite3).

Bags are read with `rosbags`, which needs no ROS; the message is described by msg/VoltageFrame.msg.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import replace
from functools import cache
from pathlib import Path

import numpy as np

from tomotactile_ros import checks
from tomotactile_ros.devices.base import Frame
from tomotactile_ros.errors import InputError
from tomotactile_ros.files import shared_folders
from tomotactile_ros.frames_file import DEFAULT_DRIVE, FramesFile, load_frames
from tomotactile_ros.layout import Layout

MESSAGE = "tomotactile_ros/msg/VoltageFrame"


def read_frames(
    path: str | os.PathLike[str],
    drive_voltage: float = DEFAULT_DRIVE,
    electrodes: int | None = None,
    layout_id: str | None = None,
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

    Raises
    ------
    InputError
        Missing or damaged file, wrong keys or shapes, impossible values, no library for bags,
        another layout.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such recording; expected frames.npz or a rosbag2")
    is_npz = path.suffix == ".npz"
    if not is_npz:
        _check_plain(path)
    frames = _npz_frames(path, drive_voltage, layout_id) if is_npz else _bag_frames(path, layout_id)
    return _checked(path, frames, electrodes)


def load_recording(
    path: str | os.PathLike[str], layout: Layout, drive_voltage: float | None = None
) -> FramesFile:
    """All frames of a recording of a layout, for the commands; InputError for anything else.

    `drive_voltage` (V) stands for the recording's own. The frames of a bag must agree in their
    ground conditions and drive voltage.
    """
    if Path(path).suffix == ".npz":
        loaded = load_frames(path, layout.id)
        if drive_voltage is None:
            drive_voltage = loaded.drive_voltage or DEFAULT_DRIVE
        checks.positive(drive_voltage, f"{path}: drive_voltage", "voltage in V")
        return replace(loaded, drive_voltage=drive_voltage)
    frames = list(read_frames(path, electrodes=layout.electrodes, layout_id=layout.id))
    if drive_voltage is not None:
        frames = [replace(frame, drive_voltage=drive_voltage) for frame in frames]
    first = frames[0]
    for frame in frames:
        _check_alike(path, frame, first)
    return FramesFile(
        np.array([frame.voltages for frame in frames]),
        first.grounded,
        first.drive_voltage,
        np.array([frame.stamp for frame in frames]),
        row_period=float(np.median([frame.row_period for frame in frames])),
    )


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


def _check_alike(path: Path, frame: Frame, first: Frame) -> None:
    where = f"{path}: frame {frame.sequence}"
    if not np.array_equal(frame.grounded, first.grounded):
        raise InputError(f"{where} has other ground conditions than the first one")
    if frame.drive_voltage != first.drive_voltage:
        raise InputError(
            f"{where} was driven with {frame.drive_voltage:g} V, the first one with "
            f"{first.drive_voltage:g} V"
        )


def _npz_frames(path: Path, drive_voltage: float, layout_id: str | None) -> Iterator[Frame]:
    loaded = load_frames(path, layout_id)
    if loaded.stamps is None:
        raise InputError(f"{path}: stamps: is missing, the time of each frame in s is needed")
    drive = loaded.drive_voltage or drive_voltage
    for sequence, (voltages, stamp) in enumerate(zip(loaded.voltages, loaded.stamps)):
        yield Frame(
            voltages.astype(np.float32),
            loaded.grounded,
            sequence,
            float(stamp),
            drive,
            loaded.row_period,
        )


def _check_plain(path: Path) -> None:
    """A bag's files must be plain ones: a named pipe would keep the reader waiting."""
    for file in path.iterdir() if path.is_dir() else [path]:
        if not file.is_file() and not file.is_dir():
            raise InputError(f"{file}: cannot be read: is no plain file")


def _bag_frames(path: Path, layout_id: str | None) -> Iterator[Frame]:
    try:
        from rosbags.highlevel import AnyReader
    except ImportError:
        raise InputError(f"{path}: reading bags needs the Python package rosbags") from None
    try:
        with AnyReader([path], default_typestore=_typestore()) as reader:
            connections = [c for c in reader.connections if c.msgtype == MESSAGE]
            _check_topics(path, connections)
            for connection, _, data in reader.messages(connections):
                message = _deserialize(reader, data)
                if layout_id not in (None, message.layout_id):
                    raise InputError(
                        f"{path}: frame {message.sequence} is of layout '{message.layout_id}', "
                        f"not of '{layout_id}'"
                    )
                yield _frame_of_message(path, message)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001 - a damaged bag ends in errors of many kinds
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: not a readable rosbag2 ({reason})") from None


def _deserialize(reader, data: bytes):
    """A message of the bag; one of before there was a row period where the bag does not say."""
    try:
        return reader.deserialize(data, MESSAGE)
    except Exception:  # noqa: BLE001 - too short, in whatever words
        return _typestore(without="float32 row_period").deserialize_cdr(data, MESSAGE)


def _check_topics(path: Path, connections: list) -> None:
    topics = sorted({c.topic for c in connections})
    if not topics:
        raise InputError(f"{path}: holds no {MESSAGE}")
    if len(topics) > 1:
        raise InputError(f"{path}: frames on several topics ({', '.join(topics)}), expected one")


def _frame_of_message(path: Path, message: object) -> Frame:
    electrodes = int(message.electrodes)
    grounded = np.asarray(message.grounded, dtype=np.uint16)
    voltages = np.asarray(message.voltages, dtype=np.float32)
    if electrodes == 0 or voltages.size != grounded.size * electrodes:
        raise InputError(
            f"{path}: frame {message.sequence}: {voltages.size} voltages for {grounded.size} "
            f"ground conditions of {electrodes} electrodes"
        )
    stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec
    return Frame(
        voltages.reshape(grounded.size, electrodes),
        grounded,
        int(message.sequence),
        stamp,
        float(message.drive_voltage),
        float(getattr(message, "row_period", 0.0)),
    )


@cache
def _typestore(without: str = ""):
    """Types of ROS 2 and this package's frame, or an older one `without` a line."""
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    typestore = get_typestore(Stores.ROS2_HUMBLE)
    lines = [line for line in _definition().splitlines() if line != without]
    typestore.register(get_types_from_msg("\n".join(lines), MESSAGE))
    return typestore


def _definition() -> str:
    """Text of msg/VoltageFrame.msg."""
    for folder in shared_folders():
        file = folder / "msg" / "VoltageFrame.msg"
        if file.is_file():
            return file.read_text(encoding="utf-8")
    raise InputError("VoltageFrame.msg: not found; source the workspace or run from its sources")
