"""The uniform rectangle with electrodes of finite radius, without a mesh.

Each electrode is a ring of point charges on its rim. A floating electrode is an equipotential
without net current, so its charges move: to leading order an induced dipole, which shunts the sheet
(64 discs of radius 2.5 mm at 28.6 mm pitch raise its conductance by about 2 pi r^2 / pitch^2 =
5 %). The charges are eliminated once; four to a ring give dipole moments within 4 %, sixteen serve
electrodes that nearly touch, and those whose rim is near the sheet's or beyond it, while their
centre is not on it: there the image in the sheet's rim is as near as a neighbour (4 x 4 electrodes
of 2.5 mm, 1 / 2 / 3 / 5 mm inside: readings are 20.9 / 9.6 / 5.0 / 2.2 mV off with four charges,
2.3 / 2.1 / 1.7 / 1.7 mV with sixteen; on the rim 1.8 and 1.9 mV). Without shunting every electrode
is a point with a radius.

A charge of a ring of n acts on itself like a disc of radius r / n: then equal charges give the
potential of the continuous ring, because the distances between n points on a circle multiply to
n r^(n - 1).
"""

from __future__ import annotations

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.sheet.green import green_rectangle, green_rectangle_self, mutual_radius
from tomotactile_ros.sheet.transfer import Transfer, electrode_of, make_transfer
from tomotactile_ros.support.errors import InputError

# radii between centres, below which an electrode sees more than its neighbour's dipole
_CLOSE = 4.0
_NEAR_RIM = 2.0  # radii between centre and the sheet's rim; half of _CLOSE, as images are mirrored
_ON_RIM = 1e-6  # of the sheet's size: half a disc, which four charges serve
_FEW, _MANY = 4, 16  # charges of a ring
_BLOCK = 128  # points at a time: temporaries fit in the cache


class ClosedFormSheet:
    """Closed-form model of `layout`, a uniform rectangle.

    shunting       model the floating electrodes as equipotentials (True) or as points with a radius
    ring           charges on the rim of each electrode; by default 4, or 16: of all where some are
    close
                   to each other, otherwise of those that are close to the sheet's rim
    """

    model = "closed_form"

    def __init__(self, layout: Layout, *, shunting: bool = True, ring: int | None = None):
        if not layout.outline.is_uniform_rectangle:
            raise InputError(
                f"layout {layout.name!r}: the closed form needs a rectangle without holes, "
                f"this outline is a {layout.outline.kind}; use model fem"
            )
        self.layout = layout
        self.shunting = shunting
        self._size = layout.outline.size
        if shunting:
            counts = _counts(layout) if ring is None else np.full(layout.electrodes, ring)
            self._charges, owner = _rings(layout, counts)
            self._radius = layout.radius / counts[owner]
            mutual = mutual_radius(self._radius, self._radius)
            self._tie(owner, self._green(self._charges, self._charges, mutual))
        else:
            self._charges, self._radius = layout.positions, layout.radius
            own = self._radius * np.eye(layout.electrodes)
            self.electrode_electrode = self._green(self._charges, self._charges, own)

    def _green(
        self, points: np.ndarray, sources: np.ndarray, radius: float | np.ndarray
    ) -> np.ndarray:
        scale = self.layout.sheet_resistance
        return scale * green_rectangle(points, sources, self._size, radius)

    def _tie(self, owner: np.ndarray, between: np.ndarray) -> None:
        """Equal potential and no net current on each ring: eliminate the charges."""
        inverse = np.linalg.inv(between)
        ties = np.eye(self.layout.electrodes)[owner]
        self.electrode_electrode = np.linalg.inv(ties.T @ inverse @ ties)
        self._average = self.electrode_electrode @ ties.T @ inverse  # (E, charges)
        self._induced = inverse - inverse @ ties @ self._average  # (charges, charges)

    def transfer(self, points: ArrayLike, radius: ArrayLike) -> Transfer:
        """`Transfer` to contacts at `points` (K, 2), discs of `radius` (scalar or (K,)), m."""
        points = np.asarray(points, float).reshape(-1, 2)
        radius = np.broadcast_to(np.asarray(radius, float), len(points))
        self_terms = green_rectangle_self(points, self._size, radius) * self.layout.sheet_resistance
        charges = np.empty((len(self._charges), len(points)))
        for start in range(0, len(points), _BLOCK):
            part = slice(start, start + _BLOCK)
            mutual = mutual_radius(self._radius, radius[part])
            charges[:, part] = block = self._green(self._charges, points[part], mutual)
            if self.shunting:
                self_terms[part] -= np.einsum("pk,pk->k", block, self._induced @ block)
        to_points = self._average @ charges if self.shunting else charges

        def green(i: np.ndarray, j: np.ndarray) -> np.ndarray:
            block = self._green(points[i], points[j], mutual_radius(radius[i], radius[j]))
            if self.shunting:
                block -= charges[:, i].T @ (self._induced @ charges[:, j])
            return block

        owner, between = electrode_of(points, self.layout), self.electrode_electrode
        return make_transfer(self.model, points, owner, between, to_points, self_terms, green)

    def prepare(self, points: ArrayLike) -> None:
        """Nothing is worth being solved ahead here."""


def _counts(layout: Layout) -> np.ndarray:
    """(E,) charges of each ring by default."""
    if layout.pitches.min() <= _CLOSE * layout.radius:
        return np.full(layout.electrodes, _MANY)
    depth = (np.array(layout.outline.size) / 2 - np.abs(layout.positions)).min(axis=1)
    near = (depth > _ON_RIM * max(layout.outline.size)) & (depth < _NEAR_RIM * layout.radius)
    return np.where(near, _MANY, _FEW)


def _rings(layout: Layout, counts: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(C, 2) charges on the sheet, m, and (C,) the electrode of each, with `counts` (E,) to a
    ring."""
    owner = np.repeat(np.arange(layout.electrodes), counts)
    place = np.arange(len(owner)) - np.repeat(np.cumsum(counts) - counts, counts)
    angle = 2 * np.pi * (place + 0.5) / counts[owner]
    circle = layout.radius * np.column_stack([np.cos(angle), np.sin(angle)])
    charges = layout.positions[owner] + circle
    half = np.array(layout.outline.size) / 2
    inside = (np.abs(charges) <= half).all(axis=1)
    return charges[inside], owner[inside]
