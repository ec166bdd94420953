"""The scene of a fake device simulated in a process of its own, where others compute in this one.

A frame of 4 x 4 electrodes takes 5 ms of the 16 that it lasts, and its image as many: two sensors in
one process have no time for their images. Until the process is there, which takes a second or two, and
if it has ended, frames are simulated here.
"""

from __future__ import annotations

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.scenes.scene import Scene
from tomotactile_ros.simulation import Simulator
from tomotactile_ros.support.beside import Process
from tomotactile_ros.support.errors import InputError


class SceneBeside:
    """A simulator in a process of its own, for one thread at a time; arguments are those of `Simulator`."""

    def __init__(self, layout: Layout, scene: Scene, model: str):
        self._given = layout, scene, model
        self._process = Process(Simulator)

    @property
    def pid(self) -> int | None:
        """Number of the process, if there is one."""
        return self._process.pid

    def start(self) -> None:
        """Begin to prepare."""
        self._process.start()
        try:
            self._process.make(*self._given)
        except ConnectionError:
            self.stop()

    def stop(self) -> None:
        """End the process."""
        self._process.stop()

    def frame(self, row_period: float, order: tuple[int, ...], t: float, sequence: int):
        """`Simulator.scanned`; None where the process is not there."""
        try:
            if self._process.runs and self._process.ready():
                return self._process.ask("scanned", row_period, order, t, sequence)
        except (ConnectionError, InputError):  # what is wrong with a scene the own simulator says
            self.stop()
        return None
