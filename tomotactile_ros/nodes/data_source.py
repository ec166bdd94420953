"""What the driver says of where its frames come from, so that nobody takes a simulation for a
sensor."""

import time
from collections.abc import Callable, Mapping

from tomotactile_ros.devices import Device, Status
from tomotactile_ros.nodes import diagnostics

LEVELS = {
    "streaming": diagnostics.OK,
    "finished": diagnostics.OK,
    "stopped": diagnostics.WARN,
    "identifying": diagnostics.WARN,
    "closed": diagnostics.WARN,
}
# of every device that is no sensor: what its data are, and the parameter that says which
NATURES = {"fake": ("SIMULATED data", "scene"), "replay": ("RECORDED data", "recording")}
_STARTING = ("closed", "identifying", "disconnected", "silent")
RESTART_PATIENCE = 3.0  # s until a restart says whether there is a device


def nature(values: Mapping) -> str:
    """What kind of data a driver with these parameters gives; empty for those of a sensor."""
    if values["device"] not in NATURES:
        return ""
    what, name = NATURES[values["device"]]
    return f"{what} ({values[name]})"


def level_of(status: Status) -> bytes:
    """Level of a device's state."""
    return LEVELS.get(status.state, diagnostics.ERROR)


def outcome(device: Device, stopped: Callable[[], bool]) -> tuple[bool, str]:
    """Whether a device that has just been opened works, and what it says; takes a moment."""
    end = time.monotonic() + RESTART_PATIENCE
    status = device.status()
    while status.state in _STARTING and time.monotonic() < end and not stopped():
        time.sleep(0.05)
        status = device.status()
    works = level_of(status) != diagnostics.ERROR
    return works, f"the device was opened anew: {status.state}, {status.message}"
