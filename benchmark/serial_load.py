"""The serial path under load: emulated sensor -> pseudo-terminal -> driver node -> a subscriber.

    scripts/setup python3 benchmark/serial_load.py                    10 min of each sensor
    scripts/setup python3 benchmark/serial_load.py --minutes 3 --sensor 8x8@250

Four processes: the emulator, the driver, this one, which subscribes and watches, and a sleeper.

* Lost: frames of which the driver got no or not every row; missed: published, but not arrived here.
* CPU and memory are those of the driver process.  Memory is what is its own (RssAnon + VmSwap),
  every 10 s.  Growth is the slope of a line through the means of the minutes after the first, with
  two standard errors; a leak of the smallest object (16 B) per frame at 250 frames/s would be
  0.24 MB/min.
* Latency is from a frame's last sample to the end of its publication.  Emulator and driver read the
  same clock, so that it is measured, not estimated.  It holds what the emulator is late by; that
  stands for hardware, which waits for nobody, and has real-time priority where that is allowed.
* The sleeper only wakes up as often as there are frames.  How late it is at that is what the
  machine does to everybody.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tomotactile_ros.layouts.layout import equal_grid

SENSORS = ("8x8@250", "16x16@15")
SAMPLE = 10.0
WARM_UP = 60.0
NAMESPACE = f"/serial_load_{os.getpid()}"  # nobody else's frames


def be_driver(latencies: str, *ros_arguments: str) -> int:
    """The driver node, with a device that writes down when each frame was published."""
    from tomotactile_ros.devices import serial
    from tomotactile_ros.nodes import driver

    seen = np.memmap(latencies, np.float64, "r+")
    made = []

    class Probe(serial.SerialDevice):
        def open(self, on_frame) -> None:
            def timed(frame) -> None:
                on_frame(frame)
                seen[self.published] = time.monotonic() - 1e-6 * self.last_sample
                self.published += 1

            self.published = 0
            made.append(self)
            super().open(timed)

        def _publish(self, rows, *others) -> None:
            self.last_sample = rows.last_sample
            super()._publish(rows, *others)

    serial.SerialDevice = Probe
    status = driver.main(["driver", *ros_arguments])
    counters = made[-1].status().counters if made else {}
    Path(latencies).with_suffix(".json").write_text(json.dumps(counters))
    return status


def be_sleeper(lateness: str, rate: str) -> int:
    """Wake up at that rate and write down how late each time."""
    seen = np.memmap(lateness, np.float64, "r+")
    due = time.monotonic()
    for k in range(seen.size):
        due = max(due + 1.0 / float(rate), time.monotonic())
        time.sleep(max(0.0, due - time.monotonic()))
        seen[k] = time.monotonic() - due
    return 0


def be_emulator(*arguments: str) -> int:
    """The emulator, ahead of all ordinary processes where that is allowed."""
    from tomotactile_ros.devices import emulator

    with contextlib.suppress(PermissionError):
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(10))
    return emulator.main(list(arguments))


ROLES = {"--emulator": be_emulator, "--driver": be_driver, "--sleeper": be_sleeper}


class Chart:
    """Memory and CPU time of a process over time, read from outside."""

    def __init__(self, pid: int) -> None:
        self._pid, self._start = pid, time.monotonic()
        self.times: list[float] = []
        self.memory: list[float] = []
        self.cpu: list[float] = []

    def sample(self) -> None:
        """Note time since the start (s), memory (MB) and CPU time (s)."""
        lines = Path(f"/proc/{self._pid}/status").read_text().splitlines()
        sizes = {name: text for name, text in (line.split(":", 1) for line in lines)}
        own = sum(int(sizes[name].split()[0]) for name in ("RssAnon", "VmSwap"))
        ticks = Path(f"/proc/{self._pid}/stat").read_text().rsplit(")", 1)[1].split()[11:13]
        self.times.append(time.monotonic() - self._start)
        self.memory.append(1.024e-3 * own)
        self.cpu.append(sum(map(int, ticks)) / os.sysconf("SC_CLK_TCK"))

    def minutes(self) -> np.ndarray:
        """Mean memory of each whole minute, MB."""
        minute = (np.array(self.times) // 60.0).astype(int)
        memory = np.array(self.memory)
        return np.array([memory[minute == m].mean() for m in range(minute[-1])])

    def growth(self) -> tuple[float, float]:
        """Slope behind the first minute in MB/min, and two standard errors; NaN if too short."""
        means = self.minutes()[1:]
        if means.size < 3:
            return np.nan, np.nan
        x = np.arange(means.size) - (means.size - 1) / 2
        slope = x @ means / (x @ x)
        scatter = means - means.mean() - slope * x
        return slope, 2.0 * np.sqrt(scatter @ scatter / (x.size - 2) / (x @ x))

    def load(self) -> float:
        """CPU time behind the first minute (or the first sample), in % of a core."""
        first = min(np.searchsorted(self.times, WARM_UP), len(self.times) - 2)
        return 100.0 * (self.cpu[-1] - self.cpu[first]) / (self.times[-1] - self.times[first])


@contextlib.contextmanager
def running(command: list[str], **options) -> Iterator[subprocess.Popen]:
    """A process, stopped and waited for at the end."""
    process = subprocess.Popen(command, **options)
    try:
        yield process
    finally:
        process.terminate()
        process.wait()


class Subscriber:
    """Counts the frames that arrive in this process."""

    def __init__(self) -> None:
        import rclpy
        from rclpy.executors import SingleThreadedExecutor

        from tomotactile_ros.msg import VoltageFrame

        rclpy.init(args=[])
        self._node = rclpy.create_node("serial_load")
        self._node.create_subscription(VoltageFrame, f"{NAMESPACE}/voltage_frame", self._take, 100)
        self._executor = SingleThreadedExecutor()
        self._executor.add_node(self._node)
        self.sequences: list[int] = []

    def spin_until(self, time_is_up: float) -> None:
        """Take frames until that time, s, monotonic."""
        while (left := time_is_up - time.monotonic()) > 0:
            self._executor.spin_once(timeout_sec=left)

    def missed(self) -> int:
        """Frames that are not there, between the first and the last one."""
        return self.sequences[-1] - self.sequences[0] + 1 - len(set(self.sequences))

    def close(self) -> None:
        """Leave ROS."""
        import rclpy

        self._node.destroy_node()
        rclpy.shutdown()

    def _take(self, message) -> None:
        self.sequences.append(message.sequence)


def make_layout(folder: str, side: int) -> str:
    """File of a side x side layout."""
    path = Path(folder, "layout.yaml")
    equal_grid(side, side, (0.2, 0.2), radius=0.0025, sheet_resistance=1e4, inset=0.005).save(path)
    return str(path)


def notebook(folder: str, name: str) -> np.ndarray:
    """A file of numbers that another process fills in; it is in nobody's own memory."""
    return np.memmap(Path(folder, name), np.float64, "w+", shape=1 << 20)


