"""The sensor of sensor.py as a process, and the judge of what comes out at the other end."""

from __future__ import annotations

import re
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
from sensor import SCALE, readings

from tomotactile_ros.devices.base import Frame

PROGRAM = sys.executable, str(Path(__file__).with_name("sensor.py"))
WAIT = 10.0


class Sensor:
    """The running program; `port` is what a host opens.

    Parameters
    ----------
    port : str
        ``pty:LINK`` or ``tcp:PORT``.
    options : of the program, without dashes
    """

    def __init__(self, port: str, **options) -> None:
        words = [w for name, v in options.items() for w in (f"--{name}", str(v))]
        self.process = subprocess.Popen(
            [*PROGRAM, "--port", port, *words], stdout=subprocess.PIPE, text=True, bufsize=1
        )
        self.port = self.process.stdout.readline().strip()
        self.starts: list[tuple[int, float, float]] = []  # sequence, s (monotonic), frames/s
        self.made = self.dropped = 0
        self._reader = threading.Thread(target=self._read, daemon=True)
        self._reader.start()

    def _read(self) -> None:
        for line in self.process.stdout:
            if found := re.match(r"from (\d+) (\d+) (\S+)", line):
                self.starts.append((int(found[1]), 1e-6 * float(found[2]), float(found[3])))
            elif found := re.match(r"frames (\d+), rows \d+, dropped (\d+)", line):
                self.made, self.dropped = map(int, found.groups())

    def begin_of(self, sequence: int, arrival: float) -> float:
        """When the frame of that number began that arrived then, s, monotonic clock; or NaN.

        To be asked when the sensor has ended: before, not all that it has said may have been read.
        """
        for first, begin, rate in reversed(self.starts):
            if sequence >= first and begin <= arrival:
                return begin + (sequence - first) / rate
        return np.nan

    def __enter__(self):
        return self

    def __exit__(self, *_) -> None:
        self.stop()

    def stop(self, how: int = signal.SIGTERM) -> None:
        """End it and wait; a kill leaves no figures."""
        self.process.send_signal(how)
        self.process.wait()
        self._reader.join()
        self.process.stdout.close()


class Judge:
    """Takes frames and compares every reading with what was sent.

    Attributes
    ----------
    frames, wrong_readings : int
        `wrong_readings` differ from those of the frame whose sequence number they carry.
    """

    def __init__(self, electrodes: int) -> None:
        self.frames = self.wrong_readings = 0
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
        if not wrong:
            self._times.append((frame.sequence, now, frame.stamp - unix + now))
        self.arrived.set()

    @property
    def sequences(self) -> list[int]:
        """Of the right frames."""
        return [sequence for sequence, _, _ in self._times]

    def times(self, source: Sensor) -> tuple[np.ndarray, np.ndarray]:
        """Of each right frame, s: from its true begin to its arrival; its stamp minus that begin.

        To be asked when the sensor has ended; frames whose begin is not known are left out.
        """
        times = [(source.begin_of(n, arrival), arrival, stamp) for n, arrival, stamp in self._times]
        begin, arrival, stamp = np.array(times).reshape(-1, 3).T
        known = np.isfinite(begin)
        return (arrival - begin)[known], (stamp - begin)[known]

    def wait_for_frame(self) -> float:
        """Wait for the next frame; the s it took, inf where none came."""
        begin = time.monotonic()
        self.arrived.clear()
        return time.monotonic() - begin if self.arrived.wait(WAIT) else np.inf
