"""Lets a device live a capture of its line again, as fast as it can."""

from __future__ import annotations

import math
import os
from collections.abc import Callable

from tomotactile_ros.devices.base import Frame
from tomotactile_ros.devices.capture import EndOfCapture, Relived
from tomotactile_ros.devices.serial import SerialDevice
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError, complaints_at


def relive(
    path: str | os.PathLike,
    on_frame: Callable[[Frame], None],
    on_rows: Callable[[Frame], None] | None = None,
) -> SerialDevice:
    """Let a device live a capture again, as fast as it can; return it as it is then.

    Raises
    ------
    InputError
        It is no capture, or the device does something else than it did then; also whatever the
        callbacks raise.
    """
    world = Relived(path)
    header = world.header
    run_length = _setting(path, header, "run_length", int)
    device = SerialDevice(
        _setting(path, header, "port", str),
        _setting(path, header, "electrodes", int),
        baud=_setting(path, header, "baud", int),
        partial_frames=_setting(path, header, "partial_frames", bool),
        address=_setting(path, header, "address", int),
    )
    device.max_age = _setting(path, header, "max_age", float) or math.inf
    device.run_length = max(1, run_length)
    device.usual_order = _usual_order(path, header)
    raised: list[Exception] = []

    def guarded(receive: Callable[[Frame], None]) -> Callable[[Frame], None]:
        def call(frame: Frame) -> None:
            try:
                receive(frame)
            except Exception as error:  # noqa: BLE001 - a device goes on, whatever it does
                raised.append(error)

        return call

    rows = guarded(on_rows or _nobody) if run_length else None
    try:
        device.relive(world, guarded(on_frame), rows)
    except EndOfCapture:
        pass
    except InputError:
        raise
    except Exception as error:  # noqa: BLE001 - what the file says steers all of it
        raise InputError(f"{path}: is damaged: {type(error).__name__}: {error}") from None
    if raised:
        raise raised[0]
    return device


def _nobody(rows: Frame) -> None:
    """Rows were handed on then, and nobody wants them now."""


def _setting(path: str | os.PathLike, header: dict, name: str, kind: type):
    value = header.get(name)
    if kind is float and isinstance(value, int) and not isinstance(value, bool):
        value = float(value)
    if type(value) is not kind:
        raise InputError(f"{path}: line 2: {name}: {checks.show(value)} is not what it should be")
    return value


def _usual_order(path: str | os.PathLike, header: dict) -> tuple[int, ...]:
    """The order of the header; none where it names none, as those before there was one."""
    found = header.get("usual_order", [])
    if found == []:
        return ()
    with complaints_at(f"{path}: line 2: "):
        return tuple(checks.order(found, "usual_order", header["electrodes"]).tolist())
