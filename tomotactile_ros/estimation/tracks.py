"""Which contact of one frame is which of the next: numbers that stay while a contact lasts.

Contacts go to the nearest of those expected from place and velocity, all together as cheaply as
possible (Kuhn 1955, "The Hungarian method for the assignment problem"). Where frames tell velocities,
what is expected is an even acceleration from one to the other, and nothing is farther off than that
may err and a finger gets while a frame is read; else than it gets meanwhile. One that is elsewhere
than in the frame before, by more than both deviations allow, moves, also where the rows of a frame
alone do not tell it from rest.

Only frames, or rows, without a contact end it, those of a whole scan: nobody lets go and touches the
same place again within one, and what is there again was lost, as where rows were left out. Time for which
nothing is told ends none, however long: no reading says that anything was let go. Nor does what is told
late, of a time before: a frame whose estimate took long, while rows went on.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from threading import Lock
from typing import NamedTuple, Protocol

import numpy as np
from scipy.optimize import linear_sum_assignment
from scipy.special import chdtri

REACH = 0.6  # spacings between where a contact is and where it was expected
# m/s: how much farther, the longer it was not seen; no longer than a frame takes where frames tell
# velocities: two taps 90 mm apart, 0.3 s between the frames looked at, were one contact
_FASTEST = 1.0
_RESTS = 1e-3  # probability of a way as long between two frames of a contact that rests
# spacings: standard deviation of a place, along each axis, where none is stated
_UNSTATED = 0.01
# s: for which a velocity tells where a contact went while nothing was told of it
# (`belief.hpp`); no time without frames or rows ends a contact
_GOES_ON = 1.0
# s: how much earlier than the last one a frame may be, or a row: of a clock that was set back if more
_DISORDER = 0.3
# s: the same of a frame told after rows that went on meanwhile, or of a row after frames
_LATE = 10.0


class Placed(Protocol):
    """What is told apart: a place, m, with its covariance (4,), m², NaN where that is not known, and
    its velocity, m/s, 0 where it seems to rest."""

    @property
    def x(self) -> float: ...

    @property
    def y(self) -> float: ...

    @property
    def position_covariance(self) -> tuple[float, float, float, float]: ...

    @property
    def velocity(self) -> tuple[float, float]: ...


class Followed(NamedTuple):
    """Number and age, s, of a contact, and its velocity (2,), m/s."""

    number: int
    age: float
    velocity: tuple[float, float]


def has_moved(way: np.ndarray, spread: np.ndarray) -> bool:
    """Whether a contact that is elsewhere than before by `way` (2,), m, does not rest; `spread` (2, 2), m²,
    of both places together."""
    return bool(way @ np.linalg.solve(spread, way) > chdtri(len(way), _RESTS))


@dataclass(eq=False)
class _Track:
    number: int
    given: int  # number by whoever follows contacts in between, 0 without
    begun: float
    seen: float
    place: np.ndarray
    covariance: np.ndarray
    velocity: np.ndarray


class Tracks:
    """Numbers and ages of contacts, for any number of threads; numbers begin at 1 and are never given
    twice.

    Parameters
    ----------
    pitch : spacing of the electrodes, m
    """

    def __init__(self, pitch: float):
        self._pitch = pitch
        self._tracks: list[_Track] = []
        self._ended: list[_Track] = []  # less than a scan ago
        self._last = 0  # the highest number that was given
        self._told = {False: -np.inf, True: -np.inf}  # s, the last frame, and the last row
        self._lock = Lock()

    @property
    def lasting(self) -> bool:
        """Whether contacts have not ended."""
        return bool(self._tracks)

    def follow(
        self,
        contacts: Sequence[Placed],
        time: float,
        timed: float = 0.0,
        given: Sequence[tuple[int, float]] | None = None,
        ends: bool = True,
    ) -> list[Followed]:
        """What is known of each of `contacts`, all that were there at `time`, s; `timed` : how long the rows
        of a frame took, s, if they tell velocities, so that 0 is rest at the last of them.

        given : number and age, s, of each by whoever follows them in between (`row_estimator`), None for a
            frame; those with the same number as before are the same
        ends : whether those that are not among them have ended: not where it was too soon to see all

        A clock that jumps back begins anew: all contacts are new ones.
        """
        with self._lock:
            self._begin_if_set_back(time, given is not None)
            return self._follow(contacts, time, timed, given or [(0, 0.0)] * len(contacts), ends)

    def _begin_if_set_back(self, time: float, by_row: bool) -> None:
        """Forget all contacts where the clock was: rows come in the order of their times, and so do frames,
        but a frame may be told long after rows of later times."""
        if self._told[by_row] - time > _DISORDER or self._told[not by_row] - time > _LATE:
            self._tracks, self._ended = [], []
            self._told = dict.fromkeys(self._told, -np.inf)
        self._told[by_row] = max(self._told[by_row], time)

    def _follow(
        self,
        contacts: Sequence[Placed],
        time: float,
        timed: float,
        given: Sequence[tuple[int, float]],
        ends: bool,
    ) -> list[Followed]:
        latest = max((track.seen for track in self._tracks), default=time)
        same = {t.given: t for t in self._tracks if t.given}
        chosen = [same.get(number) for number, _ in given]
        self._match(chosen, self._tracks, contacts, time, timed, _FASTEST)
        self._match(chosen, self._ended, contacts, time, timed, 0.0)
        tracks, found = [], []
        for contact, track, (number, age) in zip(contacts, chosen, given):
            if track is None:
                self._last += 1
                track = self._new(contact, time, age, number)
            elif time >= track.seen:
                self._go_on(track, contact, time, number)
            tracks.append(track)
            x, y = track.velocity.tolist()
            found.append(Followed(track.number, max(time - track.begun, 0.0), (x, y)))
        if time < latest or not ends:
            tracks += [track for track in self._tracks if track not in tracks]
        gone = [track for track in self._tracks + self._ended if track not in tracks]
        self._ended = [track for track in gone if time - track.seen <= timed]
        self._tracks = tracks
        return found

    def _new(self, contact: Placed, time: float, age: float, given: int) -> _Track:
        """Of a contact that has just been told for the first time."""
        place, velocity = np.array([contact.x, contact.y]), np.array(contact.velocity)
        covariance = self._covariance(contact)
        return _Track(self._last, given, time - age, time, place, covariance, velocity)

    def _go_on(self, track: _Track, contact: Placed, time: float, given: int) -> None:
        """Take in where it is now."""
        place, velocity = np.array([contact.x, contact.y]), np.array(contact.velocity)
        covariance = self._covariance(contact)
        if not velocity.any() and time > track.seen:
            way = place - track.place
            if has_moved(way, covariance + track.covariance):
                velocity = way / (time - track.seen)
        track.given, track.place, track.covariance = given, place, covariance
        track.velocity, track.seen = velocity, time

    def begin(self) -> None:
        """Forget the numbers that were `given`: whoever follows contacts in between begins anew."""
        with self._lock:
            for track in self._tracks:
                track.given = 0

    def _covariance(self, contact: Placed) -> np.ndarray:
        """(2, 2) of its place, m²."""
        stated = np.reshape(contact.position_covariance, (2, 2))
        return stated if np.isfinite(stated).all() else np.eye(2) * (_UNSTATED * self._pitch) ** 2

    def _match(
        self,
        chosen: list[_Track | None],
        among: list[_Track],
        contacts: Sequence[Placed],
        time: float,
        timed: float,
        fastest: float,
    ) -> None:
        """Choose those `among` tracks that are not chosen for contacts that have none yet; they get as far as
        `fastest`, m/s, lets them."""
        taken = {t.number for t in chosen if t is not None}
        tracks = [t for t in among if t.number not in taken]
        new = [i for i, t in enumerate(chosen) if t is None]
        if not new or not tracks:
            return
        places = np.array([[contacts[i].x, contacts[i].y] for i in new])
        gone = np.array([time - track.seen for track in tracks])
        goes_on = np.clip(gone, -_GOES_ON, _GOES_ON)
        before = np.array([track.velocity for track in tracks])
        change = np.array([contacts[i].velocity for i in new])[:, None] - before
        ways = goes_on[:, None] * (before + change / 2 if timed else before)
        expected = np.array([track.place for track in tracks]) + ways
        apart = np.hypot(*(places[:, None] - expected).transpose(2, 0, 1))
        gone, lasts = np.abs(gone), np.abs(goes_on)
        # what it did while no row was read is as even as it may be
        way = fastest * (np.minimum(lasts, timed) if timed else lasts)
        if timed:
            way = way + np.hypot(*change.transpose(2, 0, 1)) / 2 * lasts
        # afterwards nobody knows where, but no farther than it would have got
        way = way + np.hypot(*before.T) * (gone - lasts)
        reach = REACH * self._pitch + way
        cost = np.minimum(apart / reach, 1.0)
        for row, column in zip(*linear_sum_assignment(cost)):
            if cost[row, column] < 1:
                chosen[new[row]] = tracks[column]
