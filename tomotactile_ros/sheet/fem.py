"""Finite-element model of a sheet: any outline, holes, any sheet resistance, electrodes of finite size.

    -div((1/R) grad phi) = f in the sheet,    (1/R) dphi/dn = 0 on the rim

with linear triangles. Each electrode is an equipotential: its nodes share one unknown, and a floating
electrode carries no net current. One unknown is held at 0 V (any will do, see `transfer`), which makes the
stiffness matrix positive definite; one factorisation serves all ground conditions and contacts.

A source on a single node acts like a disc whose radius follows from the stiffness matrix alone. Node k and
its neighbours j obey sum_j w_j (G_kk - G_jk) = 1 / K_kk with w_j = -K_jk / K_kk, and the field outside is
-(R / 2 pi) ln |x|, so

    ln radius_k = sum_j w_j ln |x_j - x_k| - 2 pi / (R K_kk)          (0.208 h on a square lattice)

Contacts smaller than that get the spreading resistance (R / 2 pi) ln(radius_k / radius) on top: the model
then does not change with the mesh, however small the contact. A node at the edge of a bare conductor that covers
a part c < 1/2 of its cell is sqrt(2 c) of an element away from the last covered node (one dimension); the element
conducts as if it were that much shorter with (R) (1 - sqrt(2 c)) / sqrt(2 c) between node and conductor.
"""

from __future__ import annotations

from collections import OrderedDict

import numpy as np
from scipy import sparse
from scipy.spatial import cKDTree

from tomotactile_ros.layout import Layout
from tomotactile_ros.sheet.factor import LevelCholesky
from tomotactile_ros.sheet.mesh import make_mesh
from tomotactile_ros.sheet.transfer import Transfer

_CACHE_BYTES = 128e6  # of Green function columns kept for contacts that stay or come back


