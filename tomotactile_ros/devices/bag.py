"""Voltage frames, or plain arrays, of a rosbag2 (mcap, sqlite3), with or without ROS.

Where a ROS 2 is sourced its own reader, `rosbag2_py`, is used, which knows every storage and
compression that is installed there; otherwise `rosbags`, which needs no ROS and is told by
msg/VoltageFrame.msg what a frame is. Nothing else below `nodes/` imports anything of ROS.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import shared_folders
from tomotactile_ros.support.yamlio import read_mapping

MESSAGE = "tomotactile_ros/msg/VoltageFrame"
ARRAYS = tuple(
    f"std_msgs/msg/{kind}MultiArray"
    for kind in ("Float32", "Float64", "Int16", "UInt16", "Int32", "UInt32")
)
ROWS_TOPIC = "voltage_rows"
_METADATA = "metadata.yaml"
_STORAGE = {".mcap": "mcap", ".db3": "sqlite3"}


def read_bag(path: Path, topic: str | None = None) -> Iterator[Any]:
    """Messages, in their order, with the fields of VoltageFrame (older ones without `row_period`).

    Parameters
    ----------
    path : a bag's folder, or a ``.mcap`` or ``.db3`` file.
    topic : which one, where frames are on several; None where they are on one.

    Raises InputError for anything that cannot be read.
    """
    for _, message in _messages(path, topic, (MESSAGE,)):
        yield message


def read_arrays(path: Path, topic: str | None = None) -> Iterator[tuple[float, Any]]:
    """Messages of one of the types `ARRAYS`, and when they were recorded (Unix time, s); else as
    `read_bag`."""
    for nanoseconds, message in _messages(path, topic, ARRAYS):
        yield 1e-9 * nanoseconds, message


def _messages(
    path: Path, topic: str | None, types: tuple[str, ...]
) -> Iterator[tuple[int, object]]:
    _check_plain(path)
    read = _with_ros if _has_ros() else _with_rosbags
    try:
        yield from read(path, topic, types)
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001 - a damaged bag ends in errors of many kinds
        reason = " ".join(str(error).split()) or type(error).__name__
        known = path.is_dir() or path.suffix in _STORAGE  # a reader may know others
        wanted = (
            "" if known else f": wanted are .npz, its folder, or a file of {', '.join(_STORAGE)}"
        )
        raise InputError(f"{path}: not a readable rosbag2 ({reason}){wanted}") from None


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


def _with_ros(
    path: Path, topic: str | None, types: tuple[str, ...]
) -> Iterator[tuple[int, object]]:
    import rosbag2_py
    from rclpy.serialization import deserialize_message

    reader = rosbag2_py.SequentialReader()
    storage = rosbag2_py.StorageOptions(uri=str(path), storage_id=_STORAGE.get(path.suffix, ""))
    reader.open(storage, rosbag2_py.ConverterOptions("", ""))
    topics = {t.name: t.type for t in reader.get_all_topics_and_types() if t.type in types}
    chosen = _choose(path, set(topics), topic, types)
    package, _, name = topics[chosen].split("/")
    kind = getattr(import_module(f"{package}.msg"), name)
    reader.set_filter(rosbag2_py.StorageFilter(topics=[chosen]))
    while reader.has_next():
        _, data, nanoseconds = reader.read_next()
        yield nanoseconds, deserialize_message(data, kind)


def _with_rosbags(
    path: Path, topic: str | None, types: tuple[str, ...]
) -> Iterator[tuple[int, object]]:
    try:
        from rosbags.highlevel import AnyReader
    except ImportError:
        raise InputError(
            f"{path}: reading bags needs rosbag2_py of a sourced ROS 2, or the Python package rosbags"
        ) from None
    with AnyReader([path], default_typestore=_typestore()) as reader:
        connections = [c for c in reader.connections if c.msgtype in types]
        chosen = _choose(path, {c.topic for c in connections}, topic, types)
        mine = [c for c in connections if c.topic == chosen]
        for connection, nanoseconds, data in reader.messages(mine):
            yield nanoseconds, _deserialize(reader, data, connection.msgtype)


def _choose(path: Path, topics: set[str], wanted: str | None, types: tuple[str, ...]) -> str:
    """The topic to read; rows of the same frames are left out where there are frames."""
    listed = ", ".join(sorted(topics))
    if not topics:
        raise InputError(f"{path}: holds no {' or '.join(types)}")
    if wanted:
        if wanted not in topics and f"/{wanted}" not in topics:
            raise InputError(f"{path}: topic: no frames on {wanted}, but on {listed}")
        return wanted if wanted in topics else f"/{wanted}"
    whole = {name for name in topics if not name.endswith(f"/{ROWS_TOPIC}")} or topics
    if len(whole) > 1:
        raise InputError(f"{path}: frames on several topics ({listed}): name one as topic")
    return next(iter(whole))


def _deserialize(reader, data: bytes, kind: str):
    """A message of the bag; one of before there was a row period where the bag does not say."""
    try:
        return reader.deserialize(data, kind)
    except Exception:
        if kind != MESSAGE:
            raise
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
