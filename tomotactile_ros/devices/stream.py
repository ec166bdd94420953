"""Frames of a device one after another in the caller's thread, or one line that says why none
come."""

from __future__ import annotations

import queue
import time
from collections.abc import Iterator

from tomotactile_ros.devices.base import Device, Frame
from tomotactile_ros.support.errors import InputError

PATIENCE = 10.0  # s without the first frame until it is given up
_TICK = 0.1  # s between two looks at the device's state
_HOPELESS = ("refused", "failed")  # states that waiting does not change


class FrameStream:
    """Opens a device, hands its frames on, and closes it; a context manager.

    Parameters
    ----------
    device : that nobody has opened.
    patience : s to wait for the first frame; `PATIENCE` by default.
    """

    def __init__(self, device: Device, patience: float | None = None):
        self.device = device
        self._patience = PATIENCE if patience is None else patience
        self._frames: queue.SimpleQueue[Frame] = queue.SimpleQueue()
        self._begun = False

    def __enter__(self) -> FrameStream:  # noqa: PYI034 - typing has Self from 3.11 on
        self._start = time.monotonic()
        self.device.open(self._frames.put)
        return self

    def __exit__(self, *error: object) -> None:
        self.device.close()

    def __iter__(self) -> Iterator[Frame]:
        """Every frame until the source ends."""
        while not self.ended:
            frame = self.take()
            if frame is not None:
                yield frame

    def take(self, newest: bool = False) -> Frame | None:
        """The next frame, or the newest of those that wait; None if none comes within 0.1 s.

        Raises InputError where the first one does not come, or will never.
        """
        try:
            frame = self._frames.get(timeout=_TICK)
        except queue.Empty:
            self._complain()
            return None
        self._begun = True
        while newest and not self._frames.empty():
            frame = self._frames.get()
        return frame

    @property
    def ended(self) -> bool:
        """Whether a recording was played to its end, and all its frames were taken."""
        return self.device.status().state == "finished" and self._frames.empty()

    def _complain(self) -> None:
        status = self.device.status()
        if status.state in _HOPELESS:
            raise InputError(status.message)
        if not self._begun and time.monotonic() - self._start > self._patience:
            raise InputError(
                f"no frame within {self._patience:g} s, the device is {status.state}: "
                f"{status.message}"
            )
