"""What every source of frames has in common: the frame, the status and the life of a device.

A device runs in a thread of its own and hands over complete frames; whoever opened it decides what
becomes of them.  The thread never raises: whatever goes wrong ends in the device's status.
"""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field, replace

from tomotactile_ros.devices.health import Health, Trouble
from tomotactile_ros.devices.time_source import NO_TIME, TimeSource
from tomotactile_ros.frame import Frame
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError


def _nobody(frame: Frame) -> None:
    """Receives frames before a device is opened."""


def rows_time(rows: Frame) -> float:
    """How long these rows took, s."""
    return len(rows.grounded) * rows.row_period


def rows_of(frame: Frame, length: int) -> Iterator[tuple[Frame, float]]:
    """The rows of a frame in runs of `length`, and when each had ended, s after the frame began."""
    for first in range(0, len(frame.grounded), length):
        run = slice(first, first + length)
        rows = replace(
            frame,
            voltages=frame.voltages[run],
            grounded=frame.grounded[run],
            stamp=frame.stamp + first * frame.row_period,
        )
        yield rows, first * frame.row_period + rows_time(rows)


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
        Totals since ``open``, rates in 1/s, times in s; docs/topics.md explains each.
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


class SetBack(Exception):
    """The time that a source lives in was set back."""


