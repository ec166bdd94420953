"""A device at the other end of a serial line: the line is opened again whenever it is lost."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from contextlib import closing

from tomotactile_ros.devices.base import Device
from tomotactile_ros.devices.line import Line, LineFault, open_line
from tomotactile_ros.devices.world import Settings, World

FIRST_RETRY, LAST_RETRY = 0.05, 0.5  # s between attempts to connect, doubled each time
SILENCE, SILENT_FRAMES = 1.0, 3.0


class LineDevice(Device):
    """Talks over one line after the other; all that it learns from outside comes through `_world`."""

    def __init__(
        self,
        port: str,
        electrodes: int,
        baud: int,
        rate: float,
        opener: Callable[[str, int], Line] = open_line,
    ) -> None:
        super().__init__(electrodes, rate)
        self._port, self._baud = port, baud
        self._world = World(self._stop, self._changed, self._settings_now, opener)
        self._connections = 0

    def _settings_now(self) -> Settings:
        return Settings(self._rate, self._streaming, self._scan)

    def _now(self) -> float:
        return self._world.now()

    def _stopped(self) -> bool:
        return self._world.stopped()

    def _run(self) -> None:
        delay = FIRST_RETRY
        while not self._stopped():
            before = self._understood()
            try:
                line = self._world.open(self._port, self._baud)
                if line is not None:
                    with closing(line):
                        self._talk(line)
            except LineFault as fault:
                self._report(fault)
            if self._understood() > before:
                delay = FIRST_RETRY
            if not self._stopped():
                self._world.wait(delay)
                delay = min(2.0 * delay, LAST_RETRY)

    def _report(self, fault: LineFault) -> None:
        self._set_state(fault.state, str(fault))

    @abstractmethod
    def _understood(self) -> int:
        """A number that grows with what is understood from the line."""

    @abstractmethod
    def _talk(self, line: Line) -> None:
        """All that is said on an open line; a `LineFault` where it is lost."""
