"""Plays a recording as if the sensor were there."""

from __future__ import annotations

import itertools
import os
import time
from collections.abc import Iterator
from dataclasses import replace

from tomotactile_ros.devices.base import Frame, ThreadedDevice, unix_time
from tomotactile_ros.devices.recording import read_frames
from tomotactile_ros.errors import InputError


class ReplayDevice(ThreadedDevice):
    """Frames of a recording, stamped anew with the time at which they are played.

    Parameters
    ----------
    path : path
        See `tomotactile_ros.devices.recording.read_frames`.
    electrodes : int
        Electrodes of the layout; a recording with another number is refused.
    rate : float
        Frames/s; 0 keeps the recorded distances in time.
    loop : bool
        Start over at the end, instead of finishing.
    drive_voltage : float, V
        For recordings that do not hold it.

    Raises
    ------
    InputError
        At construction, when the recording cannot be read or does not fit.
    """

    def __init__(
        self,
        path: str | os.PathLike[str],
        electrodes: int,
        *,
        rate: float = 0.0,
        loop: bool = False,
        drive_voltage: float = 3.3,
    ) -> None:
        super().__init__(rate)
        self._path, self._electrodes = path, electrodes
        self._loop, self._drive_voltage = loop, drive_voltage
        self._rounds = 0
        first = next(self._frames(), None)
        if first is None:
            raise InputError(f"{path}: holds no frame")

    def _counters(self) -> dict[str, float]:
        return {"rounds": float(self._rounds)}

    def _frames(self) -> Iterator[Frame]:
        return read_frames(self._path, self._drive_voltage, self._electrodes)

    def _run(self) -> None:
        sequences = itertools.count()
        due = time.monotonic()
        self._rounds = 0
        while not self._stop.is_set():
            due = self._play_once(sequences, due)
            self._rounds += 1
            if not self._loop:
                break
        if not self._stop.is_set():
            self._set_state("finished", f"{self._path}: played to the end")

    def _play_once(self, sequences: Iterator[int], due: float) -> float:
        """Play all frames, the first at `due` (s, monotonic); return when a next one would be."""
        recorded, distance = None, 0.0
        for frame in self._frames():
            if recorded is not None:
                distance = max(0.0, frame.stamp - recorded)
                due += self._step(distance)
            recorded = frame.stamp
            due = self._wait_until(due, distance)
            if self._stop.is_set():
                return due
            self._set_state("streaming", f"playing {self._path}")
            played = replace(frame, sequence=next(sequences), stamp=unix_time(due))
            self._deliver(played, due)
        return due + self._step(distance)

    def _step(self, distance: float) -> float:
        """Time to the next frame, s, where the recorded distance is this."""
        return 1.0 / self._rate if self._rate > 0 else distance

    def _wait_until(self, due: float, distance: float) -> float:
        """Wait for `due`; a pause (`set_streaming`) moves it, a higher rate brings it forward."""
        while not self._stop.is_set():
            left = due - time.monotonic()
            if not self._streaming:
                self._set_state("stopped", "stopped on request")
                self._pause(1.0)
                due = time.monotonic()
            elif left <= 0:
                break
            else:
                self._pause(left)
                due = min(due, time.monotonic() + self._step(distance))
        return due
