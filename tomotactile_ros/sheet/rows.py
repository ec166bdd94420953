"""Rows of a sheet whose contacts change from row to row: one ground condition of each state.

The equations are those of `frames`, for the electrode l that is grounded in the row:

    (Z_l(C, C) + R_l + diag(r_C)) I_C = V0 1,        v_n = (Z_l(n, C) + R_l) I_C

What is small is done for all rows at once; a row of its own is only its n x n system. On a mesh, a
point is a mixture of three unknowns: W (n, U) of them, three in each row of W, makes
G(C, C) = W K W' of the Green function K (U, U) between the unknowns that any row needs.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.linalg.lapack import dposv

from tomotactile_ros.sheet.contacts import Patches, contact_points
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.sheet.frames import frame
from tomotactile_ros.sheet.merge import Merged, merge
from tomotactile_ros.sheet.transfer import Sheet

Touching = Sequence[tuple[Patches, ArrayLike]]
_AT_ONCE = 32  # rows: with more, fast contacts meet too many unknowns


def moving_rows(
    sheet: Sheet,
    touching: Sequence[Touching],
    grounded: np.ndarray,
    drive_voltage: float,
    to_ground: np.ndarray,
) -> np.ndarray:
    """(L, E) potentials, V, of rows that are each taken of another state of the contacts.

    Parameters
    ----------
    touching : for each row what `contact_points` takes
    grounded : (L,) electrode that is grounded in each row
    to_ground : (E,) resistance between each electrode and ground, ohm; infinite: never grounded
    """
    out = np.empty((len(grounded), sheet.layout.electrodes))
    together = isinstance(sheet, FemSheet) and sheet.shunting
    alike: dict[object, list[int]] = {}
    for row, contacts in enumerate(touching):
        counts = tuple(len(patches[1]) for patches, _ in contacts)
        simple = together and sum(counts) and np.isfinite(to_ground[grounded[row]])
        alike.setdefault(counts if simple else None, []).append(row)
    for counts, rows in alike.items():
        for part in [rows[i : i + _AT_ONCE] for i in range(0, len(rows), _AT_ONCE)]:
            contacts = [touching[row] for row in part]
            solve = _one_by_one if counts is None else _together
            out[part] = solve(sheet, contacts, grounded[part], drive_voltage, to_ground)
    return out


def _one_by_one(sheet, touching, grounded, drive_voltage, to_ground):
    rows = [
        frame(
            *contact_points(sheet, contacts),
            drive_voltage,
            grounded=[ground],
            switch_resistance=to_ground,
            own_reading=True,
        )[0]
        for contacts, ground in zip(touching, grounded)
    ]
    return np.array(rows)


def _together(sheet, touching, grounded, drive_voltage, to_ground):
    """(T, E) of states with the same number of patches each."""
    found = merge(sheet.layout, touching)
    corners, weights, local, excess = _on_mesh(sheet, found)
    nodes, number = _numbered(corners, len(sheet.where))
    to_electrodes = sheet.to_electrodes[nodes]  # (U, E)
    row = np.arange(len(grounded))
    coupling = (to_electrodes.T[grounded[:, None, None], number] * weights).sum(axis=2)
    coupling += np.where(found.nearest == grounded[:, None], excess, 0.0)
    system = _green(sheet, found, nodes, number, weights, local)
    _put_electrodes(system, found, to_electrodes, number, weights, excess)
    own = sheet.electrode_electrode[grounded, grounded] + to_ground[grounded]
    half = coupling - 0.5 * own[:, None]
    system -= half[:, :, None]
    system -= half[:, None, :]
    shorted = (found.owner == grounded[:, None]) & (
        found.resistance + to_ground[grounded, None] <= 0
    )
    current = _currents(system, found.resistance, found.active & ~shorted, drive_voltage)
    fed = np.zeros((len(row), len(nodes)))
    place = (row[:, None, None] * len(nodes) + number).ravel()
    fed += np.bincount(place, (weights * current[:, :, None]).ravel(), fed.size).reshape(fed.shape)
    out = fed @ to_electrodes
    place = (row[:, None] * out.shape[1] + found.nearest).ravel()
    out += np.bincount(place, (excess * current).ravel(), out.size).reshape(out.shape)
    total = current.sum(axis=1)
    out -= (coupling * current).sum(axis=1)[:, None]
    return out + (own[:, None] - sheet.electrode_electrode[grounded]) * total[:, None]


def _on_mesh(sheet, found: Merged):
    """Unknowns (T, n, 3) and their weights, local resistance and what the electrode's log lacks.

    A point that feeds an electrode is that electrode's unknown.
    """
    shape = found.owner.shape
    points = found.points.reshape(-1, 2)
    element, weights = sheet.mesh.locate(points)
    corners = sheet.unknown[sheet.mesh.triangles[element]]
    excess, local = sheet.electrode_excess(
        found.radii.ravel(), corners, weights, found.apart.ravel(), found.nearest.ravel()
    )
    corners, weights = corners.reshape(*shape, 3), weights.reshape(*shape, 3)
    on = found.owner >= 0
    corners[on] = found.owner[on][:, None]
    weights[on] = 1.0, 0.0, 0.0
    return corners, weights, local.reshape(shape), np.where(on, 0.0, excess.reshape(shape))


def _numbered(corners, count):
    """Unknowns (U,) that occur in `corners`, and their places among them."""
    used = np.zeros(count, bool)
    used[corners] = True
    nodes = np.flatnonzero(used)
    place = np.empty(count, np.intp)
    place[nodes] = np.arange(len(nodes))
    return nodes, place[corners]


def _green(sheet, found: Merged, nodes, number, weights, local):
    """(T, n, n) Green function between the points of each state, but for those on electrodes."""
    green, log = sheet.between(nodes)
    true_log = found.log_distance()
    least, most = local.min(), local.max()
    if most - least <= 1e-9 * most:
        scale = most / (2 * np.pi)
        out = _sandwich(number, weights, green + scale * log)
        true_log *= scale
        out -= true_log
        return out
    scale = (local[:, :, None] + local[:, None, :]) / (4 * np.pi)
    excess = _sandwich(number, weights, log)
    excess -= true_log
    return _sandwich(number, weights, green) + scale * excess


def _sandwich(number, weights, matrix):
    """(T, n, n) W_t M W_t' for a symmetric matrix M (U, U)."""
    states, points, _ = number.shape
    size, starts = len(matrix), np.arange(0, 3 * states * points + 1, 3)
    data = weights.ravel()
    mixing = sparse.csr_matrix((data, number.ravel(), starts), (states * points, size))
    half = (mixing @ matrix).reshape(states, points, size)
    turned = np.ascontiguousarray(half.transpose(0, 2, 1)).reshape(states * size, points)
    columns = number + size * np.arange(states)[:, None, None]
    mixing = sparse.csr_matrix((data, columns.ravel(), starts), (states * points, states * size))
    return (mixing @ turned).reshape(states, points, points)


def _put_electrodes(system, found: Merged, to_electrodes, number, weights, excess):
    """Exchange rows and columns of points on electrodes for what the electrodes see."""
    state, point = np.nonzero((found.owner >= 0) & found.active)
    if not len(state):
        return
    owner = found.owner[state, point]
    seen = (to_electrodes.T[owner[:, None, None], number[state]] * weights[state]).sum(axis=2)
    seen += np.where(found.nearest[state] == owner[:, None], excess[state], 0.0)
    system[state, point] = seen
    system[state, :, point] = seen


def _currents(system, resistance, used, drive_voltage):
    """(T, n) current of each point, A; 0 where a point is not used."""
    points = np.arange(resistance.shape[1])
    system[:, points, points] += np.where(used, resistance, 0.0)
    state, point = np.nonzero(~used)
    system[state, point] = 0.0
    system[state, :, point] = 0.0
    system[state, point, point] = 1.0
    current = np.where(used, drive_voltage, 0.0)
    for matrix, drive in zip(system, current):
        _, solution, failed = dposv(matrix.T, drive)
        drive[:] = np.linalg.solve(matrix, drive) if failed else solution
    return current
