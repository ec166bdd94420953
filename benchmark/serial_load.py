"""The serial path under load: emulator in its own process, driver's device in this one.

Reports lost frames, the CPU time of this process, its memory and the time from a frame's last
sample to its delivery.  Emulator and driver share one clock, so that time is measured and not
estimated.  With --replug, unplugs and replugs instead and reports how long the frames took to come
back.
"""

from __future__ import annotations

import argparse
import os
import resource
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from tomotactile_ros.devices import emulator
from tomotactile_ros.devices.serial import SerialDevice
from tomotactile_ros.layout import equal_grid

WARM_UP = 5.0


class Probe(SerialDevice):
    """Notes when each frame was delivered and when its last sample was taken."""

    def __init__(self, *args: object, **kwargs: object) -> None:
        super().__init__(*args, **kwargs)
        self.latencies = np.full(1 << 20, np.nan)
        self.delivered = 0

    def _publish(self, rows, arrival, row_bytes) -> None:
        super()._publish(rows, arrival, row_bytes)
        self.latencies[self.delivered] = time.monotonic() - 1e-6 * rows.last_sample
        self.delivered += 1


def resident() -> float:
    """Resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 1e6


def cpu() -> float:
    """CPU time of this process, s."""
    usage = resource.getrusage(resource.RUSAGE_SELF)
    return usage.ru_utime + usage.ru_stime


def start_emulator(folder: str, side: int, rate: float) -> tuple[subprocess.Popen, str]:
    """Start the emulator of a side x side sensor; return its process and port."""
    layout = Path(folder, "layout.yaml")
    equal_grid(side, side, (0.2, 0.2), radius=0.0025, sheet_resistance=1e4, margin=0.005).save(
        layout
    )
    command = [sys.executable, "-m", "tomotactile_ros.devices.emulator", "--layout", str(layout)]
    process = subprocess.Popen(
        [*command, "--rate", str(rate), "--port", f"pty:{folder}/port"],
        stdout=subprocess.PIPE,
        text=True,
    )
    return process, process.stdout.readline().strip()


def load(side: int, rate: float, duration: float) -> None:
    """Run one sensor for `duration` s after the warm-up and print a line of figures."""
    with tempfile.TemporaryDirectory() as folder:
        process, port = start_emulator(folder, side, rate)
        device = Probe(port, side * side, rate=rate)
        device.open(lambda frame: None)
        time.sleep(WARM_UP)
        begin, cpu0, memory0, first = time.monotonic(), cpu(), resident(), device.delivered
        time.sleep(duration)
        wall, busy, last = time.monotonic() - begin, cpu() - cpu0, device.delivered
        memory, counters = resident() - memory0, device.status().counters
        device.close()
        process.terminate()
        process.wait()
    latencies = 1e3 * device.latencies[first:last]
    print(
        f"{side} x {side}, {rate:g}/s, {wall:.0f} s: {last - first} frames "
        f"({(last - first) / wall:.2f}/s), lost {counters['frames_lost']:.0f}, incomplete "
        f"{counters['frames_incomplete']:.0f}, CPU {100 * busy / wall:.1f} % of a core, "
        f"memory {memory:+.2f} MB, last sample to delivery p50 {np.quantile(latencies, 0.5):.2f} "
        f"p99 {np.quantile(latencies, 0.99):.2f} max {latencies.max():.2f} ms",
        flush=True,
    )


def replug(times: int) -> None:
    """Pull and put back the plug, and print how long the frames took to come back."""
    with tempfile.TemporaryDirectory() as folder:
        link = os.path.join(folder, "port")
        sensor = emulator.Emulator(
            emulator.EmulatedDevice(emulator.idle_source(64), 64, rate=50.0),
            lambda: emulator.PtyPort(link),
        )
        sensor.plug()
        arrived = threading.Event()
        device = SerialDevice(link, 64)
        device.open(lambda frame: arrived.set())
        arrived.wait(10.0)
        waits = []
        for _ in range(times):
            sensor.unplug()
            arrived.clear()
            begin = time.monotonic()
            sensor.plug()
            if not arrived.wait(10.0):
                print("no frame within 10 s after the port returned")
                break
            waits.append(time.monotonic() - begin)
        device.close()
        sensor.unplug()
    print(
        f"{len(waits)} of {times} replugs recovered; from the port's return to the next frame: "
        f"mean {np.mean(waits):.3f} s, longest {np.max(waits):.3f} s"
    )


def main() -> None:
    arguments = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    arguments.add_argument("--duration", type=float, default=60.0, help="s per sensor")
    arguments.add_argument("--replug", type=int, metavar="TIMES")
    options = arguments.parse_args()
    if options.replug:
        replug(options.replug)
        return
    load(8, 250.0, options.duration)
    load(16, 15.0, options.duration)


if __name__ == "__main__":
    main()