class FemSheet:
    """Finite-element model of `layout`.

    h              element size, m; a fortieth of the longer side by default
    ring           nodes on the rim of each electrode, at least
    shunting       electrodes as equipotentials (True) or as rings that feed and average evenly
    resistance     function of points (n, 2) -> (n,), sheet resistance, ohm/sq; uniform without it
    """

    model = "fem"

    def __init__(self, layout: Layout, *, h=None, ring=16, shunting=True, resistance=None):
        self.layout = layout
        self.shunting = shunting
        self.h = h or max(layout.outline.size) / 40
        self.mesh = mesh = make_mesh(layout, self.h, ring, inner=0 if shunting else 3)
        centroids = mesh.points[mesh.triangles].mean(axis=1)
        uniform = np.full(len(centroids), float(layout.sheet_resistance))
        self._resistance = uniform if resistance is None else np.asarray(resistance(centroids), float)
        nodal = stiffness(mesh.points, mesh.triangles, 1 / self._resistance)
        self._number(nodal)
        reduce = sparse.csr_matrix(
            (np.ones(len(self.unknown)), (np.arange(len(self.unknown)), self.unknown))
        )
        self.stiffness = (reduce.T @ nodal @ reduce).tocsr()
        free = np.arange(1, self.stiffness.shape[0])  # unknown 0 is held at 0 V
        axis = int(np.argmax(layout.outline.size[::-1]) == 0)
        along = self.where[free, axis]
        start = np.flatnonzero(along <= along.min() + 1e-9 * self.h)
        self._factor = LevelCholesky(self.stiffness[free][:, free], start)
        self._columns: OrderedDict[int, np.ndarray] = OrderedDict()
        self._radius = self._node_radius(nodal)
        self._solve_electrodes()

    def _number(self, nodal):
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
        self.electrode_of = np.full(len(self.where), -1)
        self.electrode_of[:tied] = np.arange(tied)

    def _node_radius(self, nodal):
        """(M,) radius of the disc as which a source on each unknown acts, m; the electrodes' own there."""
        mesh = self.mesh
        corner = np.repeat(self._resistance, 3)
        nodes = mesh.triangles.ravel()
        local = np.bincount(nodes, corner) / np.bincount(nodes)
        pairs = sparse.triu(nodal, 1).tocoo()
        logs = -pairs.data * np.log(np.linalg.norm(mesh.points[pairs.row] - mesh.points[pairs.col], axis=1))
        count = len(mesh.points)
        total = np.bincount(pairs.row, logs, count) + np.bincount(pairs.col, logs, count)
        diagonal = nodal.diagonal()
        # seen from the rim, a half disc or a quarter: the same disc, but only its part in the sheet
        opening = self._opening() / (2 * np.pi)
        radius = np.exp(total / diagonal - 2 * np.pi * opening / (local * diagonal))
        out = np.full(len(self.where), self.layout.radius)
        single = self.electrode_of[self.unknown] < 0
        out[self.unknown[single]] = radius[single]
        self._local = np.empty(len(self.where))  # sheet resistance, times 2 on a straight rim
        self._local[self.unknown] = local / opening
        self._area = np.bincount(self.unknown, self.mesh.lumped_areas())
        self._centre_local = (local / opening)[[nodes[-1] for nodes in self.mesh.electrodes]]
        return out

    def _opening(self):
        """(N,) angle of the sheet seen from each node: 2 pi inside, pi on a straight rim."""
        p = self.mesh.points[self.mesh.triangles]
        angle = np.zeros(len(self.mesh.points))
        for i in range(3):
            u, v = p[:, (i + 1) % 3] - p[:, i], p[:, (i + 2) % 3] - p[:, i]
            turn = np.arctan2(u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0], (u * v).sum(axis=1))
            angle += np.bincount(self.mesh.triangles[:, i], turn, len(angle))
        return angle

    def _solve_electrodes(self):
        electrodes = self.layout.electrodes
        feed = np.zeros((len(self.where), electrodes))
        correction = np.zeros(electrodes)
        for electrode, (nodes, rim) in enumerate(zip(self.mesh.electrodes, self.mesh.rims)):
            if self.shunting:
                feed[electrode, electrode] = 1.0
            else:
                ring = self.unknown[nodes[:rim]]
                share = 1 / self._local[ring]
                share /= share.sum()
                feed[ring, electrode] = share
                excess = np.log(self._radius[ring] * self.mesh.ring / self.layout.radius)
                correction[electrode] = (share**2 * self._local[ring] * excess).sum() / (2 * np.pi)
        self._to_electrodes = self._solve(feed).T  # (E, M)
        self.electrode_electrode = self._to_electrodes @ feed + np.diag(correction)
        self._sharpen()

    def _sharpen(self):
        """Make up for what the rings lack in the logarithmic field of their own electrode."""
        rings = self.layout.radius, self.mesh.last
        rate = self._centre_local * self.mesh.log_excess()
        own = np.arange(self.layout.electrodes)
        self.electrode_electrode[own, own] += rate * np.log(rings[1] / rings[0])
        tree = cKDTree(self.where)
        for electrode, position in enumerate(self.layout.positions):
            near = np.array(tree.query_ball_point(position, rings[1][electrode]), int)
            distance = np.maximum(np.linalg.norm(self.where[near] - position, axis=1), rings[0])
            lack = rate[electrode] * np.log(rings[1][electrode] / distance)
            self._to_electrodes[electrode, near] += np.maximum(lack, 0)

    def _solve(self, feed):
        out = np.zeros_like(feed)
        out[1:] = self._factor.solve(feed[1:])
        return out

    def _green_columns(self, unknowns):
        """(M, n) Green function from `unknowns` to all; solved together, the latest are kept."""
        missing = [u for u in unknowns if u not in self._columns]
        if missing:
            feed = np.zeros((len(self.where), len(missing)))
            feed[missing, np.arange(len(missing))] = 1.0
            self._columns.update(zip(missing, self._solve(feed).T.copy()))
        for u in unknowns:
            self._columns.move_to_end(u)
        columns = np.array([self._columns[u] for u in unknowns]).reshape(len(unknowns), -1).T
        limit = int(_CACHE_BYTES / (8 * len(self.where)))
        while len(self._columns) > limit:
            self._columns.popitem(last=False)
        return columns

    def transfer(self, points, radius) -> Transfer:
        """`Transfer` to contacts at `points` (K, 2), discs of `radius` (scalar or (K,)), m."""
        points = np.asarray(points, float).reshape(-1, 2)
        radius = np.broadcast_to(np.asarray(radius, float), len(points))
        element, weights = self.mesh.locate(points)
        nearest = np.linalg.norm(points[:, None] - self.layout.positions, axis=2).argmin(axis=1)
        offset = np.linalg.norm(points - self.layout.positions[nearest], axis=1)
        on_electrode = np.where(offset < self.layout.radius, nearest, -1)
        corners = self.unknown[self.mesh.triangles[element]]
        if self.shunting:
            covered = on_electrode >= 0
            corners[covered] = on_electrode[covered, None]
        where = (corners.ravel(), np.repeat(np.arange(len(points)), 3))
        spread = sparse.csr_matrix((weights.ravel(), where), (len(self.where), len(points)))
        to_electrodes = self._to_electrodes @ spread
        self_term = self._self_terms(corners, weights, radius, on_electrode)

        def green(i, j):
            feed = spread[:, j].toarray()
            return spread[:, i].T @ self._solve(feed)

        return Transfer(
            self.model,
            points,
            self.electrode_electrode,
            np.ascontiguousarray(to_electrodes),
            self_term,
            on_electrode,
            green,
        )

    def _self_terms(self, corners, weights, radius, on_electrode):
        """Quadratic form of the inverse in each triangle, moved from the mesh's radius to the contact's."""
        first, second = np.repeat(np.arange(3), 3), np.tile(np.arange(3), 3)
        rows, columns = corners[:, first], corners[:, second]
        product = weights[:, first] * weights[:, second]
        entries = np.zeros(rows.shape)
        free = (rows > 0) & (columns > 0)
        entries[free] = self._factor.inverse_entries(rows[free] - 1, columns[free] - 1)
        apart = np.linalg.norm(self.where[rows] - self.where[columns], axis=2)
        apart = np.where(rows == columns, self._radius[rows], apart)
        excess = (product * np.log(np.maximum(apart, 1e-300))).sum(axis=1) - np.log(radius)
        local = (weights * self._local[corners]).sum(axis=1)
        plain = (product * entries).sum(axis=1)
        on_equipotential = (on_electrode >= 0) & self.shunting
        return plain + np.where(on_equipotential, 0.0, local * excess / (2 * np.pi))

    def contact_points(self, points, areas, conductance):
        """Where the cells of a contact (or several) meet the sheet: the nodes around them.

        Parameters
        ----------
        points : (Q, 2) centres of the cells, m; areas : (Q,), m^2; conductance : (Q,), S/m^2, may be inf

        Returns
        -------
        Transfer of n mesh nodes, (n,) resistance of each to the drive, ohm. Cells outside the outline
        are left out.
        """
        element, weights = self.mesh.locate(np.asarray(points, float).reshape(-1, 2))
        inside = element >= 0
        weights = np.clip(weights[inside], 0, None) * np.asarray(areas, float)[inside, None]
        corners = self.unknown[self.mesh.triangles[element[inside]]]
        unknowns, number = np.unique(corners[weights > 0], return_inverse=True)
        area = np.bincount(number, weights[weights > 0])
        with np.errstate(invalid="ignore"):
            flow = (weights * np.asarray(conductance, float)[inside, None])[weights > 0]
        with np.errstate(divide="ignore"):
            resistance = 1 / np.bincount(number, flow)
        resistance = resistance + self._crowding(unknowns, area, resistance)
        block = self._green_columns(unknowns.tolist())[unknowns]
        block = (block + block.T) / 2
        transfer = Transfer(
            self.model,
            self.where[unknowns],
            self.electrode_electrode,
            self._to_electrodes[:, unknowns],
            np.diagonal(block).copy(),
            self.electrode_of[unknowns],
            lambda i, j: block[np.ix_(i, j)],
        )
        return transfer, resistance


    def _crowding(self, unknowns, area, resistance):
        """(n,) resistance of the field that the mesh is too coarse for, ohm; see the head of this file."""
        part = area / self._area[unknowns]
        local = self._local[unknowns]
        links = self.stiffness[unknowns][:, unknowns]
        at_edge = links.astype(bool) @ (part >= 0.5)
        reach = np.sqrt(np.clip(2 * part, 1e-12, 1))
        stiff = local / (local + part * resistance)
        edge = stiff * local * (1 - reach) / reach
        excess = np.log(self._radius[unknowns] / np.sqrt(area / np.pi))
        spreading = local * np.maximum(excess, 0) / (2 * np.pi)
        return np.where(self.electrode_of[unknowns] >= 0, 0.0, np.where(at_edge, edge, spreading))


def stiffness(points, triangles, conductance) -> sparse.csr_matrix:
    """Stiffness matrix (N, N) of linear triangles, `conductance` (T,) of each, S per square."""
    rows, columns, values = [], [], []
    for i in range(3):
        j, k = triangles[:, (i + 1) % 3], triangles[:, (i + 2) % 3]
        u, v = points[j] - points[triangles[:, i]], points[k] - points[triangles[:, i]]
        cotangent = (u * v).sum(axis=1) / (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
        weight = conductance * cotangent / 2
        rows += [j, k, j, k]
        columns += [k, j, j, k]
        values += [-weight, -weight, weight, weight]
    shape = (len(points), len(points))
    where = (np.concatenate(rows), np.concatenate(columns))
    return sparse.csr_matrix((np.concatenate(values), where), shape)
