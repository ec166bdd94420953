"""Sources of frames: `make_device` makes the one that the settings name."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from tomotactile_ros.devices.base import Device, Frame, Status
from tomotactile_ros.devices.text import FORMATS
from tomotactile_ros.devices.time_source import TimeSource
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.scan_order import spread
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.sheet import MODELS
from tomotactile_ros.support.errors import InputError

__all__ = ["Device", "DeviceSettings", "Frame", "Status", "make_device"]

KINDS = ("fake", "serial", "replay")
PROTOCOLS = ("binary", *FORMATS)
ORDERS = ("jumping", "device", "adaptive")


def _parameter(default: Any, meaning: str, **limits: Any) -> Any:
    """A field that the driver has as a parameter; `limits` are `low` and `high`, `choices`, or whether it
    is a `path`."""
    return field(default=default, metadata={"description": meaning, **limits})


@dataclass(frozen=True)
class DeviceSettings:
    """What a device needs to know: each field says what it is.

    Attributes
    ----------
    layout : Layout
    scene : Scene or None
        For ``fake``; what touches the sheet.
    order : str
        Where neither `scan` nor the layout names electrodes: ``device`` for the device's own order,
        ``jumping`` (`layouts.scan_order`) where it takes one, ``adaptive`` where `set_scan` will be
        called in every frame.
    time : TimeSource or None
        For ``fake`` and ``replay``: the time that they live in; None for this machine's.
    beside : bool
        For ``fake``: simulate in a process of its own, where others compute in this one.
    """

    layout: Layout
    device: str = _parameter("fake", "Where the frames come from", choices=KINDS)
    rate: float = _parameter(0.0, "Frames/s; 0 leaves it to the device", low=0.0, high=10_000.0)
    scene: Scene | None = None
    model: str = _parameter("fem", "For fake: physics of the sheet", choices=MODELS)
    port: str = _parameter(
        "", "For serial: /dev/tty..., usb:VID:PID, socket:// or rfc2217://HOST:PORT", path=True
    )
    baud: int = _parameter(2_000_000, "For serial: bit/s", low=1200, high=50_000_000)
    protocol: str = _parameter(
        "binary",
        "For serial: packets, or rows that are printed as text in V, mV or counts",
        choices=PROTOCOLS,
    )
    partial_frames: bool = _parameter(
        False, "For serial: also deliver frames with rows lost on the line"
    )
    recording: str = _parameter("", "For replay: a frames.npz or a rosbag2", path=True)
    topic: str = _parameter("", "For replay: topic, for a bag of several sensors", path=True)
    loop: bool = _parameter(False, "For replay: start over at the end")
    drive_voltage: float = _parameter(
        3.3,
        "Drive voltage, V: for protocol text-..., and for replay where the recording names none",
        low=1e-3,
        high=1e3,
    )
    max_age: float = _parameter(
        0.0, "For serial: s; older readings are not published; 0: any age", low=0.0, high=3600.0
    )
    rows_per_message: int = _parameter(8, "For delivery rows: rows in a message", low=1, high=65535)
    scan: tuple[int, ...] = _parameter(
        (),
        "Electrodes to ground, row after row, also repeatedly; []: as the layout or `order` says",
        low=0,
        high=65534,
    )
    order: str = _parameter(
        "device",
        "Without scan: rows far from each other in turn, the device's own, or near contacts most often",
        choices=ORDERS,
    )
    address: int = _parameter(
        0, "For serial: address of the device on a bus; 0: it has none", low=0, high=254
    )
    capture: str = _parameter(
        "",
        "For serial: a new file for all that comes from the line, for `tomotactile replay --raw`",
        path=True,
    )
    time: TimeSource | None = None
    beside: bool = False


def make_device(settings: DeviceSettings) -> Device:
    """Make the device; nothing is opened yet.

    Raises
    ------
    InputError
        An unknown kind, a missing or impossible setting, an unreadable recording.
    """
    if not 0.0 <= settings.rate <= 1e5:
        raise InputError(
            f"rate: {settings.rate:g} frames/s cannot be; expected more, or 0 for the device's own"
        )
    if settings.device not in KINDS:
        raise InputError(f"device: {settings.device!r} is none of {', '.join(KINDS)}")
    make: dict[str, Callable[[DeviceSettings], Device]] = {
        "fake": _make_fake,
        "serial": _make_serial,
        "replay": _make_replay,
    }
    device = make[settings.device](settings)
    device.run_length = settings.rows_per_message
    if settings.time is not None and settings.device != "serial":
        device.time = settings.time
    if settings.order != "device" and settings.protocol == "binary":
        positions = settings.layout.positions
        device.usual_order = tuple(spread(positions, range(len(positions))))
    device.set_scan(settings.scan or settings.layout.scan)
    return device


def _make_fake(settings: DeviceSettings) -> Device:
    from tomotactile_ros.devices.fake import FakeDevice
    from tomotactile_ros.devices.scene_beside import SceneBeside
    from tomotactile_ros.simulation import Simulator

    if settings.scene is None:
        raise InputError("scene: missing; the fake device needs to know what touches the sheet")
    given = settings.layout, settings.scene, settings.model
    beside = SceneBeside(*given) if settings.beside and not settings.scene.live else None
    return FakeDevice(Simulator(*given), rate=settings.rate, beside=beside)


def _make_serial(settings: DeviceSettings) -> Device:
    from tomotactile_ros.devices.line import complaint_about
    from tomotactile_ros.devices.serial import SerialDevice
    from tomotactile_ros.devices.text_serial import TextSerialDevice

    if not settings.port:
        raise InputError("port: missing; expected a tty, usb:VID:PID or a URL such as socket://")
    complaint = complaint_about(settings.port)
    if complaint:
        raise InputError(complaint)
    if settings.baud <= 0:
        raise InputError(f"baud: {settings.baud} is no bit rate; expected e.g. 2000000")
    if settings.protocol not in PROTOCOLS:
        raise InputError(f"protocol: {settings.protocol!r} is none of {', '.join(PROTOCOLS)}")
    if settings.protocol != "binary":
        for name in ("capture", "partial_frames", "address"):
            if getattr(settings, name):
                raise InputError(f"{name}: is for protocol binary, not for {settings.protocol}")
        return TextSerialDevice(
            settings.port,
            settings.layout.electrodes,
            settings.protocol,
            settings.drive_voltage,
            baud=settings.baud,
            rate=settings.rate,
        )
    device = SerialDevice(
        settings.port,
        settings.layout.electrodes,
        baud=settings.baud,
        rate=settings.rate,
        partial_frames=settings.partial_frames,
        address=settings.address,
        capture=settings.capture,
    )
    device.max_age = settings.max_age or math.inf
    return device


def _make_replay(settings: DeviceSettings) -> Device:
    from tomotactile_ros.devices.replay import ReplayDevice

    if not settings.recording:
        raise InputError("recording: missing; expected frames.npz or a rosbag2")
    return ReplayDevice(
        settings.recording,
        settings.layout.electrodes,
        rate=settings.rate,
        loop=settings.loop,
        drive_voltage=settings.drive_voltage,
        layout_id=settings.layout.id,
        topic=settings.topic,
    )
