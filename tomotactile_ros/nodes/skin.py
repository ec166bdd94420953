"""Node `skin`: contacts of several sensors as one list, and their wrench, in a robot's frame.

It publishes with every message of a sensor, and goes on to say who is silent when none come.
"""

import math
from copy import copy
from functools import partial

import numpy as np
from builtin_interfaces.msg import Time
from geometry_msgs.msg import Point, Vector3, WrenchStamped
from rclpy.clock import Clock, ClockType
from rclpy.node import Node
from std_msgs.msg import Header

from tomotactile_ros.devices.health import Trouble
from tomotactile_ros.devices.time_source import NO_TIME
from tomotactile_ros.msg import Contact, ContactArray
from tomotactile_ros.nodes import diagnostics
from tomotactile_ros.nodes.conditions import Conditions
from tomotactile_ros.nodes.contact_messages import wrench_to_message
from tomotactile_ros.nodes.conversions import stamp_of, vector, vectors
from tomotactile_ros.nodes.diagnostics import Diagnostics, Report
from tomotactile_ros.nodes.namespaces import SENSORS, full_namespaces
from tomotactile_ros.nodes.node_time import PassingTime, is_timeless, seconds_now
from tomotactile_ros.nodes.parameters import Spec
from tomotactile_ros.nodes.poses import POSES, Locate, make_locator
from tomotactile_ros.nodes.running import Part, run
from tomotactile_ros.nodes.stopping import unless_stopped
from tomotactile_ros.nodes.topics import publisher, subscription
from tomotactile_ros.skin import Skin
from tomotactile_ros.spatial import Pose, wrench_of
from tomotactile_ros.support.checks import LONGEST
from tomotactile_ros.support.errors import InputError, printable

SPECS = (
    SENSORS,
    Spec("frame_id", "base_link", "Frame of the skin, of the robot", read_only=True, frame=True),
    POSES,
    Spec(
        "timeout",
        0.5,
        "s without a message of contacts after which a sensor counts as silent",
        low=0.01,
        high=60.0,
    ),
    Spec(
        "max_age",
        2.0,
        "s; contacts with older stamps do not count; 0: any age",
        low=0.0,
        high=3600.0,
    ),
)
_ID_BITS = 24
_STRONGEST = 1e6  # N: whatever a sensor feels is far below
_UNIT = 0.01  # of a direction's length


