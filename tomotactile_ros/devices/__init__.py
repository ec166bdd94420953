"""Sources of frames: `make_device` makes the one that the settings name."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass

from tomotactile_ros.devices.base import Device, Frame, Status
from tomotactile_ros.devices.text import FORMATS
from tomotactile_ros.devices.time_source import TimeSource
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.scan_order import spread
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.support.errors import InputError

__all__ = ["Device", "DeviceSettings", "Frame", "Status", "make_device"]

KINDS = ("fake", "serial", "replay")
PROTOCOLS = ("binary", *FORMATS)
ORDERS = ("jumping", "device", "adaptive")


@dataclass(frozen=True)
class DeviceSettings:
    """What a device needs to know.

    Attributes
    ----------
    layout : Layout
    device : str
        ``fake``, ``serial`` or ``replay``.
    rate : float
        Frames/s; 0 leaves it to the device (fake: 1000 ground conditions a second, replay: as
        recorded).
    scene, model : Scene or None, str
        For ``fake``; the physics is that of `tomotactile_ros.sheet.make_sheet`.
    port, baud : str, int
        For ``serial``; see `tomotactile_ros.devices.line.find_port`.
    protocol : str
        For ``serial``: ``binary``, docs/protocol.md, or one of `tomotactile_ros.devices.text.FORMATS`.
    partial_frames : bool
        For ``serial``: deliver incomplete frames, with NaN in the missing rows.
    recording, topic, loop : str, str, bool
        For ``replay``: file or bag, which topic of a bag with several, and whether to start over at
        its end.
    drive_voltage : float, V
        For text, and for ``replay`` of recordings that do not hold it.
    max_age : float, s
        For ``serial``: frames whose last sample is longer ago are dropped and counted; 0 for any.
    rows_per_message : int
        Rows of a frame that are handed over together, to whoever wants rows.
    scan : tuple of int
        Electrodes to ground, row after row; none: the scan of the layout, or the device's own
        order.
    order : str
        Where neither `scan` nor the layout names electrodes: ``device`` for the device's own order,
        ``jumping`` (`layouts.scan_order`) where it takes one, ``adaptive`` where `set_scan` will be
        called in every frame.
    address : int
        For ``serial``: of the device on a bus; 0: it has none.
    capture : str
        For ``serial``: a file for all that comes from the line; none if empty.
    time : TimeSource or None
        For ``fake`` and ``replay``: the time that they live in; None for this machine's.
    beside : bool
        For ``fake``: simulate in a process of its own, where others compute in this one.
    """

    layout: Layout
    device: str = "fake"
    rate: float = 0.0
    scene: Scene | None = None
    model: str = "fem"
    port: str = ""
    baud: int = 2_000_000
    protocol: str = "binary"
    partial_frames: bool = False
    recording: str = ""
    topic: str = ""
    loop: bool = False
    drive_voltage: float = 3.3
    max_age: float = 0.0
    rows_per_message: int = 8
    scan: tuple[int, ...] = ()
    order: str = "device"
    address: int = 0
    capture: str = ""
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
