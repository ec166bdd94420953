"""The sensor without hardware: speaks docs/protocol.md on a pseudo-terminal or a TCP port.

`firmware` is the device (`printer` one that prints text), a port of `ports` the cable, and `Emulator` joins them in a loop that
never sleeps longer than to the end of the frame.
"""

from __future__ import annotations

import threading
import time
from collections.abc import Callable

from tomotactile_ros.devices.firmware import EmulatedDevice
from tomotactile_ros.devices.ports import PtyPort, TcpPort
from tomotactile_ros.devices.printer import PrintingDevice


class Emulator:
    """Runs a device on a port, in the caller's thread (`run`) or in one of its own (`plug`).

    Parameters
    ----------
    device : EmulatedDevice or PrintingDevice
    make_port : callable
        Makes the port, each time the plug goes in.
    mangle : callable
        What the line does to the device's packets, for fault tests: bytes -> bytes.
    """

    TICK = 0.001
    IDLE = 0.05
    BUFFER = 1 << 19  # of a microcontroller with half a megabyte to spare
    PIECE = 1 << 16

    def __init__(
        self,
        device: EmulatedDevice | PrintingDevice,
        make_port: Callable[[], PtyPort | TcpPort],
        mangle: Callable[[bytes], bytes] = bytes,
    ) -> None:
        self.device = device
        if isinstance(device, PrintingDevice):
            self.BUFFER = 1  # what nobody reads is lost, and not read later
        self.path = ""
        self._make_port, self._mangle = make_port, mangle
        self._stop = threading.Event()
        self._thread: threading.Thread | None = None

    def plug(self) -> str:
        """Plug in and run in a thread; return the path or URL for the host."""
        self._stop.clear()
        port = self._make_port()
        self.path = port.path
        self._thread = threading.Thread(target=self._serve, args=(port,), daemon=True)
        self._thread.start()
        return self.path

    def unplug(self) -> None:
        """Pull the plug and stop; a device on battery: sequence and time go on at the next plug."""
        self._stop.set()
        if self._thread is not None:
            self._thread.join()

    def run(self, announce: Callable[[str], None]) -> None:
        """Plug in, `announce` the path and serve until an exception such as Ctrl-C."""
        port = self._make_port()
        announce(port.path)
        self._serve(port)

    def _serve(self, port: PtyPort | TcpPort) -> None:
        pending = bytearray()
        try:
            while not self._stop.is_set():
                if port.wait(self._idle_time(), sending=bool(pending)):
                    answer = self.device.receive(port.receive(), time.monotonic())
                    pending += self._mangle(answer)
                rows = self.device.rows_due(time.monotonic())
                if len(pending) < self.BUFFER:
                    pending += self._mangle(rows)
                else:
                    self.device.dropped += rows.count(0)
                if pending:
                    del pending[: port.send(bytes(pending[: self.PIECE]))]
        finally:
            port.close()

    def _idle_time(self) -> float:
        due = self.device.next_due()
        if due is None:
            return self.IDLE
        return max(0.0, min(self.TICK, due - time.monotonic()))
