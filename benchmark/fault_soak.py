"""Long runs of faults.py: the driver node on the C sensor, and the firmware in QEMU."""

from __future__ import annotations

import argparse
import contextlib
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
import qemu_board
from diagnostic_msgs.msg import DiagnosticArray
from fault_sensor import SCALE, Sensor, readings, sensor, workshop
from serial_load import NAMESPACE, SAMPLE, Chart, Subscriber, make_layout, running

from tomotactile_ros.devices.serial import SerialDevice

BUFFER = 1 << 19  # of a microcontroller with half a megabyte to spare


class Inspector(Subscriber):
    """A subscriber that compares every reading and notes how old each frame is when it arrives."""

    def __init__(self, source: Sensor, electrodes: int) -> None:
        self._source, self._electrodes = source, electrodes
        self.wrong_readings = 0
        self._arrivals: list[tuple[int, float]] = []
        self.counters: dict[str, str] = {}
        super().__init__()
        self._node.create_subscription(DiagnosticArray, "/diagnostics", self._note, 10)

    def ages(self) -> np.ndarray:
        """From the end of each frame to its arrival, s; to be asked when the sensor has ended."""
        begins = [self._source.begin_of(*arrival) for arrival in self._arrivals]
        ages = np.array([now for _, now in self._arrivals]) - begins
        return ages[np.isfinite(ages)] - 1.0 / self._source.starts[-1][2]

    def _note(self, message: DiagnosticArray) -> None:
        for status in message.status:
            if status.name.startswith(NAMESPACE.strip("/")):
                self.counters = {value.key: value.value for value in status.values}

    def _take(self, message) -> None:
        now = time.monotonic()
        super()._take(message)
        counts = np.frombuffer(message.voltages, np.float32) / np.float32(SCALE)
        counts -= readings(message.sequence, self._electrodes).ravel()
        with np.errstate(invalid="ignore"):
            wrong = np.abs(counts, out=counts) > 0.1
        self.wrong_readings += int(wrong.sum())
        self._arrivals.append((message.sequence, now))


def descriptors(pid: int) -> int:
    """Open files of a process."""
    return len(os.listdir(f"/proc/{pid}/fd"))


