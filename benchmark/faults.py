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

import argparse
import itertools
import signal
import sys
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tomotactile_ros.bench.tables import markdown
from tomotactile_ros.devices.base import Status
from tomotactile_ros.devices.serial import SerialDevice
from tomotactile_ros.nodes import data_source, diagnostics

sys.path.insert(0, str(Path(__file__).parent))  # scripts/setup keeps Python from doing so

import fault_kills
import fault_soak
from fault_sensor import Judge, Sensor, sensor
from sensor import ANSWERS, IDENTITY, ROWS

LEVELS = ("OK", "WARN", "ERROR")
MAX_AGE = 1.0  # s, as the driver node has it
FAST = 250.0 * 64 * 169.0  # bytes/s of 8 x 8 electrodes at 250 frames/s

LINE = {
    "none": (1.0,),
    **dict.fromkeys(
        ("flip", "burst", "zeros", "drop-byte", "insert-byte", "cut", "double", "swap", "merge"),
        (0.001, 0.01, 0.1),
    ),
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
    with sensor(port, electrodes=64, **fault) as source:
        device = SerialDevice(source.port, 64, rate=rate)
        device.max_age = MAX_AGE
        device.open(judge)
        watcher = Watcher(device)
        time.sleep(seconds)
        status = watcher.close()
        device.close()
    ages, errors = judge.times(source)
    return [
        name,
        str(source.made),
        str(judge.frames),
        str(judge.wrong_readings),
        *(f"{np.abs(each).max():.3f}" if each.size else "-" for each in (ages, errors)),
        *(f"{sum(status.counters[key] for key in keys):.0f}" for keys in COUNTERS.values()),
        str(source.dropped),
        LEVELS[watcher.worst],
        watcher.told.replace("|", "/")[:140],
    ]


def cases(part: str, seconds: float) -> Iterator[tuple[str, dict]]:
    """Names, and what `run` is given."""
    if part == "line":
        for fault, amounts in LINE.items():
            for seed, amount in enumerate(amounts):
                given = {"fault": fault, "amount": amount, "seed": seed}
                yield f"{fault}, {100 * amount:g} %", given | {"seconds": seconds}
    elif part == "nonsense":
        for fault, amount in itertools.product((*ROWS, *ANSWERS, *IDENTITY), (1.0, 0.01)):
            given = {"fault": fault, "amount": amount, "seconds": seconds}
            yield f"{fault}, {100 * amount:g} %", given
    elif part == "age":
        shares = [0.9 * FAST, 0.5 * FAST, 0.15 * FAST]
        for line, buffer in itertools.product(("pty", "tcp"), (1e4, 1e8)):
            for carries in shares if line == "pty" else [*shares, 400e3]:  # the last: a modem
                given = {"rate": 250.0, "buffer": int(buffer), "throttle": carries}
                given |= {"seconds": 3 * seconds} | ({"port": "tcp:0"} if line == "tcp" else {})
                yield f"{line}, buffer {buffer / 1e6:g} MB, carries {carries / FAST:.0%}", given
    else:
        for fault in ("restart", "restart-streaming"):
            yield f"{fault} every 2 s", {"fault": fault, "amount": 2.0, "seconds": 4 * seconds}


def short(part: str, options: argparse.Namespace) -> None:
    """A table of the cases of a part."""
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        port = f"pty:{folder}/port"
        for name, given in cases(part, options.seconds):
            rows.append(run(name, **{"port": port} | given))
            print(name, file=sys.stderr, flush=True)
        print("\n".join(markdown(HEADER, rows)), flush=True)
        if part == "restarts":
            print(f"\nplug pulled {options.times} times: {plug_pulled(port, options.times)}")


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


SHORT = ("line", "nonsense", "age", "restarts")
LONG = {"soak": fault_soak.soak, "kills": fault_kills.kills}


def main() -> int:
    """Run the parts that are asked for; returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join((*SHORT, *LONG)))
    parser.add_argument("--seconds", type=float, default=4.0, help="of each case")
    parser.add_argument("--minutes", type=float, default=1.0, help="of a soak")
    parser.add_argument("--times", type=int, default=10, help="of each kill, and of the plug")
    sensors = ("8x8@250", "16x16@15")
    parser.add_argument(
        "--sensor", nargs="+", default=sensors, help="of the soak, ROWSxCOLUMNS@RATE"
    )
    parser.add_argument("--program", nargs="+", help="to be killed; all of them otherwise")
    options = parser.parse_args()
    unknown = set(options.parts) - {*SHORT, *LONG}
    if unknown:
        parser.error(
            f"no part {', '.join(sorted(unknown))}; there are {', '.join((*SHORT, *LONG))}"
        )
    for name in options.parts or SHORT:
        print(f"## {name}\n", flush=True)
        LONG[name](options) if name in LONG else short(name, options)
        print(flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
