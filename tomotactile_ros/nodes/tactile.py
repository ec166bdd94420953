"""Driver and reconstruction in one process: frames go from one to the other without DDS.

The device's thread leaves each frame in a slot for one, a thread of the reconstruction takes it
from there: a slow image costs frames, never the device's time, and the newest frame is always next.
Topics, services and parameters are those of the two nodes.
"""

import threading
from collections.abc import Iterator

from rclpy.node import Node

from tomotactile_ros.devices import Frame
from tomotactile_ros.nodes.driver import Driver
from tomotactile_ros.nodes.life import PlainNode, run
from tomotactile_ros.nodes.reconstruction import Reconstruction


class DirectReconstruction(Reconstruction):
    """A reconstruction whose frames are handed over within the process."""

    def __init__(self, node: Node):
        super().__init__(node, subscribe=False)
        self._slot: tuple[Frame, str, str] | None = None
        self._filled = threading.Condition()
        self._worker: threading.Thread | None = None
        self._stopping = False

    def activate(self) -> None:
        """Begin to process frames."""
        super().activate()
        self._stopping = False
        self._worker = threading.Thread(target=self._work, name="reconstruction", daemon=True)
        self._worker.start()

    def deactivate(self) -> None:
        """Stop processing frames; the thread has ended afterwards."""
        super().deactivate()
        if self._worker is not None:
            with self._filled:
                self._stopping = True
                self._filled.notify()
            self._worker.join()
            self._worker = None

    def hand_over(self, frame: Frame, layout_id: str, frame_id: str) -> None:
        """Leave a frame to be processed next; one that still waits is dropped."""
        with self._filled:
            self._slot = frame, layout_id, frame_id
            self._filled.notify()

    def _work(self) -> None:
        while True:
            with self._filled:
                self._filled.wait_for(lambda: self._slot is not None or self._stopping)
                if self._stopping:
                    return
                item, self._slot = self._slot, None
            try:
                self.accept(*item)
            except Exception as error:  # noqa: BLE001 - publishing fails while ROS shuts down
                self._log.error(f"{type(error).__name__}: {error}", throttle_duration_sec=5.0)


def make_nodes() -> Iterator[Node]:
    """Both nodes, connected."""
    reconstruction = PlainNode(DirectReconstruction)
    yield reconstruction
    driver = PlainNode(Driver)
    driver.part.listeners.append(reconstruction.part.hand_over)
    yield driver


def main(args: list[str] | None = None) -> int:
    """Run both nodes."""
    return run(make_nodes, args)
