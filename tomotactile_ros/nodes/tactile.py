"""Driver and reconstruction in one process: frames and rows go from one to the other without DDS.

The device's thread leaves each frame in a queue, a thread of the reconstruction takes the newest
from there: a slow image costs frames, never the device's time. Rows have a queue and a thread of
their own, which takes them in turn, but those of 20 ms before others that wait: a slow image does
not delay them either. Images of several sensors in one process are made one after the other.
Topics, services and parameters are those of the two nodes.
"""

import sys
import threading
from collections.abc import Callable, Iterator
from queue import Empty, SimpleQueue

from rclpy.node import Node
from std_msgs.msg import Header

from tomotactile_ros.devices import Frame
from tomotactile_ros.nodes.driver import SPECS as DRIVER_SPECS
from tomotactile_ros.nodes.driver import Driver
from tomotactile_ros.nodes.reconstruction import PATIENCE, Reconstruction
from tomotactile_ros.nodes.reconstruction_parameters import SPECS as RECONSTRUCTION_SPECS
from tomotactile_ros.nodes.row_watch import fall_behind
from tomotactile_ros.nodes.running import Making, run
from tomotactile_ros.nodes.turns import Turns

# of all sensors in this process; waiting for those of eight small sheets takes no longer
IMAGES = Turns(0.02)
PARAMETERS = {Driver.name: DRIVER_SPECS, Reconstruction.name: RECONSTRUCTION_SPECS}


class DirectDriver(Driver):
    """A driver that shares its process with reconstructions."""

    alone = False


class DirectReconstruction(Reconstruction):
    """A reconstruction whose frames are handed over within the process."""

    def __init__(self, node: Node):
        super().__init__(node, subscribe=False)
        self._queue: SimpleQueue[tuple[Frame, str, Header] | None] = SimpleQueue()
        self._row_queue: SimpleQueue[tuple[Frame, str, Header] | None] = SimpleQueue()
        self._workers: list[threading.Thread] = []

    def activate(self) -> None:
        """Begin to process frames."""
        super().activate()
        self._workers = [
            threading.Thread(target=work, name=name, daemon=True)
            for name, work in (("reconstruction", self._work), ("rows", self._work_on_rows))
        ]
        for worker in self._workers:
            worker.start()

    def deactivate(self) -> None:
        """Stop processing frames; the threads have ended afterwards."""
        super().deactivate()
        if self._workers:
            self._queue.put(None)
            self._row_queue.put(None)
        for worker in self._workers:
            worker.join()
        self._workers = []

    def hand_over(self, frame: Frame, layout_id: str, header: Header) -> None:
        """Leave a frame to be processed next; those that still wait are dropped."""
        if not self._active:
            return
        try:  # they would be hundreds while an image takes seconds
            while self._queue.get_nowait() is not None:
                pass
            self._queue.put(None)  # the word to end, which is not for this thread
        except Empty:
            self._queue.put((frame, layout_id, header))

    def hand_over_rows(self, rows: Frame, layout_id: str, header: Header) -> None:
        """Leave rows to be followed in turn."""
        if self._active and self._rows.wanted:
            self._row_queue.put((rows, layout_id, header))

    def _work(self) -> None:
        while True:
            item = self._queue.get()
            with IMAGES.mine():
                while item is not None and not self._queue.empty():
                    item = self._queue.get()
                if item is None:
                    return
                self._do(self.accept, item)

    def _work_on_rows(self) -> None:
        ended = False
        while not ended:
            items = [self._row_queue.get()]
            while not self._row_queue.empty():
                items.append(self._row_queue.get())
            waiting = [item for item in items if item is not None]
            ended = len(waiting) < len(items)
            behind = fall_behind([rows.stamp for rows, *_ in waiting])
            for item, left_out in zip(waiting, behind, strict=True):
                if left_out:
                    self._rows.watch.skip(item[0].sequence, len(item[0].grounded))
                else:
                    self._do(self.accept_rows, item)

    def _do(self, accept: Callable[[Frame, str, Header], None], item: tuple) -> None:
        try:
            accept(*item)
        except Exception as error:  # noqa: BLE001 - a defect must not end the thread
            if self._node.context.ok():  # otherwise ROS shuts down and nothing can be published
                self._log.error(f"{type(error).__name__}: {error}", throttle_duration_sec=5.0)


def make_nodes(make: Making) -> Iterator[Node]:
    """Both nodes of one sensor, connected; `make` makes each of what it does."""
    reconstruction = make(DirectReconstruction)
    yield reconstruction
    driver = make(DirectDriver)
    driver.part.listeners.append(reconstruction.part.hand_over)
    driver.part.row_listeners.append(reconstruction.part.hand_over_rows)
    yield driver


def main(args: list[str] | None = None, managed: bool = False) -> int:
    """Run both nodes."""
    sys.setswitchinterval(PATIENCE)
    return run(make_nodes, args, __doc__, PARAMETERS, managed=managed)
