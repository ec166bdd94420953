"""Driver and reconstruction in one process: frames and rows go from one to the other without DDS.

The device's thread leaves each frame to a thread of the reconstruction, which takes the newest: a
slow image costs frames, never the device's time. Rows have a thread of their own: a slow image does
not delay them either. Images of several sensors in one process are made one after the other.
Topics, services and parameters are those of the two nodes.
"""

import sys
import threading
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, nullcontext

from rclpy.node import Node
from std_msgs.msg import Header

from tomotactile_ros.devices import Frame
from tomotactile_ros.nodes.driver import SPECS as DRIVER_SPECS
from tomotactile_ros.nodes.driver import Driver
from tomotactile_ros.nodes.frame_subscriptions import (
    Accept,
    Item,
    Source,
    Take,
    in_turn,
    newest,
)
from tomotactile_ros.nodes.reconstruction import PATIENCE, Reconstruction
from tomotactile_ros.nodes.reconstruction_parameters import SPECS as RECONSTRUCTION_SPECS
from tomotactile_ros.nodes.running import Making, run
from tomotactile_ros.nodes.turns import Turns

# of all sensors in this process; waiting for those of eight small sheets takes no longer
IMAGES = Turns(0.02)
_LOOK = 0.1  # s after which a thread looks whether it is to end
PARAMETERS = {Driver.name: DRIVER_SPECS, Reconstruction.name: RECONSTRUCTION_SPECS}


class DirectDriver(Driver):
    """A driver that shares its process with reconstructions."""

    alone = False


class Handed(Source):
    """Frames, or rows of them, that another thread hands over.

    most : that wait, those before are dropped; None: all wait. turn : in which what waits is taken
    """

    def __init__(
        self,
        name: str,
        take: Take,
        most: int | None = None,
        turn: Callable[[], AbstractContextManager] = nullcontext,
    ):
        super().__init__(name, take)
        self._turn, self._news = turn, threading.Event()
        self._waiting: deque[Item] = deque(maxlen=most)

    def put(self, frame: Frame, layout_id: str, header: Header) -> None:
        """Leave one to be taken."""
        self._waiting.append((frame, layout_id, header))
        self._news.set()

    def _work(self) -> None:
        self._waiting.clear()
        while not self._stopped.is_set():
            if not self._news.wait(_LOOK):
                continue
            with self._turn():
                self._news.clear()
                if items := [self._waiting.popleft() for _ in range(len(self._waiting))]:
                    self._take(items)


class DirectReconstruction(Reconstruction):
    """A reconstruction whose frames are handed over within the process."""

    def _make_sources(self) -> list[Handed]:
        take_rows = in_turn(self._guarded(self.accept_rows), self._rows.watch.skip)
        self._to_follow = Handed("rows", take_rows)
        self.frames = Handed("reconstruction", newest(self._guarded(self.accept)), 1, IMAGES.mine)
        return [self.frames, self._to_follow]

    def hand_over_rows(self, rows: Frame, layout_id: str, header: Header) -> None:
        """Leave rows to be followed in turn."""
        if self._active and self._rows.wanted:
            self._to_follow.put(rows, layout_id, header)

    def _guarded(self, accept: Accept) -> Accept:
        def guarded(frame: Frame, layout_id: str, header: Header) -> None:
            try:
                accept(frame, layout_id, header)
            except Exception as error:  # noqa: BLE001 - a defect must not end the thread
                if self._node.context.ok():  # otherwise ROS shuts down and nothing can be published
                    self._log.error(f"{type(error).__name__}: {error}", throttle_duration_sec=5.0)

        return guarded


def make_nodes(make: Making) -> Iterator[Node]:
    """Both nodes of one sensor, connected; `make` makes each of what it does."""
    reconstruction = make(DirectReconstruction)
    yield reconstruction
    driver = make(DirectDriver)
    driver.part.listeners.append(reconstruction.part.frames.put)
    driver.part.row_listeners.append(reconstruction.part.hand_over_rows)
    yield driver


def main(args: list[str] | None = None, managed: bool = False) -> int:
    """Run both nodes."""
    sys.setswitchinterval(PATIENCE)
    return run(make_nodes, args, __doc__, PARAMETERS, managed=managed)
