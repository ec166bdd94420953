"""Plays a recording as if the sensor were there."""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from dataclasses import replace

from tomotactile_ros.devices.base import Device, Frame, SetBack, rows_of, rows_time
from tomotactile_ros.devices.health import Trouble
from tomotactile_ros.devices.recording import read_frames
from tomotactile_ros.simulation import ROW_PERIOD


class ReplayDevice(Device):
    """Frames of a recording, stamped anew: their last row is taken when they are played.

    Parameters
    ----------
    path, electrodes, drive_voltage, layout_id, topic
        As of `tomotactile_ros.devices.recording.read_frames`.
    rate : float
        Frames/s; 0 keeps the recorded distances in time.
    loop : bool
        Start over at the end, instead of finishing.

    A frame is due the recorded distance after the one before.  Where there is no such distance,
    because the recording starts over, its clock was set back or it has one frame only, it is that
    of the frames before, or that of 1000 ground conditions a second.

    Raises
    ------
    InputError
        At construction, when the recording cannot be read or does not fit.
    """

    BEHIND = 1.0  # s; whoever is later than that goes on from now, with stamps of now

    def __init__(
        self,
        path: str | os.PathLike[str],
        electrodes: int,
        *,
        rate: float = 0.0,
        loop: bool = False,
        drive_voltage: float = 3.3,
        layout_id: str | None = None,
        topic: str | None = None,
    ) -> None:
        super().__init__(electrodes, rate)
        self._path, self._topic = path, topic
        self._loop, self._drive_voltage, self._layout_id = loop, drive_voltage, layout_id
        self._rounds = self._not_later = 0
        next(self._frames())

    def _counters(self) -> dict[str, float]:
        return {"rounds": float(self._rounds), "stamps_not_later": float(self._not_later)}

    def _troubles(self) -> list[Trouble]:
        found = super()._troubles()
        if self._not_later:
            text = (
                f"the recorded times of {self._not_later} frames are not later than those of the "
                "frames before them: a clock was set, or frames are out of order"
            )
            found.append(Trouble("recorded stamps", False, text))
        return found

    def _frames(self) -> Iterator[Frame]:
        return read_frames(
            self._path, self._drive_voltage, self._electrodes, self._layout_id, self._topic
        )

    def _run(self) -> None:
        if not self._wait_for_time():
            return
        due = self._now()
        for sequence, (distance, frame) in enumerate(self._timed_frames()):
            due = self._when_due(due + self._step(distance) if sequence else due, distance)
            if self._stop.is_set():
                return
            self._set_state("streaming", f"playing {self._path}")
            try:
                end = self._play_rows(replace(frame, sequence=sequence), due, distance)
            except SetBack:  # the next frame is due as long after now as after this one
                due = self._now()
                continue
            stamp = max(self.time.stamp(end) - rows_time(frame), 0.0)
            self._deliver(replace(frame, sequence=sequence, stamp=stamp), end)
        self._set_state("finished", f"{self._path}: played to the end")

    def _play_rows(self, frame: Frame, begin: float, distance: float) -> float:
        """Hand rows over when each of them is due, if they are wanted; return when the last was.

        They are as much closer together as the frames are, where these are played faster.
        """
        if self._on_rows is None:
            return begin
        end = begin
        faster = min(1.0, self._step(distance) / distance)
        for rows, after in rows_of(frame, self.run_length):
            end = begin + faster * after
            if not self._wait_until(end):
                break
            stamp = self.time.stamp(end - faster * rows_time(rows))
            self._deliver_rows(replace(rows, stamp=stamp), end)
        return end

    def _timed_frames(self) -> Iterator[tuple[float, Frame]]:
        """The frames of all rounds, each with its distance from the one before, s."""
        self._rounds, distance = 0, 0.0
        while self._loop or self._rounds == 0:
            recorded = math.inf
            for frame in self._frames():
                if frame.stamp > recorded:
                    distance = frame.stamp - recorded
                elif math.isfinite(recorded) and self._rounds == 0:
                    self._not_later += 1
                recorded = frame.stamp
                distance = distance or ROW_PERIOD * frame.grounded.size
                yield distance, frame
            self._rounds += 1

    def _step(self, distance: float) -> float:
        """Time to the next frame, s, where the recorded distance is this."""
        return 1.0 / self._rate if self._rate > 0 else distance

    def _when_due(self, due: float, distance: float) -> float:
        """Wait for `due`; return it, or when it is instead.

        A pause (`set_streaming`), falling behind and a time that is set back move it, a higher rate
        brings it forward.
        """
        while not self._stop.is_set():
            try:
                now = self._now()
                self._notice(now)
            except SetBack:
                due = now + self._step(distance)
            if not self._streaming:
                self._set_state("stopped", "stopped on request")
                self._pause(now + 1.0)
                due = self._now()
            elif due <= now:
                earliest = max(self.time.before() - self.BEHIND, self.time.since())
                return due if due >= earliest else now
            else:
                self._pause(due)
                due = min(due, self._now() + self._step(distance))
        return due
