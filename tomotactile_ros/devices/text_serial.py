"""A sensor that prints its readings as text (devices/text.py) and takes no commands."""

from __future__ import annotations

import math

import numpy as np

from tomotactile_ros.devices.base import Frame, rows_of
from tomotactile_ros.devices.line import Line
from tomotactile_ros.devices.line_device import SILENCE, SILENT_FRAMES, LineDevice
from tomotactile_ros.devices.text import TextFrame, TextFrames, counts_of, volts_per_unit

STALE = 0.1  # s from the opening: what comes until then has waited on the line
LEAST_STEP = 1e-4  # s from one stamp to the next


class TextSerialDevice(LineDevice):
    """Frames from lines of text; their times are those at which the lines arrive.

    Parameters
    ----------
    port, electrodes, baud
        As of `tomotactile_ros.devices.serial.SerialDevice`.
    text_format : str
        One of `tomotactile_ros.devices.text.FORMATS`.
    drive_voltage : float, V
        Counts of a converter are shares of it.
    rate : float
        Frames/s that are expected; the sensor cannot be told.

    `set_scan` says which electrodes its rows ground, each in turn where there is none.
    """

    def __init__(
        self,
        port: str,
        electrodes: int,
        text_format: str,
        drive_voltage: float,
        *,
        baud: int = 115_200,
        rate: float = 0.0,
    ) -> None:
        super().__init__(port, electrodes, baud, rate)
        self._drive_voltage = drive_voltage
        self._volts = volts_per_unit(text_format, drive_voltage)
        self._counts = counts_of(text_format)
        self._text = TextFrames(electrodes, range(electrodes), self._counts)
        self._bytes = 0

    def _counters(self) -> dict[str, float]:
        text = self._text
        return {
            "bytes": float(self._bytes),
            "lines": float(text.lines),
            "lines_ignored": float(text.lines_ignored),
            "frames_incomplete": float(text.frames_incomplete),
            "reconnects": float(max(0, self._connections - 1)),
        }

    def _run(self) -> None:
        self._text = TextFrames(self._electrodes, range(self._electrodes), self._counts)
        self._connections, self._bytes, self._period, self._stamp = 0, 0, 0.0, -math.inf
        super()._run()

    def _understood(self) -> int:
        return self._bytes

    def _talk(self, line: Line) -> None:
        self._set_state("identifying", f"reading lines from {line.name}")
        self._connections += 1
        self._text.restart()
        heard = begin = self._now()
        while not self._stopped():
            data, arrival = self._world.read(line, 0.1)
            self._bytes += len(data)
            if data:
                heard = arrival
                if arrival - begin > STALE:
                    self._take(data, arrival, line)
            elif arrival - heard > max(SILENCE, SILENT_FRAMES * self._period):
                self._set_state("silent", f"port: {line.name} sends nothing")

    def _take(self, data: bytes, arrival: float, line: Line) -> None:
        order = list(self._scan or range(self._electrodes))
        if order != self._text.order:
            self._text.order = order
            self._text.restart()
        lost = self._text.frames_incomplete
        frames = self._text.feed(data, arrival)
        self.health.frames_lost(self._text.frames_incomplete - lost)
        if not self._streaming:
            self._set_state("stopped", f"lines from {line.name}; stopped on request")
        elif frames:
            self._set_state("streaming", f"text from {line.name}")
            for frame in frames:
                self._publish(frame)
        elif self._text.since > 3 * len(order):
            self._set_state(
                "garbled",
                f"port: {self._text.since} lines from {line.name} at {line.baud} bit/s and no frame of "
                f"{len(order)} rows of {self._electrodes} readings: {self._text.complaint}",
            )
        elif self._text.lines == 0 and self._bytes > 1 << 16:
            self._set_state("garbled", f"port: no line ends in what {line.name} sends; wrong baud?")

    def _publish(self, text: TextFrame) -> None:
        first, last = text.arrivals[0], text.arrivals[-1]
        row_period = (last - first) / max(1, len(text.arrivals) - 1)
        self._period = last - first + row_period
        # a row is printed when it has been read
        self._stamp = max(first - row_period, self._stamp + LEAST_STEP)
        frame = Frame(
            (self._volts * text.readings).astype(np.float32),
            text.grounded.astype(np.uint16),
            text.sequence,
            self._world.unix_time(self._stamp),
            self._drive_voltage,
            row_period,
        )
        if self._on_rows is not None:
            for rows, _ in rows_of(frame, self.run_length):
                self._deliver_rows(rows, last)
        self._deliver(frame, last)
