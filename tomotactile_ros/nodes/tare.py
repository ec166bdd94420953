"""The services `~/tare` and `~/untare`, and the file by which a tare survives a crash.

A crash leaves the file behind, and the next start takes the tare from it; a clean end removes it,
unless the parameter `tare_file` names it: then it is kept. A start that finds a tare which it
cannot use says so for as long as there is none.
"""

import os
import time
from collections import deque
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path

from rclpy.node import Node
from std_srvs.srv import Trigger

from tomotactile_ros.devices import Frame
from tomotactile_ros.devices.health import Trouble
from tomotactile_ros.nodes.node_time import PassingTime
from tomotactile_ros.nodes.parameters import Spec
from tomotactile_ros.reconstruction import Pipeline
from tomotactile_ros.reconstruction.at_rest import at_rest
from tomotactile_ros.reconstruction.frame_checks import ordered
from tomotactile_ros.reconstruction.tare_file import Tare, is_tare, load_tare, this_boot
from tomotactile_ros.support.errors import InputError

SPECS = (
    Spec("tare_frames", 16, "Frames that ~/tare averages", low=1, high=1000),
    Spec(
        "tare_file",
        "",
        "Keeps the tare from start to start; empty: a crash is survived, no more",
        read_only=True,
    ),
)
_STALE = 1.0  # s without a frame
_PERIODS = 3.0  # or times as long as usual from one to the next


