"""Potentials of the electrodes at any place with their slopes, read off a lattice.

The Green function of the sheet between an electrode and a place falls with the logarithm of their
distance and is bent by the dipoles of the other electrodes (`core/include/tomotactile/induced.hpp`). Both
are taken off before and added again after; what is left changes slowly and is interpolated by cubic
convolution (Keys 1981), on an electrode itself by the values on a ring about it.
"""

from __future__ import annotations

from copy import copy
from functools import cached_property
from typing import Any

import numpy as np

from tomotactile_ros.core import compiled
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.sheet import Sheet
from tomotactile_ros.sheet.green import FAR, softened

_PER_PITCH = 10  # points of the lattice along one spacing
_POINTS = 41, 131  # along the longer side, at least and at most
_BEYOND = 1.6  # radii from the centre of an electrode: nearer, its rim is not a few charges
_TINY = 1e-15  # m²: a patch does not push itself
# radii: rings from which potentials are continued onto an electrode; points of one, and harmonics that they tell apart
_AROUND, _RING, _HARMONICS = 1.15, 12, 4
_BLOCK = 512  # points at a time, for memory


class Lattice:
    """Values on a rectangular lattice that covers `size` (2,), m, one step wider on all sides.

    points : (K, 2) in m
    """

    def __init__(self, size: np.ndarray, along: int):
        counts = np.maximum(2, np.ceil((along - 1) * size / size.max()).astype(int) + 1)
        self.step = size / (counts - 1)
        self._start = -size / 2 - self.step
        self._counts = counts + 2
        self._offsets = np.add.outer(np.arange(4) * self._counts[1], np.arange(4)).ravel()
        axes = [s + h * np.arange(n) for s, h, n in zip(self._start, self.step, self._counts)]
        self.points = np.stack(np.meshgrid(*axes, indexing="ij"), -1).reshape(-1, 2)

    @cached_property
    def core(self) -> Any:
        return compiled.Lattice(self._start, self.step, self._counts)

    def stencil(self, places: np.ndarray) -> Stencil:
        """At `places` (Q, 2), m."""
        at = (places - self._start) / self.step
        low = np.clip(np.floor(at).astype(int), 1, self._counts - 3)
        part = np.clip(at - low, 0.0, 1.0)
        first = (low[:, 0] - 1) * self._counts[1] + low[:, 1] - 1
        return Stencil(first[:, None] + self._offsets, part)

    @classmethod
    def fine(cls, layout: Layout, pitch: float) -> Lattice:
        """That of potentials, with electrodes `pitch`, m, apart."""
        size = np.array(layout.outline.size, float)
        return cls(size, int(np.clip(np.ceil(size.max() / pitch * _PER_PITCH), *_POINTS)))


class Stencil:
    """Points (Q, 16) of a lattice around each of Q places, at the positions `part` (Q, 2) between the
    middle ones, and their weights (Q, 16)."""

    def __init__(self, points: np.ndarray, part: np.ndarray):
        self.points = points
        x, y = (part[..., None] ** np.arange(4) @ _KEYS).transpose(
            1, 0, 2
        )  # four neighbours each way
        self.weights = (x[:, :, None] * y[:, None]).reshape(-1, 16)


class Around:
    """Points of a lattice around `places` (Q, 2): nodes (m,), weights (Q, m)."""

    def __init__(self, lattice: Lattice, places: np.ndarray):
        stencil = lattice.stencil(places)
        used = np.zeros(len(lattice.points), bool)
        used[stencil.points] = True
        self.nodes = np.flatnonzero(used)
        at = np.empty(len(used), int)
        at[self.nodes] = np.arange(len(self.nodes))
        self.weights = np.zeros((len(places), len(self.nodes)))
        self.weights[np.arange(len(places))[:, None], at[stencil.points]] = stencil.weights


_KEYS = np.array([[0, 2, 0, 0], [-1, 0, 1, 0], [2, -5, 4, -1], [-1, 3, -3, 1]]) / 2


def mirrored(points: np.ndarray, half: np.ndarray) -> np.ndarray:
    """`points` (K, 2) beyond the rim of a rectangle of half sides `half`, mirrored in it as
    potentials are."""
    beyond = np.maximum(np.abs(points) - half, 0.0)
    return np.sign(points) * (np.minimum(np.abs(points), half) - beyond)


