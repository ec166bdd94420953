"""Between numpy and messages, without a Python loop over elements.

A float32[] or uint16[] field takes an `array.array` of the right type as it is; anything else would
be checked element by element. Images have row 0 at the +y edge, as everywhere in this package.
"""

import math
import sys
from array import array
from collections.abc import Iterable
from typing import Any

import numpy as np
from builtin_interfaces.msg import Time
from sensor_msgs.msg import Image, PointCloud2, PointField
from std_msgs.msg import Header

from tomotactile_ros.devices import Frame
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.msg import VoltageFrame
from tomotactile_ros.support.errors import InputError

_BIG_ENDIAN = sys.byteorder == "big"
_NANO = 1_000_000_000
_LONGEST = 3600.0  # s of a frame; of the slowest device it takes a quarter of an hour
_LATEST = 2.0**31 - 2 * _LONGEST  # s that a stamp can be, and what is added to it


def make_header(stamp: float, frame_id: str) -> Header:
    """Header of a stamp in seconds."""
    seconds, nanoseconds = divmod(round(stamp * _NANO), _NANO)
    return Header(stamp=Time(sec=seconds, nanosec=nanoseconds), frame_id=frame_id)


def later(header: Header, seconds: float) -> Header:
    """The same header `seconds` later, without rounding the stamp that it has."""
    nanoseconds = header.stamp.sec * _NANO + header.stamp.nanosec + round(seconds * _NANO)
    sec, nanosec = divmod(nanoseconds, _NANO)
    return Header(stamp=Time(sec=sec, nanosec=nanosec), frame_id=header.frame_id)


def stamp_of(header: Header) -> float:
    """Stamp of a header in seconds."""
    return header.stamp.sec + header.stamp.nanosec / _NANO


def vector(kind: type, values: Iterable[float]) -> Any:
    """(3,) numbers as a message of a `kind` with x, y and z."""
    x, y, z = map(float, values)
    return kind(x=x, y=y, z=z)


def vectors(messages: Iterable[Any]) -> np.ndarray:
    """(N, 3) x, y and z of messages."""
    return np.array([(each.x, each.y, each.z) for each in messages], float).reshape(-1, 3)


def frame_to_message(frame: Frame, layout_id: str, header: Header) -> VoltageFrame:
    """A device's frame as a message."""
    message = VoltageFrame(
        header=header,
        sequence=frame.sequence % 2**32,
        layout_id=layout_id,
        drive_voltage=float(frame.drive_voltage),
        row_period=float(frame.row_period),
        electrodes=frame.voltages.shape[1],
        grounded=_filled("H", frame.grounded, np.uint16),
    )
    message.voltages = _filled("f", frame.voltages, np.float32)  # the constructor would copy it
    return message


def check_frame(frame: Frame, layout: Layout) -> None:
    """Refuse, with the reason as InputError, a frame that cannot be one of this layout."""
    electrodes = frame.voltages.shape[1]
    if electrodes != layout.electrodes:
        raise InputError(
            f"the frame has {electrodes} electrodes, layout {layout.id} has {layout.electrodes}"
        )
    if frame.grounded.max() >= layout.electrodes:
        raise InputError(
            f"electrode {frame.grounded.max()} is said to be grounded, layout {layout.id} has "
            f"0 to {layout.electrodes - 1}"
        )
    if not 0 < frame.drive_voltage < math.inf:
        raise InputError(f"the drive voltage is {frame.drive_voltage:g} V, it must be positive")
    if not 0 <= frame.row_period * len(frame.grounded) <= _LONGEST:
        raise InputError(
            f"the row period is {frame.row_period:g} s, it must be 0 or positive, and a frame of "
            f"{len(frame.grounded)} rows no longer than {_LONGEST:g} s"
        )
    if not abs(frame.stamp) <= _LATEST:
        raise InputError(
            f"its stamp, {frame.stamp:.10g} s, is the latest a message can carry: expected are s since 1970"
        )
    largest = np.fmax.reduce(np.abs(frame.voltages), axis=None)
    if np.isnan(largest):
        raise InputError("no voltage is valid")
    if np.isinf(largest):
        raise InputError("a voltage is infinite; NaN is what marks an invalid reading")


def image_to_message(image: np.ndarray, header: Header) -> Image:
    """(H, W) numbers as 32FC1, or (H, W, 3) bytes as rgb8."""
    numbers = image.ndim == 2
    image = np.ascontiguousarray(image, np.float32 if numbers else np.uint8)
    return Image(
        header=header,
        height=image.shape[0],
        width=image.shape[1],
        encoding="32FC1" if numbers else "rgb8",
        is_bigendian=_BIG_ENDIAN,
        step=image.strides[0],
        data=_filled("B", image, image.dtype),
    )


def message_to_image(message: Image) -> np.ndarray:
    """(H, W) float32 or (H, W, 3) uint8 of an image message of this package."""
    if message.encoding == "32FC1":
        order = ">f4" if message.is_bigendian else "<f4"
        return np.frombuffer(message.data, order).reshape(message.height, message.width)
    if message.encoding == "rgb8":
        return np.frombuffer(message.data, np.uint8).reshape(message.height, message.width, 3)
    raise InputError(f"encoding {message.encoding!r} is none of 32FC1, rgb8")


def cloud_to_message(points: np.ndarray, pressure: np.ndarray, header: Header) -> PointCloud2:
    """(P, 3) positions, m, and (P,) pressures, Pa, as fields x, y, z, pressure."""
    table = np.column_stack([points, pressure]).astype(np.float32)
    names = ("x", "y", "z", "pressure")
    return PointCloud2(
        header=header,
        height=1,
        width=len(table),
        fields=[
            PointField(name=name, offset=4 * i, datatype=PointField.FLOAT32, count=1)
            for i, name in enumerate(names)
        ],
        is_bigendian=_BIG_ENDIAN,
        point_step=16,
        row_step=16 * len(table),
        data=_filled("B", table, np.float32),
        is_dense=True,
    )


def _filled(typecode: str, values: np.ndarray, dtype: type | np.dtype) -> array:
    """The values' bytes as an array that a message field takes without a check per element."""
    result = array(typecode)
    result.frombytes(np.ascontiguousarray(values, dtype).data.cast("B"))
    return result
