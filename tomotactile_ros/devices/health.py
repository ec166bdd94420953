"""Figures about a stream of frames for diagnostics: rate, latency, dead channels."""

from __future__ import annotations

import threading
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from tomotactile_ros.support.checks import plain


class DeadChannels:
    """Finds electrodes whose readings do not take part in what happens on the sheet.

    The span of an electrode is its largest minus its smallest reading over all ground conditions
    of `window` frames.  Something presses when the median span exceeds 5 % of the drive voltage;
    only then can dead and idle be told apart.  An electrode is called dead while its span is below
    2 % of the median span; with nothing on the sheet that verdict stays.  It is also called dead
    while it has no valid reading in a whole window.  One that stays at the drive voltage is not: a
    conductor may lie on it, which only the readings of its neighbours tell.
    """

    AT_DRIVE = 0.1  # of the drive voltage: as far from it channels of different gains read it

    def __init__(self, window: int = 64) -> None:
        self.dead: tuple[int, ...] = ()
        self._window = window
        self._constant: set[int] = set()
        self._frames = 0
        self._low = self._high = np.empty(0)  # V, of the window under way; empty before it

    def update(self, voltages: np.ndarray, drive_voltage: float) -> tuple[float, float]:
        """Take in the readings (L, E) of one frame, V, NaN where invalid.

        Returns the largest of them, either way, and from the lowest to the highest; NaN where there is none.
        """
        low, high = np.fmin.reduce(voltages, axis=0), np.fmax.reduce(voltages, axis=0)
        highest, lowest = np.fmax.reduce(high), np.fmin.reduce(low)
        if self._low.shape != low.shape:
            self._low, self._high, self._frames = low, high, 0
        else:
            np.fmin(self._low, low, out=self._low)
            np.fmax(self._high, high, out=self._high)
        self._frames += 1
        if self._frames >= self._window:
            self._judge(drive_voltage)
            self._low = np.empty(0)
        return float(max(highest, -lowest)), float(highest - lowest)

    def _judge(self, drive_voltage: float) -> None:
        span = self._high - self._low
        invalid = np.isnan(span)
        median = 0.0 if invalid.all() else np.median(span[~invalid])
        if median > 0.05 * drive_voltage:
            beside = np.abs(self._high + self._low - 2 * drive_voltage) / 2
            constant = (span < 0.02 * median) & (beside > self.AT_DRIVE * drive_voltage)
            self._constant = set(np.flatnonzero(constant).tolist())
        self.dead = tuple(sorted(self._constant.union(np.flatnonzero(invalid).tolist())))


@dataclass(frozen=True)
class Trouble:
    """Something wrong with frames that arrive all the same.

    `name` stays while it lasts; `which` changes where it is worth another line in a log.
    """

    name: str
    serious: bool
    text: str
    which: str = ""


def late_of(late: int, total: int, what: str) -> str:
    """The number of frames or rows that came late or not at all, as it is shown everywhere; nothing
    where none were due."""
    return f"{late} of {total} {what}" if total else ""


class Recent:
    """What was counted in the last `seconds`, by name, by the time `now`, s."""

    def __init__(self, seconds: int = 10, now: Callable[[], float] = time.monotonic) -> None:
        self._of_seconds: list[tuple[int, Counter[str]]] = [(-1, Counter())] * seconds
        self._now = now

    def add(self, **numbers: int | np.bool_) -> None:
        """Add to the sums of this second."""
        more = Counter({name: int(number) for name, number in numbers.items()})
        second = int(self._now())
        place = second % len(self._of_seconds)
        then, sums = self._of_seconds[place]
        # another one, as others may be reading the one before
        self._of_seconds[place] = second, sums + more if then == second else more

    def sums(self) -> Counter[str]:
        """Sums over the last seconds; of a time that was set back, none of those ahead."""
        now = int(self._now())
        of_seconds = list(self._of_seconds)
        return sum((s for then, s in of_seconds if now - len(of_seconds) < then <= now), Counter())