class Taring:
    """The tare of a reconstruction node.

    Parameters
    ----------
    node : the node.
    parameters : its parameters, `tare_frames` and `tare_file` among them.
    lock : guards the pipeline.
    pipeline : gives the pipeline in use, if the node is active.
    complaint : gives the reason for which there are no frames, if it is known.
    """

    def __init__(
        self,
        node: Node,
        values: Callable[[], dict],
        lock: AbstractContextManager,
        pipeline: Callable[[], Pipeline | None],
        complaint: Callable[[], str],
    ):
        self._log, self._now = node.get_logger(), PassingTime(node).now
        self._values, self._lock, self._complaint = values, lock, complaint
        self._pipeline = pipeline
        self._named = bool(values()["tare_file"])
        self._file = Path(values()["tare_file"] or _own_file(node))
        self._frames: deque[tuple[float, Frame]] = deque(maxlen=values()["tare_frames"])
        self._tare: Tare | None = None
        self._lost = ""  # why there is none although there was one
        self._note = ""  # where it comes from, or why it is not kept
        node.create_service(Trigger, "~/tare", self._on_tare)
        node.create_service(Trigger, "~/untare", self._on_untare)

    def remember(self, frame: Frame) -> None:
        """Keep a frame that was processed."""
        if self._frames.maxlen != self._values()["tare_frames"]:
            self._frames = deque(self._frames, maxlen=self._values()["tare_frames"])
        now = self._now()
        if self._frames and now - self._frames[-1][0] > self._patience():
            self._frames.clear()  # what was before a gap is not how the sheet is now
        self._frames.append((now, frame))

    def restore(self, pipeline: Pipeline) -> None:
        """Take the tare from the file, if there is one, and say what became of it."""
        self._tare, self._lost, self._note = None, "", ""
        if not self._file.exists():
            return
        try:
            found = load_tare(self._file, pipeline.layout.id, pipeline.layout.electrodes)
            if not self._named and found.boot != this_boot():
                raise InputError(
                    f"{self._file}: was made before this machine was started, and zero may have moved since"
                )
        except InputError as error:
            self._lost = f"restarted without its tare: {error}; tare again, or untare"
            return
        pipeline.use_baseline(found.baseline)
        self._tare, self._note = found, "restored"
        self._log.info(f"tare of {_clock(found.stamp)} restored from {self._file}")

    def forget(self) -> None:
        """The clean end: a file that nobody named goes, too."""
        self._frames.clear()
        if self._tare is not None and not self._named:
            self._remove()
        self._tare = None

    def troubles(self) -> list[Trouble]:
        """What is wrong with the tare."""
        text = self._lost or (self._note if self._note != "restored" else "")
        return [Trouble("tare", False, text, which=text)] if text else []

    def figures(self) -> dict[str, str]:
        """What zero is."""
        if self._tare is None:
            return {"tare": "none"}
        restored = ", restored" if self._note == "restored" else ""
        return {"tare": f"{self._tare.frames} frames at {_clock(self._tare.stamp)}{restored}"}

    def _on_tare(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            try:
                pipeline = self._pipeline()
                if pipeline is None:
                    raise InputError("the reconstruction is not active")
                frames = self._fresh()
                rows = [(frame.voltages, frame.grounded) for frame in frames]
                layout = pipeline.layout
                rest = at_rest([ordered(layout, *each) for each in rows], frames[-1].drive_voltage)
                pipeline.tare(rows)
            except InputError as error:
                response.message = str(error)
            else:
                response.success = True
                self._keep(pipeline, len(frames))
                said = [f"zero is now the mean of the last {len(frames)} frames"]
                if rest.doubt:
                    self._log.warning(f"tare: {rest.doubt}")
                response.message = "; ".join(filter(None, [*said, rest.doubt, self._note]))
        return response

    def _on_untare(self, request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        with self._lock:
            pipeline = self._pipeline()
            if pipeline is None:
                response.message = "the reconstruction is not active"
                return response
            there_was = pipeline.baseline is not None
            pipeline.untare()
            self._tare, self._lost, self._note = None, "", ""
            self._remove()
        response.success = True
        response.message = "zero is 0 V again" if there_was else "there was no tare"
        return response

    def _fresh(self) -> list[Frame]:
        """The last frames; InputError, with the reason, where they are not of now."""
        if not self._frames:
            raise InputError(self._complaint() or "no frame has arrived yet")
        age = self._now() - self._frames[-1][0]
        if age > self._patience():
            reason = self._complaint() or "none has come since"
            raise InputError(f"the last frame is {age:.1f} s old: {reason}")
        return [frame for _, frame in self._frames]

    def _patience(self) -> float:
        """s after which the last frame is stale."""
        times = [at for at, _ in self._frames]
        usual = (times[-1] - times[0]) / (len(times) - 1) if len(times) > 1 else 0.0
        return max(_STALE, _PERIODS * usual)

    def _keep(self, pipeline: Pipeline, frames: int) -> None:
        assert pipeline.baseline is not None
        tare = Tare(pipeline.layout.id, pipeline.baseline, frames, time.time(), this_boot())
        self._tare, self._lost, self._note = tare, "", ""
        try:
            self._spare_others()
            tare.save(self._file)
        except InputError as error:
            self._note = f"the tare would not survive a crash: {error}"

    def _spare_others(self) -> None:
        """InputError where the file that somebody named holds anything else than a tare."""
        if self._named and self._file.exists() and not is_tare(self._file):
            raise InputError(
                f"{self._file}: is no file of a tare and stays as it is; remove it, or name another"
            )

    def _remove(self) -> None:
        try:
            self._spare_others()
        except InputError as error:
            self._log.warning(str(error))
            return
        try:
            self._file.unlink(missing_ok=True)
        except OSError as error:
            self._log.warning(f"{self._file}: cannot be removed: {error.strerror}")


def _own_file(node: Node) -> Path:
    """A place in ROS's folder that only this node has: its full name and its domain say which."""
    home = Path(os.environ.get("ROS_HOME") or Path("~/.ros").expanduser())
    name = node.get_fully_qualified_name().strip("/").replace("/", "-")
    domain = os.environ.get("ROS_DOMAIN_ID", "0")
    return home / "tomotactile_ros" / f"{name}-{domain}.tare.npz"


def _clock(stamp: float) -> str:
    return time.strftime("%Y-%m-%d %H:%M:%S", time.localtime(stamp))
