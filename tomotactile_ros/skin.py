"""Several sensors as one skin: what each felt last, in one frame; silent sensors are named.

Times are stamps where they belong to data, and times of arrival (s, of a clock that never goes back)
where it is asked who still sends.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tomotactile_ros.spatial import Pose
from tomotactile_ros.support.yamlio import Reader

FORMAT = "tomotactile-poses/1"


@dataclass
class Member:
    """One sensor of the skin.

    Attributes
    ----------
    arrival : of its last contacts, s; None before the first.
    complaint : why its contacts are not known; empty where they are.
    contacts : in the skin's frame, of whatever kind.
    complete : whether all was tried to find them.
    alternative : contacts that are nearly as likely; None: there are none.
    force, torque : (3,) of these contacts, N and N m, in the skin's frame.
    """

    arrival: float | None = None
    complaint: str = ""
    contacts: list = field(default_factory=list)
    complete: bool = True
    alternative: list | None = None
    force: np.ndarray = field(default_factory=lambda: np.full(3, np.nan))
    torque: np.ndarray = field(default_factory=lambda: np.full(3, np.nan))

    def problem(self, now: float, timeout: float) -> str:
        """Why its contacts are not known now; empty where they are."""
        if self.arrival is None:
            return self.complaint or "no contacts yet"
        if self.is_silent(now, timeout):
            return f"no contacts for {now - self.arrival:.1f} s"
        return self.complaint

    def is_silent(self, now: float, timeout: float) -> bool:
        """Whether it sent contacts, and does not any more."""
        return self.arrival is not None and now - self.arrival > timeout


class Skin:
    """The members of a skin, by name.

    Parameters
    ----------
    names : of the sensors, in an order that stays.
    timeout : s without contacts after which a sensor is silent.
    """

    def __init__(self, names: Sequence[str], timeout: float):
        self.members = {name: Member() for name in names}
        self.timeout = timeout

    def problems(self, now: float) -> dict[str, str]:
        """Why contacts are not known, for each sensor of which they are not."""
        found = {name: m.problem(now, self.timeout) for name, m in self.members.items()}
        return {name: problem for name, problem in found.items() if problem}

    def kind(self, name: str, now: float) -> str:
        """What kind of problem a sensor has, if it has any: stays while only a figure in its text
        changes."""
        member = self.members[name]
        return "silent" if member.is_silent(now, self.timeout) else member.complaint

    def contacts(self, now: float, others: bool = False) -> list[tuple[int, Any]]:
        """(number of the sensor, contact) of all sensors that are known, sensor by sensor; `others` : of
        those where other contacts are nearly as likely, these."""
        problems = self.problems(now)
        return [
            (number, contact)
            for number, (name, member) in enumerate(self.members.items())
            if name not in problems
            for contact in (
                member.alternative if others and member.alternative is not None else member.contacts
            )
        ]

    def wrench(self, now: float) -> tuple[np.ndarray, np.ndarray]:
        """Sum of all forces (3,), N, and torques (3,), N m; NaN unless all sensors are known."""
        if self.problems(now):
            return np.full(3, np.nan), np.full(3, np.nan)
        members = self.members.values()
        forces, torques = ([getattr(m, part) for m in members] for part in ("force", "torque"))
        return np.sum(forces, axis=0), np.sum(torques, axis=0)


def load_poses(path: Path, frame_id: str) -> Mapping[str, Pose]:
    """Where frames are in `frame_id`, from a file; frame -> pose. InputError for anything else.

    Angles are roll, pitch and yaw about fixed axes, rad, as in URDF.
    """
    reader = Reader.open(path, FORMAT)
    reader.only("format", "frame_id", "poses")
    if reader.text("frame_id") != frame_id:
        reader.refuse("frame_id", reader.text("frame_id"), f"is not that of the skin, {frame_id}")
    poses = reader.section("poses")
    found = {}
    for name in poses.mapping:
        entry = poses.section(name)
        entry.only("xyz", "rpy")
        rotation = Rotation.from_euler("xyz", entry.numbers("rpy", 3, (0.0, 0.0, 0.0)))
        found[name] = Pose(np.array(entry.numbers("xyz", 3)), rotation)
    return found
