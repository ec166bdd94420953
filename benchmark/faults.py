"""Everything that can go wrong between sensor and picture, done on purpose, and what is said of it.

    scripts/setup python3 benchmark/faults.py                    some minutes, all but the long ones
    scripts/setup python3 benchmark/faults.py line nonsense      only these
    scripts/setup python3 benchmark/faults.py soak --minutes 30 --sensor 8x8@250 16x16@15
    scripts/setup python3 benchmark/faults.py kills --times 100
    scripts/setup python3 benchmark/faults.py fuzz --bytes 1e8
    scripts/setup python3 benchmark/faults.py qemu --minutes 10

The sensor is sensor.c, written from docs/protocol.md alone; every reading is a hash of sequence,
row and electrode, so that any wrong value is seen. The figures of docs/faults.md come from here.

line      what a bad line does to the bytes: frames published, wrong readings, level, counters
loss      share of packets lost against the level of the diagnostics
nonsense  whole packets that say what cannot be, or what should not be
age       a line slower than the sensor: how old frames are, and whether their stamp says so
restarts  a device that restarts, and one whose plug is pulled
soak      driver node and subscriber for long: lost, age, memory, descriptors
kills     every program ended at random moments: strays, broken files
fuzz      random bytes to the parser and to the firmware
qemu      the firmware in QEMU at 1,000 rows/s: every reading right
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import os
import signal
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tomotactile_ros.devices.base import Status
from tomotactile_ros.devices.serial import SerialDevice
from tomotactile_ros.nodes import data_source, diagnostics

ROOT = Path(__file__).resolve().parent.parent
sys.path.insert(0, str(ROOT / "benchmark"))  # scripts/setup keeps Python from doing so

import fault_kills
import fault_soak
from fault_sensor import Judge, Sensor, sensor, terminal_server, workshop

LEVELS = ("OK", "WARN", "ERROR")
MAX_AGE = 1.0  # s, as the driver node has it
FRAME_BYTES = 64 * 169.0  # of 8 x 8, on the line
SHORT = ("line", "loss", "nonsense", "age", "restarts")

LINE = {
    "none": (1.0,),
    "flip": (0.001, 0.01, 0.1),
    "burst": (0.001, 0.01, 0.1),
    "zeros": (0.001, 0.01, 0.1),
    "drop-byte": (0.001, 0.01, 0.1),
    "insert-byte": (0.001, 0.01, 0.1),
    "cut": (0.001, 0.01, 0.1),
    "lose": (0.001, 0.01, 0.1),
    "double": (0.001, 0.01, 0.1),
    "noise": (0.0001, 0.001),
    "swap": (0.001, 0.01, 0.1),
    "merge": (0.001, 0.01, 0.1),
}
LOSS = (0.0, 1e-5, 1e-4, 1e-3, 0.01, 0.03)  # of the packets
NOT_NONSENSE = (*LINE, "restart", "restart-streaming")


@dataclass
class Outcome:
    """What one run with a fault has shown."""

    made: int
    dropped: int
    judge: Judge
    ages: np.ndarray
    stamp_errors: np.ndarray
    worst: int  # level
    state: str
    message: str
    counters: dict[str, float]

    @property
    def level(self) -> str:
        """Name of the worst level that the diagnostics had once frames should flow."""
        return LEVELS[self.worst]


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
        self.worst, self.told = 0, ""
        self._device, self._over = device, threading.Event()
        self._thread = threading.Thread(target=self._watch, daemon=True)
        self._thread.start()

    def _watch(self) -> None:
        while not self._over.wait(0.1):
            status = self._device.status()
            if status.state in ("closed", "disconnected", "identifying"):
                continue
            level = level_of(status)
            if level > self.worst:
                self.worst, self.told = level, f"{status.state}: {status.message}"

    def close(self) -> None:
        """Stop asking."""
        self._over.set()
        self._thread.join()


def run(
    program: str, port: str, seconds: float, side: int = 8, rate: float = 60.0,
    network: bool = False, **options,
) -> Outcome:  # fmt: skip
    """One sensor with one fault and one device that listens for so many seconds.

    `network`: the sensor's tty is reached by RFC 2217, through a terminal server of this process.
    """
    judge = Judge(side * side)
    with contextlib.ExitStack() as stack:
        source = stack.enter_context(sensor(program, port, electrodes=side * side, **options))
        where = stack.enter_context(terminal_server(source.port)) if network else source.port
        device = SerialDevice(where, side * side, rate=rate)
        device.max_age = MAX_AGE
        device.open(judge)
        watcher = Watcher(device)
        time.sleep(seconds)
        status = device.status()
        watcher.close()
        device.close()
    if level_of(status) > watcher.worst:
        watcher.worst, watcher.told = level_of(status), f"{status.state}: {status.message}"
    message = watcher.told or f"{status.state}: {status.message}"
    ages, errors = judge.times(source)
    return Outcome(
        source.made, source.dropped, judge, ages, errors, watcher.worst, status.state, message,
        status.counters,
    )  # fmt: skip


def table(head: list[str], rows: list[list[str]]) -> None:
    """Print a table as in the documents."""
    print("| " + " | ".join(head) + " |")
    print("|" + "---|" * len(head))
    for row in rows:
        print("| " + " | ".join(row) + " |", flush=True)
    print()


def remark(outcome: Outcome) -> str:
    """What the diagnostics say beyond the device's name, short and fit for a table."""
    words = outcome.message.replace(outcome.state + ": ", "", 1)
    remarks = [word for word in words.split("; ") if "(firmware" not in word]
    text = "; ".join(remarks) or "streaming"
    return text.replace("|", "/")[:140]


