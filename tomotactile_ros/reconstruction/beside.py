"""Frames estimated in a process of their own, so that rows do not wait for them.

One thread of Python computes at a time. A frame whose estimate takes a fifth of a second takes half
of the interpreter from rows that come every millisecond, and they fall behind. The process beside
(`support.beside`) has a pipeline of the same layout and settings, and is told of tares and of what is
learned of the sensor.
"""

from __future__ import annotations

from tomotactile_ros.estimation.frames_in_rows import FrameSeen
from tomotactile_ros.estimation.row_estimator import RowsState
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.learning.state import SensorState
from tomotactile_ros.reconstruction.pipeline import Pipeline
from tomotactile_ros.reconstruction.settings import Result, Settings
from tomotactile_ros.support.beside import Process

_NICE = 5  # rows go first where there are fewer processors than processes


class Beside:
    """Processes frames and corrects rows as `Pipeline` does, in a process of its own.

    To be used by one thread at a time. A process that ends by itself is a ConnectionError of who
    asks it; the next `takes` starts another.
    """

    def __init__(self) -> None:
        self._process = Process(_Frames, _NICE, "the process that estimates frames has ended")
        self._made: tuple = ()  # layout and settings that it has
        self._knows: tuple = ()  # tare and sensor that it has

    @property
    def pid(self) -> int | None:
        """Number of the process, if there is one."""
        return self._process.pid

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
        return self._process.ask("process", *frame, False, deadline)

    def correct(
        self, state: RowsState, voltages, grounded, drive_voltage, row_period, stamp, deadline=None
    ) -> None:
        """As `Pipeline.correct`, of the frame that was just given to `process` if any was."""
        frame = voltages, grounded, drive_voltage, row_period, stamp
        seen = self._process.ask("correct", *frame, state.clear, deadline)
        if seen is not None:
            state.tell(seen)

    def stop(self) -> None:
        """End the process; `takes` starts another."""
        self._process.stop()
        self._made = self._knows = ()

    def _takes(self, pipeline: Pipeline) -> bool:
        made = pipeline.layout, pipeline.settings
        if not self._process.runs:
            self.stop()
            self._process.start()
        if not self._process.ready():
            return False
        if any(a is not b for a, b in zip(made, self._made or (None, None))):
            self._process.make(*made)
            self._made, self._knows = made, (None, None)
            return False
        knows = pipeline.baseline, pipeline.sensor
        if any(a is not b for a, b in zip(knows, self._knows)):
            self._process.ask("know", *knows)
            self._knows = knows
        return True


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