class Sensed:
    """What the electrodes of a sheet sense of tiny discs at `points` (K, 2), m: known once for both
    tables that are made of it.

    Attributes
    ----------
    between (K, E) G between electrodes and points, ohm; own (K,) that of the points with themselves,
        all electrodes floating
    tiny : radius of the discs, m
    """

    def __init__(self, sheet: Sheet, points: np.ndarray):
        self._sheet, self.points = sheet, points
        self.tiny = 1e-3 * sheet.layout.radius
        self.between = np.empty((len(points), sheet.layout.electrodes))
        self.own = np.empty(len(points))
        self._look(np.arange(len(points)))

    def moved_to(self, places: np.ndarray) -> Sensed:
        """What the same sheet's electrodes sense at other `places` (P, 2), m."""
        return Sensed(self._sheet, places)

    def moved(self, places: np.ndarray) -> Sensed:
        """The same at `places` (K, 2), m, most of which are the points still."""
        other = copy(self)
        other.points, other.between, other.own = places, self.between.copy(), self.own.copy()
        other._look(np.flatnonzero((places != self.points).any(axis=1)))
        return other

    def _look(self, which: np.ndarray) -> None:
        for start in range(0, len(which), _BLOCK):
            part = which[start : start + _BLOCK]
            transfer = self._sheet.transfer(self.points[part], np.full(len(part), self.tiny))
            self.between[part] = transfer.electrode_point.T
            self.own[part] = transfer.point_self


def induced_charges(layout: Layout) -> Any:
    """Those of the electrodes of `layout`, which rims of a rectangle mirror."""
    size = layout.outline.size if layout.outline.is_uniform_rectangle else (0.0, 0.0)
    return compiled.InducedCharges(
        layout.positions, layout.radius, float(layout.sheet_resistance), size
    )


class PotentialTable:
    """G between the electrodes of a layout and any place, ohm; `sensed` at the points of `lattice`, those
    beyond the rim mirrored."""

    def __init__(self, layout: Layout, lattice: Lattice, sensed: Sensed):
        self.lattice, self.induced = lattice, induced_charges(layout)
        self._used = np.arange(layout.electrodes)
        self._centres = layout.positions
        self._radius = layout.radius
        self._scale = float(layout.sheet_resistance) / (2 * np.pi)
        self.rest = sensed.between - self._singular(lattice.points)
        ring = np.exp(2j * np.pi * np.arange(_RING) / _RING)
        ways = _AROUND * layout.radius * np.stack([ring.real, ring.imag], axis=1)
        around = (self._centres[:, None] + ways).reshape(-1, 2)
        half = np.array(layout.outline.size, float) / 2
        on_ring = sensed.moved_to(mirrored(around, half)).between - self._singular(around)
        apart, nearest = layout.nearest(lattice.points)
        on = np.flatnonzero(apart < _AROUND * layout.radius)
        way = (lattice.points[on] - self._centres[nearest[on]]) / (_AROUND * layout.radius)
        powers = ((way[:, 0] + 1j * way[:, 1])[:, None] * ring.conj())[..., None]
        harmonics = powers ** np.arange(1, _HARMONICS + 1)
        weights = (1 + 2 * harmonics.real.sum(axis=-1)) / _RING
        of_ring = on_ring.reshape(len(self._centres), _RING, -1)[nearest[on]]
        self.rest[on] = np.einsum("pr,pre->pe", weights, of_ring)

    def of(self, used: np.ndarray) -> PotentialTable:
        """The same of the electrodes `used` (n,)."""
        if len(used) == len(self._centres):
            return self
        other = copy(self)
        other._centres, other.rest, other._used = self._centres[used], self.rest[:, used], used
        return other

    def _singular(self, places: np.ndarray) -> np.ndarray:
        """(Q, n) the part with the logarithm, of images in the same place too, and that of dipoles, ohm."""
        apart = places[:, None] - self._centres
        squared = np.einsum("qnd,qnd->qn", apart, apart)
        logarithm = -0.5 * self._scale * np.log(np.maximum(squared, self._radius**2))
        dipoles = self.induced.potentials(places)[:, self._used]
        return logarithm * self.induced.counted[self._used] + dipoles

    def __call__(self, places: np.ndarray) -> np.ndarray:
        """(Q, n) potentials at `places` (Q, 2), ohm."""
        stencil = self.lattice.stencil(places)
        smooth = np.matmul(stencil.weights[:, None], self.rest[stencil.points])[:, 0]
        return smooth + self._singular(places)


