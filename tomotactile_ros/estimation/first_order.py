"""What an uneven sheet, and one that is cut or printed otherwise, changes to first order, by finite elements
(`operator` has the integrals).

All of it is known with every electrode held at a potential. Electrodes f that float take no current, and
follow the others: u = E u_k with u_f = -Y_ff^-1 Y_fk u_k. By elimination (Schur complement)

    Y' = E^T Y E,  dY' = E^T dY E,  H' = E^T H,  dH'(x) = E^T dH(x) - ((dY E)_f)^T Y_ff^-1 H_f(x)
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from scipy.sparse import csr_matrix

from tomotactile_ros.estimation.displacement import Displacement
from tomotactile_ros.estimation.field import SheetField
from tomotactile_ros.estimation.rim import Rim
from tomotactile_ros.estimation.tables import Lattice, mirrored
from tomotactile_ros.estimation.uneven import bordered_inverse
from tomotactile_ros.sheet.fem import FemSheet


@dataclass(frozen=True)
class FirstOrder:
    """Changes by each of J coefficients, of n electrodes, at M points of a lattice.

    admittance (n, n) Y0 of the even sheet as these elements have it, S; energy (n, n) the same as their
        integrals have it; change (J, n, n) dY0
    share (n, M) H at the points, share_change (J, M, n) dH
    """

    field: SheetField
    rim: Rim
    admittance: np.ndarray
    energy: np.ndarray
    change: np.ndarray
    share: np.ndarray
    share_change: np.ndarray

    def of(self, used: np.ndarray) -> FirstOrder:
        """The same of the electrodes `used` (n,), all others floating."""
        afloat = np.setdiff1d(np.arange(len(self.admittance)), used)
        if not len(afloat):
            return self
        inverse = np.linalg.inv(self.admittance[np.ix_(afloat, afloat)])
        follow = -inverse @ self.admittance[np.ix_(afloat, used)]

        def folded(columns: np.ndarray) -> np.ndarray:
            """Of (..., E) for all electrodes."""
            return columns[..., used] + columns[..., afloat] @ follow

        def both(matrices: np.ndarray) -> np.ndarray:
            return folded(np.swapaxes(folded(matrices), -1, -2))

        drawn = folded(self.change)[:, afloat]  # by the floating ones, at rest
        through = (inverse @ self.share[afloat]).T
        return replace(
            self,
            admittance=both(self.admittance),
            energy=both(self.energy),
            change=both(self.change),
            share=folded(self.share.T).T,
            share_change=folded(self.share_change) - through @ drawn,
        )


def first_order(
    fem: FemSheet,
    fields: Displacement,
    lattice: Lattice,
    pitch: float,
    known: SheetField | None,
    by_radius: np.ndarray,
) -> FirstOrder:
    """That of an even sheet `fem` with electrodes `pitch`, m, apart: by the modes of its field, those of
    `known` where there are some, by anisotropy, the ways of its rim, and the logarithm of all radii, of
    which `fields` and `by_radius` (E,), ohm, tell."""
    mesh, layout = fem.mesh, fem.layout
    inverse = bordered_inverse(fem.electrode_electrode, np.arange(layout.electrodes))
    fed = np.vstack([fem._to_electrodes.T, np.ones(len(fem.where))])
    shares = (inverse @ fed)[:-1].T[fem.unknown]
    corners, area, slope = _gradients(mesh.points, mesh.triangles)
    middles = corners.mean(axis=1)
    field = known.on(middles) if known else SheetField(layout, middles, area, pitch)
    order, cells = field.order, list(pairwise(field.ends))
    root = np.sqrt(area / float(layout.sheet_resistance))[:, None, None]
    gradient = (root * np.einsum("tcd,tcn->tdn", slope, shares[mesh.triangles]))[order]
    parts = [_flat(gradient[low:high]) for low, high in cells]
    by_cell = np.array([part.T @ part for part in parts])
    along, across = gradient[:, 0], gradient[:, 1]
    mixed = along.T @ across
    rim = Rim(
        layout.outline,
        layout.tolerance.cut(layout.outline.size),
        mesh.points,
        mesh.triangles,
    )
    strips, cut = rim.changes(shares, float(layout.sheet_resistance))
    turned = [along.T @ along - across.T @ across, mixed + mixed.T]
    wider = fields.wider(by_radius)
    by_field = np.tensordot(field.modes.T, by_cell, 1)

    places = mirrored(lattice.points, np.array(layout.outline.size) / 2)
    element, weights = mesh.locate(places)
    corners = fem.unknown[mesh.triangles[element]]
    feed = np.zeros((len(fem.where), len(places)))
    for corner in range(3):
        np.add.at(feed, (corners[:, corner], np.arange(len(places))), weights[:, corner])
    at_places = np.einsum("kce,kc->ek", fem._to_electrodes[corners], weights)
    share = inverse @ np.vstack([at_places, np.ones(len(places))])
    potential = fem._solve(feed) - fed.T @ share
    count, unknowns = len(potential), fem.unknown[mesh.triangles[order]]  # (T, 3)
    slopes = (root * slope.transpose(0, 2, 1))[order]  # (T, 2, 3)
    # what the currents of H bring to the unknowns of each cell: fewer than elements
    inside = np.repeat(np.arange(len(cells)), np.diff(field.ends))[:, None] * count + unknowns
    pairs, number = np.unique(inside, return_inverse=True)
    brought = _scattered(slopes, number.reshape(-1, 3), len(pairs)) @ _flat(gradient)
    at = np.searchsorted(pairs, np.arange(len(cells) + 1) * count)
    seen = np.array([-potential[pairs[l:h] % count].T @ brought[l:h] for l, h in pairwise(at)])
    seen_by_field = np.tensordot(field.modes.T, seen, 1)
    seen_by_field -= field.cell_values(places).T[:, :, None] * seen.sum(axis=0)
    gather = _scattered(slopes, unknowns, count)
    ways = gradient * [[1.0], [-1.0]], gradient[:, ::-1]  # along less across, and mixed
    seen_turned = [-potential.T @ (gather @ _flat(each)) for each in ways]
    begins, ends = potential[fem.unknown[rim.ends]]
    seen_cut = -(ends - begins).T @ strips
    corners, weights = mesh.locate(fields.ring)
    on_ring = np.einsum("rcp,rc->rp", potential[fem.unknown[mesh.triangles[corners]]], weights)
    seen_wider = fields.wider_seen(by_radius, on_ring).T
    return FirstOrder(
        field,
        rim,
        inverse[:-1, :-1],
        by_cell.sum(axis=0),
        np.concatenate([by_field, turned, cut, wider[None]]),
        share[:-1],
        np.concatenate([seen_by_field, seen_turned, seen_cut, seen_wider[None]]),
    )


def _flat(gradient: np.ndarray) -> np.ndarray:
    """(2 T, n) of (T, 2, n)."""
    return gradient.reshape(-1, gradient.shape[2])


def _scattered(slopes: np.ndarray, unknowns: np.ndarray, count: int) -> csr_matrix:
    """(count, 2 T) sums over elements of their `slopes` (T, 2, 3) at `unknowns` (T, 3)."""
    ends = np.arange(0, slopes.size + 1, 3)
    columns = np.repeat(unknowns, 2, axis=0).ravel()
    return csr_matrix((slopes.ravel(), columns, ends), (len(ends) - 1, count)).T


def _gradients(
    points: np.ndarray, triangles: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners (T, 3, 2), areas (T,) and gradients (T, 3, 2) of the shape functions of triangles."""
    corners = points[triangles]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    u, v = b - a, c - a
    area = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    edges = np.stack([c - b, a - c, b - a], axis=1)
    slope = np.stack([-edges[:, :, 1], edges[:, :, 0]], axis=-1) / (2 * area)[:, None, None]
    return corners, area, slope
