"""Reads recorded frames: `frames.npz` of `tomotactile simulate`, or a rosbag2 (mcap, sqlite3).

Bags are read with `rosbags`, which needs no ROS; the message is described by msg/VoltageFrame.msg.
"""

from __future__ import annotations

import os
import sys
import zipfile
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tomotactile_ros.devices.base import Frame
from tomotactile_ros.errors import InputError

MESSAGE = "tomotactile_ros/msg/VoltageFrame"


def read_frames(path: str | os.PathLike[str], drive_voltage: float = 3.3) -> Iterator[Frame]:
    """Frames of a recording in its order, with their recorded stamps.

    Parameters
    ----------
    path : path
        A ``.npz`` file, a bag's folder, or a ``.mcap`` or ``.db3`` file.
    drive_voltage : float, V
        For ``.npz`` files, which may hold their own as ``drive_voltage``.

    Raises
    ------
    InputError
        Missing file, wrong keys or shapes, no frames, no library for bags.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such recording; expected frames.npz or a rosbag2")
    return _npz_frames(path, drive_voltage) if path.suffix == ".npz" else _bag_frames(path)


def _npz_frames(path: Path, drive_voltage: float) -> Iterator[Frame]:
    try:
        with np.load(path, allow_pickle=False) as data:
            arrays = {k: data[k] for k in data.files if k in _NPZ_SHAPES or k == "drive_voltage"}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise InputError(f"{path}: not a readable .npz file ({error})") from None
    _check_npz(path, arrays)
    drive = float(arrays.get("drive_voltage", np.array(drive_voltage)))
    grounded = arrays["grounded"].astype(np.uint16)
    for sequence, (voltages, stamp) in enumerate(
        zip(arrays["voltages"], arrays["stamps"], strict=True)
    ):
        yield Frame(voltages.astype(np.float32), grounded, sequence, float(stamp), drive)


_NPZ_SHAPES = {"voltages": "(N, L, E)", "grounded": "(L)", "stamps": "(N)"}


def _check_npz(path: Path, arrays: dict[str, np.ndarray]) -> None:
    for key, shape in _NPZ_SHAPES.items():
        if key not in arrays:
            raise InputError(f"{path}: {key}: missing, expected an array {shape}")
        if arrays[key].ndim != shape.count(",") + 1 or arrays[key].dtype.kind not in "fiu":
            raise InputError(
                f"{path}: {key}: shape {arrays[key].shape} of {arrays[key].dtype}, "
                f"expected numbers {shape}"
            )
    frames, rows, electrodes = arrays["voltages"].shape
    if arrays["grounded"].size != rows or arrays["stamps"].size != frames:
        raise InputError(f"{path}: voltages, grounded and stamps differ in length")
    if not np.isin(arrays["grounded"], np.arange(electrodes)).all():
        raise InputError(f"{path}: grounded: indices of electrodes must be 0 ... {electrodes - 1}")
    drive = arrays.get("drive_voltage", np.zeros(()))
    if drive.shape != () or drive.dtype.kind not in "fiu" or not np.isfinite(drive):
        raise InputError(f"{path}: drive_voltage: expected one number, V")
    if not np.isfinite(arrays["stamps"]).all():
        raise InputError(f"{path}: stamps: not all finite")


def _bag_frames(path: Path) -> Iterator[Frame]:
    try:
        from rosbags.highlevel import AnyReader, AnyReaderError
    except ImportError:
        raise InputError(f"{path}: reading bags needs the Python package rosbags") from None
    try:
        with AnyReader([path], default_typestore=_typestore()) as reader:
            connections = [c for c in reader.connections if c.msgtype == MESSAGE]
            _check_topics(path, connections)
            for connection, _, data in reader.messages(connections):
                yield _frame_of_message(path, reader.deserialize(data, connection.msgtype))
    except (AnyReaderError, OSError) as error:
        raise InputError(f"{path}: not a readable rosbag2 ({error})") from None


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
    )


def _typestore():
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    typestore = get_typestore(Stores.ROS2_HUMBLE)
    typestore.register(get_types_from_msg(_definition(), MESSAGE))
    return typestore


def _definition() -> str:
    """Text of msg/VoltageFrame.msg: in the source tree, or where ament installed it."""
    prefixes = [p for p in os.environ.get("AMENT_PREFIX_PATH", "").split(os.pathsep) if p]
    folders = [Path(__file__).resolve().parents[2]]
    folders += [Path(p, "share", "tomotactile_ros") for p in [*prefixes, sys.prefix]]
    for folder in folders:
        file = folder / "msg" / "VoltageFrame.msg"
        if file.is_file():
            return file.read_text(encoding="utf-8")
    raise InputError("VoltageFrame.msg: not found; source the workspace or run from its sources")
