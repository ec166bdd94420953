"""Whether contacts keep their ids while they last: each true touch of a scene has one, in real processes over DDS.

    scripts/setup python3 benchmark/ids.py --scene default slide tap --profile fast balanced accurate --minutes 10

Contacts that are valid are paired with what really touches at their stamp. `changed` counts touches that
were given a second id, each on a line with the least true force meanwhile; `missed` messages in which a
touch of a quarter newton or more has no contact, and `nothing` contacts where nothing touches; `gap` is
the longest time between two valid messages, s.
"""

import os
import sys
from argparse import Namespace
from collections import defaultdict
from itertools import product

import numpy as np

from tomotactile_ros.bench.program import Table, options
from tomotactile_ros.msg import ContactArray, VoltageFrame
from tomotactile_ros.nodes.conversions import stamp_of
from tomotactile_ros.scenes.scene import Scene, load_scene

sys.path.insert(0, os.path.dirname(__file__))  # scripts/setup keeps Python from doing so

from nodes import Nodes, arguments

SYSTEMS = {"one": ["tactile"], "two": ["driver", "reconstruction"]}
NEAR = 0.02  # m
FIRM = 0.25  # N


class Audit:
    """Pairs contacts with touches."""

    def __init__(self, scene: Scene):
        self.scene, self.messages, self.withheld, self.nothing, self.missed = scene, 0, 0, 0, 0
        self.ids: dict[tuple[int, int], list[int]] = defaultdict(list)
        self.times: list[float] = []
        self._touches: dict[int, int] = defaultdict(int)  # how often each of the scene has begun
        self._there: set[int] = set()
        self._seen: dict[int, float] = {}  # when each had a contact last, s

    def take(self, message: ContactArray, now: float) -> None:
        """Take in contacts that hold for `now`, s in the scene."""
        self.messages += 1
        present = {i: c for i, each in enumerate(self.scene.contacts) if (c := each.at(now))}
        for i in present.keys() - self._there:
            self._touches[i] += 1
        self._there = set(present)
        if message.state != ContactArray.VALID:
            self.withheld += 1
            return
        self.times.append(now)
        seen = set()
        for contact in message.contacts:
            here = np.array([contact.position.x, contact.position.y])
            apart = {i: np.hypot(*(here - c.centroid)) for i, c in present.items()}
            nearest = min(apart, key=apart.__getitem__, default=None)
            if nearest is None or apart[nearest] > NEAR:
                self.nothing += 1
                continue
            seen.add(nearest)
            ids = self.ids[nearest, self._touches[nearest]]
            # 0: a frame was cut before contacts were told apart
            if contact.id and contact.id not in ids:
                ids.append(contact.id)
                if len(ids) > 1:
                    self._tell(nearest, ids, now)
            self._seen[nearest] = now
        firm = {i for i, c in present.items() if (c.total_force or 0.0) >= FIRM}
        self.missed += len(firm - seen)

    def _tell(self, touch: int, ids: list[int], now: float) -> None:
        """Print how firmly what has another id since `now`, s, touched since it was told last."""
        since = self._seen[touch]
        felt = [self.scene.contacts[touch].at(t) for t in np.linspace(since, now, 100)]
        least = min((each.total_force or 0.0) if each else 0.0 for each in felt)
        changed = f"{ids[-2]} -> {ids[-1]}"
        print(f"# {changed}: {since:.3f} to {now:.3f} s, {least:.3f} N at least", flush=True)

    def row(self) -> list[str]:
        """What became of it."""
        changed = sum(len(ids) > 1 for ids in self.ids.values())
        counts = len(self.ids), changed, self.messages, self.withheld, self.missed, self.nothing
        return [*map(str, counts), f"{max(np.diff(self.times), default=np.nan):.2f}"]


def measure(scene: str, profile: str, system: str, asked: Namespace) -> Audit:
    """Run the nodes and listen."""
    given = {"layout": asked.layout, "delivery": asked.delivery}
    words = arguments(given | {"scene": scene, "profile": profile})
    audit, begun = Audit(load_scene(scene)), []

    def on_frame(message: VoltageFrame) -> None:
        lasts = message.row_period * len(message.grounded)
        begun.append(stamp_of(message.header) - message.sequence * lasts)

    def on_contacts(message: ContactArray) -> None:
        if begun:
            audit.take(message, stamp_of(message.header) - begun[0])

    with Nodes([(program, *words) for program in SYSTEMS[system]]) as nodes:
        frames = nodes.node.create_subscription(VoltageFrame, "voltage_frame", on_frame, 10)
        nodes.node.create_subscription(ContactArray, "contacts", on_contacts, 200)
        nodes.spin(lambda: bool(begun))
        nodes.node.destroy_subscription(frames)
        nodes.spin(lambda: audit.messages > 0)
        nodes.spin_for(60 * asked.minutes)
    return audit


def main() -> None:
    """Measure every combination and print a table."""
    asked = options(
        __doc__,
        scene=["default", "slide", "tap"],
        profile=["fast", "balanced", "accurate"],
        system=(list(SYSTEMS), None, SYSTEMS),
        delivery=("rows", None, ("frames", "rows")),
        layout="equal-8x8",
        minutes=(10.0, "of each"),
    )
    table = Table(
        *("scene", "profile", "processes", "touches", "changed", "messages", "withheld"),
        *("missed", "nothing", "gap, s"),
    )
    for each in product(asked.scene, asked.profile, asked.system):
        table.add(*each, *measure(*each, asked).row())


if __name__ == "__main__":
    main()