def line_faults(options: argparse.Namespace) -> None:
    """Damage to the bytes on the way."""
    rows = []
    with workshop() as (folder, program):
        for fault, amounts in LINE.items():
            for amount in amounts:
                out = run(
                    program, f"pty:{folder}/port", options.seconds, fault=fault, amount=amount,
                    seed=len(rows), protocol=options.protocol,
                )  # fmt: skip
                c = out.counters
                damaged = sum(c[k] for k in ("crc_errors", "framing_errors", "malformed"))
                rows.append(
                    [
                        fault,
                        "" if fault == "none" else f"{100 * amount:g} %",
                        str(out.made),
                        str(out.judge.frames),
                        str(out.judge.wrong_readings),
                        f"{damaged:.0f}",
                        f"{c['packets_lost']:.0f}",
                        f"{c['reconnects']:.0f}",
                        f"{out.dropped}",
                        out.level,
                    ]
                )
    table(
        ["fault", "of the packets", "frames sent", "published", "wrong readings",
         "packets refused", "rows lost", "reconnects", "rows that the sensor dropped", "level"],
        rows,
    )  # fmt: skip


def loss_levels(options: argparse.Namespace) -> None:
    """Lost packets against the level of the diagnostics."""
    rows = []
    with workshop() as (folder, program):
        for amount in LOSS:
            out = run(
                program, f"pty:{folder}/port", 2 * options.seconds, fault="lose", amount=amount,
                protocol=options.protocol,
            )  # fmt: skip
            lost = 1.0 - out.judge.frames / max(out.made, 1)
            rows.append([f"{100 * amount:g} %", f"{100 * lost:.1f} %", out.level, remark(out)])
    table(["packets lost", "frames lost", "level", "said"], rows)


def stamp_error(outcome: Outcome) -> str:
    """Largest distance of a stamp from the true begin of its frame."""
    errors = np.abs(outcome.stamp_errors)
    if not errors.size:
        return "-"
    return f"{1e3 * errors.max():.0f} ms" if errors.max() < 1.0 else f"{errors.max():.1f} s"


def kinds_of_nonsense(program: str) -> list[str]:
    """Faults of the sensor that are not of the line."""
    known = subprocess.run([program, "--list"], capture_output=True, text=True, check=True)
    return [fault for fault in known.stdout.split() if fault not in NOT_NONSENSE]


def nonsense(options: argparse.Namespace) -> None:
    """Packets that are whole and wrong: always, and one in a hundred."""
    rows = []
    with workshop() as (folder, program):
        for fault in kinds_of_nonsense(program):
            cells = []
            for amount in (1.0, 0.01):
                out = run(
                    program, f"pty:{folder}/port", options.seconds, fault=fault, amount=amount,
                    protocol=options.protocol,
                )  # fmt: skip
                share = f"{out.judge.frames} of {out.made}"
                cells += [share, str(out.judge.wrong_frames), stamp_error(out), out.level]
                if amount == 1.0:
                    said = remark(out)
            rows.append([fault, *cells, said])
    table(
        ["what is said", "always: published", "wrong", "stamps off", "level",
         "1 %: published", "wrong", "stamps off", "level", "diagnostics (always)"], rows,
    )  # fmt: skip


def age(options: argparse.Namespace) -> None:
    """A line that carries less than the sensor makes, with small and with large buffers."""
    shares = itertools.product(("pty", "tcp"), (1e4, 1e8), (0.9, 0.5, 0.15))
    cases = [(line, 250.0, buffer, share * 250.0 * FRAME_BYTES) for line, buffer, share in shares]
    cases += [("socket", 250.0, buffer, 400e3) for buffer in (1e4, 1e8)]  # what a modem carries
    cases += [("rfc2217", 60.0, buffer, None) for buffer in (1e4, 1e8)]  # as fast as it is
    rows = []
    with workshop() as (folder, program):
        for line, rate, buffer, carries in cases:
            before = resident()
            out = run(
                program, f"pty:{folder}/port" if line in ("pty", "rfc2217") else "tcp:0",
                3 * options.seconds, rate=rate, buffer=int(buffer), throttle=carries or 0,
                protocol=options.protocol, network=line == "rfc2217",
            )  # fmt: skip
            oldest = f"{out.ages.max():.2f} s" if out.ages.size else "-"
            share = 100 * carries / rate / FRAME_BYTES if carries else None
            rows.append(
                [
                    line,
                    f"{rate:g}",
                    f"{buffer / 1e6:g} MB",
                    f"{1e-3 * carries:.0f} kB/s, {share:.0f} %" if carries else "what it can",
                    f"{out.judge.frames} of {out.made}",
                    str(out.judge.wrong_readings),
                    oldest,
                    stamp_error(out),
                    f"{out.counters['frames_stale']:.0f}",
                    f"{resident() - before:+.1f} MB",
                    out.level,
                ]
            )
    table(
        ["line", "frames/s", "sensor's buffer", "line carries", "published", "wrong readings",
         "oldest", "stamp off by", "too old, kept back", "memory", "level"], rows,
    )  # fmt: skip