def soak(options: argparse.Namespace) -> None:
    """Each sensor for so many minutes; prints a table."""
    os.environ.setdefault("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    columns = {}
    for name in options.sensor:
        size, _, rate = name.partition("@")
        columns[name] = one_soak(int(size.partition("x")[0]), float(rate), options)
    print(f"| {options.minutes:g} minutes each | " + " | ".join(columns) + " |")
    print("|---|" + "---|" * len(columns))
    for row in next(iter(columns.values())):
        print(f"| {row} | " + " | ".join(column[row] for column in columns.values()) + " |")
    print()


def one_soak(side: int, rate: float, options: argparse.Namespace) -> dict[str, str]:
    """One sensor on the driver node; a column of the table."""
    from ament_index_python.packages import get_package_prefix

    minutes = options.minutes
    program = Path(get_package_prefix("tomotactile_ros"), "lib", "tomotactile_ros", "driver")
    with contextlib.ExitStack() as stack:
        folder, built = stack.enter_context(workshop())
        source = stack.enter_context(
            sensor(
                built,
                f"pty:{folder}/port",
                electrodes=side * side,
                rate=rate,
                buffer=BUFFER,
                protocol=options.protocol,
            )
        )
        with contextlib.suppress(PermissionError):  # hardware waits for nobody
            os.sched_setscheduler(source.process.pid, os.SCHED_FIFO, os.sched_param(10))
        inspector = Inspector(source, side * side)
        stack.callback(inspector.close)
        named = {"layout": make_layout(folder, side), "device": "serial", "rate": rate}
        named["port"] = f"{folder}/port"
        words = [word for item in named.items() for word in ("-p", "{}:={}".format(*item))]
        command = [str(program), "--ros-args", "-r", f"__ns:={NAMESPACE}", *words]
        driver = stack.enter_context(running(command, stderr=subprocess.DEVNULL))
        chart, files = watch(driver.pid, inspector, f"{side}x{side}@{rate:g}", minutes)
    ages = 1e3 * inspector.ages()
    lost = sum(
        int(float(inspector.counters[name]))
        for name in ("frames_lost", "frames_incomplete", "frames_stale")
    )
    slope, error = chart.growth()
    spread = " / ".join(f"{v:.2f}" for v in np.quantile(ages, (0.5, 0.99, 0.999, 1.0)))
    growth = "too short" if np.isnan(slope) else f"{slope:+.4f} ± {error:.4f} MB"
    return {
        "frames that arrived": f"{len(inspector.sequences):,}",
        "frames lost or incomplete in the driver": "{frames_lost}, {frames_incomplete}".format(
            **inspector.counters
        ),
        "frames too old in the driver": "{frames_stale}".format(**inspector.counters),
        "published, and not arrived": f"{inspector.missed() - lost}",
        "wrong readings": f"{inspector.wrong_readings}",
        "rows that the sensor dropped": f"{source.dropped}",
        "age at the subscriber, p50 / p99 / p99.9 / longest": f"{spread} ms",
        "memory of the driver, first and last minute": "{:.1f}, {:.1f} MB".format(
            *(chart.minutes()[[0, -1]] if minutes >= 1.2 else (chart.memory[0], chart.memory[-1]))
        ),
        "growth a minute": growth,
        "descriptors, at first and at last": f"{files[0]}, {files[-1]} (at most {max(files)})",
        "processor, of one core": f"{chart.load():.0f} %",
    }


def watch(pid: int, inspector: Inspector, name: str, minutes: float) -> tuple[Chart, list[int]]:
    """Take samples of the driver until the time is over; say how it goes once a minute."""
    while not inspector.sequences:
        inspector.spin_until(time.monotonic() + 0.1)
    chart, files = Chart(pid), [descriptors(pid)]
    chart.sample()
    begin = time.monotonic()
    for k in range(1, round(60 * minutes / SAMPLE) + 1):
        inspector.spin_until(begin + SAMPLE * k)
        chart.sample()
        files.append(descriptors(pid))
        if k % 6 == 0:
            print(
                f"{name}: {k // 6} min, {len(inspector.sequences)} frames, missed "
                f"{inspector.missed()}, wrong {inspector.wrong_readings}, "
                f"memory {chart.memory[-1]:.2f} MB, files {files[-1]}",
                file=sys.stderr,
                flush=True,
            )
    return chart, files


class TableJudge:
    """Compares every reading of a frame with the table that the firmware was built with."""

    def __init__(self, table: np.ndarray) -> None:
        self.frames = self.readings = self.wrong = 0
        self.sequences: set[int] = set()
        self._volts = table * qemu_board.SCALE

    def __call__(self, frame) -> None:
        expected = self._volts[frame.sequence % len(self._volts)]
        self.frames += 1
        self.sequences.add(frame.sequence)
        valid = ~np.isnan(frame.voltages)
        off_diagonal = ~np.eye(expected.shape[0], dtype=bool)
        wrong = np.abs(frame.voltages - expected) > 0.1 * qemu_board.SCALE
        self.readings += int(valid.sum())
        self.wrong += int(wrong[valid].sum() + (off_diagonal & ~valid).sum())


def qemu(options: argparse.Namespace) -> None:
    """The firmware in QEMU: 8 electrodes, 1,000 rows/s, random readings of 16 bits."""
    if absent := qemu_board.missing():
        print(absent)
        return
    table = qemu_board.random_table(8, 16)
    judge = TableJudge(table)
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder)
        qemu_board.write_table(place, table.tolist(), 16)
        image = qemu_board.build(place)
        with qemu_board.running(image) as port:
            device = SerialDevice(port, 8, rate=125.0)
            device.open(judge)
            time.sleep(60.0 * options.minutes)
            counters = device.status().counters
            device.close()
    span = max(judge.sequences) - min(judge.sequences) + 1
    print(
        f"{options.minutes:g} minutes: {judge.frames} frames, {8 * judge.frames} rows, "
        f"{judge.readings} readings, {judge.wrong} wrong; {span - judge.frames} frames missing, "
        f"{counters['crc_errors']:.0f} checksums wrong, {counters['packets_lost']:.0f} rows lost, "
        f"{counters['rate_device']:g} frames/s told, {judge.frames / 60 / options.minutes:.1f} seen\n"
    )
