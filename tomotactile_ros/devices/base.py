"""What every source of frames has in common: the frame, the status and the life of a device.

A device runs in a thread of its own and hands over complete frames; whoever opened it decides what
becomes of them.  The thread never raises: whatever goes wrong ends in the device's status.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from tomotactile_ros.devices.health import Health, Trouble
from tomotactile_ros.errors import InputError


@dataclass(frozen=True, eq=False)
class Frame:
    """One scan of the sheet: electrodes grounded one after another, all others read.

    Attributes
    ----------
    voltages : (L, E) float32, V
        One row per ground condition; NaN where there is no valid reading.  The grounded electrode's
        own entry may hold what it reads, or NaN.
    grounded : (L,) uint16
        The grounded electrode of each row.
    sequence : int
        Counts frames at their source; gaps are lost frames.
    stamp : float, s
        Start of the frame's first row, Unix time.
    drive_voltage : float, V
    row_period : float, s
        Row i was taken at stamp + i * row_period; 0: all at once, or not known.
    """

    voltages: np.ndarray
    grounded: np.ndarray
    sequence: int
    stamp: float
    drive_voltage: float
    row_period: float = 0.0


def unix_time(monotonic: float) -> float:
    """Unix time of a `monotonic` time, s, to some µs, so that stamps keep their order.

    The two clocks are read one after the other; where the process was held up in between, again.
    """
    for _ in range(10):
        before, now, after = time.monotonic(), time.time(), time.monotonic()
        if after - before < 2e-5:
            break
    return monotonic + now - before


@dataclass(frozen=True)
class Status:
    """State of a device at one moment.

    Attributes
    ----------
    state : str
        ``closed`` (not opened, or closed), ``disconnected`` (no port; trying again),
        ``identifying`` (asking who is there), ``streaming`` (frames arrive), ``stopped`` (paused on
        request), ``late`` (frames arrive, too old to be used), ``silent`` (port open, no data),
        ``garbled`` (data, but no valid packet),
        ``refused`` (the device does not fit or rejects a setting), ``finished`` (end of a
        recording), ``failed`` (an error in the source itself).
    message : str
        One line for people: what is wrong and what would be right.
    counters : dict of str to float
        Totals since ``open``, rates in 1/s, times in s; docs/protocol.md explains each.
    dead : tuple of int
        Electrodes that look dead (rule: `tomotactile_ros.devices.health.DeadChannels`).
    troubles : tuple of Trouble
        What is wrong with frames that arrive all the same; the message tells it, too.
    """

    state: str
    message: str
    counters: dict[str, float] = field(default_factory=dict)
    dead: tuple[int, ...] = ()
    troubles: tuple[Trouble, ...] = ()


class Device(Protocol):
    """A source of frames."""

    def open(self, on_frame: Callable[[Frame], None]) -> None:
        """Start; `on_frame` is called from the device's thread, once per frame."""

    def close(self) -> None:
        """Stop and wait for the thread; no call of `on_frame` begins afterwards."""

    def status(self) -> Status:
        """State, message and counters; from any thread."""

    def set_rate(self, rate: float) -> None:
        """Ask for `rate` frames per second; takes effect soon, see `status`."""

    def set_streaming(self, streaming: bool) -> None:
        """Pause (False) or resume (True) the frames."""


class ThreadedDevice:
    """A device whose `_run` lives in one thread; delivery, health and status are done here.

    Parameters
    ----------
    rate : float
        Wanted frames per second; 0 leaves it to the source.

    Attributes
    ----------
    max_age : float, s
        Frames whose last sample is longer ago are dropped, counted and told; inf for any age.
    """

    LATE_FOR = 10.0  # s that too old frames are told of

    def __init__(self, rate: float = 0.0) -> None:
        self.health = Health()
        self.max_age = math.inf
        self._rate = float(rate)
        self._streaming = True
        self._on_frame: Callable[[Frame], None] | None = None
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._changed = threading.Event()
        self._state = ("closed", "not opened")

    def open(self, on_frame: Callable[[Frame], None]) -> None:
        """Start the thread; a device that was closed can be opened again."""
        if self._thread is not None:
            raise RuntimeError("the device is open already")
        self._on_frame = on_frame
        self._stop.clear()
        self.health.reset()
        self._thread = threading.Thread(
            target=self._guarded_run, name=type(self).__name__, daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Stop the thread and join it; harmless when closed already."""
        self._stop.set()
        self._changed.set()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join()
            self._thread = None

    def status(self) -> Status:
        """State, message and counters of this moment."""
        state, message = self._state
        if state == "streaming" and self.health.stale_within(self.LATE_FOR):
            state, message = "late", f"{self.health.stale_note(self.max_age)}; {message}"
        if self.health.callback_error:
            message += f"; a frame was refused: {self.health.callback_error}"
        counters = {"rate_wanted": self._rate, **self.health.counters(), **self._counters()}
        troubles = self._troubles() if state in ("streaming", "late") else []
        message = "; ".join([message, *(trouble.text for trouble in troubles)])
        return Status(state, message, counters, self.health.dead_channels.dead, tuple(troubles))

    def set_rate(self, rate: float) -> None:
        """Ask for `rate` frames per second."""
        self._rate = float(rate)
        self._changed.set()

    def set_streaming(self, streaming: bool) -> None:
        """Pause or resume."""
        self._streaming = bool(streaming)
        self._changed.set()

    def _run(self) -> None:
        raise NotImplementedError

    def _troubles(self) -> list[Trouble]:
        return self.health.troubles()

    def _counters(self) -> dict[str, float]:
        return {}

    def _set_state(self, state: str, message: str) -> None:
        self._state = (state, message)

    def _pause(self, seconds: float) -> None:
        """Wait until the time is over, a setting changes or the device is closed."""
        if self._changed.wait(max(0.0, seconds)):
            self._changed.clear()

    def _deliver(self, frame: Frame, last_sample: float | None = None) -> None:
        """Hand `frame` over; `last_sample` (s, monotonic clock) says how old it is."""
        if self._stop.is_set():
            return
        age = 0.0 if last_sample is None else time.monotonic() - last_sample
        if age > self.max_age:
            self.health.frame_too_old(age)
            return
        try:
            self._on_frame(frame)
        except Exception as error:  # noqa: BLE001 - the receiver's mistake must not end the source
            self.health.callback_failed(f"{type(error).__name__}: {error}")
        self.health.frame_delivered(frame.voltages, frame.drive_voltage, last_sample)

    def _guarded_run(self) -> None:
        try:
            self._run()
        except InputError as error:
            self._set_state("failed", str(error))
        except Exception as error:  # noqa: BLE001 - nothing escapes from the thread
            self._set_state("failed", f"{type(error).__name__}: {error}")
        else:
            if self._stop.is_set():
                self._set_state("closed", "closed")
