"""Everything that can go wrong between sensor and picture, done on purpose, and what is said of it.

    scripts/setup python3 benchmark/faults.py                    some minutes, all but the long ones
    scripts/setup python3 benchmark/faults.py line nonsense      only these
    scripts/setup python3 benchmark/faults.py soak --minutes 30 --sensor 8x8@250 16x16@15
    scripts/setup python3 benchmark/faults.py kills --times 100

The sensor is sensor.py, written from docs/protocol.md alone; every reading is a hash of sequence,
row and electrode, so that any wrong value is seen. The figures of docs/faults.md come from here.

line      what a bad line does to the bytes, and packets that are lost
nonsense  whole packets that say what cannot be, or what should not be: always, and one in a hundred
age       a line slower than the sensor: how old frames are, and whether their stamp says so
restarts  a device that restarts (its numbers begin anew: ages mean nothing), and one whose plug is pulled
soak      driver node and subscriber for long: lost, age, memory, descriptors
kills     every program ended at random moments: strays, broken files
"""

from __future__ import annotations

import contextlib
import itertools
import os
import signal
import sys
import tempfile
import threading
import time
from argparse import Namespace
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np

from tomotactile_ros.bench.program import options
from tomotactile_ros.devices.base import Status
from tomotactile_ros.devices.serial import SerialDevice
from tomotactile_ros.layouts.layout import equal_grid
from tomotactile_ros.msg import VoltageFrame
from tomotactile_ros.nodes import data_source, diagnostics
from tomotactile_ros.nodes.conversions import stamp_of

sys.path.insert(0, str(Path(__file__).parent))  # scripts/setup keeps Python from doing so

import fault_kills
from fault_sensor import Judge, Sensor
from nodes import Nodes, arguments
from sensor import ANSWERS, IDENTITY, LINE, ROWS

from tomotactile_ros.bench.tables import Table

LEVELS = ("OK", "WARN", "ERROR")
SECONDS = 4.0  # of most cases
MAX_AGE = 1.0  # s, as the driver node has it
BUFFER = 1 << 19  # of a microcontroller with half a megabyte to spare
NAMESPACE = f"/soak_{os.getpid()}"  # nobody else's frames
SAMPLE = 10.0  # s
IN_DRIVER = "frames_lost", "frames_incomplete", "frames_stale"
FAST = 250.0 * 64 * 169.0  # bytes/s of 8 x 8 electrodes at 250 frames/s

AMOUNTS = {  # of faults of the line
    **dict.fromkeys(LINE, (0.001, 0.01, 0.1)),
    "none": (1.0,),
    "lose": (1e-5, 1e-4, 0.001, 0.01, 0.03, 0.1),
    "noise": (0.0001, 0.001),
}
COUNTERS = {
    "packets refused": ("crc_errors", "framing_errors", "malformed"),
    "rows lost": ("packets_lost",),
    "too old, kept back": ("frames_stale",),
    "reconnects": ("reconnects",),
}
HEADER = (
    *("fault", "frames sent", "published", "wrong readings", "oldest s", "stamps off s"),
    *(*COUNTERS, "rows that the sensor dropped", "level", "said"),
)


def level_of(status: Status) -> int:
    """Level that the driver node gives a device with this status."""
    level = data_source.level_of(status)
    for trouble in status.troubles:
        level = max(level, diagnostics.level_of(trouble))
    if status.dead:
        level = max(level, diagnostics.WARN)
    return level[0]


class Watcher:
    """Asks a device for its status ten times a second, as the diagnostics would, until closed."""

    def __init__(self, device: SerialDevice) -> None:
        self.worst, self.told = -1, ""
        self._device, self._over = device, threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        while not self._over.wait(0.1):
            status = self._device.status()
            if status.state not in ("closed", "disconnected", "identifying"):
                self.note(status)

    def note(self, status: Status) -> None:
        """Keep the worst level, and what was said with it."""
        if level_of(status) > self.worst:
            self.worst, self.told = level_of(status), f"{status.state}: {status.message}"

    def close(self) -> Status:
        """Stop asking; the last status."""
        self._over.set()
        self._thread.join()
        status = self._device.status()
        self.note(status)
        return status


def run(name: str, port: str, seconds: float, rate: float = 60.0, **fault) -> list[str]:
    """Cells under `HEADER` of one sensor with one fault and a device that listens for so many seconds."""
    judge = Judge(64)
    with Sensor(port, electrodes=64, **fault) as source:
        device = SerialDevice(source.port, 64, rate=rate)
        device.max_age = MAX_AGE
        device.open(judge)
        watcher = Watcher(device)
        time.sleep(seconds)
        status = watcher.close()
        device.close()
    ages, errors = judge.times(source)
    return [
        *(name, str(source.made), str(judge.frames), str(judge.wrong_readings)),
        *(f"{np.abs(each).max():.3f}" if each.size else "-" for each in (ages, errors)),
        *(f"{sum(status.counters[key] for key in keys):.0f}" for keys in COUNTERS.values()),
        str(source.dropped),
        LEVELS[watcher.worst],
        watcher.told.replace("|", "/")[:140],
    ]