class SkinPart(Part):
    """What the skin does."""

    name, specs = "skin", SPECS

    def __init__(self, node: Node):
        super().__init__(node)
        self._conditions = Conditions(self._log)
        self._now = PassingTime(node).now
        self._skin = Skin((), 1.0)
        self._locate: Locate  # of `configure`
        self._topics: dict[str, str] = {}
        self._active = False
        self._published = 0.0
        self._contacts = publisher(node, ContactArray, "~/contacts")
        self._wrench = publisher(node, WrenchStamped, "~/wrench")
        frame_id = self.parameters["frame_id"]
        self._diagnostics = Diagnostics(node, "sensors", lambda: frame_id, self.report)
        self.parameters.warn_of_typos()

    def configure(self) -> None:
        """Listen to the sensors."""
        values = self.parameters
        names = values["sensors"]
        namespaces = full_namespaces(self._node, names)
        self._skin = Skin(names, values["timeout"])
        self._locate = make_locator(self._node, values["frame_id"], values["poses"])
        for name, namespace in zip(names, namespaces, strict=True):
            self._listen(name, f"{namespace.rstrip('/')}/contacts")

    def activate(self) -> None:
        """Begin to publish."""
        self._active = True
        # it looks by a steady clock: where simulated time stands still, who is silent is told all the same
        self._node.create_timer(0.1, self._go_on, clock=Clock(clock_type=ClockType.STEADY_TIME))

    def deactivate(self) -> None:
        """Publish nothing any more."""
        self._active = False

    def report(self) -> Report:
        """Which sensors are silent, for /diagnostics."""
        now = self._now()
        unknown, mixed = self._skin.problems(now), self._mixed()
        figures: dict[str, float | int | str] = {
            "sensors": len(self._skin.members),
            "silent": len(unknown),
        }
        troubles = [
            Trouble(f"unknown {name}", True, f"{name}: {text}", self._skin.kind(name, now))
            for name, text in unknown.items()
        ]
        troubles += [Trouble(f"mixed {name}", True, f"{name}: {t}") for name, t in mixed.items()]
        self._conditions.say(troubles)
        if troubles:
            return Report(diagnostics.ERROR, "; ".join(t.text for t in troubles), figures)
        return Report(diagnostics.OK, "all sensors have valid contacts", figures)

    def _mixed(self) -> dict[str, str]:
        """Sensors whose contacts come from several nodes in turn."""
        found = {name: self._node.count_publishers(t) for name, t in self._topics.items()}
        return {
            name: f"{n} publishers of {self._topics[name]}" for name, n in found.items() if n > 1
        }

    def _listen(self, name: str, topic: str) -> None:
        made = subscription(self._node, ContactArray, topic, partial(self._on_contacts, name))
        self._topics[name] = made.topic_name

    def _on_contacts(self, name: str, message: ContactArray) -> None:
        member = self._skin.members[name]
        member.arrival, member.contacts, member.alternative = self._now(), [], None
        member.complaint, member.complete = "", message.complete
        if message.state != ContactArray.VALID:
            member.complaint = printable(message.reason) or "its contacts are not valid"
        elif is_timeless(self._node):
            member.complaint = f"how old its contacts are is not known, {NO_TIME}"
        elif self._too_old(message.header):
            member.complaint = "its contacts are too old, by their stamps (max_age)"
        try:
            check_contacts([*message.contacts, *message.alternative])
            pose = self._locate(message.header)
            member.contacts = moved(message.contacts, pose)
            if message.ambiguous:
                member.alternative = moved(message.alternative, pose)
            member.force, member.torque = wrench_of(
                vectors(c.position for c in member.contacts),
                vectors(c.normal for c in member.contacts),
                np.array([c.force for c in member.contacts]),
            )
        except InputError as error:
            member.complaint = str(error)
            self._log.warning(f"{name}: {error}", throttle_duration_sec=5.0)
        self._publish(message.header.stamp)

    def _too_old(self, header: Header) -> bool:
        """Whether contacts hold for a time that is too long ago: they may have waited on the way."""
        age = seconds_now(self._node) - stamp_of(header)
        return 0 < self.parameters["max_age"] < age

    def _go_on(self) -> None:
        """Say who is silent while nobody sends."""
        if self._now() - self._published > self._skin.timeout:
            self._publish(self._node.get_clock().now().to_msg())

    def _publish(self, stamp: Time) -> None:
        if not self._active:
            return
        now = self._published = self._now()
        header = Header(stamp=stamp, frame_id=self.parameters["frame_id"])
        problems = self._skin.problems(now)
        message = ContactArray(header=header, state=ContactArray.VALID)
        message.complete = all(member.complete for member in self._skin.members.values())
        message.contacts = self._all(now)
        known = [m for name, m in self._skin.members.items() if name not in problems]
        message.ambiguous = any(member.alternative is not None for member in known)
        message.alternative = self._all(now, others=True) if message.ambiguous else []
        if problems:
            message.state, message.reason = ContactArray.STALE, _reason(problems)
        with unless_stopped(self._node):
            self._contacts.publish(message)
            self._wrench.publish(wrench_to_message(*self._skin.wrench(now), header))

    def _all(self, now: float, others: bool = False) -> list[Contact]:
        found = [numbered(c, number) for number, c in self._skin.contacts(now, others)]
        return sorted(found, key=lambda contact: contact.force, reverse=True)

    def _change(self, changed: set[str], values: dict) -> None:
        self._skin.timeout = values["timeout"]


def check_contacts(contacts: list[Contact]) -> None:
    """Refuse contacts that are nowhere, pull, or press with no finite force in no direction."""
    for c in contacts:
        position, normal, tangent = vectors((c.position, c.normal, c.tangent))
        if not np.isfinite([*position, *normal, *tangent, c.force]).all():
            raise InputError("a contact has a place, a direction or a force that is not finite")
        if not (0.0 <= c.force <= _STRONGEST and np.abs(position).max() <= LONGEST):
            raise InputError(
                f"a contact of {c.force:g} N at {position.tolist()} m cannot be: 0 to {_STRONGEST:g} N "
                f"within {LONGEST:g} m are taken"
            )
        if not abs(math.hypot(*normal) - 1.0) <= _UNIT:
            raise InputError("the normal of a contact is no direction: its length is not 1")


def moved(contacts: list[Contact], pose: Pose) -> list[Contact]:
    """The same contacts in another frame; what lies along the surface stays as it is."""
    if not contacts:
        return []
    positions = pose.positions(vectors(c.position for c in contacts))
    turned = {
        key: pose.directions(vectors(getattr(c, key) for c in contacts))
        for key in ("velocity", "normal", "tangent")
    }
    result = []
    for i, contact in enumerate(contacts):
        other = copy(contact)
        other.position = vector(Point, positions[i])
        for key, directions in turned.items():
            setattr(other, key, vector(Vector3, directions[i]))
        result.append(other)
    return result


def numbered(contact: Contact, number: int) -> Contact:
    """The contact with the sensor's number in the upper bits of its id; 0 stays 0."""
    if contact.id:
        contact = copy(contact)
        contact.id = (number + 1) << _ID_BITS | contact.id % (1 << _ID_BITS)
    return contact


def _reason(problems: dict[str, str]) -> str:
    return "; ".join(f"{name}: {problem}" for name, problem in problems.items())


def main(args: list[str] | None = None) -> int:
    """Run the node."""
    return run(lambda make: [make(SkinPart)], args, __doc__, {SkinPart.name: SPECS})
