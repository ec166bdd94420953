"""Which contact of one frame is which of the next: numbers that stay while a contact lasts.

Contacts go to the nearest of those expected from place and velocity, all together as cheaply as
possible (Kuhn 1955, "The Hungarian method for the assignment problem"), and none farther than a
finger gets while a frame is read.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from scipy.optimize import linear_sum_assignment

REACH = 0.6  # spacings between where a contact is and where it was expected
_FASTEST = 1.0  # m/s: how much farther it may be the longer it was not seen
_LOST = 0.3  # s without a valid frame after which a contact is a new one


class Placed(Protocol):
    """What is told apart: a place, m, and its velocity, m/s."""

    x: float
    y: float
    velocity: tuple[float, float]


@dataclass
class _Track:
    number: int
    begun: float
    seen: float
    place: np.ndarray
    velocity: np.ndarray


class Tracks:
    """Numbers and ages of contacts; numbers begin at 1 and are never given twice.

    Parameters
    ----------
    pitch : spacing of the electrodes, m
    """

    def __init__(self, pitch: float):
        self._pitch = pitch
        self._tracks: list[_Track] = []
        self.last = 0  # the highest number that was given

    def follow(self, contacts: Sequence[Placed], time: float) -> list[tuple[int, float]]:
        """Number and age, s, of each of `contacts` of a valid frame that holds for `time`, s.

        A clock that jumps back begins anew: all contacts are new ones.
        """
        self._tracks = [t for t in self._tracks if 0 <= time - t.seen <= _LOST]
        chosen = self._matched(contacts, time)
        tracks, found = [], []
        for contact, track in zip(contacts, chosen):
            place, velocity = np.array([contact.x, contact.y]), np.array(contact.velocity)
            if track is None:
                self.last += 1
                track = _Track(self.last, time, time, place, velocity)
            track.place, track.velocity, track.seen = place, velocity, time
            tracks.append(track)
            found.append((track.number, time - track.begun))
        self._tracks = tracks
        return found

    def _matched(self, contacts, time) -> list[_Track | None]:
        chosen: list[_Track | None] = [None] * len(contacts)
        if not contacts or not self._tracks:
            return chosen
        places = np.array([[each.x, each.y] for each in contacts])
        lasts = np.array([time - track.seen for track in self._tracks])
        expected = np.array([track.place for track in self._tracks])
        expected += lasts[:, None] * np.array([track.velocity for track in self._tracks])
        apart = np.hypot(*(places[:, None] - expected).transpose(2, 0, 1))
        reach = REACH * self._pitch + _FASTEST * lasts
        cost = np.minimum(apart / reach, 1.0)
        for row, column in zip(*linear_sum_assignment(cost)):
            if cost[row, column] < 1:
                chosen[row] = self._tracks[column]
        return chosen
