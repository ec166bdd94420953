"""Where contacts meet a sheet in many states at once: `contact_points` for rows in time."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.layout import Layout
from tomotactile_ros.sheet.contacts import SAME
from tomotactile_ros.sheet.green import FAR, softened
from tomotactile_ros.sheet.metric import Metric

_OF_CONTACTS = "parts", "rigid"
_RIGID = 1e-12  # parts of the sheet: rounding of points that move as a whole
_MANY = 16  # electrodes near a contact's way, from which on a search tree is faster


@dataclass(frozen=True, eq=False)
class Merged:
    """Points (T, n, 2) of T states, all of them there in each state, used or not.

    radii, resistance (T, n), m and ohm; owner (T, n) electrode that a point feeds, -1 for none;
    nearest electrode (T, n); active (T, n), which points stand for themselves and those merged with
    them; leads (T, n), the point that stands for each, -1 outside, and n + the electrode for those
    that feed one; parts, slices of the points of each contact; rigid, whether it moves as a whole.
    """

    points: np.ndarray
    radii: np.ndarray
    resistance: np.ndarray
    owner: np.ndarray
    nearest: np.ndarray
    active: np.ndarray
    leads: np.ndarray
    parts: tuple[slice, ...]
    rigid: tuple[bool, ...]

    def states(self, some: slice) -> Merged:
        """The same of some states only."""
        arrays = {key: value[some] for key, value in vars(self).items() if key not in _OF_CONTACTS}
        return replace(self, **arrays)

    def log_distance(self, metric: Metric) -> np.ndarray:
        """(T, n, n) true ln |x_i - x_j|, once for each contact that only moves as a whole."""
        seen = metric.at(self.points), metric.mean * self.radii
        states, count = self.owner.shape
        out = np.empty((states, count, count))
        for i, (part, rigid) in enumerate(zip(self.parts, self.rigid)):
            some = slice(0, 1) if rigid else slice(None)
            out[:, part, part] = _log(*seen, part, part, some)
            for other in self.parts[:i]:
                block = _log(*seen, part, other, slice(None))
                out[:, part, other] = block
                out[:, other, part] = block.transpose(0, 2, 1)
        return out


def _log(points, radii, part, other, states):
    first, second = points[states, part], points[states, other]
    squared = (first[:, :, None, 0] - second[:, None, :, 0]) ** 2
    squared += (first[:, :, None, 1] - second[:, None, :, 1]) ** 2
    mutual = (radii[states, part][:, :, None] ** 2 + radii[states, other][:, None, :] ** 2) / 2
    if squared.min() < FAR * mutual.max():
        squared = softened(squared, mutual)
    np.log(squared, out=squared)
    squared *= 0.5
    return squared


def merge(layout: Layout, touching: Sequence) -> Merged:
    """Merge the patches of states that have the same number of patches each.

    Parameters
    ----------
    touching : for each state what `contact_points` takes; patches are left out, feed electrodes and
        conduct side by side as there
    """
    parts, columns = [], []
    for contact in zip(*touching):
        points, areas, radii = (
            np.array(each) for each in zip(*(patches for patches, _ in contact))
        )
        conductance = np.array([each for _, each in contact], float).reshape(len(contact), -1)
        start = parts[-1].stop if parts else 0
        parts.append(slice(start, start + points.shape[1]))
        with np.errstate(invalid="ignore"):
            flow = np.nan_to_num(areas * conductance, nan=0.0, posinf=np.inf)
        columns.append((points, radii, flow, *_nearest(layout, points)))
    points, radii, flow, apart, nearest = (np.concatenate(each, axis=1) for each in zip(*columns))
    size = max(layout.outline.size)
    inside = layout.outline.contains(points.reshape(-1, 2), 1e-9 * size).reshape(apart.shape)
    owner = np.where(inside & (apart < layout.radius + radii), nearest, -1)
    rigid = [_is_rigid(points[:, part], radii[:, part], size) for part in parts]
    first = _leaders(points, radii, inside, owner, parts, rigid)
    states, count = first.shape
    place = (count * np.arange(states)[:, None] + first).ravel()
    total = np.bincount(place, np.where(inside, flow, 0.0).ravel(), first.size).reshape(first.shape)
    with np.errstate(divide="ignore", over="ignore"):
        resistance = 1 / total
    active = inside & (first == np.arange(count)) & np.isfinite(resistance)
    leads = np.where(owner >= 0, count + owner, np.where(inside, first, -1))
    return Merged(
        points, radii, resistance, owner, nearest, active, leads, tuple(parts), tuple(rigid)
    )


def _nearest(layout, points):
    """Distance and number (T, n) of the electrode nearest to each of (T, n, 2) points."""
    flat = points.reshape(-1, 2)
    low, high = flat.min(axis=0), flat.max(axis=0)
    to_middle = np.linalg.norm(layout.positions - (low + high) / 2, axis=1)
    reach = to_middle.min() + 1.001 * np.linalg.norm(high - low)
    few = np.flatnonzero(to_middle <= reach)
    if len(few) > _MANY:
        apart, nearest = layout.nearest(flat)
    else:
        x, y = (flat[:, None] - layout.positions[few]).transpose(2, 0, 1)
        squared = x * x + y * y
        chosen = squared.argmin(axis=1)
        apart, nearest = np.sqrt(squared[np.arange(len(flat)), chosen]), few[chosen]
    return apart.reshape(points.shape[:2]), nearest.reshape(points.shape[:2])


def _is_rigid(points, radii, size):
    shape = points - points[:, :1]
    return bool(np.abs(shape - shape[0]).max() <= _RIGID * size and (radii == radii[0]).all())


def _leaders(points, radii, inside, owner, parts, rigid):
    """(T, n) point that stands for each: the first on its electrode, or the first so close."""
    states, count = owner.shape
    first = np.broadcast_to(np.arange(count), owner.shape).copy()
    state, point = np.nonzero(owner >= 0)
    leader = np.full((states, owner.max(initial=-1) + 1), count)
    np.minimum.at(leader, (state, owner[state, point]), point)
    first[state, point] = leader[state, owner[state, point]]
    off = inside & (owner < 0)
    close = [
        _close(points, radii, part, other, rigid[i] and part == other)
        for i, part in enumerate(parts)
        for other in parts[i:]
    ]
    pairs = {pair: where for found in close for pair, where in found.items()}
    for one, other in sorted(pairs):
        both = off[:, one] & off[:, other] & pairs[one, other]
        first[both, other] = first[both, one]
    return first


def _close(points, radii, part, other, rigid):
    """Pairs of points of two contacts that are one, with the states (T,) in which they are."""
    some = slice(0, 1) if rigid else slice(None)
    first, second = points[some, part], points[some, other]
    reach = SAME * min(radii[:, part].max(), radii[:, other].max())
    gap = np.maximum(first.min(axis=1) - second.max(axis=1), second.min(axis=1) - first.max(axis=1))
    if gap.max(axis=1).min() > reach:
        return {}
    x, y = (first[:, :, None] - second[:, None]).transpose(3, 0, 1, 2)
    limit = SAME * np.minimum(radii[some, part][:, :, None], radii[some, other][:, None])
    near = np.hypot(x, y) < limit
    if part == other:
        near &= np.triu(np.ones(near.shape[1:], bool), 1)
    found = np.argwhere(near.any(axis=0))
    return {(part.start + i, other.start + j): near[:, i, j] for i, j in found.tolist()}
