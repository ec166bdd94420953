"""Maps the clock of a device to the host's monotonic clock, from pairs of device and arrival time.

A packet can arrive late, never early: of each second only the smallest difference between arrival
and device time is used.  A line through the minima of the last 30 s, with the median of the
pairwise slopes (Theil 1950, Sen 1968), gives offset and drift; delayed packets do not move it, nor
does what has piled up while the host stood still or because the line is slower than the device.
Whatever is late is taken for late, never for a jump of the device's clock: old readings must not be
stamped fresh.  Whoever has emptied the line (devices/serial.py) begins a new mapping.
"""

from __future__ import annotations

from collections import deque

import numpy as np


class DeviceClock:
    """Offset and drift of one device clock; all times in s.

    Parameters
    ----------
    window : int
        Number of one-second minima the line goes through.
    tolerance : float
        An arrival this much before its predicted time means that the device clock has jumped.  In
        the first second an early arrival only says that the ones before were late, unless it is
        early by more than a second.  An arrival this much after it is late.

    Attributes
    ----------
    late_since : float or None
        Host time since when every arrival has been late.
    late : float
        How late the last arrival was, s; below 0 where it was early.
    """

    MAX_DRIFT = 2e-3
    LEAST_STEP = 1e-4

    def __init__(self, window: int = 30, tolerance: float = 0.05) -> None:
        self.jumps = 0
        self._tolerance = tolerance
        self._window = window
        self._last_mapped = -np.inf
        self._begun = False
        self._begin(0.0, 0.0)

    def _begin(self, device: float, host: float) -> None:
        self._device0 = self._last_device = device
        self._host0 = host
        self.late_since: float | None = None
        self.late = 0.0
        self._slope = self._intercept = 0.0
        self._minima: deque[tuple[float, float]] = deque(maxlen=self._window)
        self._least = (0.0, 0.0)
        self._bucket_end = 1.0
        self._outdated = False

    @property
    def drift(self) -> float:
        """Relative speed of the device clock: 1e-6 means 1 µs per second too fast."""
        return -self._slope / (1.0 + self._slope)

    def update(self, device: float, host: float) -> None:
        """Take in that what happened at `device` arrived at `host`."""
        if not self._begun:
            self._begun = True
            self._begin(device, host)
            return
        late = self.late = host - self.to_host(device)
        if self._has_jumped(device, late):
            self.jumps += 1
            self._begin(device, host)
            return
        self._last_device = device
        if late > self._tolerance:
            self.late_since = host if self.late_since is None else self.late_since
            return
        self.late_since = None
        self._intercept += min(late, 0.0)
        elapsed = device - self._device0
        difference = (host - self._host0) - elapsed
        if difference < self._least[1]:
            self._least = (elapsed, difference)
        if elapsed >= self._bucket_end:
            self._minima.append(self._least)
            self._least = (elapsed, np.inf)
            self._bucket_end = elapsed + 1.0
            self._outdated = True

    def fit(self) -> None:
        """Draw the line anew where a second is over; takes its time, so not while a frame waits."""
        if not self._outdated or len(self._minima) < 5:
            return
        self._outdated = False
        elapsed, difference = np.array(self._minima).T
        first, second = np.triu_indices(elapsed.size, k=1)
        slopes = (difference[second] - difference[first]) / (elapsed[second] - elapsed[first])
        self._slope = float(np.clip(np.median(slopes), -self.MAX_DRIFT, self.MAX_DRIFT))
        self._intercept = float(np.min(difference - self._slope * elapsed))

    def to_host(self, device: float) -> float:
        """Host time of the `device` time; needs one `update` before."""
        elapsed = device - self._device0
        return self._host0 + elapsed * (1.0 + self._slope) + self._intercept

    def duration(self, device: float) -> float:
        """What a short time by the `device` clock is by the host's."""
        return device * (1.0 + self._slope)

    def stamp(self, device: float) -> float:
        """Host time of `device`, later than every stamp before by `LEAST_STEP` or more."""
        self._last_mapped = max(self.to_host(device), self._last_mapped + self.LEAST_STEP)
        return self._last_mapped

    def successor(self) -> DeviceClock:
        """A fresh mapping, for a device that may have restarted, whose stamps go on from here."""
        clock = DeviceClock(self._window, self._tolerance)
        clock._last_mapped, clock.jumps = self._last_mapped, self.jumps
        return clock

    def _has_jumped(self, device: float, late: float) -> bool:
        settled = device - self._device0 >= 1.0 or late < -1.0
        return device < self._last_device or (settled and late < -self._tolerance)
