"""Voltage frames of a rosbag2 (mcap, sqlite3), with or without ROS.

Where a ROS 2 is sourced its own reader, `rosbag2_py`, is used, which knows every storage and
compression that is installed there; otherwise `rosbags`, which needs no ROS and is told by
msg/VoltageFrame.msg what a frame is. Nothing else below `nodes/` imports anything of ROS.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from pathlib import Path

from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import shared_folders
from tomotactile_ros.support.yamlio import read_mapping

MESSAGE = "tomotactile_ros/msg/VoltageFrame"
ROWS_TOPIC = "voltage_rows"
_METADATA = "metadata.yaml"
_STORAGE = {".mcap": "mcap", ".db3": "sqlite3"}


def read_bag(path: Path, topic: str | None = None) -> Iterator[object]:
    """Messages, in their order, with the fields of VoltageFrame (older ones without `row_period`).

    Parameters
    ----------
    path : a bag's folder, or a ``.mcap`` or ``.db3`` file.
    topic : which one, where frames are on several; None where they are on one.

    Raises InputError for anything that cannot be read.
    """
    _check_plain(path)
    read = _with_ros if _has_ros() else _with_rosbags
    try:
        yield from read(path, topic)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001 - a damaged bag ends in errors of many kinds
        reason = " ".join(str(error).split()) or type(error).__name__
        raise InputError(f"{path}: not a readable rosbag2 ({reason})") from None


def _check_plain(path: Path) -> None:
    """A bag's files must be plain ones: a named pipe would keep the reader waiting. What lies there
    as metadata must be YAML of a bag's size; otherwise its reader takes minutes, and cites it."""
    for file in path.iterdir() if path.is_dir() else [path]:
        if not file.is_file() and not file.is_dir():
            raise InputError(f"{file}: cannot be read: is not a plain file")
    if (path / _METADATA).is_file():
        read_mapping(path / _METADATA)


def _has_ros() -> bool:
    try:
        import rosbag2_py  # noqa: F401
    except ImportError:
        return False
    return True


def _with_ros(path: Path, topic: str | None) -> Iterator[object]:
    import rosbag2_py
    from rclpy.serialization import deserialize_message

    from tomotactile_ros.msg import VoltageFrame

    reader = rosbag2_py.SequentialReader()
    storage = rosbag2_py.StorageOptions(uri=str(path), storage_id=_STORAGE.get(path.suffix, ""))
    reader.open(storage, rosbag2_py.ConverterOptions("", ""))
    topics = {t.name for t in reader.get_all_topics_and_types() if t.type == MESSAGE}
    chosen = _choose(path, topics, topic)
    reader.set_filter(rosbag2_py.StorageFilter(topics=[chosen]))
    while reader.has_next():
        _, data, _ = reader.read_next()
        yield deserialize_message(data, VoltageFrame)


def _with_rosbags(path: Path, topic: str | None) -> Iterator[object]:
    try:
        from rosbags.highlevel import AnyReader
    except ImportError:
        raise InputError(
            f"{path}: reading bags needs rosbag2_py of a sourced ROS 2, or the Python package rosbags"
        ) from None
    with AnyReader([path], default_typestore=_typestore()) as reader:
        connections = [c for c in reader.connections if c.msgtype == MESSAGE]
        chosen = _choose(path, {c.topic for c in connections}, topic)
        for _, _, data in reader.messages([c for c in connections if c.topic == chosen]):
            yield _deserialize(reader, data)


def _choose(path: Path, topics: set[str], wanted: str | None) -> str:
    """The topic to read; rows of the same frames are left out where there are frames."""
    listed = ", ".join(sorted(topics))
    if not topics:
        raise InputError(f"{path}: holds no {MESSAGE}")
    if wanted:
        if wanted not in topics and f"/{wanted}" not in topics:
            raise InputError(f"{path}: topic: no frames on {wanted}, but on {listed}")
        return wanted if wanted in topics else f"/{wanted}"
    whole = {name for name in topics if not name.endswith(f"/{ROWS_TOPIC}")} or topics
    if len(whole) > 1:
        raise InputError(f"{path}: frames on several topics ({listed}): name one as topic")
    return next(iter(whole))


def _deserialize(reader, data: bytes):
    """A message of the bag; one of before there was a row period where the bag does not say."""
    try:
        return reader.deserialize(data, MESSAGE)
    except Exception:  # noqa: BLE001 - too short, in whatever words
        return _typestore(without="float32 row_period").deserialize_cdr(data, MESSAGE)


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
