"""What a serial device learns from outside: clocks, bytes, settings, and when to end.

All of it goes through one object, in the device's thread and in an order that follows from nothing
else.  Whoever writes down what it says (devices/capture.py) can let the device live it again.
"""

from __future__ import annotations

import random
import threading
import time
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import dataclass

from tomotactile_ros.devices.line import Line, open_line
from tomotactile_ros.devices.time_source import unix_time


@dataclass(frozen=True)
class Settings:
    """What is wanted of a device while it runs.

    Attributes
    ----------
    rate : float
        Frames/s; 0 leaves it to the device.
    streaming : bool
    scan : tuple of int
        Electrodes to ground, row after row; none: the device's own order.
    """

    rate: float = 0.0
    streaming: bool = True
    scan: tuple[int, ...] = ()


class World:
    """The world as it is.

    Parameters
    ----------
    stop : threading.Event
        The device is to end.
    changed : threading.Event
        Settings have changed, or the device is to end.
    settings : callable
        The settings of now.
    opener : callable
        How a port is opened.
    """

    def __init__(
        self,
        stop: threading.Event,
        changed: threading.Event,
        settings: Callable[[], Settings],
        opener: Callable[[str, int], Line] = open_line,
    ) -> None:
        self._stop, self._changed, self._settings, self._opener = stop, changed, settings, opener

    def now(self) -> float:
        """Time of a clock that is never set, s."""
        return time.monotonic()

    def unix_time(self, monotonic: float) -> float:
        """Unix time of a time of `now`, s."""
        return unix_time(monotonic)

    def first_tag(self) -> int:
        """Where tags begin: answers to whoever asked before must not fit."""
        return random.randrange(0xFFFF)

    def stopped(self) -> bool:
        """Whether the device is to end."""
        return self._stop.is_set()

    def changed(self) -> bool:
        """Whether there are new settings."""
        return self._changed.is_set()

    def settings(self) -> Settings:
        """The settings of now; they count as known."""
        self._changed.clear()
        return self._settings()

    def wait(self, seconds: float) -> None:
        """Let time pass, no longer than until the device is to end."""
        self._stop.wait(seconds)

    def open(self, port: str, baud: int) -> Line | None:
        """Open the port; None if stopped in the meantime: the network may take seconds to fail."""
        opening: Future[Line] = Future()

        def attempt() -> None:
            try:
                opening.set_result(self._opener(port, baud))
            except Exception as error:  # noqa: BLE001 - raised by `result`
                opening.set_exception(error)
            self._changed.set()

        threading.Thread(target=attempt, daemon=True).start()
        while not opening.done() and not self._stop.is_set():
            self._changed.wait()
            self._changed.clear()
        if self._stop.is_set():
            opening.add_done_callback(_close)
            return None
        return opening.result()

    def read(self, line: Line, timeout: float) -> tuple[bytes, float]:
        """Bytes that have come, waiting for the first, and when they had, by `now`."""
        data = line.read(timeout)
        return data, time.monotonic()

    def write(self, line: Line, data: bytes) -> None:
        """Send bytes."""
        line.write(data)

    def close(self) -> None:
        """The device has ended."""


def _close(opening: Future[Line]) -> None:
    if opening.exception() is None:
        opening.result().close()
