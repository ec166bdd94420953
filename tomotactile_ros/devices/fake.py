"""A sensor without hardware: frames of a simulated scene at the pace of a real scan."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.devices.base import Device, Frame, SetBack
from tomotactile_ros.devices.scene_beside import SceneBeside
from tomotactile_ros.scenes.scene import described
from tomotactile_ros.scenes.touches import Touch, Touches
from tomotactile_ros.simulation import ROW_PERIOD, Simulator


@dataclass(frozen=True)
class _Scan:
    """A frame that is to be scanned: its number, begin (s, by `time`), period (s) and order."""

    sequence: int
    start: float
    period: float
    order: tuple[int, ...]

    @property
    def row_period(self) -> float:
        return self.period / len(self.order)


class FakeDevice(Device):
    """Scans a simulated sheet.

    Frame k covers the time from k / rate to (k + 1) / rate: it is computed meanwhile, handed over
    at the end and stamped with its beginning.  A simulation too slow for the rate leaves frames out
    (`frames_skipped`), so that time in the scene stays time in the world. Where that is simulated
    time, which goes on in steps, all that was due within a step is handed over at its end; where it
    is set ahead, the frame under way is dropped and the scene goes on there; where it is set back,
    that begins anew.

    Where rows are wanted while their frame is under way, the frame is computed before it begins.

    In a live scene `press` says from any thread what touches the sheet. A frame, or a run of rows,
    is then computed at its end, when all that has touched meanwhile is known.

    Parameters
    ----------
    simulator : Simulator
        Time in its scene begins when the device is opened.
    rate : float
        Frames/s; 0 means 1000 ground conditions a second (Kojima et al. 2023: 15.6 Hz for 64).
    beside : SceneBeside
        The same scene in a process of its own, which makes the frames once it is ready; not live.
    """

    def __init__(
        self, simulator: Simulator, *, rate: float = 0.0, beside: SceneBeside | None = None
    ) -> None:
        super().__init__(simulator.layout.electrodes)
        self._simulator, self._beside = simulator, beside
        self._own_order = tuple(simulator.grounded.tolist())
        self._skipped = 0
        self._begin = math.nan  # of time in the scene, s, by `time`; not before it is open
        self._touches = Touches(simulator.layout) if simulator.scene.live else None
        simulator.live = self._touches
        self._ahead: tuple[_Scan, Future[np.ndarray]] | None = None
        self.set_rate(rate)

    def set_rate(self, rate: float) -> None:
        """Scan `rate` frames per second from the next frame on (0: 1000 ground conditions)."""
        self._wished = rate
        super().set_rate(rate or 1.0 / (ROW_PERIOD * len(self._order())))

    def set_scan(self, order: Sequence[int]) -> None:
        """Ground these electrodes from the next frame on, none: the own order."""
        super().set_scan(order)
        self.set_rate(self._wished)

    def press(self, touches: Sequence[Touch]) -> list[str]:
        """From now on these touches are on the sheet, and no others, for `touches.HOLD` s.

        Returns a line about each that cannot be; it is left out. A device that is not open feels
        nothing.
        """
        if self._touches is None:
            return ["touches: the scene is not live, it takes none from outside"]
        if math.isnan(self._begin):
            return []
        return self._touches.press(touches, self._now() - self._begin)

    def truth(self, t: float) -> list[dict]:
        """What really touches at the time `t` (s) of the scene, as `Scene.truth`, with what presses
        from outside."""
        live = () if self._touches is None else self._touches.at(t)
        return [*self._simulator.scene.truth(t), *map(described, live)]

    def _counters(self) -> dict[str, float]:
        return {"frames_skipped": float(self._skipped)}

    def _run(self) -> None:
        self._sequence = self._skipped = 0
        if self._beside is not None:
            self._beside.start()
        try:
            with ThreadPoolExecutor(1, thread_name_prefix="scene") as pool:
                while self._wait_for_time():
                    if self._touches is not None:
                        self._touches.clear()
                    try:
                        self._scan_on(pool)
                    except SetBack:
                        self.health.forget_rate()
        finally:
            if self._beside is not None:
                self._beside.stop()

    def _scan_on(self, pool: ThreadPoolExecutor) -> None:
        """Scan frame after frame until the device is closed; SetBack where time is."""
        self._begin = start = self._now()
        self._ahead, self._took = None, 0.0
        while not self._stop.is_set():
            if not self._streaming:
                self._set_state("stopped", "stopped on request")
                self._pause(self._now() + 1.0)
                start = self._now()
                continue
            scan = self._scan_of(self._sequence, start)
            end = start + scan.period
            if self._on_rows is None:
                voltages = self._whole(scan, pool)
            else:
                voltages = self._in_runs(scan, pool)
            if not self._wait_until(end):
                return
            self._set_state("streaming", f"simulated, {1.0 / scan.period:g} frames/s")
            self._deliver(self._frame(scan, voltages), end)
            if end < self.time.since():  # it was dropped, and nothing of the time left out is lost
                start = self.time.since()
                continue
            behind = max(int((self.time.before() - end) / scan.period), 0)
            self._skipped += behind
            self.health.frames_lost(behind)
            self._sequence += 1 + behind
            start = end + behind * scan.period

    def _scan_of(self, sequence: int, start: float) -> _Scan:
        """What to scan next; a frame that is computed already keeps its order, as one under way
        does in hardware."""
        scan = _Scan(sequence, start, 1.0 / self._rate, self._order())
        ahead = self._ahead[0] if self._ahead else scan
        return ahead if replace(scan, order=ahead.order) == ahead else scan

    def _order(self) -> tuple[int, ...]:
        return self._scan or self.usual_order or self._own_order

    def _frame(self, scan: _Scan, voltages: np.ndarray, first: int = 0) -> Frame:
        """Rows of a frame from the row `first` on, the whole frame without it."""
        return Frame(
            voltages,
            np.array(scan.order[first : first + len(voltages)], np.uint16),
            scan.sequence,
            self.time.stamp(scan.start + first * scan.row_period),
            self._simulator.scene.drive_voltage,
            scan.row_period,
        )

    def _whole(self, scan: _Scan, pool: ThreadPoolExecutor) -> np.ndarray:
        """(L, E) voltages of a frame; returns before it ends, of a live scene behind that."""
        # as under real hardware, the computer is free for the last frame's image at first
        idle_until = scan.start + min(0.5 * scan.period, scan.period - 2.0 * self._took)
        if self._touches is not None:
            idle_until = scan.start + scan.period
        self._wait_until(idle_until)
        now = self._now()
        voltages = pool.submit(self._compute, scan).result()
        self._took = self._now() - now
        return voltages

    def _compute(self, scan: _Scan, first: int = 0, last: int | None = None) -> np.ndarray:
        """(L, E) voltages of a frame, or of some of its rows."""
        simulator, t = self._simulator, scan.start - self._begin
        if self._beside is not None:
            found = self._beside.frame(scan.row_period, scan.order, t, scan.sequence)
            if found is not None:
                return found.astype(np.float32)
        if last is None:
            found = simulator.scanned(scan.row_period, scan.order, t, scan.sequence)
            return found.astype(np.float32)
        simulator.row_period, simulator.grounded = scan.row_period, np.array(scan.order)
        return simulator.rows(t, first, last, scan.sequence).astype(np.float32)

    def _in_runs(self, scan: _Scan, pool: ThreadPoolExecutor) -> np.ndarray:
        """(L, E) voltages of a frame whose rows were handed over as soon as they were taken."""
        done = []
        for first, voltages in self._runs(scan, pool):
            end = scan.start + (first + len(voltages)) * scan.row_period
            if not self._wait_until(end):
                break
            done.append(voltages)
            self._deliver_rows(self._frame(scan, voltages, first), end)
        return np.concatenate(done or [np.empty((0, self._electrodes), np.float32)])

    def _runs(self, scan: _Scan, pool: ThreadPoolExecutor) -> Iterator[tuple[int, np.ndarray]]:
        """First row and voltages of each run of rows of a frame."""
        rows, step = len(scan.order), self.run_length
        if self._touches is not None:
            for first in range(0, rows, step):
                last = min(first + step, rows)
                end = scan.start + last * scan.row_period
                if not self._wait_until(end):
                    return
                yield first, self._compute(scan, first, last)
            return
        ahead, self._ahead = self._ahead, None
        if ahead is None or ahead[0] != scan:
            ahead = scan, pool.submit(self._compute, scan)
        voltages = ahead[1].result()
        following = self._scan_of(scan.sequence + 1, scan.start + scan.period)
        self._ahead = following, pool.submit(self._compute, following)
        for first in range(0, rows, step):
            yield first, voltages[first : first + step]
