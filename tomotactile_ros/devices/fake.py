"""A sensor without hardware: frames of a simulated scene at the pace of a real scan."""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from tomotactile_ros.devices.base import Frame, ThreadedDevice

DEFAULT_RATE = 15.625


class FakeDevice(ThreadedDevice):
    """Scans a simulated sheet.

    Frame k covers the time from k / rate to (k + 1) / rate: it is computed meanwhile, handed over
    at the end and stamped with its beginning.  A simulation too slow for the rate leaves frames out
    (`frames_skipped`), so that time in the scene stays time in the world.

    Parameters
    ----------
    frame : callable
        (time in the scene, s; sequence) -> voltages (L, E), V, NaN where there is no reading.
    grounded : (L,) int
        Grounded electrode of each row.
    drive_voltage : float, V
    rate : float
        Frames/s; 0 means 15.625, the paper's 64 ground conditions at 1 kHz.
    """

    def __init__(
        self,
        frame: Callable[[float, int], np.ndarray],
        grounded: np.ndarray,
        drive_voltage: float,
        *,
        rate: float = 0.0,
    ) -> None:
        super().__init__(rate or DEFAULT_RATE)
        self._frame = frame
        self._grounded = np.asarray(grounded, dtype=np.uint16)
        self._drive_voltage = drive_voltage
        self._skipped = 0

    def set_rate(self, rate: float) -> None:
        """Scan `rate` frames per second from the next frame on (0: 15.625)."""
        super().set_rate(rate or DEFAULT_RATE)

    def _counters(self) -> dict[str, float]:
        return {"frames_skipped": float(self._skipped)}

    def _run(self) -> None:
        begin = start = time.monotonic()
        sequence = 0
        while not self._stop.is_set():
            if not self._streaming:
                self._set_state("stopped", "stopped on request")
                self._pause(1.0)
                start = time.monotonic()
                continue
            period = 1.0 / self._rate
            voltages = np.asarray(self._frame(start - begin, sequence), dtype=np.float32)
            end = start + period
            if self._stop.wait(max(0.0, end - time.monotonic())):
                return
            self._set_state("streaming", f"simulated, {self._rate:g} frames/s")
            stamp = start + time.time() - time.monotonic()
            self._deliver(
                Frame(voltages, self._grounded, sequence, stamp, self._drive_voltage), end
            )
            behind = int((time.monotonic() - end) / period)
            self._skipped += behind
            sequence += 1 + behind
            start = end + behind * period
