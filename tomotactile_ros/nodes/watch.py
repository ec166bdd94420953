"""Watches the frames that come in, and says why none do."""

from collections import deque

import numpy as np
from rclpy.node import Node
from rclpy.topic_endpoint_info import TopicEndpointInfo

from tomotactile_ros.devices.health import Recent, Trouble, late_of
from tomotactile_ros.devices.time_source import NO_TIME
from tomotactile_ros.nodes.diagnostics import percentiles
from tomotactile_ros.nodes.node_time import STANDS_STILL, PassingTime, clock_of, is_timeless
from tomotactile_ros.support.checks import plain

TYPE = "tomotactile_ros/msg/VoltageFrame"
_RESTART = 2**16
_SOME, _MANY = 0.01, 0.1  # of the frames
_WINDOW = 10  # s
_OLD = 1.0  # s from a frame's stamp to its image, or the other way round
_MOSTLY = 0.5  # of the age: work is the reason
_OVERLONG = 2.0  # times the distance between stamps: stamps of other drivers may jitter
_UNKNOWN = "_NODE_NAME_UNKNOWN_"  # what ROS calls a node of which it has heard no more than a topic
_PATIENCE = 2.0  # s without a frame before it is said


class FrameWatch:
    """Counts frames and finds out what keeps them away.

    Parameters
    ----------
    node : the node that waits for frames.
    topic : resolved name of the topic.
    """

    def __init__(self, node: Node, topic: str):
        self._node = node
        self._topic = topic
        self._time = PassingTime(node)
        self._now = self._time.now
        # when, s, how old, s of work
        self._ages: deque[tuple[float, float, float]] = deque(maxlen=1000)
        self._sequence: int | None = None
        self._stamp = -np.inf
        self.stamps_back = 0
        self.processed = self.refused = self.missed = 0
        self.restart()

    def restart(self) -> None:
        """Begin to wait anew."""
        self._since = self._begun = self._now()
        self._refusal = self._last_refusal = self._incompatible = ""
        self._recent = Recent(_WINDOW, self._now)
        self._lasts = self._step = 0.0

    def accepted(
        self,
        sequence: int,
        stamp: float,
        latency: float,
        duration: float,
        lasts: float = 0.0,
        deadline: float = np.inf,
        complete: bool = True,
    ) -> None:
        """Note a processed frame: its stamp, s, s from there to its image, s of work, s that its rows
        took, s from the last of them to the image beyond which it is late, and whether all was tried by
        then."""
        gap = 0 if self._sequence is None else (sequence - self._sequence - 1) % 2**32
        missed = gap if gap < _RESTART else 0  # a number far away is that of another start
        self.missed += missed
        # a simulated clock goes back whenever a bag starts over
        back = stamp < self._stamp and not clock_of(self._node).ros_time_is_active
        self.stamps_back += back
        step = stamp - self._stamp
        overlong = gap == 0 and lasts > _OVERLONG * step > 0
        if overlong:
            self._lasts, self._step = lasts, step
        self._sequence, self._stamp = sequence, stamp
        late = latency - lasts > deadline or not complete
        self._recent.add(
            processed=1,
            missed=missed,
            back=back,  # stamped before the one before
            overlong=overlong,  # than from one to the next
            in_turn=gap > 2**31,  # numbered before the one before
            late=late,  # or cut
            cut=not complete,
        )
        self.processed += 1
        self._ages.append((self._now(), latency, duration))
        self._since, self._incompatible = self._now(), ""

    def refuse(self, reason: str) -> None:
        """Note a frame that was refused."""
        self.refused += 1
        self._recent.add(refused=1)
        self._refusal = self._last_refusal = reason

    def incompatible_qos(self, policy: str) -> None:
        """Note that a publisher's quality of service does not suit."""
        self._incompatible = policy

    def troubles(self, max_age: float = 0.0) -> list[Trouble]:
        """What is wrong with the frames of the last 10 s, though there are some.

        Contacts of readings beyond `max_age`, s, are not valid; 0 for those of any age.
        """
        recent, found = self._recent.sums(), []
        processed, missed, refused = (recent[n] for n in ("processed", "missed", "refused"))
        publishers = self._node.count_publishers(self._topic)
        if publishers > 1:
            mixed = recent["in_turn"] > 1  # once: a driver that was started again
            unless = "" if mixed else ", unless one rests or has just died"
            text = f"{publishers} publishers of {self._topic}: frames are mixed{unless}"
            found.append(Trouble("publishers", mixed, text))
        if refused > _SOME * (processed + refused):
            share = 100 * refused / (processed + refused)
            text = f"{share:.0f} % of the frames are refused: {self._last_refusal}"
            found.append(Trouble("refused", share > 50, text))
        if missed > _MANY * (processed + missed):
            share = 100 * missed / (processed + missed)
            text = (
                f"{share:.0f} % of the frames were not used: {plain(processed / self._span())} of "
                f"{plain((processed + missed) / self._span())} images/s are made: images or network "
                "are too slow"
            )
            found.append(Trouble("missed", False, text))
        if (cut := recent["cut"]) > _MANY * processed:
            text = (
                f"not all was tried in {cut:.0f} of {processed:.0f} frames: the deadline came before, as this machine "
                "is too slow for it, or too much touches at once"
            )
            found.append(Trouble("cut", False, text))
        if back := recent["back"]:
            text = (
                f"the stamps of {back:.0f} frames lie before those of the frames before them, ids and "
                "ages of contacts are wrong there: a clock was set, a recording starts "
                "over, or several publish"
            )
            found.append(Trouble("stamps", back > _MANY * processed, text))
        if recent["overlong"] > _MANY * processed:
            text = (
                f"the rows of a frame take {plain(self._lasts)} s by its row_period, and frames follow one "
                f"another after {plain(self._step)} s: times and velocities of contacts are wrong (row_period "
                "is in s)"
            )
            found.append(Trouble("row period", True, text))
        age, work = self._age()
        if age > (min(_OLD, max_age) if max_age > 0 else _OLD):
            why = "clocks differ, or messages are slow"
            if work > _MOSTLY * age:
                why = f"an image takes {plain(work)} s"
            text = f"frames are {plain(age)} s old: {why}"
            found.append(Trouble("old", 0 < max_age < age, text))
        elif age < -_OLD:
            text = f"frames are stamped {plain(-age)} s ahead of the time here: clocks differ"
            found.append(Trouble("ahead", False, text))
        return found

    def late(self) -> str:
        """How many frames of the last 10 s were told late, cut by the deadline or not told at all, each
        once, for people."""
        recent = self._recent.sums()
        missed = recent["missed"]
        return late_of(missed + recent["late"], missed + recent["processed"], "frames")

    def cut(self) -> str:
        """In how many frames of the last 10 s not all was tried, for people."""
        recent = self._recent.sums()
        return late_of(recent["cut"], recent["processed"], "frames")

    def figures(self) -> dict[str, float | int]:
        """Counts so far; times over the last 1000 frames."""
        recent = self._recent.sums()
        return {
            "frames_processed": self.processed,
            "frames_refused": self.refused,
            "frames_missed": self.missed,
            "stamps_back": self.stamps_back,
            "rate_wanted": (recent["processed"] + recent["missed"]) / self._span(),
            "rate_reached": recent["processed"] / self._span(),
            **percentiles(self._ages, "latency", "processing"),
        }

    def _age(self) -> tuple[float, float]:
        """Medians over the frames of the last 10 s: how old they were, s, and s of work for each; 0
        without any."""
        since = self._now() - _WINDOW
        recent = [(age, work) for when, age, work in list(self._ages) if when >= since]
        age, work = np.median(recent, axis=0) if recent else (0.0, 0.0)
        return float(age), float(work)

    def _span(self) -> float:
        """s over which the recent frames were counted."""
        return min(max(self._now() - self._begun, 1.0), float(_WINDOW))

    def complaint(self) -> str:
        """Why there are no frames, or nothing while there are some."""
        if self._now() - self._since < _PATIENCE:
            return ""
        publishers = self._node.get_publishers_info_by_topic(self._topic)
        if is_timeless(self._node):
            return f"no frames are used: {NO_TIME} (use_sim_time is set)"
        if self._time.stands_still():
            return f"no frames: {STANDS_STILL}"
        if not publishers:
            self._refusal = self._incompatible = ""  # of one that has gone
            return (
                f"no frames: nobody publishes {self._topic}; is the driver running, with the same "
                "namespace and ROS_DOMAIN_ID?"
            )
        if self._refusal:
            return f"every frame on {self._topic} is refused: {self._refusal}"
        others = {p.topic_type for p in publishers} - {TYPE}
        if others:
            return f"no frames: {self._topic} carries {', '.join(sorted(others))}, not {TYPE}"
        if self._incompatible:
            return (
                f"no frames: quality of service does not match on {self._topic} "
                f"({self._incompatible}): see qos_overrides of both nodes"
            )
        who = ", ".join(sorted({_full_name(p) for p in publishers}))
        return (
            f"no frames: {who} publishes {self._topic}, but nothing arrives: its diagnostics say why, unless "
            "it has just died"
        )

    @property
    def waits(self) -> bool:
        """Whether no frame was processed since it began to wait."""
        return self._since == self._begun


def _full_name(publisher: TopicEndpointInfo) -> str:
    if publisher.node_name == _UNKNOWN:
        return "a driver that is just starting"
    return f"{publisher.node_namespace.rstrip('/')}/{publisher.node_name}"
