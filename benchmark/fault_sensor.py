"""The sensor of sensor.c as a process, and the judge of what comes out at the other end.

Every reading of that sensor is a hash of sequence, row and electrode; the hash is written down here
a second time, so that any wrong value in a frame is seen.
"""

from __future__ import annotations

import contextlib
import functools
import re
import signal
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from tomotactile_ros.devices.base import Frame

SOURCE = Path(__file__).with_name("sensor.c")
SCALE = 3.3 / 4096
WAIT = 10.0


def build(folder: str) -> str:
    """Compile the sensor; return the path of the program."""
    program = str(Path(folder, "sensor"))
    command = ["cc", "-std=c99", "-O2", "-Wall", "-Wextra", "-Werror", "-o", program, str(SOURCE)]
    subprocess.run([*command, "-lm"], check=True)
    return program


@functools.cache
def _places(electrodes: int) -> np.ndarray:
    row, electrode = np.indices((electrodes, electrodes), dtype=np.uint32) + np.uint32(1)
    return row * np.uint32(0x85EBCA77) ^ electrode * np.uint32(0xC2B2AE3D)


def readings(sequence: int, electrodes: int) -> np.ndarray:
    """Counts (E, E) of a frame, as sensor.c makes them."""
    h = _places(electrodes) ^ np.uint32(sequence * 0x9E3779B1 & 0xFFFFFFFF)
    h ^= h >> np.uint32(15)
    h *= np.uint32(0x2C1B3C6D)
    h ^= h >> np.uint32(12)
    h *= np.uint32(0x297A2D39)
    h ^= h >> np.uint32(15)
    h %= np.uint32(4000)
    return h


class Sensor:
    """The running program; `port` is what a host opens.

    Parameters
    ----------
    program : str
        As `build` has made it.
    port : str
        ``pty:LINK`` or ``tcp:PORT``.
    options : of the program, without dashes
    """

    def __init__(self, program: str, port: str, **options) -> None:
        words = [w for name, v in options.items() for w in (f"--{name}", str(v))]
        self.process = subprocess.Popen(
            [program, "--port", port, *words], stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self.port = self.process.stdout.readline().strip()
        self.starts: list[tuple[int, float, float]] = []  # sequence, s (monotonic), frames/s
        self.made = self.rows = self.dropped = 0
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            if found := re.match(r"from (\d+) (\d+) (\S+)", line):
                self.starts.append((int(found[1]), 1e-6 * float(found[2]), float(found[3])))
            elif found := re.match(r"frames (\d+), rows (\d+), dropped (\d+)", line):
                self.made, self.rows, self.dropped = map(int, found.groups())

    def begin_of(self, sequence: int, arrival: float) -> float:
        """When the frame of that number began that arrived then, s, monotonic clock; or NaN.

        To be asked when the sensor has ended: before, not all that it has said may have been read.
        """
        for first, begin, rate in reversed(self.starts):
            if sequence >= first and begin <= arrival:
                return begin + (sequence - first) / rate
        return np.nan

    def stop(self, how: int = signal.SIGTERM) -> None:
        """End it and wait; a kill leaves no figures."""
        self.process.send_signal(how)
        self.process.wait()
        self._reader.join()
        self.process.stdout.close()


@contextlib.contextmanager
def sensor(program: str, port: str, **options) -> Iterator[Sensor]:
    """A running sensor, ended at last."""
    running = Sensor(program, port, **options)
    try:
        yield running
    finally:
        running.stop()


class Judge:
    """Takes frames and compares every reading with what was sent.

    Attributes
    ----------
    frames, wrong_frames, wrong_readings : int
        `wrong_readings` differ from those of the frame whose sequence number they carry.
    """

    def __init__(self, electrodes: int) -> None:
        self.frames = self.wrong_frames = self.wrong_readings = 0
        self._times: list[tuple[int, float, float]] = []  # sequence, arrival, stamp (monotonic)
        self.arrived = threading.Event()
        self._electrodes = electrodes

    def __call__(self, frame: Frame) -> None:
        now, unix = time.monotonic(), time.time()
        self.frames += 1
        expected = readings(frame.sequence, self._electrodes)
        valid = ~np.isnan(frame.voltages)
        wrong = int((np.abs(frame.voltages - expected * SCALE) > 0.1 * SCALE)[valid].sum())
        self.wrong_readings += wrong
        self.wrong_frames += wrong > 0
        if not wrong:
            self._times.append((frame.sequence, now, frame.stamp - unix + now))
        self.arrived.set()

    def times(self, source: Sensor) -> tuple[np.ndarray, np.ndarray]:
        """Of each right frame, s: from its true begin to its arrival; its stamp minus that begin.

        To be asked when the sensor has ended; frames whose begin is not known are left out.
        """
        times = [(source.begin_of(n, arrival), arrival, stamp) for n, arrival, stamp in self._times]
        begin, arrival, stamp = np.array(times).reshape(-1, 3).T
        known = np.isfinite(begin)
        return (arrival - begin)[known], (stamp - begin)[known]

    def wait_for_frame(self, patience: float = WAIT) -> float:
        """Wait for the next frame; the s it took, inf where none came."""
        begin = time.monotonic()
        self.arrived.clear()
        return time.monotonic() - begin if self.arrived.wait(patience) else np.inf


@contextlib.contextmanager
def workshop() -> Iterator[tuple[str, str]]:
    """A folder that goes away, with the program in it: (folder, program)."""
    with tempfile.TemporaryDirectory() as folder:
        yield folder, build(folder)
