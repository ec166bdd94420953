"""Finite-element model of a sheet: any outline and resistance, electrodes of finite size.

    -div((1/R) grad phi) = f in the sheet,    (1/R) dphi/dn = 0 on the rim

with linear triangles. Each electrode is an equipotential: its nodes share one unknown, and a
floating electrode carries no net current. One unknown is held at 0 V (any will do, see `transfer`),
which makes the stiffness matrix positive definite; one factorisation serves all ground conditions
and contacts.

Close to a source the field is -(R / 2 pi) ln |x|, which linear elements round off: a source on node
k acts like a disc whose radius follows from the stiffness matrix alone. Node k and its neighbours j
obey sum_j w_j (G_kk - G_jk) = 1 / K_kk with w_j = -K_jk / K_kk, therefore

    ln radius_k = sum_j w_j ln |x_j - x_k| - 2 pi / (R K_kk)          (0.208 h on a square lattice)

Points between nodes feed and read by the weights of their triangle. The logarithm as the mesh has
it, ln |x_i - x_j| between the nodes and ln radius_k on one, weighted likewise, is then exchanged
for the true one: contacts may be smaller and closer than elements.

An anisotropic sheet is an isotropic one in stretched coordinates. Cotangents, angles and logarithms
are taken there; discs are ellipses there, which act like discs of their mean semi-axis.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.scenes.sheet_field import Anisotropy
from tomotactile_ros.sheet.factor import LevelFactor
from tomotactile_ros.sheet.green import mutual_radius, softened
from tomotactile_ros.sheet.image import image_excess
from tomotactile_ros.sheet.mesh import Mesh, make_mesh
from tomotactile_ros.sheet.metric import Metric
from tomotactile_ros.sheet.solved_on_demand import KeptGreen
from tomotactile_ros.sheet.transfer import Transfer, make_transfer
from tomotactile_ros.sheet.triangles import at_ends, corner_angles, links, stiffness

Resistance = Callable[[np.ndarray], np.ndarray]  # ohm/sq (n,) at points (n, 2), m
_FEW = 300  # points whose mutual Green function is computed at once
_NEAR = 3.0  # elements from an electrode's centre, where its field is still rounded


class FemSheet:
    """Finite-element model of `layout`.

    h              element size, m; a fortieth of the longer side by default
    ring           nodes on the rim of each electrode, at least
    shunting       electrodes as equipotentials (True) or as rings that feed and average evenly
    resistance     function of points (n, 2) -> (n,), sheet resistance, ohm/sq; uniform without it
    anisotropy     of the whole sheet; none without it
    lines          polylines (V, 2), m, that elements follow: where the resistance jumps
    mesh           of another sheet of the same layout and elements, for the same triangles again
    """

    model = "fem"

    def __init__(
        self,
        layout: Layout,
        *,
        h: float | None = None,
        ring: int = 16,
        shunting: bool = True,
        resistance: Resistance | None = None,
        anisotropy: Anisotropy | None = None,
        lines: Sequence[np.ndarray] = (),
        mesh: Mesh | None = None,
    ):
        self.layout = layout
        self.shunting = shunting
        self.h = h or max(layout.outline.size) / 40
        self.metric = Metric(anisotropy, layout.radius)
        inner = 0 if shunting else 3
        self.mesh = mesh = mesh or make_mesh(layout, self.h, ring, inner=inner, lines=lines)
        centroids = mesh.points[mesh.triangles].mean(axis=1)
        uniform = np.full(len(centroids), float(layout.sheet_resistance))
        self._resistance = (
            uniform if resistance is None else np.asarray(resistance(centroids), float)
        )
        self._number()
        cotangents, angles = corner_angles(self.metric.at(mesh.points), mesh.triangles)
        ends, conductance = links(mesh.triangles, cotangents, 1 / self._resistance)
        self.stiffness = stiffness(self.unknown[ends], conductance, len(self.where))
        along = self.where[1:, np.argmax(layout.outline.size)]
        start = np.flatnonzero(along <= along.min() + 1e-9 * self.h)
        self._factor = LevelFactor(self.stiffness[1:, 1:], start)  # unknown 0 is held at 0 V
        self._kept = KeptGreen(self._solve, self._among, self._mesh_log, len(self.where))
        self._radius = self._node_radius(ends, conductance, angles)
        self._solve_electrodes()

    def _number(self) -> None:
        """Unknown of each node; those of electrodes first where electrodes are equipotentials."""
        mesh, electrodes = self.mesh, self.layout.electrodes
        tied = electrodes if self.shunting else 0
        self.unknown = np.full(len(mesh.points), -1)
        for number, nodes in enumerate(mesh.electrodes[:tied]):
            self.unknown[nodes] = number
        alone = self.unknown < 0
        self.unknown[alone] = tied + np.arange(np.count_nonzero(alone))
        self.where = np.empty((tied + np.count_nonzero(alone), 2))
        self.where[self.unknown] = mesh.points
        self.where[:tied] = self.layout.positions[:tied]
        self._seen_at = self.metric.at(self.where)
        self.electrode_of = np.full(len(self.where), -1)
        self.electrode_of[:tied] = np.arange(tied)

    def _node_radius(
        self, ends: np.ndarray, conductance: np.ndarray, angles: np.ndarray
    ) -> np.ndarray:
        """(M,) radius of the disc as which each unknown acts, m; of an electrode its own."""
        points, nodes = self.metric.at(self.mesh.points), self.mesh.triangles.ravel()
        # what conducts around a node: seen from the rim, a half disc or a quarter
        around = (angles / self._resistance[:, None]).ravel()
        around = np.bincount(nodes, around) / (2 * np.pi)
        total = at_ends(ends, conductance, len(points))
        logs = conductance * np.log(np.linalg.norm(points[ends[0]] - points[ends[1]], axis=1))
        mean_log = at_ends(ends, logs, len(points)) / total
        radius = np.exp(mean_log - 2 * np.pi * around / total)
        self._reach = np.where(self.electrode_of >= 0, self.metric.radius, 0.0)
        out = np.full(len(self.where), self.metric.radius)
        single = self.electrode_of[self.unknown] < 0
        out[self.unknown[single]] = radius[single]
        self.local = np.empty(len(self.where))  # sheet resistance, times 2 on a straight rim
        self.local[self.unknown] = 1 / around
        self._centre_local = 1 / around[[nodes[-1] for nodes in self.mesh.electrodes]]
        return out

    def _solve_electrodes(self) -> None:
        electrodes = self.layout.electrodes
        feed = np.zeros((len(self.where), electrodes))
        correction = np.zeros(electrodes)
        if self.shunting:
            np.fill_diagonal(feed, 1.0)
        else:
            for electrode, (nodes, rim) in enumerate(zip(self.mesh.electrodes, self.mesh.rims)):
                ring = self.unknown[nodes[:rim]]
                share = 1 / self.local[ring]
                share /= share.sum()
                feed[ring, electrode] = share
                excess = np.log(self._radius[ring] * self.mesh.ring / self.metric.radius)
                correction[electrode] = (share**2 * self.local[ring] * excess).sum() / (2 * np.pi)
        self._to_electrodes = self._solve(feed)  # (M, E)
        fed = np.flatnonzero(feed.any(axis=1))
        self.electrode_electrode = feed[fed].T @ self._to_electrodes[fed] + np.diag(correction)
        self._sharpen()

    def _sharpen(self) -> None:
        """Make up for what the rings lack in the logarithmic field of their own electrode."""
        radius, last = self.layout.radius, self.mesh.last
        rate = self._centre_local * self.mesh.log_excess()
        own = np.arange(self.layout.electrodes)
        self.electrode_electrode[own, own] += rate * np.log(last / radius)
        distance, nearest = self.layout.nearest(self.where)
        lack = rate[nearest] * np.log(last[nearest] / np.maximum(distance, radius))
        self._to_electrodes[np.arange(len(lack)), nearest] += np.maximum(lack, 0)

    def _solve(self, feed: np.ndarray) -> np.ndarray:
        out = np.zeros_like(feed)
        out[1:] = self._factor.solve(feed[1:])
        return out

    def _among(self, unknowns: np.ndarray) -> np.ndarray:
        """(n, n) Green function between `unknowns` (n,)."""
        out = np.zeros((len(unknowns), len(unknowns)))
        free = np.flatnonzero(unknowns > 0)
        out[np.ix_(free, free)] = self._factor.inverse_among(unknowns[free] - 1)
        return out

    def prepare(self, points: ArrayLike) -> None:
        """Solve ahead for contacts that will touch the sheet around `points` (Q, 2)."""
        element, _ = self.mesh.locate(np.asarray(points, float).reshape(-1, 2))
        nodes = np.unique(self.unknown[self.mesh.triangles[element]])
        self._kept.prepare(nodes)

    def transfer(self, points: ArrayLike, radius: ArrayLike) -> Transfer:
        """`Transfer` to contacts at `points` (K, 2), discs of `radius` (scalar or (K,)), m."""
        points = np.asarray(points, float).reshape(-1, 2)
        radius = np.broadcast_to(np.asarray(radius, float), len(points))
        seen_at, acts = self.metric.at(points), self.metric.mean * radius
        element, weights = self.mesh.locate(points)
        corners = self.unknown[self.mesh.triangles[element]]
        to_points = np.einsum("kce,kc->ek", self._to_electrodes[corners], weights)
        apart, nearest = self.layout.nearest(points)
        local = (weights * self.local[corners]).sum(axis=1)
        excess = self.electrode_excess(points, radius, corners, weights, nearest, local)
        to_points[nearest, np.arange(len(points))] += excess

        images = self._images(points, radius, corners, weights, apart, nearest)

        def place_of(some: np.ndarray, chosen: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
            """Which of `chosen` are among `some`, and which of these they are."""
            at = np.searchsorted(some, chosen)
            here = np.flatnonzero(some[np.minimum(at, len(some) - 1)] == chosen)
            return here, at[here]

        def green(i: np.ndarray, j: np.ndarray) -> np.ndarray:
            """Between points i and j: by finite elements, with the true logarithm."""
            both = i if i is j else np.concatenate([i, j])
            nodes, number = np.unique(corners[both], return_inverse=True)
            mixing = _weights(number.reshape(-1, 3), weights[both], len(nodes))
            first, second = mixing[: len(i)], mixing[-len(j) :]
            true_log = _log_distance(seen_at[i], seen_at[j], mutual_radius(acts[i], acts[j]))
            for some, excess in images:
                row, column = place_of(some, i), place_of(some, j)
                true_log[np.ix_(row[0], column[0])] -= excess[np.ix_(row[1], column[1])]
            scale = (local[i][:, None] + local[j]) / (4 * np.pi)
            return first @ (self._kept.among(nodes) @ second.T) - scale * true_log

        if len(points) <= _FEW:
            everything = np.arange(len(points))
            block = green(everything, everything)
            self_terms = np.diagonal(block).copy()

            def found(i: np.ndarray, j: np.ndarray) -> np.ndarray:
                return block[np.ix_(i, j)]
        else:
            pairs = _pairs(corners, weights)
            self_terms = self._self_terms(*pairs) + self._self_log(*pairs)
            own = np.log(acts)
            for some, excess in images:
                own[some] -= np.diagonal(excess)
            self_terms -= own * local / (2 * np.pi)
            found = green
        between = self.electrode_electrode
        owner = np.where(apart < self.layout.radius, nearest, -1)
        return make_transfer(self.model, points, owner, between, to_points, self_terms, found)

    def _images(
        self,
        points: np.ndarray,
        radius: np.ndarray,
        corners: np.ndarray,
        weights: np.ndarray,
        apart: np.ndarray,
        nearest: np.ndarray,
    ) -> list[tuple[np.ndarray, np.ndarray]]:
        """Of each electrode the points beside it (m,), and their `image_excess` (m, m)."""
        if not self.shunting:
            return []
        beside = (apart >= self.layout.radius) & (apart < self.reach)
        out = []
        for electrode in np.unique(nearest[beside]):
            some = np.flatnonzero(beside & (nearest == electrode))
            given = points[some], corners[some], weights[some]
            at, its, parts = (each[None] for each in given)
            out.append((some, image_excess(self, electrode, at, radius[some], its, parts)[0]))
        return out

    def seen_at(self, unknowns: np.ndarray) -> np.ndarray:
        """(..., 2) m, where unknowns (...) are, as the `metric` has it."""
        return self._seen_at[unknowns]

    @property
    def to_electrodes(self) -> np.ndarray:
        """(M, E) Green function between unknowns and electrodes."""
        return self._to_electrodes

    @property
    def reach(self) -> float:
        """m from an electrode's centre, where its logarithm is still rounded by the mesh."""
        return _NEAR * self.h / self.metric.least

    def smooth(self, nodes: np.ndarray) -> np.ndarray:
        """(T, n, n) Green function between unknowns (T, n) without its logarithm.

        That is the mesh's own, by the local sheet resistance over 2 pi, the mean of both ends.
        """
        return self._kept.blocks(nodes)

    def electrode_excess(
        self,
        points: np.ndarray,
        radius: np.ndarray,
        corners: np.ndarray,
        weights: np.ndarray,
        nearest: np.ndarray,
        local: np.ndarray,
    ) -> np.ndarray:
        """(K,) ohm, by which G to the nearest electrode exceeds the mesh's.

        `local` is the sheet resistance around each point, ohm/sq.
        """
        reach = self.metric.reach(points - self.layout.positions[nearest])
        acts = self.metric.mean * radius
        excess = self._electrode_log(acts, corners, weights, reach, nearest)
        return excess * local / (2 * np.pi)

    def _mesh_log(self, first: np.ndarray, second: np.ndarray) -> np.ndarray:
        """(n, m) ohm, -G between unknowns as far as it is the mesh's own ln |x_i - x_j|.

        On one unknown that of the radius as which it acts.
        """
        squared = _squared_distance(self._seen_at[first], self._seen_at[second])
        reach = np.maximum.outer(self._reach[first], self._reach[second])
        np.maximum(squared, reach**2, out=squared)
        row, column = np.nonzero(first[:, None] == second)
        squared[row, column] = self._radius[first[row]] ** 2
        np.log(squared, out=squared)
        squared *= np.add.outer(self.local[first], self.local[second]) / (8 * np.pi)
        return squared

    def _electrode_log(
        self,
        radius: np.ndarray,
        corners: np.ndarray,
        weights: np.ndarray,
        apart: np.ndarray,
        nearest: np.ndarray,
    ) -> np.ndarray:
        """(K,) what the mesh's logarithm from the nearest electrode exceeds the true one by."""
        centre, least = self.layout.positions[nearest], self.metric.radius
        at_corners = self.metric.reach(self.where[corners] - centre[:, None])
        rounded = (weights * np.log(np.maximum(at_corners, least))).sum(axis=1)
        excess = rounded - np.log(np.maximum(apart, np.maximum(radius, least)))
        return np.where(apart < _NEAR * self.h, excess, 0.0)

    def _self_terms(self, rows: np.ndarray, columns: np.ndarray, product: np.ndarray) -> np.ndarray:
        """(K,) quadratic form of the inverse stiffness matrix with the weights of each point."""
        entries = np.zeros(rows.shape)
        free = (rows > 0) & (columns > 0)
        entries[free] = self._factor.inverse_entries(rows[free] - 1, columns[free] - 1)
        return (product * entries).sum(axis=1)

    def _self_log(self, rows: np.ndarray, columns: np.ndarray, product: np.ndarray) -> np.ndarray:
        """(K,) ohm, what the mesh's own logarithm has of each point's self term, as `_mesh_log`."""
        x, y = (self._seen_at[rows] - self._seen_at[columns]).T
        apart = np.maximum(np.hypot(x, y).T, self._reach[rows])
        apart = np.where(rows == columns, self._radius[rows], apart)
        local = (self.local[rows] + self.local[columns]) / (4 * np.pi)
        return (product * local * np.log(apart)).sum(axis=1)


def _squared_distance(first: np.ndarray, second: np.ndarray) -> np.ndarray:
    squared = np.subtract.outer(first[:, 0], second[:, 0]) ** 2
    squared += np.subtract.outer(first[:, 1], second[:, 1]) ** 2
    return squared


def _log_distance(first: np.ndarray, second: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """(n, m) ln |x_i - x_j| of points with mutual radii (n, m)."""
    return 0.5 * np.log(softened(_squared_distance(first, second), radius**2))


def _pairs(corners: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The six pairs of corners of each triangle, and the products of their weights: (K, 6) each."""
    first, second, times = [0, 1, 2, 0, 1, 2], [0, 1, 2, 1, 2, 0], [1, 1, 1, 2, 2, 2]
    return corners[:, first], corners[:, second], weights[:, first] * weights[:, second] * times


def _weights(number: np.ndarray, weights: np.ndarray, count: int) -> np.ndarray:
    """(n, count) dense rows with three `weights` each at `number`."""
    out = np.zeros((len(number), count))
    row = np.arange(len(number))
    for corner in range(3):
        out[row, number[:, corner]] += weights[:, corner]
    return out
