"""A sensor without hardware: frames of a simulated scene at the pace of a real scan."""

from __future__ import annotations

import time
from collections.abc import Sequence

import numpy as np

from tomotactile_ros.devices.base import Frame, ThreadedDevice, unix_time
from tomotactile_ros.simulation import ROW_PERIOD, Simulator
from tomotactile_ros.touches import Touch, Touches


class FakeDevice(ThreadedDevice):
    """Scans a simulated sheet.

    Frame k covers the time from k / rate to (k + 1) / rate: it is computed meanwhile, handed over
    at the end and stamped with its beginning.  A simulation too slow for the rate leaves frames out
    (`frames_skipped`), so that time in the scene stays time in the world.

    In a live scene `press` says from any thread what touches the sheet. A frame is then computed at
    its end, when all that has touched meanwhile is known.

    Parameters
    ----------
    simulator : Simulator
        Time in its scene begins when the device is opened.
    rate : float
        Frames/s; 0 means 1000 ground conditions a second (Kojima et al. 2023: 15.6 Hz for 64).
    """

    def __init__(self, simulator: Simulator, *, rate: float = 0.0) -> None:
        super().__init__()
        self._simulator = simulator
        self._grounded = simulator.grounded.astype(np.uint16)
        self._skipped = 0
        self._begin: float | None = None  # of time in the scene, s, monotonic clock
        self._touches = Touches(simulator.layout) if simulator.scene.live else None
        simulator.live = self._touches
        self.set_rate(rate)

    def set_rate(self, rate: float) -> None:
        """Scan `rate` frames per second from the next frame on (0: 1000 ground conditions)."""
        super().set_rate(rate or 1.0 / (ROW_PERIOD * self._grounded.size))

    def press(self, touches: Sequence[Touch]) -> list[str]:
        """From now on these touches are on the sheet, and no others, for `touches.HOLD` s.

        Returns a line about each that cannot be; it is left out. A device that is not open feels
        nothing.
        """
        if self._touches is None:
            return ["touches: the scene is not live, it takes none from outside"]
        if self._begin is None:
            return []
        return self._touches.press(touches, time.monotonic() - self._begin)

    def _counters(self) -> dict[str, float]:
        return {"frames_skipped": float(self._skipped)}

    def _run(self) -> None:
        if self._touches is not None:
            self._touches.clear()
        self._begin = begin = start = time.monotonic()
        sequence = self._skipped = 0
        took = 0.0
        while not self._stop.is_set():
            if not self._streaming:
                self._set_state("stopped", "stopped on request")
                self._pause(1.0)
                start = time.monotonic()
                continue
            period = 1.0 / self._rate
            end = start + period
            # as under real hardware, the computer is free for the last frame's image at first
            idle_until = start + min(0.5 * period, period - 2.0 * took)
            if self._touches is not None:
                idle_until = end
            if self._stop.wait(max(0.0, idle_until - time.monotonic())):
                return
            now = time.monotonic()
            self._simulator.row_period = period / self._grounded.size
            voltages = self._simulator.frame(start - begin, sequence).astype(np.float32)
            took = time.monotonic() - now
            if self._stop.wait(max(0.0, end - time.monotonic())):
                return
            self._set_state("streaming", f"simulated, {self._rate:g} frames/s")
            stamp = unix_time(start)
            drive = self._simulator.scene.drive_voltage
            row_period = self._simulator.row_period
            frame = Frame(voltages, self._grounded, sequence, stamp, drive, row_period)
            self._deliver(frame, end)
            behind = int((time.monotonic() - end) / period)
            self._skipped += behind
            sequence += 1 + behind
            start = end + behind * period
