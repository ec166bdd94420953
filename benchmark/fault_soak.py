"""Long runs of faults.py: the driver node on the sensor of sensor.py, every reading of which is compared."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import tempfile
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from fault_sensor import Judge, sensor
from nodes import Nodes, arguments

from tomotactile_ros.bench.tables import markdown
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.msg import VoltageFrame
from tomotactile_ros.nodes.conversions import stamp_of

BUFFER = 1 << 19  # of a microcontroller with half a megabyte to spare
NAMESPACE = f"/soak_{os.getpid()}"  # nobody else's frames
SAMPLE = 10.0  # s
IN_DRIVER = "frames_lost", "frames_incomplete", "frames_stale"


def soak(options: argparse.Namespace) -> None:
    """Each sensor for so many minutes; prints a table."""
    columns = {}
    for name in options.sensor:
        size, _, rate = name.partition("@")
        columns[name] = one_soak(int(size.partition("x")[0]), float(rate), options)
    rows = [
        [row, *(each[row] for each in columns.values())] for row in next(iter(columns.values()))
    ]
    print("\n".join(markdown([f"{options.minutes:g} minutes each", *columns], rows)))


def one_soak(side: int, rate: float, options: argparse.Namespace) -> dict[str, str]:
    """One sensor on the driver node; a column of the table."""
    judge = Judge(side * side)

    def take(message: VoltageFrame) -> None:
        voltages = np.frombuffer(message.voltages, np.float32).reshape(-1, side * side)
        stamp = stamp_of(message.header)
        judge(SimpleNamespace(sequence=message.sequence, voltages=voltages, stamp=stamp))

    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        port, layout = f"{folder}/port", Path(folder, "layout.yaml")
        equal_grid(side, side, (0.2, 0.2), 0.0025, 1e4, inset=0.005).save(layout)
        given = {"electrodes": side**2, "rate": rate, "buffer": BUFFER}
        source = stack.enter_context(sensor(f"pty:{port}", **given))
        with contextlib.suppress(PermissionError):  # hardware waits for nobody
            os.sched_setscheduler(source.process.pid, os.SCHED_FIFO, os.sched_param(10))
        words = arguments({"layout": layout, "device": "serial", "rate": rate, "port": port})
        nodes = stack.enter_context(Nodes([("driver", "-r", f"__ns:={NAMESPACE}", *words)]))
        nodes.node.create_subscription(VoltageFrame, f"{NAMESPACE}/voltage_frame", take, 100)
        nodes.spin(lambda: judge.frames > 0)
        begin, used = time.monotonic(), nodes.processor_seconds()
        memory, files = [], []
        while time.monotonic() < begin + 60 * options.minutes:
            memory.append(nodes.megabytes())
            files.append(len(os.listdir(f"/proc/{nodes.children[0].pid}/fd")))
            print(f"{judge.frames} frames, {memory[-1]:.2f} MB", file=sys.stderr)
            nodes.spin_for(SAMPLE)
        used = (nodes.processor_seconds() - used) / (time.monotonic() - begin)
        counters = next(
            each for name, each in nodes.heard.items() if name.startswith(NAMESPACE.strip("/"))
        )
    ages = judge.times(source)[0] - 1 / source.starts[-1][2]
    spread = 1e3 * np.quantile(ages, (0.5, 0.99, 0.999, 1.0))
    missed = judge.sequences[-1] - judge.sequences[0] + 1 - len(set(judge.sequences))
    lost = {name: int(float(counters[name])) for name in IN_DRIVER}
    minute = round(60 / SAMPLE)
    return {
        "frames that arrived": f"{judge.frames:,}",
        "frames lost, incomplete, too old in the driver": ", ".join(map(str, lost.values())),
        "published, and not arrived": f"{missed - sum(lost.values())}",
        "wrong readings": f"{judge.wrong_readings}",
        "rows that the sensor dropped": f"{source.dropped}",
        "age at the subscriber, p50 / p99 / p99.9 / longest, ms": " / ".join(
            f"{each:.2f}" for each in spread
        ),
        "memory of the driver, first and last minute, MB": ", ".join(
            f"{np.mean(part):.1f}" for part in (memory[:minute], memory[-minute:])
        ),
        "descriptors, at first and at last": f"{files[0]}, {files[-1]} (at most {max(files)})",
        "processor, of one core": f"{100 * used:.0f} %",
    }
