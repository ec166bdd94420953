"""Rows of a sheet whose contacts change from row to row: one ground condition of each state.

The equations are those of `frames`, for the electrode l that is grounded in the row:

    (Z_l(C, C) + R_l + diag(r_C)) I_C = V0 1,        v_n = (Z_l(n, C) + R_l) I_C

What is small is done for all rows at once; a row of its own is only its n x n system. On a mesh, a
point is a mixture of three unknowns: W (n, U) of them, three in each row of W, makes
G(C, C) = W K W' of the Green function K (U, U) between the unknowns that any row needs.

Where contacts are slow, nearly equal states need not all be solved: some are, `_STEP` apart, and
rows between two of them are interpolated, each in its own ground condition; but never between a
state in which a point feeds an electrode and one in which it does not.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.linalg.lapack import dposv

from tomotactile_ros import memory
from tomotactile_ros.sheet.contacts import Patches, contact_points
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.sheet.frames import frame
from tomotactile_ros.sheet.merge import Merged, merge
from tomotactile_ros.sheet.transfer import Sheet

Touching = Sequence[tuple[Patches, ArrayLike]]
_AT_ONCE = 16  # states: with more, fast contacts meet too many unknowns
_STEP = 2e-4  # m that a point moves between states that are solved, see docs/model.md
_RATIO = 1e-2  # by which a conductance changes meanwhile
_FAR = 1e6  # steps
_BYTES = 64.0  # for each two points of a state


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
    to_ground : (L,) resistance between that electrode and ground in each row, ohm; infinite: open
    """
    out = np.empty((len(grounded), sheet.layout.electrodes))
    together = isinstance(sheet, FemSheet) and sheet.shunting
    alike: dict[object, list[int]] = {}
    for row, contacts in enumerate(touching):
        counts = tuple(len(patches[1]) for patches, _ in contacts)
        simple = together and sum(counts) and np.isfinite(to_ground[row])
        alike.setdefault(counts if simple else None, []).append(row)
    for counts, rows in alike.items():
        contacts = [touching[row] for row in rows]
        solve = _one_by_one if counts is None else _few_states
        out[rows] = solve(sheet, contacts, grounded[rows], drive_voltage, to_ground[rows])
    return out


def _one_by_one(sheet, touching, grounded, drive_voltage, to_ground):
    rows = [
        frame(
            *contact_points(sheet, contacts),
            drive_voltage,
            grounded=[ground],
            switch_resistance=wire,
            own_reading=True,
        )[0]
        for contacts, ground, wire in zip(touching, grounded, to_ground)
    ]
    return np.array(rows)


def _few_states(sheet, touching, grounded, drive_voltage, to_ground):
    """(L, E) from as many of the L states as it takes; all have the same number of patches."""
    path = _path(touching)
    chosen = np.diff(np.floor(path), prepend=-1) > 0
    chosen[-1] = True
    if 2 * np.count_nonzero(chosen) > len(path):
        chosen[:] = True
    solved = np.flatnonzero(chosen)
    _check_memory(touching[0], min(len(solved), _AT_ONCE))
    found = merge(sheet.layout, [touching[row] for row in solved])
    unlike = np.flatnonzero((found.leads[1:] != found.leads[:-1]).any(axis=1))
    for gap in unlike[np.diff(solved)[unlike] > 1]:
        chosen[solved[gap] : solved[gap + 1]] = True
    if np.count_nonzero(chosen) > len(solved):
        solved = np.flatnonzero(chosen)
        found = merge(sheet.layout, [touching[row] for row in solved])
    before = np.cumsum(chosen) - 1
    between = np.flatnonzero(~chosen)
    start, stop = (path[solved[before[between] + each]] for each in (0, 1))
    length = np.where(stop > start, stop - start, 1.0)
    share = np.zeros((len(path), 1))
    share[between, 0] = (path[between] - start) / length
    state = np.concatenate([before, before[between] + 1])
    ground, wires = (np.concatenate([each, each[between]]) for each in (grounded, to_ground))
    voltages = np.empty((len(state), sheet.layout.electrodes))
    for first in range(0, len(solved), _AT_ONCE):
        part = np.flatnonzero((state >= first) & (state < first + _AT_ONCE))
        some = found.states(slice(first, first + _AT_ONCE))
        voltages[part] = _solve(
            sheet, some, state[part] - first, ground[part], drive_voltage, wires[part]
        )
    out = voltages[: len(path)]
    out[between] += share[between] * (voltages[len(path) :] - out[between])
    return out


def _check_memory(contacts, states):
    points = sum(len(patches[1]) for patches, _ in contacts)
    what = f"contacts: {len(contacts)}, in {points} patches that change,"
    memory.check(_BYTES * states * points**2, what)


def _path(touching):
    """(L,) how far the states have changed since the first one, in steps that must be solved."""
    steps = np.zeros(len(touching) - 1)
    for contact in zip(*touching):
        points = np.array([patches[0] for patches, _ in contact])
        steps = np.maximum(steps, np.abs(np.diff(points, axis=0)).max(axis=(1, 2)) / _STEP)
        conductance = np.array([each for _, each in contact], float).reshape(len(contact), -1)
        unlike = conductance[1:] != conductance[:-1]
        if unlike.any():
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = np.abs(np.diff(np.log(conductance), axis=0)) / _RATIO
            ratio = np.where(unlike, np.minimum(np.nan_to_num(ratio, nan=_FAR), _FAR), 0.0)
            steps = np.maximum(steps, ratio.max(axis=1))
    return np.concatenate([[0.0], np.cumsum(steps)])


