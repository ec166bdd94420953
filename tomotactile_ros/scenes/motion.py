"""How a contact moves: straight on, or along way points, round and round if it is a loop.

A contact that slides and one that rolls move alike: what travels is the area of contact, as fast as
the finger that slides, or as the axis of the ball or cylinder that rolls without slipping. The area
keeps its direction.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

FASTEST = 1e6  # m/s


@dataclass(frozen=True, eq=False)
class Motion:
    """Shifts (2,), m, of a contact against where it begins.

    Parameters
    ----------
    corners : (C, 2) shifts at the way points, m, the first being 0; two for a straight motion.
    speed : m/s; 0: at rest.
    loop : back to the first corner from the last, and so on.
    endless : straight on beyond the last corner, else the contact rests there.
    """

    corners: np.ndarray
    speed: float
    loop: bool = False
    endless: bool = False
    _at: np.ndarray = field(init=False, repr=False)  # (C,) way to each corner, m

    def __post_init__(self):
        corners = self.corners
        if self.loop:
            corners = np.concatenate([corners, corners[:1]])
        ways = np.linalg.norm(np.diff(corners, axis=0), axis=1)
        corners, ways = corners[np.append(True, ways > 0)], ways[ways > 0]
        object.__setattr__(self, "corners", corners)
        object.__setattr__(self, "_at", np.concatenate([[0.0], np.cumsum(ways)]))

    def shift(self, age: ArrayLike) -> np.ndarray:
        """(..., 2) ``age`` (...) s after the beginning."""
        way = self.speed * np.asarray(age, float)
        if not self.endless:
            way = way % self._at[-1] if self.loop else np.minimum(way, self._at[-1])
        return self._at_way(way)

    def legs(self, lasts: float, longest: float) -> list[tuple[np.ndarray, np.ndarray]]:
        """Straight parts of the way while the contact lasts (s): where each begins, the way on.

        An endless way is cut at ``longest`` (m).
        """
        way = self.speed * lasts
        ends = [0.0, min(way, longest)] if self.endless else np.minimum(self._at, way)
        places = self._at_way(np.array(ends))
        return list(zip(places[:-1], np.diff(places, axis=0)))

    def steps(self, step: float, lasts: float, longest: float) -> np.ndarray:
        """(S, 2) shifts every ``step`` m of the way that is made while the contact lasts (s).

        Of an endless way ``longest`` m at most, of a loop once round.
        """
        way = min(self.speed * lasts, longest if self.endless else self._at[-1])
        return self._at_way(np.arange(0.0, way, step))

    def _at_way(self, way):
        """(..., 2) shifts after ``way`` (...) metres, at most once round."""
        if self.endless:
            return np.multiply.outer(way / self._at[-1], self.corners[-1])
        return np.stack([np.interp(way, self._at, self.corners[:, i]) for i in range(2)], axis=-1)


def straight(velocity: np.ndarray) -> Motion | None:
    """Straight on, for ever, with ``velocity`` (2,) m/s; None for a contact at rest."""
    speed = float(np.linalg.norm(velocity))
    if np.abs(velocity).max() > FASTEST:
        raise InputError(f"velocity: {velocity.tolist()} is faster than {FASTEST:g} m/s")
    if speed == 0:
        return None
    return Motion(np.stack([np.zeros(2), velocity / speed]), speed, endless=True)


def along_path(center: np.ndarray, path: object, speed: float | None, loop: bool) -> Motion:
    """From ``center`` (2,) to the way points ``path`` (W, 2), m, with ``speed`` m/s."""
    if speed is None:
        raise InputError("speed: is missing, a path needs it")
    speed = checks.positive(speed, "speed", "speed in m/s", most=FASTEST)
    points = np.concatenate([[center], checks.points(path, "path")])
    if not np.linalg.norm(np.diff(points, axis=0), axis=1).max() >= checks.SHORTEST:
        raise InputError("path: leads nowhere, all its points are where the contact begins")
    return Motion(points - points[0], speed, loop)
