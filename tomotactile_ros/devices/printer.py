"""The firmware of a simulated first prototype: it prints readings as text, a line a row and an empty
line behind each frame, from power-up on and whether anybody listens or not (docs/hardware.md)."""

from __future__ import annotations

import numpy as np

from tomotactile_ros.devices.firmware import Source


class PrintingDevice:
    """What `devices.emulator.Emulator` runs; electrodes are grounded in the `order` (L,).

    source : as of `devices.firmware.EmulatedDevice`
    volts : V of a printed 1; below 0.1 whole numbers are printed, else three places behind the point
    rate : frames/s
    """

    def __init__(self, source: Source, order: np.ndarray, volts: float, rate: float) -> None:
        self.dropped = 0
        self._source, self._order, self._volts = source, order, volts
        self._row_period = 1.0 / (rate * len(order))
        self._form = "{:.0f}" if volts < 0.1 else "{:.3f}"
        self._start: float | None = None
        self._rows, self._lines = 0, list[str]()

    def receive(self, data: bytes, now: float) -> bytes:
        """Nothing is answered, whatever comes."""
        return b""

    def next_due(self) -> float | None:
        """When the next row is read, s."""
        return None if self._start is None else self._start + (self._rows + 1) * self._row_period

    def rows_due(self, now: float) -> bytes:
        """Lines of the rows that are read by `now` (s, steady clock)."""
        if self._start is None:
            self._start = now
        due = int((now - self._start) / self._row_period + 1e-6)
        if due - self._rows > len(self._order):  # held up: goes on with the frame of now
            self._rows = due - due % len(self._order)
        text = ""
        while self._rows < due:
            frame, row = divmod(self._rows, len(self._order))
            if row == 0:
                self._lines = self._print(frame)
            text += self._lines[row]
            self._rows += 1
        return text.encode("ascii")

    def _print(self, frame: int) -> list[str]:
        begin = frame * len(self._order) * self._row_period
        counts = np.nan_to_num(self._source(begin, frame, self._order)) / self._volts
        lines = ["\t".join(map(self._form.format, row)) + "\r\n" for row in counts]
        lines[-1] += "\r\n"
        return lines