def measure(side: int, rate: float, minutes: float) -> dict[str, str]:
    """Run one sensor and tell how it goes; return a column of the table."""
    me = [sys.executable, __file__]
    with tempfile.TemporaryDirectory() as folder, contextlib.ExitStack() as stack:
        latencies, lateness = notebook(folder, "latencies"), notebook(folder, "lateness")
        layout, port = make_layout(folder, side), f"{folder}/port"
        emulator = [*me, "--emulator", "--layout", layout, "--port", f"pty:{port}"]
        sensor = stack.enter_context(running(emulator, stdout=subprocess.PIPE))
        sensor.stdout.readline()
        priority = os.sched_getscheduler(sensor.pid)
        subscriber = Subscriber()
        stack.callback(subscriber.close)
        named = {"layout": layout, "device": "serial", "port": port, "rate": rate}
        parameters = [word for item in named.items() for word in ("-p", "{}:={}".format(*item))]
        stack.enter_context(running([*me, "--sleeper", lateness.filename, str(rate)]))
        driver = running(
            [
                *me,
                "--driver",
                latencies.filename,
                "--ros-args",
                "-r",
                f"__ns:={NAMESPACE}",
                *parameters,
            ]
        )
        with driver as process:
            chart = watch(process.pid, subscriber, latencies, f"{side}x{side}@{rate:g}", minutes)
        counters = json.loads(Path(latencies.filename).with_suffix(".json").read_text())
        table = figures(chart, subscriber, latencies, lateness, counters)
        table["emulator's priority"] = "real-time" if priority == os.SCHED_FIFO else "ordinary"
        return table