class MutualTable:
    """G between any two places, ohm, for patches of contacts.

    Taken apart into the logarithm of the distance, that to mirror images beyond a near rim
    included; the charges that it induces on floating electrodes (circle theorem); a part that is
    smooth over the whole sheet and beyond its rims, known on a coarse lattice on both sides; and what
    is left, of rims of other outlines above all, which is known for a patch with itself and taken as
    the mean of two for others of the same contact. What is made of it is compiled (`touches.hpp`).
    """

    def __init__(self, sheet: Sheet, lattice: Lattice, potentials: PotentialTable, sensed: Sensed):
        layout = sheet.layout
        self._outline, self._resistance = layout.outline, float(layout.sheet_resistance)
        size = np.array(layout.outline.size, float)
        self._coarse = lattice
        inside = mirrored(self._coarse.points, size / 2)
        nodes = off_electrodes(inside, layout)
        self.induced = potentials.induced
        tiny = np.full(len(nodes), 1e-3 * layout.radius)
        between = sheet.transfer(nodes, tiny).among(np.arange(len(nodes)))
        if self._outline.is_uniform_rectangle:  # rims mirror potentials, not the parts of them
            beyond = np.abs(self._coarse.points) > (0.5 + 1e-9) * size
            nodes = self._coarse.points + np.where(beyond, -1, 1) * (nodes - inside)
        self.smooth = between - self._logarithm(nodes, tiny) - self.induced.between(nodes)
        places = off_electrodes(sensed.points, layout)
        # elsewhere what the table says of potentials is what is sensed
        self._moved = np.flatnonzero((places != sensed.points).any(axis=1))
        sensed = sensed.moved(places)
        near = places[self._moved]
        self._seen = (1, sensed.between[self._moved]), (-1, potentials(near))
        self._own = sensed.own.copy()
        for start in range(0, len(places), _BLOCK):
            part = slice(start, start + _BLOCK)
            radii = np.full(len(places[part]), sensed.tiny)
            self._own[part] -= self._own_part(places[part], radii)

    def own_rest(self, used: np.ndarray, inverse: np.ndarray) -> np.ndarray:
        """(K,) what else a patch at each point of the fine lattice sees of itself, ohm; `inverse`
        (n + 1, n + 1) of the bordered Green function of the electrodes `used` (n,), all others floating."""
        out = self._own.copy()
        for sign, seen in self._seen:
            fed = np.vstack([seen[:, used].T, np.ones(len(seen))])
            out[self._moved] -= sign * np.einsum("ek,ek->k", fed, inverse @ fed)
        return out

    def _logarithm(
        self, places: np.ndarray, radii: np.ndarray, own_only: bool = False
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """(P, P) the part with logarithms, ohm, images in the rims of a rectangle included; (P,)
        its diagonal only."""
        scale = -self._resistance / (4 * np.pi)
        mutual = radii**2 if own_only else np.add.outer(radii**2, radii**2) / 2
        reach = FAR * mutual.max()
        at = places if own_only else places[:, None]
        along = [self._mirror_ways(at[..., i], places[:, i], i) ** 2 for i in range(2)]
        product = 1.0
        for i, across in enumerate(along[0]):
            for j, up in enumerate(along[1]):
                squared = across + up
                if i == j == 0 or squared.min() < reach:
                    squared = softened(squared, mutual)
                product = product * squared
        return scale * np.log(product)

    def _mirror_ways(self, at: np.ndarray, to: np.ndarray, axis: int) -> np.ndarray:
        """(3 or 1, ...) ways along one axis from `at` to `to` and to its images in both rims, m, as the
        two broadcast; their derivatives by `at` are 1."""
        ways = [at - to]
        if self._outline.is_uniform_rectangle:
            sums, side = at + to, self._outline.size[axis]
            ways += [sums + side, sums - side]
        return np.array(ways)

    def _own_part(self, places: np.ndarray, radii: np.ndarray) -> np.ndarray:
        """(P,) what all that says of a patch with itself but for `own_rest`, ohm."""
        stencil = self._coarse.stencil(places)
        points, weights = stencil.points, stencil.weights
        block = self.smooth[points[:, :, None], points[:, None, :]]
        smooth = np.einsum("pi,pij,pj->p", weights, block, weights)
        smooth += self.induced.own(places)
        return smooth + self._logarithm(places, radii, own_only=True)


def off_electrodes(places: np.ndarray, layout: Layout) -> np.ndarray:
    """`places` (K, 2), those on an electrode moved beyond its rim."""
    distance, nearest = layout.nearest(places)
    centres = layout.positions[nearest]
    beyond = _BEYOND * layout.radius
    inwards = np.where(np.linalg.norm(centres, axis=1)[:, None] > 1e-9, -centres, [1.0, 0.0])
    way = np.where(distance[:, None] > 1e-9, places - centres, inwards)
    way = way / np.maximum(np.linalg.norm(way, axis=1), 1e-12)[:, None]
    return np.where((distance < beyond)[:, None], centres + beyond * way, places)