class Health:
    """Counts delivered frames, measures their rate and latency, and watches the channels, by the time
    `now`, s."""

    RATE_WINDOW, LEAST_SPAN = 5.0, 0.5
    LOSS, SERIOUS_LOSS = 0.01, 1 / 3  # of the frames
    REACHED = 0.9  # of the rate that is wanted
    ABOVE, OFTEN = 1.1, 0.1  # times the drive voltage; of the frames
    PRESSED, FLAT = 0.05, 1e-3  # of the drive voltage: some reading is above, all are within
    HALF = 0.01  # of the drive voltage, as far as resistors of 1 % put it elsewhere

    def __init__(self, now: Callable[[], float] = time.monotonic) -> None:
        self._lock, self._now = threading.Lock(), now
        self.reset()

    def reset(self) -> None:
        """Forget everything, as at the start."""
        with self._lock:
            self.dead_channels = DeadChannels()
            self.callback_error = ""
            self._frames = 0
            self._callback_errors = 0
            self._age = 0.0
            self._recent = Recent(now=self._now)  # of frames
            self._highest = 0.0
            self._stale, self._stale_age, self._stale_at = 0, 0.0, -np.inf
            self._times = np.full(1024, -np.inf)
            self._latencies = np.full(4096, np.nan)

    def frame_delivered(
        self, voltages: np.ndarray, drive_voltage: float, last_sample: float | None
    ) -> None:
        """Note a frame that has just been handed over; `last_sample` in s, by `now`."""
        now = self._now()
        with self._lock:
            self._times[self._frames % self._times.size] = now
            late = np.nan if last_sample is None else now - last_sample
            self._age = 0.0 if last_sample is None else late
            self._latencies[self._frames % self._latencies.size] = late
            self._frames += 1
        highest, span = self.dead_channels.update(voltages, drive_voltage)
        above = highest > self.ABOVE * drive_voltage
        flat = span < self.FLAT * drive_voltage and highest > self.PRESSED * drive_voltage
        # electronics that are tried without sheet (docs/build.md, step 2) read half of the drive all over
        flat &= abs(highest - drive_voltage / 2) > self.HALF * drive_voltage
        with self._lock:
            self._recent.add(delivered=1, above=above, empty=np.isnan(span), flat=flat)
            if above or flat:
                self._highest = highest

    def frames_lost(self, number: int) -> None:
        """Note frames that did not arrive, or not whole."""
        if number:
            with self._lock:
                self._recent.add(lost=number)

    def troubles(self, wanted: float = 0.0) -> list[Trouble]:
        """What is wrong with the frames of the last 10 s; `wanted` frames/s, 0 for any."""
        with self._lock:
            recent = self._recent.sums()
        delivered = recent["delivered"]
        found = []
        seen, span = self._rate()
        if span > 0.5 * self.RATE_WINDOW and seen < self.REACHED * wanted:
            text = f"{plain(seen)} frames/s arrive, {plain(wanted, 4)} are wanted"
            found.append(Trouble("rate", False, text))
        share = recent["lost"] / max(delivered + recent["lost"], 1.0)
        if share > self.LOSS:
            text = f"{100 * share:.0f} % of the frames are lost or incomplete"
            found.append(Trouble("loss", share > self.SERIOUS_LOSS, text))
        if recent["above"] > self.OFTEN * delivered:
            text = (
                f"readings up to {plain(self._highest, 4)} V are above the drive voltage: their unit (protocol), "
                "or scale, range or drive voltage of the device are wrong"
            )
            found.append(Trouble("above drive", True, text))
        if recent["empty"] > self.OFTEN * delivered:
            found.append(Trouble("no reading", True, "no electrode gives a valid reading"))
        if recent["flat"] > self.OFTEN * delivered:
            text = (
                f"all readings are the same, {plain(self._highest)} V: the converter stands still, "
                "or no electrode is grounded"
            )
            found.append(Trouble("all the same", True, text))
        if refused := recent["refused"]:
            text = f"{refused:.0f} of the frames could not be handed on: {self.callback_error}"
            found.append(Trouble("receiver", refused > self.OFTEN * delivered, text))
        return found

    def frame_too_old(self, age: float) -> None:
        """Note a frame that was dropped because its last sample was `age` s ago."""
        with self._lock:
            self._stale += 1
            self._stale_age, self._stale_at = age, self._now()

    def stale_within(self, seconds: float) -> bool:
        """Whether a frame was too old in the last `seconds`."""
        return self._now() - self._stale_at < seconds

    def stale_note(self, limit: float) -> str:
        """What is to be said of frames that were older than `limit`, s."""
        return (
            f"frames are {plain(self._stale_age, 2)} s old and not published (max_age {limit:g} s, "
            f"{self._stale} so far): line or host are slower than the sensor, lower its rate"
        )

    def forget_rate(self) -> None:
        """Measure the rate anew, because another one is due from now on."""
        with self._lock:
            self._times.fill(-np.inf)

    def callback_failed(self, message: str) -> None:
        """Note that the receiver of a frame raised an exception; the last one is kept."""
        with self._lock:
            self._callback_errors += 1
            self._recent.add(refused=1)
            self.callback_error = " ".join(message.split())

    def counters(self) -> dict[str, float]:
        """Figures so far; latencies over the last 4096 frames, the rate over the last 5 s."""
        with self._lock:
            latencies = self._latencies[~np.isnan(self._latencies)]
            counters = {
                "frames": float(self._frames),
                "frames_stale": float(self._stale),
                "age": float(self._stale_age if self._stale_at > self._times.max() else self._age),
                "callback_errors": float(self._callback_errors),
            }
        seen, span = self._rate()
        counters["rate_seen"] = seen if span >= self.LEAST_SPAN else 0.0
        counters["latency_mean"] = float(latencies.mean()) if latencies.size else 0.0
        counters["latency_p99"] = float(np.quantile(latencies, 0.99)) if latencies.size else 0.0
        counters["latency_max"] = float(latencies.max()) if latencies.size else 0.0
        counters["dead_channels"] = float(len(self.dead_channels.dead))
        return counters

    def _rate(self) -> tuple[float, float]:
        """Frames/s of the last seconds, and the time, s, over which they were counted."""
        with self._lock:
            ago = self._now() - self._times
            recent = self._times[(ago >= 0) & (ago < self.RATE_WINDOW)]
        span = float(np.ptp(recent)) if recent.size else 0.0
        return (recent.size - 1) / span if span > 0 else 0.0, span
