"""Driver and reconstruction in one process: frames go from one to the other without DDS.

The device's thread leaves each frame in a queue, a thread of the reconstruction takes the newest
from there: a slow image costs frames, never the device's time. Topics, services and parameters are
those of the two nodes.
"""

import sys
import threading
from collections.abc import Callable, Iterator
from queue import SimpleQueue

from rclpy.node import Node
from std_msgs.msg import Header

from tomotactile_ros.devices import Frame
from tomotactile_ros.nodes.driver import SPECS as DRIVER_SPECS
from tomotactile_ros.nodes.driver import Driver
from tomotactile_ros.nodes.life import ManagedNode, PlainNode, run
from tomotactile_ros.nodes.reconstruction import Reconstruction
from tomotactile_ros.nodes.reconstruction_parameters import SPECS as RECONSTRUCTION_SPECS

PATIENCE = 1e-4  # s until a thread that computes lets the other one have the interpreter
PARAMETERS = {Driver.name: DRIVER_SPECS, Reconstruction.name: RECONSTRUCTION_SPECS}


class DirectReconstruction(Reconstruction):
    """A reconstruction whose frames are handed over within the process."""

    def __init__(self, node: Node):
        super().__init__(node, subscribe=False)
        self._queue: SimpleQueue[tuple[Frame, str, Header] | None] = SimpleQueue()
        self._worker: threading.Thread | None = None

    def activate(self) -> None:
        """Begin to process frames."""
        super().activate()
        self._worker = threading.Thread(target=self._work, name="reconstruction", daemon=True)
        self._worker.start()

    def deactivate(self) -> None:
        """Stop processing frames; the thread has ended afterwards."""
        super().deactivate()
        if self._worker is not None:
            self._queue.put(None)
            self._worker.join()
            self._worker = None

    def hand_over(self, frame: Frame, layout_id: str, header: Header) -> None:
        """Leave a frame to be processed next; those that still wait are dropped."""
        if not self._active:
            return
        self._queue.put((frame, layout_id, header))

    def _work(self) -> None:
        while True:
            item = self._queue.get()
            while item is not None and not self._queue.empty():
                item = self._queue.get()
            if item is None:
                return
            try:
                self.accept(*item)
            except Exception as error:  # noqa: BLE001 - a defect must not end the thread
                if self._node.context.ok():  # otherwise ROS shuts down and nothing can be published
                    self._log.error(f"{type(error).__name__}: {error}", throttle_duration_sec=5.0)


def make_nodes(make: Callable[..., PlainNode | ManagedNode] = PlainNode) -> Iterator[Node]:
    """Both nodes of one sensor, connected; `make` makes each of what it does."""
    reconstruction = make(DirectReconstruction)
    yield reconstruction
    driver = make(Driver)
    driver.part.listeners.append(reconstruction.part.hand_over)
    yield driver


def main(args: list[str] | None = None) -> int:
    """Run both nodes."""
    sys.setswitchinterval(PATIENCE)
    return run(make_nodes, args, __doc__, PARAMETERS)
