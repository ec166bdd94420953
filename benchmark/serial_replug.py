"""How long frames stay away after the plug is back: emulated sensor on a pseudo-terminal."""

from __future__ import annotations

import argparse
import os
import tempfile
import threading
import time

import numpy as np

from tomotactile_ros.devices.emulator import Emulator
from tomotactile_ros.devices.firmware import EmulatedDevice, idle_source
from tomotactile_ros.devices.ports import PtyPort
from tomotactile_ros.devices.serial import SerialDevice

PATIENCE = 10.0


def replug(times: int, link: str) -> list[float]:
    """Pull and put back the plug; time from the port's return to the next frame, s."""
    sensor = Emulator(EmulatedDevice(idle_source(64), 64, rate=50.0), lambda: PtyPort(link))
    sensor.plug()
    arrived = threading.Event()
    device = SerialDevice(link, 64)
    device.open(lambda frame: arrived.set())
    arrived.wait(PATIENCE)
    waits = []
    for _ in range(times):
        sensor.unplug()
        arrived.clear()
        begin = time.monotonic()
        sensor.plug()
        arrived.wait(PATIENCE)
        waits.append(time.monotonic() - begin)
    device.close()
    sensor.unplug()
    return waits


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--times", type=int, default=100)
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        waits = replug(options.times, os.path.join(folder, "port"))
    print(
        f"{sum(w < PATIENCE for w in waits)} of {len(waits)} replugs recovered; from the port's "
        f"return to the next frame: mean {np.mean(waits):.3f} s, longest {np.max(waits):.3f} s"
    )


if __name__ == "__main__":
    main()