def resident() -> float:
    """Memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def restarts(options: argparse.Namespace) -> None:
    """Devices that begin anew: by themselves, while they stream, and without their plug."""
    rows = []
    with workshop() as (folder, program):
        port = f"pty:{folder}/port"
        for fault in ("restart", "restart-streaming"):
            out = run(
                program, port, 4 * options.seconds, fault=fault, amount=2.0,
                protocol=options.protocol,
            )  # fmt: skip
            rows.append(
                [
                    {"restart": "restarts, is quiet", "restart-streaming": "restarts, goes on"}[
                        fault
                    ],
                    f"{4 * options.seconds / 2:.0f}",
                    f"{out.judge.frames} of {out.made}",
                    str(out.judge.wrong_readings),
                    "",
                    out.level,
                ]
            )
        rows.append(plug_pulled(program, port, options.times))
    table(["what", "times", "published", "wrong readings", "away, mean and longest", "level"], rows)


def plug_pulled(program: str, port: str, times: int) -> list[str]:
    """Kill the sensor and start another one, again and again, once the driver has said that it is away.

    The level is the worst that the driver gives from the first frame on, also while nothing is there.
    """
    judge = Judge(64)
    device = SerialDevice(port.partition(":")[2], 64, rate=60.0)
    device.open(judge)
    waits, worst = [], 0
    for _ in range(times):
        source = Sensor(program, port)
        waits.append(judge.wait_for_frame())
        source.stop(signal.SIGKILL)
        worst = max(worst, level_of(noticed(device)))
    device.close()
    spread = f"{np.mean(waits):.2f} s, {np.max(waits):.2f} s"
    wrong = str(judge.wrong_readings)
    return ["plug pulled", str(times), str(judge.frames), wrong, spread, LEVELS[worst]]


def noticed(device: SerialDevice, patience: float = 10.0) -> Status:
    """What a device says as soon as it no longer says that frames arrive; after `patience`, s, what it
    says then."""
    end = time.monotonic() + patience
    status = device.status()
    while status.state == "streaming" and time.monotonic() < end:
        time.sleep(0.01)
        status = device.status()
    return status


def fuzz(options: argparse.Namespace) -> None:
    """Random bytes to the parser (fuzz_protocol.py) and to the firmware (firmware/test/fuzz.c)."""
    parser = [sys.executable, str(ROOT / "benchmark" / "fuzz_protocol.py"), "--seconds", "10"]
    subprocess.run([*parser, "--bytes", str(options.bytes)], check=True)
    with tempfile.TemporaryDirectory() as folder:
        make = ["make", "-s", "-C", str(ROOT / "firmware"), "fuzz", f"OUT={folder}"]
        subprocess.run([*make, f"FUZZ_BYTES={options.bytes}"], check=True)


PARTS = {
    "line": line_faults,
    "loss": loss_levels,
    "nonsense": nonsense,
    "age": age,
    "restarts": restarts,
    "soak": fault_soak.soak,
    "kills": fault_kills.kills,
    "fuzz": fuzz,
    "qemu": fault_soak.qemu,
}


def main() -> int:
    """Run the parts that are asked for; returns the exit status."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("parts", nargs="*", metavar="PART", help=", ".join(PARTS))
    parser.add_argument("--seconds", type=float, default=4.0, help="of each case")
    parser.add_argument("--minutes", type=float, default=1.0, help="of a soak, or of QEMU")
    parser.add_argument("--times", type=int, default=10, help="of each kill, and of the plug")
    parser.add_argument("--bytes", type=float, default=1e7, help="of the fuzzing")
    parser.add_argument(
        "--sensor",
        nargs="+",
        default=["8x8@250", "16x16@15"],
        help="of the soak, ROWSxCOLUMNS@RATE",
    )
    parser.add_argument("--protocol", type=int, default=1, choices=(1, 2), help="of the sensor")
    parser.add_argument("--program", nargs="+", help="to be killed; all of them otherwise")
    options = parser.parse_args()
    unknown = set(options.parts) - set(PARTS)
    if unknown:
        parser.error(f"no part {', '.join(sorted(unknown))}; there are {', '.join(PARTS)}")
    for name in options.parts or SHORT:
        print(f"## {name}\n", flush=True)
        PARTS[name](options)
    return 0


if __name__ == "__main__":
    sys.exit(main())
