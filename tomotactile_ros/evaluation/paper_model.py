"""The paper's assumption on a uniform rectangle in closed form: electrodes and contacts are points
with a radius. (The article itself computes with finite elements: `point_nodes`.)

Distances below the radius count as the radius, those to mirror images in the rim too: the mean of
ln |p - q| over a circle around p is ln max(|p - q|, radius). Unlike the models in `sheet`,
electrodes do not shunt the sheet ("negligible" in Kojima et al. 2023), and no contact is on an
electrode: one that lies within its radius is as far from it as the radius. Everything is at 1
ohm/sq, which J (eq. 2) does not depend on.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.evaluation.symmetry import Symmetry
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.sheet.green import green_rectangle, green_rectangle_self, softened
from tomotactile_ros.sheet.transfer import Transfer
from tomotactile_ros.support.errors import InputError

CONTACT_RADIUS = 0.001  # m
# in electrode radii: a contact as large as the electrode it touches is a short circuit
_LARGEST_CONTACT = 0.5
_POINT = 1e-6  # radius of what is replaced, in parts of the radius that replaces it


def default_contact_radius(layout: Layout) -> float:
    """1 mm, or half the radius of the electrodes where these are smaller than 2 mm, m."""
    return min(CONTACT_RADIUS, _LARGEST_CONTACT * layout.radius)


def paper_transfer(
    layout: Layout, points, radius: float | None = None, symmetry: Symmetry | None = None
) -> Transfer:
    """`Transfer` to contacts of `radius` (m, `default_contact_radius` without it) at `points`.

    With the `symmetry` that the electrodes and the points have, G is computed for one electrode of
    each kind.

    Raises InputError for other outlines than rectangles without holes, and for contacts that are
    too large.
    """
    if not layout.outline.is_uniform_rectangle:
        raise InputError(
            f"layout {layout.name!r}: points with a radius need a rectangle without holes, this "
            f"outline is a {layout.outline.kind}; use model fem"
        )
    radius = default_contact_radius(layout) if radius is None else radius
    if radius > _LARGEST_CONTACT * layout.radius:
        raise InputError(
            f"contact radius: {1e3 * radius:g} mm is too large where electrodes "
            f"of {1e3 * layout.radius:g} mm are points, at most half of that works; "
            "use model closed_form"
        )
    contacts = Contacts(np.asarray(points, float), layout.outline.size, radius)
    return contacts.transfer(layout.positions, layout.radius, symmetry)


class Contacts:
    """Contacts of `radius` (m) at `points` (K, 2) of a rectangle of `size`, for any electrodes."""

    def __init__(self, points, size, radius: float):
        self.points, self.size, self.radius = points, size, radius
        self._self = green_self(points, size, radius)

    def transfer(self, positions, radius: float, symmetry: Symmetry | None = None) -> Transfer:
        """`Transfer` for electrodes of `radius` (m) at `positions` (E, 2)."""
        kinds = np.arange(len(positions)) if symmetry is None else symmetry.kinds
        to_points = green(positions[kinds], self.points, self.size, radius)
        between = green(positions[kinds], positions, self.size, radius)
        if symmetry is not None:
            to_points = symmetry.spread(to_points, symmetry.pixels)
            between = symmetry.spread(between, symmetry.electrodes)
        nowhere = np.full(len(self.points), -1)
        return Transfer("paper", self.points, between, to_points, self._self, nowhere, self._green)

    def _green(self, i, j):
        return green(self.points[i], self.points[j], self.size, self.radius)


def green(points, sources, size, radius: float) -> np.ndarray:
    """(P, Q) Green function at 1 ohm/sq, distances at least `radius`, m."""
    points, sources = np.asarray(points, float), np.asarray(sources, float)
    tiny = _POINT * radius
    out = green_rectangle(points, sources, size, tiny)
    for across in _images(points[:, None, 0], sources[:, 0], size[0], radius):
        for along in _images(points[:, None, 1], sources[:, 1], size[1], radius):
            near = np.nonzero((np.abs(across) < radius) & (np.abs(along) < radius))
            out[near] += _excess(across[near] ** 2 + along[near] ** 2, radius)
    return out


def green_self(points, size, radius: float) -> np.ndarray:
    """(P,) Green function at 1 ohm/sq between each point and itself."""
    points = np.asarray(points, float)
    out = green_rectangle_self(points, size, _POINT * radius)
    for across in _images(points[:, 0], points[:, 0], size[0], radius):
        for along in _images(points[:, 1], points[:, 1], size[1], radius):
            out += _excess(across**2 + along**2, radius)
    return out


def _images(x, s, side, radius):
    """Distances along one axis, from `x` to `s` and to its mirror images where these are near."""
    yield x - s
    for rim in (-side, side):
        if min(np.abs(x - rim / 2).min(), np.abs(s - rim / 2).min()) < radius:
            yield x + s - rim


def _excess(squared, radius):
    """What a point source at a squared distance has too much of."""
    point = softened(squared, (_POINT * radius) ** 2)
    return np.minimum(np.log(point) - 2 * np.log(radius), 0) / (4 * np.pi)
