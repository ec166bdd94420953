"""Figures about a stream of frames for diagnostics: rate, latency, dead channels."""

from __future__ import annotations

import threading
import time

import numpy as np


class DeadChannels:
    """Finds electrodes whose readings do not take part in what happens on the sheet.

    The span of an electrode is its largest minus its smallest reading over all ground conditions
    of `window` frames.  Something presses when the median span exceeds 5 % of the drive voltage;
    only then can dead and idle be told apart.  An electrode is called dead while its span is below
    2 % of the median span; with nothing on the sheet that verdict stays.  It is also called dead
    while it has no valid reading in a whole window.
    """

    def __init__(self, window: int = 64) -> None:
        self.dead: tuple[int, ...] = ()
        self._window = window
        self._constant: set[int] = set()
        self._frames = 0
        self._low: np.ndarray | None = None
        self._high: np.ndarray | None = None

    def update(self, voltages: np.ndarray, drive_voltage: float) -> None:
        """Take in the readings (L, E) of one frame, V, NaN where invalid."""
        low, high = np.fmin.reduce(voltages, axis=0), np.fmax.reduce(voltages, axis=0)
        if self._low is None or self._low.shape != low.shape:
            self._low, self._high, self._frames = low, high, 0
        else:
            np.fmin(self._low, low, out=self._low)
            np.fmax(self._high, high, out=self._high)
        self._frames += 1
        if self._frames >= self._window:
            self._judge(drive_voltage)
            self._low = None

    def _judge(self, drive_voltage: float) -> None:
        span = self._high - self._low
        invalid = np.isnan(span)
        median = 0.0 if invalid.all() else np.median(span[~invalid])
        if median > 0.05 * drive_voltage:
            self._constant = set(np.flatnonzero(span < 0.02 * median).tolist())
        self.dead = tuple(sorted(self._constant.union(np.flatnonzero(invalid).tolist())))


class Health:
    """Counts delivered frames, measures their rate and latency, and watches the channels."""

    RATE_WINDOW, LEAST_SPAN = 5.0, 0.5

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self.reset()

    def reset(self) -> None:
        """Forget everything, as at the start."""
        with self._lock:
            self.dead_channels = DeadChannels()
            self.callback_error = ""
            self._frames = 0
            self._callback_errors = 0
            self._times = np.full(1024, -np.inf)
            self._latencies = np.full(4096, np.nan)

    def frame_delivered(
        self, voltages: np.ndarray, drive_voltage: float, last_sample: float | None
    ) -> None:
        """Note a frame that has just been handed over; `last_sample` in s, monotonic clock."""
        now = time.monotonic()
        with self._lock:
            self._times[self._frames % self._times.size] = now
            late = np.nan if last_sample is None else now - last_sample
            self._latencies[self._frames % self._latencies.size] = late
            self._frames += 1
        self.dead_channels.update(voltages, drive_voltage)

    def forget_rate(self) -> None:
        """Measure the rate anew, because another one is due from now on."""
        with self._lock:
            self._times.fill(-np.inf)

    def callback_failed(self, message: str) -> None:
        """Note that the receiver of a frame raised an exception; the last one is kept."""
        with self._lock:
            self._callback_errors += 1
            self.callback_error = " ".join(message.split())

    def counters(self) -> dict[str, float]:
        """Figures so far; latencies over the last 4096 frames, the rate over the last 5 s."""
        now = time.monotonic()
        with self._lock:
            recent = self._times[self._times > now - self.RATE_WINDOW]
            latencies = self._latencies[~np.isnan(self._latencies)]
            counters = {
                "frames": float(self._frames),
                "callback_errors": float(self._callback_errors),
            }
        span = float(np.ptp(recent)) if recent.size else 0.0
        counters["rate_seen"] = (recent.size - 1) / span if span >= self.LEAST_SPAN else 0.0
        counters["latency_mean"] = float(latencies.mean()) if latencies.size else 0.0
        counters["latency_p99"] = float(np.quantile(latencies, 0.99)) if latencies.size else 0.0
        counters["latency_max"] = float(latencies.max()) if latencies.size else 0.0
        counters["dead_channels"] = float(len(self.dead_channels.dead))
        return counters
