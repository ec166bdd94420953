"""Node `optimizer`: moves electrodes, shows the resolution map of every step, writes the best
layout.

Its parameters are the options of `tomotactile optimize` (`optimizer/options.py`). It ends by
itself; a stop (Ctrl-C) ends it at once and keeps the best layout so far.
"""

import threading
from dataclasses import replace

import rclpy
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy
from rclpy.qos_overriding_options import QoSOverridingOptions
from sensor_msgs.msg import Image
from std_msgs.msg import Header

from tomotactile_ros.nodes import diagnostics
from tomotactile_ros.nodes.conversions import image_to_message
from tomotactile_ros.nodes.diagnostics import Diagnostics, Report
from tomotactile_ros.nodes.parameters import Parameters, Spec
from tomotactile_ros.nodes.running import BAD_INPUT, PlainNode, run
from tomotactile_ros.optimizer.checkpoint import state_file_of
from tomotactile_ros.optimizer.options import OPTIONS, START, Option, request_of, start_of
from tomotactile_ros.optimizer.request import ALIASES, METHODS, Request
from tomotactile_ros.optimizer.step import Step
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import YAML, check_out

GRID = 8  # rows and columns of the grid to start from, where nothing is given


def spec_of(option: Option) -> Spec:
    """The parameter of an option; what may be left away is 0, empty or []."""
    default = option.unset if option.default is None else option.default
    if option.name in ("rows", "cols"):
        default = GRID
    limits = {"low": 0, "high": option.high} if option.kind in (int, float) else {}
    return Spec(
        option.name,
        default,
        option.help,
        choices=option.choices,
        read_only=True,
        items=option.kind if option.metavar else int,
        **(limits if not option.metavar else {}),
    )


SPECS = (
    Spec(
        "method",
        METHODS[0],
        "How electrodes are moved",
        choices=(*METHODS, *ALIASES),
        read_only=True,
    ),
    *(spec_of(option) for option in OPTIONS),
    Spec("out", "optimized.yaml", "File for the best layout", read_only=True),
    Spec("name", "optimized", "Name of the best layout", read_only=True),
    Spec("frame_id", "tactile_link", "Frame of the resolution map", read_only=True, frame=True),
)


class Optimizer:
    """What the optimizer does: steps in a thread of its own, while the node answers."""

    name = "optimizer"

    def __init__(self, node: Node):
        self._node = node
        self._log = node.get_logger()
        self.parameters = Parameters(node, SPECS, _nothing_changes)
        self.status = 0
        self._request: Request | None = None
        self._history: list[Step] = []
        self._lock = threading.Lock()  # nothing is shown or written after the end
        self._at_work = False
        self._publisher = node.create_publisher(
            Image,
            "resolution_map",
            QoSProfile(
                depth=1,
                reliability=ReliabilityPolicy.RELIABLE,
                durability=DurabilityPolicy.TRANSIENT_LOCAL,
            ),
            qos_overriding_options=QoSOverridingOptions.with_default_policies(),
        )
        start = self.parameters["layout"] or "equal grid"
        self._diagnostics = Diagnostics(node, "optimization", lambda: start, self.report)
        self.parameters.warn_of_typos()

    def configure(self) -> None:
        """Read the layout to start from, and see that there is a place for the best one."""
        values = self.parameters
        check_out(values["out"], *YAML)
        given = {option.name: option.given(values[option.name]) for option in OPTIONS}
        kept = {"layout"} if given["electrodes"] is None else {"layout", "electrodes", "inset"}
        if given["layout"] is not None:
            given |= {option.name: option.default for option in START if option.name not in kept}
        elif given["electrodes"] is not None:  # they are on no grid, which always has a default
            given |= {"rows": None, "cols": None}
        layout = start_of(given)
        replace(layout, name=values["name"])  # refuses a name that the best layout cannot have
        state_file = state_file_of(values["out"])
        self._request = request_of(layout, values["method"], given, state_file)

    def activate(self) -> None:
        """Begin."""
        self._at_work = True
        threading.Thread(target=self._work, name="optimizer", daemon=True).start()

    def deactivate(self) -> None:
        """End at once, without the step under way; the best layout so far is written."""
        try:
            self._end()
        except InputError as error:
            self._fail(BAD_INPUT, str(error))

    def cleanup(self) -> None:
        """Nothing is left to do."""

    def report(self) -> Report:
        """Progress for /diagnostics."""
        if not self._history:
            return Report(diagnostics.OK, "evaluating the layout to start from")
        step = self._history[-1]
        figures = {"step": step.iteration, "of": step.total, "score": step.score, "eta": step.eta}
        return Report(diagnostics.OK, _progress(step), figures)

    def _work(self) -> None:
        try:
            for step in self._request.steps_of():
                with self._lock:
                    if not self._at_work:
                        return
                    self._show(step)
            self._end()
        except InputError as error:
            self._fail(BAD_INPUT, str(error))
        except Exception as error:  # noqa: BLE001 - a thread has nobody to raise it to
            self._fail(1, f"{type(error).__name__}: {error}")
        finally:
            rclpy.try_shutdown()  # ends the node

    def _end(self) -> None:
        """Write the best layout so far, if there is one and nobody has done it yet."""
        with self._lock:
            at_work, self._at_work = self._at_work, False
            if not at_work:
                return
            if len(self._history) > 1:
                self._write()
            else:
                self._log.warning("no step was finished: nothing is written")

    def _fail(self, status: int, reason: str) -> None:
        self.status = status
        self._log.fatal(reason)

    def _show(self, step: Step) -> None:
        self._history.append(step)
        self._log.info(_progress(step))
        header = Header(stamp=self._node.get_clock().now().to_msg())
        header.frame_id = self.parameters["frame_id"]
        try:
            self._publisher.publish(image_to_message(step.hwhm_map, header))
        except RuntimeError:
            if rclpy.ok():
                raise  # otherwise nobody listens any more

    def _write(self) -> None:
        best = [step for step in self._history if step.best][-1]
        values = self.parameters
        self._request.result(values["name"], self._history, best).save(values["out"])
        if self._history[-1].iteration == self._request.total and self._request.state_file:
            self._request.state_file.unlink(missing_ok=True)  # there is nothing to go on with
        self._log.info(f"step {best.iteration} was the best, {values['out']} written")


def _progress(step: Step) -> str:
    hwhm = step.metrics["hwhm"]
    return (
        f"step {step.iteration} of {step.total}: HWHM {1e3 * hwhm['mean']:.2f} mm, worst region "
        f"{1e3 * hwhm['worst_region']:.2f} mm, {step.eta:.0f} s left"
    )


def _nothing_changes(changed: set[str], values: dict) -> None:
    """All parameters are read-only."""


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    parts: list[Optimizer] = []

    def make_part(node: Node) -> Optimizer:
        parts.append(Optimizer(node))
        return parts[0]

    make_part.name = Optimizer.name
    status = run(lambda: [PlainNode(make_part)], args, __doc__, {Optimizer.name: SPECS})
    return status or (parts[0].status if parts else 0)
