"""Frames estimated in a process of their own, so that rows do not wait for them.

One thread of Python computes at a time. A frame whose estimate takes a fifth of a second takes half
of the interpreter from rows that come every millisecond, and they fall behind. The process beside
has a pipeline of the same layout and settings, is told of tares and of what is learned of the
sensor, and ends as soon as the pipe to it does: with whoever started it, however that ends.
"""

from __future__ import annotations

import os
import subprocess
import sys
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from typing import Any

from tomotactile_ros.estimation.frames_in_rows import FrameSeen
from tomotactile_ros.estimation.row_estimator import RowsState
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.learning.state import SensorState
from tomotactile_ros.reconstruction.pipeline import Pipeline
from tomotactile_ros.reconstruction.settings import Result, Settings

_NICE = 5  # rows go first where there are fewer processors than processes
_PATIENCE = 1.0  # s to end by itself
_ENDED = "the process that estimates frames has ended"
# the same modules as here, whatever the working directory
_PROGRAM = (
    "import sys; sys.path[:] = {path!r}; "
    "from tomotactile_ros.reconstruction.beside import serve; serve({pipe})"
)


class Beside:
    """Processes frames and corrects rows as `Pipeline` does, in a process of its own.

    To be used by one thread at a time. A process that ends by itself is a ConnectionError of who
    asks it; the next `takes` starts another.
    """

    def __init__(self) -> None:
        self._process: subprocess.Popen | None = None
        self._pipe: Connection | None = None
        self._prepares = False  # has not answered to other settings yet
        self._made: tuple = ()  # layout and settings that it has
        self._knows: tuple = ()  # tare and sensor that it has

    @property
    def pid(self) -> int | None:
        """Number of the process, if there is one."""
        return None if self._process is None else self._process.pid

    def takes(self, pipeline: Pipeline) -> bool:
        """Whether frames of `pipeline` can be given to it. That takes some seconds after a start or
        after other settings, which this does not wait for."""
        try:
            return self._takes(pipeline)
        except ConnectionError:
            return False

    def process(
        self, voltages, grounded, drive_voltage, row_period, stamp, deadline=None
    ) -> Result:
        """As `Pipeline.process`, with contacts that have no numbers."""
        frame = voltages, grounded, drive_voltage, row_period, stamp
        return self._ask("process", *frame, False, deadline)

    def correct(
        self, state: RowsState, voltages, grounded, drive_voltage, row_period, stamp, deadline=None
    ) -> None:
        """As `Pipeline.correct`, of the frame that was just given to `process` if any was."""
        frame = voltages, grounded, drive_voltage, row_period, stamp
        seen = self._ask("correct", *frame, state.clear, deadline)
        if seen is not None:
            state.tell(seen)

    def stop(self) -> None:
        """End the process; `takes` starts another."""
        process, pipe = self._process, self._pipe
        self._process = self._pipe = None
        self._made = self._knows = ()
        if pipe is not None:
            pipe.close()
        if process is not None:
            try:
                process.wait(_PATIENCE)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()

    def _takes(self, pipeline: Pipeline) -> bool:
        made = pipeline.layout, pipeline.settings
        if self._process is None or self._process.poll() is not None:
            self.stop()
            self._start()
        if self._prepares:
            if self._pipe is not None and not self._pipe.poll():
                return False
            self._answer()
            self._prepares = False
        if any(a is not b for a, b in zip(made, self._made or (None, None))):
            self._send("make", *made)
            self._made, self._knows, self._prepares = made, (None, None), True
            return False
        knows = pipeline.baseline, pipeline.sensor
        if any(a is not b for a, b in zip(knows, self._knows)):
            self._ask("know", *knows)
            self._knows = knows
        return True

    def _start(self) -> None:
        self._pipe, other = Pipe()
        program = _PROGRAM.format(path=sys.path, pipe=other.fileno())
        self._process = subprocess.Popen(
            [sys.executable, "-c", program],
            stdin=subprocess.DEVNULL,
            pass_fds=(other.fileno(),),
            start_new_session=True,  # a Ctrl-C on the terminal is for whoever started it
        )
        other.close()

    def _ask(self, what: str, *words) -> Any:
        self._send(what, *words)
        return self._answer()

    def _send(self, *words) -> None:
        if self._pipe is None:
            raise ConnectionError(_ENDED)
        try:
            self._pipe.send(words)
        except OSError as error:
            raise ConnectionError(_ENDED) from error

    def _answer(self) -> Any:
        if self._pipe is None:
            raise ConnectionError(_ENDED)
        try:
            answer = self._pipe.recv()
        except (EOFError, OSError) as error:
            raise ConnectionError(_ENDED) from error
        if isinstance(answer, Exception):
            raise answer
        return answer


class _Frames:
    """What the process beside does, a method for each thing that it is asked."""

    def __init__(self, layout: Layout, settings: Settings):
        self._pipeline = Pipeline(layout, settings)
        self._state = self._pipeline.rows(waits=False)

    def stop(self) -> None:
        """End what is still looked for."""
        self._pipeline.stop()

    def know(self, baseline, sensor: SensorState | None) -> None:
        """Go on with another tare, or what was learned."""
        self._pipeline.use_sensor(sensor)
        if baseline is None:
            self._pipeline.untare()
        else:
            self._pipeline.use_baseline(baseline)
        self._state = self._pipeline.rows(waits=False)

    def process(self, *frame) -> Result:
        """A frame's result."""
        return self._pipeline.process(*frame)

    def correct(self, *frame) -> FrameSeen | None:
        """What a frame tells rows."""
        self._pipeline.correct(self._state, *frame)
        return self._state.told()


def serve(pipe: int) -> None:
    """Answer what is asked through the file descriptor `pipe` until that ends."""
    os.nice(_NICE)
    connection: Connection = Connection(pipe)
    frames = None
    while True:
        try:
            what, *words = connection.recv()
        except (EOFError, OSError):
            return
        try:
            if what == "make":
                if frames is not None:
                    frames.stop()
                frames, answer = _Frames(*words), None
            else:
                answer = getattr(frames, what)(*words)
        except Exception as error:  # noqa: BLE001 - whoever asked is told
            answer = error
        try:
            connection.send(answer)
        except OSError:
            return