def watch(
    pid: int, subscriber: Subscriber, latencies: np.ndarray, name: str, minutes: float
) -> Chart:
    """Take samples of the driver and print each."""
    while not subscriber.sequences:
        subscriber.spin_until(time.monotonic() + 0.1)
    chart = Chart(pid)
    chart.sample()
    begin, seen = time.monotonic(), np.count_nonzero(latencies)
    for k in range(1, round(60 * minutes / SAMPLE) + 1):
        subscriber.spin_until(begin + SAMPLE * k)
        chart.sample()
        published = np.count_nonzero(latencies)
        p99 = 1e3 * np.quantile(latencies[seen:published], 0.99)
        left = 60 * minutes - SAMPLE * k
        print(
            f"{name}: {left // 60:2.0f} min {left % 60:2.0f} s left, {published} frames, "
            f"missed {subscriber.missed()}, memory {chart.memory[-1]:.2f} MB, p99 {p99:.2f} ms",
            flush=True,
        )
        seen = published
    print(f"{name}: memory by the minute, MB:", *(f"{m:.2f}" for m in chart.minutes()), flush=True)
    return chart


def figures(
    chart: Chart,
    subscriber: Subscriber,
    latencies: np.ndarray,
    lateness: np.ndarray,
    counters: dict,
) -> dict[str, str]:
    """What a run has shown."""
    slope, error = chart.growth()
    late, asleep = (1e3 * x[: np.count_nonzero(x)] for x in (latencies, lateness))

    def spread(x: np.ndarray) -> str:
        return " / ".join(f"{v:.2f}" for v in np.quantile(x, (0.5, 0.99, 0.999, 1.0)))

    return {
        "frames published": f"{counters['frames']:.0f}",
        "frames incomplete, lost": f"{counters['frames_incomplete']:.0f}, "
        f"{counters['frames_lost']:.0f}",
        "frames missed here": f"{subscriber.missed()}",
        "damaged packets": f"{counters['crc_errors'] + counters['framing_errors']:.0f}",
        "CPU, % of a core": f"{chart.load():.1f}",
        "memory, MB": f"{chart.memory[-1]:.1f}",
        "growth, MB/min": "too short" if np.isnan(slope) else f"{slope:+.4f} +- {error:.4f}",
        "latency p50/p99/p99.9/max, ms": spread(late),
        "sleeper p50/p99/p99.9/max, ms": spread(asleep),
    }


def main() -> int:
    if sys.argv[1:2] and sys.argv[1] in ROLES:
        return ROLES[sys.argv[1]](*sys.argv[2:])
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--minutes", type=float, default=10.0, help="of each sensor")
    parser.add_argument("--sensor", nargs="+", default=SENSORS, help="ROWSxCOLUMNS@RATE, square")
    options = parser.parse_args()
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    table = {}
    for sensor in options.sensor:
        size, _, rate = sensor.partition("@")
        table[sensor] = measure(int(size.partition("x")[0]), float(rate), options.minutes)
    print(f"{f'{options.minutes:g} min each':<32}", *(f"{name:>28}" for name in table))
    for row in next(iter(table.values())):
        print(f"{row:<32}", *(f"{column[row]:>28}" for column in table.values()))
    return 0


if __name__ == "__main__":
    sys.exit(main())