def _solve(sheet, found, state, grounded, drive_voltage, to_ground):
    """(P, E) potentials in `state` (P,) with `grounded` (P,) at ground, behind `to_ground` (P,)."""
    corners, weights, local, excess = _on_mesh(sheet, found)
    nodes, number = _numbered(corners, len(sheet.where))
    to_electrodes = sheet.to_electrodes[nodes]  # (U, E)
    system = _green(sheet, found, nodes, number, weights, local)
    _put_electrodes(system, found, to_electrodes, number, weights, excess)
    number, weights, excess, nearest = (
        each[state] for each in (number, weights, excess, found.nearest)
    )
    coupling = (to_electrodes.T[grounded[:, None, None], number] * weights).sum(axis=2)
    coupling += np.where(nearest == grounded[:, None], excess, 0.0)
    own = sheet.electrode_electrode[grounded, grounded] + to_ground
    half = coupling - 0.5 * own[:, None]
    on_ground = found.owner[state] == grounded[:, None]
    free = found.resistance[state] + to_ground[:, None] > 0
    used = found.active[state] & (~on_ground | free)
    alone = (on_ground & found.active[state]).any(axis=1)
    alone |= np.bincount(state, minlength=len(system))[state] == 1
    current = np.empty_like(half)
    current[alone] = _currents(
        system, found.resistance, state[alone], half[alone], used[alone], drive_voltage
    )
    for each in np.unique(state[~alone]):
        rows = np.flatnonzero((state == each) & ~alone)
        current[rows] = _shared_currents(
            system[each], found.resistance[each], half[rows], used[rows[0]], drive_voltage
        )
    row = np.arange(len(state))
    place = (row[:, None, None] * len(nodes) + number).ravel()
    fed = np.bincount(place, (weights * current[:, :, None]).ravel(), len(row) * len(nodes))
    out = fed.reshape(len(row), -1) @ to_electrodes
    place = (row[:, None] * out.shape[1] + nearest).ravel()
    out += np.bincount(place, (excess * current).ravel(), out.size).reshape(out.shape)
    out -= (coupling * current).sum(axis=1)[:, None]
    total = current.sum(axis=1)[:, None]
    return out + (own[:, None] - sheet.electrode_electrode[grounded]) * total


def _on_mesh(sheet, found: Merged):
    """Unknowns (T, n, 3) and their weights, local resistance and what the electrode's log lacks.

    A point that feeds an electrode is that electrode's unknown.
    """
    shape = found.owner.shape
    points = found.points.reshape(-1, 2)
    element, weights = sheet.mesh.locate(points)
    corners = sheet.unknown[sheet.mesh.triangles[element]]
    excess, local = sheet.electrode_excess(
        points, found.radii.ravel(), corners, weights, found.nearest.ravel()
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
    true_log = found.log_distance(sheet.metric)
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


def _currents(green, resistance, state, half, used, drive_voltage):
    """(P, n) current of each point, A, 0 where it is not used: one system for each row.

    green (S, n, n), resistance (S, n), state (P,); Z_l(i, j) + R_l = G(i, j) - half_i - half_j
    """
    current = np.where(used, drive_voltage, 0.0)
    own = np.where(used, resistance[state], 0.0)
    some = ~used.all(axis=1)
    system = np.empty(green.shape[1:])
    diagonal = system.reshape(-1)[:: len(system) + 1]
    for row, each in enumerate(state):
        np.subtract(green[each], half[row], out=system)
        system -= half[row][:, None]
        diagonal += own[row]
        if some[row]:
            _leave_out(system, used[row])
        _, solution, failed = dposv(system.T, current[row])
        current[row] = np.linalg.solve(system, current[row]) if failed else solution
    return current


def _shared_currents(green, resistance, half, used, drive_voltage):
    """The same for rows of one state with no point on their grounded electrodes.

    One factorisation serves them all: with A = G + diag(r), a = A^-1 1, b = A^-1 half the current
    is (V0 + q) a + p b, p being its sum and q its product with `half`. Z_l does not change when a
    constant is added to G and half of it to `half`, which makes A positive definite.
    """
    shift = green[used][:, used].max(initial=1.0)
    half = np.where(used, half + 0.5 * shift, 0.0)
    system = green + shift
    points = np.arange(len(used))
    system[points, points] += np.where(used, resistance, 0.0)
    _leave_out(system, used)
    right = np.column_stack([used.astype(float), half.T])
    _, solved, failed = dposv(system, right)
    if failed:
        solved = np.linalg.solve(system, right)
    a, b = solved[:, 0], solved[:, 1:].T
    alpha, beta, gamma = a.sum(), 1 - half @ a, (half * b).sum(axis=1)
    p = alpha * drive_voltage / (beta**2 - alpha * gamma)
    return (p * beta / alpha)[:, None] * a + p[:, None] * b


def _leave_out(system, used):
    """Make 1 I = 0 of the equations of points that are not used."""
    gone = np.flatnonzero(~used)
    system[gone] = 0.0
    system[:, gone] = 0.0
    system[gone, gone] = 1.0
