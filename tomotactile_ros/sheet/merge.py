"""Where contacts meet a sheet in many states at once: `contact_points` for rows in time.

A moving contact moves as a whole: its patches keep their relations to each other in all states, and
only near an electrode, the rim or another contact do they have to be examined.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.sheet.contact_points import SAME, Patches, beside_electrodes, flow
from tomotactile_ros.sheet.green import FAR, softened
from tomotactile_ros.sheet.metric import Metric


@dataclass(frozen=True, eq=False)
class Track:
    """One contact in T states.

    patches: (Q, 2) points about its centre, m, (Q,) areas, m², (Q,) radii, m; centers (T, 2), m;
    conductance (T, 1) or (T, Q), S/m², infinite for a bare conductor; there (T,), whether it is.
    """

    patches: Patches
    centers: np.ndarray
    conductance: np.ndarray
    there: np.ndarray

    def states(self, some: np.ndarray) -> Track:
        """The same in some states only."""
        return Track(self.patches, self.centers[some], self.conductance[some], self.there[some])

    def contact(self, state: int) -> tuple[Patches, np.ndarray]:
        """What `contact_points` takes."""
        points, areas, radii = self.patches
        conductance = np.broadcast_to(self.conductance[state], len(areas))
        return (self.centers[state] + points, areas, radii), conductance


@dataclass(frozen=True, eq=False)
class Merged:
    """Points (T, n, 2) of T states, all of them there in each state, used or not.

    radii (n,), m; resistance (T, n), ohm; owner (T, n) electrode that a point feeds, -1 for none;
    nearest electrode (T, n), -1 where none is near; active (T, n), which points stand for
    themselves and those merged with them; leads (T, n), the point that stands for each, -1 outside,
    and n + the electrode for those that feed one; way (T,), m that the contact which moves most has
    gone; parts, slices of the points of each contact, and of those that feed electrodes; rigid, which of
    these keep their relations to each other in all states.
    """

    points: np.ndarray
    radii: np.ndarray
    resistance: np.ndarray
    owner: np.ndarray
    nearest: np.ndarray
    active: np.ndarray
    leads: np.ndarray
    way: np.ndarray
    parts: tuple[slice, ...]
    rigid: tuple[bool, ...]

    def states(self, some: slice) -> Merged:
        """The same of some states only."""
        same = "parts", "rigid", "radii"
        of_states = (each.name for each in fields(self) if each.name not in same)
        return replace(self, **{key: getattr(self, key)[some] for key in of_states})

    def take_log(self, out: np.ndarray, metric: Metric, scale: np.ndarray) -> None:
        """Take `scale` (T, n, n) or () times the true ln |x_i - x_j| from `out` (T, n, n), i <= j.

        That is all that `out` is right in: blocks of contacts above the diagonal, and on it.
        """
        seen, radii = metric.at(self.points), metric.mean * self.radii
        for i, (part, rigid) in enumerate(zip(self.parts, self.rigid)):
            for other in self.parts[i:]:
                some = slice(0, 1) if part == other and rigid else slice(None)
                log = _log(seen[some, part], seen[some, other], radii[part], radii[other])
                log *= 0.5
                if scale.ndim:
                    log = log * scale[:, part, other]
                else:
                    log *= scale
                out[:, part, other] -= log


def _log(
    first: np.ndarray, second: np.ndarray, radii: np.ndarray, others: np.ndarray
) -> np.ndarray:
    """(T, q, r) 2 ln |x_i - x_j| between points (T, q, 2) and (T, r, 2) of radii (q,), (r,).

    |x - y|^2 as a product of (x, |x|^2, 1) and (-2 y, 1, |y|^2).
    """
    origin = first[:, :1]
    first, second = first - origin, second - origin
    left, right = np.ones((*first.shape[:2], 4)), np.ones((*second.shape[:2], 4))
    left[..., :2], left[..., 2] = first, _squares(first)
    right[..., :2], right[..., 3] = -2 * second, _squares(second)
    squared = left @ right.transpose(0, 2, 1)
    mutual = np.add.outer(radii**2, others**2) / 2
    if squared.min() < FAR * mutual.max():
        squared = softened(np.maximum(squared, 0.0), mutual)
    return np.log(squared, out=squared)


def _squares(vectors: np.ndarray) -> np.ndarray:
    return vectors[..., 0] ** 2 + vectors[..., 1] ** 2


def merge(layout: Layout, tracks: Sequence[Track], reach: float) -> Merged:
    """Merge the patches of contacts that are there in all of their T states.

    Patches are left out, feed electrodes and conduct side by side as in `contact_points`. An
    electrode within `reach` (m) of a patch, or of the patch's rim if that is farther, is near it.
    """
    columns, parts, rigid, start = [], [], [], 0
    onto = np.zeros((len(tracks[0].centers), layout.electrodes))
    for track in tracks:
        offsets, areas, radii = track.patches
        parts.append(slice(start, start + len(radii)))
        start = parts[-1].stop
        points = track.centers[:, None] + offsets
        far = float(np.linalg.norm(offsets, axis=1).max())
        inside = _inside(layout.outline, points, track.centers, far) & (track.conductance > 0)
        near = max(reach, layout.radius + 2 * max(radii.max(), np.sqrt(areas.max() / np.pi)))
        apart, nearest = _nearest(layout, points, track.centers, far, near)
        conductance = np.broadcast_to(track.conductance, apart.shape)
        beside, places = beside_electrodes(
            layout, points, areas, radii, conductance, apart, nearest
        )
        rigid.append(places is points)
        state, point = np.nonzero(inside & (beside < 1))
        fed = flow(areas * (1 - beside), conductance)[state, point]
        np.add.at(onto, (state, nearest[state, point]), fed)
        of_sheet = np.where(inside, flow(areas * beside, conductance), 0.0)
        columns.append((points, places, of_sheet, inside & (beside > 0), nearest))
    points, places, total, beside, nearest = (
        each[0] if len(columns) == 1 else np.concatenate(each, axis=1) for each in zip(*columns)
    )
    radii = np.concatenate([track.patches[2] for track in tracks])
    first = _leaders(tracks, parts, points, radii, beside)
    state, point = np.nonzero(first != np.arange(start))
    np.add.at(total, (state, first[state, point]), total[state, point])
    leads = np.where(beside, first, -1)
    active = beside & (first == np.arange(start))
    owner = np.full(leads.shape, -1)
    met = np.flatnonzero(onto.any(axis=0))
    if len(met):
        feeds = onto[:, met] > 0
        parts.append(slice(start, start + len(met)))
        rigid.append(True)
        places = _beside(places, np.broadcast_to(layout.positions[met], (len(feeds), len(met), 2)))
        radii = np.append(radii, np.full(len(met), layout.radius))
        total, active = _beside(total, onto[:, met]), _beside(active, feeds)
        owner = _beside(owner, np.where(feeds, met, -1))
        leads = _beside(leads, np.where(feeds, start + met, -1))
        nearest = _beside(nearest, np.broadcast_to(met, feeds.shape))
    with np.errstate(divide="ignore", over="ignore"):
        resistance = 1 / total
    active &= np.isfinite(resistance)
    steps = [_distance(track.centers[1:], track.centers[:-1]) for track in tracks]
    way = np.append(0.0, np.cumsum(np.max(steps, axis=0)))
    found = places, radii, resistance, owner, nearest, active, leads, way
    return Merged(*found, tuple(parts), tuple(rigid))


def _beside(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    return np.concatenate([first, second], axis=1)


def _inside(outline: Outline, points: np.ndarray, centers: np.ndarray, far: float) -> np.ndarray:
    """(T, q) which points are on the sheet; none is farther than `far` (m) from its centre."""
    inside = np.ones(points.shape[:2], bool)
    reach = far + _distance(centers, centers[0]).max()
    if not outline.contains(centers[:1])[0] or outline.rim_distance(centers[:1])[0] <= reach:
        tolerance = 1e-9 * max(outline.size)
        rim = np.flatnonzero(~outline.contains(centers) | (outline.rim_distance(centers) <= far))
        near = points[rim].reshape(-1, 2)
        inside[rim] = outline.contains(near, tolerance).reshape(-1, points.shape[1])
    return inside


def _nearest(
    layout: Layout, points: np.ndarray, centers: np.ndarray, far: float, reach: float
) -> tuple[np.ndarray, np.ndarray]:
    """(T, q) distance, m, and number of the electrode nearest to each point, up to `reach` (m);
    else infinite and -1."""
    apart, nearest = np.full(points.shape[:2], np.inf), np.full(points.shape[:2], -1)
    away = _distance(centers[:, None], layout.positions)
    state, electrode = np.nonzero(away < far + reach)
    rank = np.arange(len(state)) - np.searchsorted(state, state)
    for turn in range(rank.max(initial=-1) + 1):
        some, number = state[rank == turn], electrode[rank == turn, None]
        distance = _distance(points[some], layout.positions[number])
        closer = distance < np.minimum(apart[some], reach)
        apart[some] = np.where(closer, distance, apart[some])
        nearest[some] = np.where(closer, number, nearest[some])
    return apart, nearest


def _distance(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    """(...) m between points (..., 2)."""
    x, y = first[..., 0] - second[..., 0], first[..., 1] - second[..., 1]
    return np.sqrt(x * x + y * y)


def _leaders(
    tracks: Sequence[Track],
    parts: list[slice],
    points: np.ndarray,
    radii: np.ndarray,
    off: np.ndarray,
) -> np.ndarray:
    """(T, n) point that stands for each: the first so close, of those that are `off` (T, n) electrodes."""
    first = np.broadcast_to(np.arange(points.shape[1]), off.shape).copy()
    pairs: dict[tuple[int, int], np.ndarray] = {}
    for i, part in enumerate(parts):
        for other, track in zip(parts[i:], tracks[i:]):
            pairs |= _close(points, radii, part, other, tracks[i], track)
    for one, same in sorted(pairs):
        both = off[:, one] & off[:, same] & pairs[one, same]
        first[both, same] = first[both, one]
    return first


def _close(
    points: np.ndarray, radii: np.ndarray, part: slice, other: slice, track: Track, along: Track
) -> dict[tuple[int, int], np.ndarray]:
    """Pairs of points of two contacts that are one, with the states (T,) in which they are."""
    limit = SAME * np.minimum.outer(radii[part], radii[other])
    if part == other:
        offsets = track.patches[0]
        near = _distance(offsets[:, None], offsets) < limit
        near = np.triu(near, 1)[None]
    else:
        far = sum(np.linalg.norm(each.patches[0], axis=1).max() for each in (track, along))
        away = _distance(track.centers, along.centers)
        some = np.flatnonzero(away <= far + limit.max())
        if not len(some):
            return {}
        near = np.zeros((len(away), *limit.shape), bool)
        near[some] = _distance(points[some, part, None], points[some, None, other]) < limit
    found = np.argwhere(near.any(axis=0))
    return {(part.start + i, other.start + j): near[:, i, j] for i, j in found.tolist()}