def cases(part: str) -> Iterator[tuple[str, dict]]:
    """Names, and what `run` is given."""
    faults: list[tuple[str, float, int]] = []  # with amount and seed
    if part == "line":
        faults = [(fault, each, i) for fault in AMOUNTS for i, each in enumerate(AMOUNTS[fault])]
    elif part == "nonsense":
        faults = [*itertools.product((*ROWS, *ANSWERS, *IDENTITY), (1.0, 0.01), (0,))]
    for fault, amount, seed in faults:
        given = {"fault": fault, "amount": amount, "seed": seed, "seconds": SECONDS}
        yield f"{fault}, {100 * amount:g} %", given
    if part == "age":
        shares = [0.9 * FAST, 0.5 * FAST, 0.15 * FAST]
        for line, buffer in itertools.product(("pty", "tcp"), (1e4, 1e8)):
            for carries in shares if line == "pty" else [*shares, 400e3]:  # the last: a modem
                given = {"rate": 250.0, "buffer": int(buffer), "throttle": carries}
                given |= {"seconds": 3 * SECONDS} | ({"port": "tcp:0"} if line == "tcp" else {})
                yield f"{line}, buffer {buffer / 1e6:g} MB, carries {carries / FAST:.0%}", given
    elif part == "restarts":
        for fault in ("restart", "restart-streaming"):
            yield f"{fault} every 2 s", {"fault": fault, "amount": 2.0, "seconds": 4 * SECONDS}


def short(part: str, asked: Namespace) -> None:
    """A table of the cases of a part."""
    with tempfile.TemporaryDirectory() as folder:
        port, table = f"pty:{folder}/port", Table(*HEADER)
        for name, given in cases(part):
            table.add(*run(name, **{"port": port} | given))
        if part == "restarts":
            print(f"\nplug pulled {asked.times} times: {plug_pulled(port, asked.times)}")


def plug_pulled(port: str, times: int) -> str:
    """Kill the sensor and start another one, again and again, once the driver has said that it is away.

    The level is the worst that the driver gives from the first frame on, also while nothing is there.
    """
    judge = Judge(64)
    device = SerialDevice(port.partition(":")[2], 64, rate=60.0)
    device.open(judge)
    waits, worst = [], 0
    for _ in range(times):
        source = Sensor(port)
        waits.append(judge.wait_for_frame())
        source.stop(signal.SIGKILL)
        worst = max(worst, level_of(noticed(device)))
    device.close()
    return (
        f"{judge.frames} frames, {judge.wrong_readings} wrong readings, {LEVELS[worst]}, away "
        f"{np.mean(waits):.2f} s in the mean, {np.max(waits):.2f} s at most"
    )


def noticed(device: SerialDevice, patience: float = 10.0) -> Status:
    """What a device says as soon as it no longer says that frames arrive; after `patience`, s, what it
    says then."""
    end = time.monotonic() + patience
    status = device.status()
    while status.state == "streaming" and time.monotonic() < end:
        time.sleep(0.01)
        status = device.status()
    return status


def soak(asked: Namespace) -> None:
    """Each sensor for so many minutes; prints a table."""
    columns = {}
    for name in asked.sensor:
        size, _, rate = name.partition("@")
        columns[name] = one_soak(int(size.partition("x")[0]), float(rate), asked.minutes)
    table = Table(f"{asked.minutes:g} minutes each", *columns)
    for row in next(iter(columns.values())):
        table.add(row, *(each[row] for each in columns.values()))


def one_soak(side: int, rate: float, minutes: float) -> dict[str, str]:
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
        source = stack.enter_context(Sensor(f"pty:{port}", **given))
        with contextlib.suppress(PermissionError):  # hardware waits for nobody
            os.sched_setscheduler(source.process.pid, os.SCHED_FIFO, os.sched_param(10))
        words = arguments({"layout": layout, "device": "serial", "rate": rate, "port": port})
        nodes = stack.enter_context(Nodes([("driver", "-r", f"__ns:={NAMESPACE}", *words)]))
        nodes.node.create_subscription(VoltageFrame, f"{NAMESPACE}/voltage_frame", take, 100)
        nodes.spin(lambda: judge.frames > 0)
        begin, used = time.monotonic(), nodes.processor_seconds()
        memory, files = [], []
        while time.monotonic() < begin + 60 * minutes:
            memory.append(nodes.megabytes())
            files.append(len(os.listdir(f"/proc/{nodes.children[0].pid}/fd")))
            print(f"{judge.frames} frames, {memory[-1]:.2f} MB", file=sys.stderr)
            nodes.spin_for(SAMPLE)
        used = (nodes.processor_seconds() - used) / (time.monotonic() - begin)
        own = NAMESPACE.strip("/")
        counters = next(each for name, each in nodes.heard.items() if name.startswith(own))
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


SHORT = ("line", "nonsense", "age", "restarts")
LONG = {"soak": soak, "kills": fault_kills.kills}


def main() -> None:
    """Run the parts that are asked for."""
    asked = options(
        __doc__,
        *(*SHORT, *LONG),
        minutes=(1.0, "of a soak"),
        times=(10, "of each kill, and of the plug"),
        sensor=(["8x8@250", "16x16@15"], "of the soak, ROWSxCOLUMNS@RATE"),
    )
    for name in asked.cases or SHORT:
        print(f"## {name}\n", flush=True)
        LONG[name](asked) if name in LONG else short(name, asked)
        print(flush=True)


if __name__ == "__main__":
    main()