class Device:
    """A source of frames, whose `_run` lives in one thread; delivery, health and status are done here.

    Parameters
    ----------
    electrodes : int
        Of the layout.
    rate : float
        Wanted frames per second; 0 leaves it to the source.

    Attributes
    ----------
    max_age : float, s
        Frames whose last sample is longer ago are dropped, counted and told; inf for any age.
    run_length : int
        Rows of a frame that are handed over together, where `open` is given `on_rows`.
    usual_order : tuple of int
        Electrodes to ground where `set_scan` asks for none and the device takes an order.
    time : TimeSource
        The time that it lives in. A source that has hardware lives in this machine's.
    """

    LATE_FOR = 10.0  # s that too old frames are told of

    def __init__(self, electrodes: int, rate: float = 0.0) -> None:
        self.time = TimeSource()
        # not by `_now`: what a serial device learns is captured, figures from any thread are not
        self.health = Health(lambda: self.time.now())
        self._electrodes = electrodes
        self.max_age = math.inf
        self.run_length = 1
        self.usual_order: tuple[int, ...] = ()
        self._rate = float(rate)
        self._streaming = True
        self._scan: tuple[int, ...] = ()
        self._on_frame: Callable[[Frame], None] = _nobody
        self._on_rows: Callable[[Frame], None] | None = None
        self._stale_at = -math.inf
        self._latest = -math.inf  # s, by `time`, the last time that was noticed
        self._thread: threading.Thread | None = None
        self._stop = threading.Event()
        self._changed = threading.Event()
        self._state = ("closed", "not opened")

    def open(
        self,
        on_frame: Callable[[Frame], None],
        on_rows: Callable[[Frame], None] | None = None,
    ) -> None:
        """Start the thread; a device that was closed can be opened again.

        `on_frame` is called from the thread, once per frame. So is `on_rows`, where it is given, with
        rows of frames that are still under way.
        """
        if self._thread is not None:
            raise RuntimeError("the device is open already")
        self._on_frame, self._on_rows = on_frame, on_rows
        self._stop.clear()
        self.health.reset()
        self._thread = threading.Thread(
            target=self._guarded_run, name=type(self).__name__, daemon=True
        )
        self._thread.start()

    def close(self) -> None:
        """Stop the thread and join it; no call of `on_frame` begins afterwards. Harmless when closed
        already."""
        self._stop.set()
        self._changed.set()
        thread = self._thread
        if thread is not None and thread is not threading.current_thread():
            thread.join()
            self._thread = None

    def status(self) -> Status:
        """State, message and counters of this moment; from any thread."""
        state, message = self._state
        if state == "streaming" and self.health.stale_within(self.LATE_FOR):
            state, message = "late", f"{self.health.stale_note(self.max_age)}; {message}"
        counters = {"rate_wanted": self._rate, **self.health.counters(), **self._counters()}
        troubles = self._troubles() if state in ("streaming", "late") else []
        message = "; ".join([message, *(trouble.text for trouble in troubles)])
        return Status(state, message, counters, self.health.dead_channels.dead, tuple(troubles))

    def set_rate(self, rate: float) -> None:
        """Ask for `rate` frames per second; takes effect soon, see `status`."""
        self._rate = float(rate)
        self.health.forget_rate()
        self._changed.set()

    def set_streaming(self, streaming: bool) -> None:
        """Pause (False) or resume (True) the frames."""
        self._streaming = bool(streaming)
        self._changed.set()

    def set_scan(self, order: Sequence[int]) -> None:
        """Ask for frames that ground these electrodes, row after row; none: the device's order.
        InputError for an impossible one."""
        wanted = checks.order(list(order), "scan", self._electrodes).tolist() if order else ()
        self._scan = tuple(wanted)
        self._changed.set()

    def _run(self) -> None:
        raise NotImplementedError

    def _now(self) -> float:
        return self.time.now()

    def _stopped(self) -> bool:
        return self._stop.is_set()

    def _troubles(self) -> list[Trouble]:
        return self.health.troubles(self._rate_due())

    def _rate_due(self) -> float:
        """Frames/s that should come; 0 where nobody said."""
        return self._rate

    def _counters(self) -> dict[str, float]:
        return {}

    def _set_state(self, state: str, message: str) -> None:
        self._state = (state, message)

    def _pause(self, until: float) -> None:
        """Wait until then, by `time`, until a setting changes, the time makes a step or the device is
        closed."""
        self.time.wait(until, self._changed)
        self._changed.clear()

    def _wait_until(self, due: float) -> bool:
        """Wait until then, by `time`; whether the device goes on: SetBack where the time was set back."""
        self._notice(self._now())
        while not self._stop.is_set() and (now := self._now()) < due:
            self._notice(now)
            self._pause(due)
        return not self._stop.is_set()

    def _notice(self, now: float) -> None:
        latest, self._latest = self._latest, now
        if now < latest:
            raise SetBack

    def _wait_for_time(self) -> bool:
        """Wait until it is known what time it is; whether the device goes on."""
        while not self._stop.is_set() and self._now() <= 0.0:
            self._set_state("stopped", NO_TIME)
            self._pause(math.inf)
            self._set_state("streaming", "the first frame is under way")
        self._latest = self._now()
        return not self._stop.is_set()

    def _deliver(self, frame: Frame, last_sample: float | None = None) -> None:
        """Hand `frame` over; `last_sample` (s, by `time`) says how old it is."""
        if self._is_wanted(last_sample):
            self._call(self._on_frame, frame)
            self.health.frame_delivered(frame.voltages, frame.drive_voltage, last_sample)

    def _deliver_rows(self, rows: Frame, last_sample: float | None = None) -> None:
        """Hand rows of a frame over, likewise."""
        if self._on_rows is not None and self._is_wanted(last_sample, whole=False):
            self._call(self._on_rows, rows)

    def _is_wanted(self, last_sample: float | None, whole: bool = True) -> bool:
        """False where the device is closed, for what is of before the time was set, or for what is too
        old, which is counted and told."""
        if self._stopped() or (last_sample is not None and last_sample < self.time.since()):
            return False
        now = self._now()
        age = 0.0 if last_sample is None else now - last_sample
        if age <= self.max_age:
            return True
        self._stale_at = now
        if whole:
            self.health.frame_too_old(age)
        return False

    def _call(self, receive: Callable[[Frame], None], frame: Frame) -> None:
        try:
            receive(frame)
        except Exception as error:  # noqa: BLE001 - the receiver's mistake must not end the source
            self.health.callback_failed(f"{type(error).__name__}: {error}")

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
