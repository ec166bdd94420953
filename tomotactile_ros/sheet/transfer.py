"""The one seam between the physics and everything that uses it.

A `Transfer` holds the Green function `G` of the ungrounded sheet between its electrodes and the
points at which current may enter. With electrode `l` grounded the transfer impedance of two points
is

    Z_l(a, b) = G(a, b) - G(a, l) - G(l, b) + G(l, l)

so one `Transfer` serves all ground conditions, frames, sensitivities, images and metrics. `G` is
known up to a term u(a) + u(b), which cancels in `Z_l`: each model is free to choose its own
reference.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.layouts.layout import Layout


@dataclass(frozen=True, eq=False)
class Transfer:
    """Green function between E electrodes and K points, in ohm.

    model               name of the model that filled it, `closed_form` or `fem`
    points              (K, 2), m
    electrode_electrode (E, E)
    electrode_point     (E, K)
    point_self          (K,), G(k, k) of a contact of the radius that the points were given
    electrode_of        (K,), index of the electrode that the point lies on, else -1
    green               green(i, j) -> (len(i), len(j)), G between chosen points, computed on demand
    """

    model: str
    points: np.ndarray
    electrode_electrode: np.ndarray
    electrode_point: np.ndarray
    point_self: np.ndarray
    electrode_of: np.ndarray
    green: Callable[[np.ndarray, np.ndarray], np.ndarray]

    @property
    def electrodes(self) -> int:
        return len(self.electrode_electrode)

    def among(self, chosen: ArrayLike) -> np.ndarray:
        """(n, n) Green function between `chosen` points, self terms on the diagonal."""
        chosen = np.asarray(chosen)
        block = np.array(self.green(chosen, chosen))
        np.fill_diagonal(block, self.point_self[chosen])
        return block

    def at(self, chosen: ArrayLike) -> Transfer:
        """The same sheet, restricted to `chosen` points."""
        chosen = np.asarray(chosen)
        return Transfer(
            self.model,
            self.points[chosen],
            self.electrode_electrode,
            self.electrode_point[:, chosen],
            self.point_self[chosen],
            self.electrode_of[chosen],
            lambda i, j: self.green(chosen[i], chosen[j]),
        )

    def self_impedance(self, grounded: ArrayLike | None = None) -> np.ndarray:
        """(L, K) Z_l(k, k): from a contact at point k to the electrode l that is grounded."""
        rows = slice(None) if grounded is None else np.asarray(grounded)
        own = np.diagonal(self.electrode_electrode)[rows, None]
        return self.point_self - 2 * self.electrode_point[rows] + own

    def impedance(self, grounded: int) -> np.ndarray:
        """(E, K) Z_l(n, k): voltage at each electrode per ampere fed in at each point."""
        ee, ep = self.electrode_electrode, self.electrode_point
        return ep - ee[:, grounded, None] - ep[grounded] + ee[grounded, grounded]


class Sheet(Protocol):
    """What a model of a sheet offers."""

    model: str
    layout: Layout
    electrode_electrode: np.ndarray

    def transfer(self, points: ArrayLike, radius: ArrayLike) -> Transfer:
        """`Transfer` to contacts at `points` (K, 2), discs of `radius` (scalar or (K,)), m."""

    def prepare(self, points: ArrayLike) -> None:
        """Solve ahead for contacts that will touch the sheet around `points` (Q, 2)."""


def make_transfer(
    model: str,
    points: np.ndarray,
    owner: np.ndarray,
    between: np.ndarray,
    to_points: np.ndarray,
    self_terms: np.ndarray,
    green: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> Transfer:
    """`Transfer` to `points`, of which those on an electrode are the electrode.

    owner (K,) as of `electrode_of`; between (E, E), to_points (E, K) and self_terms (K,) in ohm;
    green(i, j) as in `Transfer`.
    """
    covered = np.flatnonzero(owner >= 0)
    if not len(covered):
        return Transfer(model, points, between, to_points, self_terms, owner, green)
    to_points[:, covered] = between[:, owner[covered]]
    self_terms[covered] = between[owner[covered], owner[covered]]

    def green_with_electrodes(i: np.ndarray, j: np.ndarray) -> np.ndarray:
        block = green(i, j)
        first, second = owner[i], owner[j]
        block[first >= 0] = to_points[first[first >= 0]][:, j]
        block[:, second >= 0] = to_points[second[second >= 0]][:, i].T
        return block

    return Transfer(model, points, between, to_points, self_terms, owner, green_with_electrodes)


def electrode_of(points: np.ndarray, layout: Layout, radius: ArrayLike = 0.0) -> np.ndarray:
    """(K,) index of the electrode that each of `points` (K, 2) lies on, -1 where on none.

    With a `radius` (scalar or (K,), m): the electrode that a disc around the point overlaps.
    """
    distance, nearest = layout.nearest(points)
    return np.where(distance < layout.radius + np.asarray(radius), nearest, -1)
