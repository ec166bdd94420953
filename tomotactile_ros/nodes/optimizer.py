"""Node `optimizer`: moves electrodes, or chooses the rows of a scan; shows the resolution map of
every step, writes the best layout.

Its parameters are the options of `tomotactile optimize` (`optimizer/options.py`). It ends by
itself; a stop (Ctrl-C) ends it at once and keeps the best layout so far.
"""

import math
import threading

import rclpy
from rclpy.node import Node
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from tomotactile_ros.nodes import diagnostics
from tomotactile_ros.nodes.conversions import image_to_message
from tomotactile_ros.nodes.diagnostics import Diagnostics, Report
from tomotactile_ros.nodes.parameters import Spec
from tomotactile_ros.nodes.running import BAD_INPUT, Making, Part, PlainNode, run
from tomotactile_ros.nodes.topics import publisher
from tomotactile_ros.optimizer.jobs import Job, Stage, job_of
from tomotactile_ros.optimizer.options import EXPLORE, OPTIONS, Option
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import check_inputs_stay

GRID = 8  # rows and columns of the grid to start from, where nothing is given
OUT = "optimized.yaml"


def spec_of(option: Option) -> Spec:
    """The parameter of an option; what may be left away is 0, empty or []."""
    default = option.unset if option.default is None else option.default
    is_limited = option.kind in (int, float) and not option.is_list
    return Spec(
        option.name,
        OUT if option.name == "out" else default,
        option.help,
        low=0 if is_limited else None,
        high=option.high if is_limited else math.inf,
        choices=option.choices,
        read_only=True,
        items=option.kind if option.is_list else int,
    )


SPECS = (
    *(spec_of(option) for option in OPTIONS),
    Spec("frame_id", "tactile_link", "Frame of the resolution map", read_only=True, frame=True),
)


class Optimizer(Part):
    """What the optimizer does: steps in a thread of its own, while the node answers."""

    name, specs = "optimizer", SPECS

    def __init__(self, node: Node):
        super().__init__(node)
        self.status = 0
        self._job: Job  # of `configure`
        self._last: Stage | None = None
        self._thread = threading.Thread(target=self._work, name="optimizer", daemon=True)
        self._lock = threading.Lock()  # nothing is shown or written after the end
        self._at_work = self._stopped = False
        self._publisher = publisher(node, Image, "resolution_map", latched=True)
        start = self.parameters["layout"] or "equal grid"
        self._diagnostics = Diagnostics(node, "optimization", lambda: start, self.report)
        self.parameters.warn_of_typos()

    def configure(self) -> None:
        """Read the layout to start from, and see that there is a place for the best one."""
        given = {option.name: option.given(self.parameters[option.name]) for option in OPTIONS}
        if all(given[name] is None for name in ("layout", "electrodes", "rows", "cols", EXPLORE)):
            given |= {"rows": GRID, "cols": GRID}
        check_inputs_stay(given, "")
        self._job = job_of(given)

    def activate(self) -> None:
        """Begin."""
        self._at_work = True
        self._thread.start()

    def deactivate(self) -> None:
        """End at once, without the step under way; the best layout so far is written."""
        self._stopped = True
        if self._at_work:
            self._job.work.stop()
        try:
            self._end()
        except InputError as error:
            self._fail(BAD_INPUT, str(error))

    def report(self) -> Report:
        """Progress for /diagnostics."""
        last = self._last
        if last is None:
            return Report(diagnostics.OK, "evaluating the layout to start from")
        figures = {"step": last.done, "of": self._job.total}
        return Report(diagnostics.OK, self._progress(last), {**figures})

    def _progress(self, stage: Stage) -> str:
        return f"step {stage.done} of {self._job.total}: {stage.note}"

    def _work(self) -> None:
        try:
            for stage in self._job.stages():
                with self._lock:
                    if not self._at_work:
                        return
                    self._show(stage)
            self._end()
        except Exception as error:  # noqa: BLE001 - a thread has nobody to raise it to
            if isinstance(error, InputError):
                self._fail(BAD_INPUT, str(error))
            elif not self._stopped:  # otherwise what there is has been written
                self._fail(1, f"{type(error).__name__}: {error}")
        finally:
            self._job.work.stop()
            rclpy.try_shutdown()  # ends the node

    def _end(self) -> None:
        """Write the best layout so far, if there is one and nobody has done it yet."""
        with self._lock:
            at_work, self._at_work = self._at_work, False
            if not at_work:
                return
            if not self._job.has_result:
                self._log.warning("no step was finished: nothing is written")
                return
            for line in self._job.write():
                self._log.info(line)

    def _fail(self, status: int, reason: str) -> None:
        self.status = status
        self._log.fatal(reason)

    def _show(self, stage: Stage) -> None:
        self._last = stage
        self._log.info(self._progress(stage))
        if stage.hwhm_map is None:
            return
        header = Header(stamp=self._node.get_clock().now().to_msg())
        header.frame_id = self.parameters["frame_id"]
        try:
            self._publisher.publish(image_to_message(stage.hwhm_map, header))
        except RuntimeError:
            if rclpy.ok():
                raise  # otherwise nobody listens any more


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    nodes: list[PlainNode[Optimizer]] = []

    def make_nodes(_: Making) -> list[PlainNode[Optimizer]]:
        nodes.append(PlainNode(Optimizer))
        return nodes

    status = run(make_nodes, args, __doc__, {Optimizer.name: SPECS})
    return status or (nodes[0].part.status if nodes else 0)
