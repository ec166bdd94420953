"""Rows of a sheet whose contacts change from row to row: one ground condition of each state.

The equations are those of `voltages`, for the electrode l that is grounded in the row:

    (Z_l(C, C) + R_l + diag(r_C)) I_C = V0 1,        v_n = (Z_l(n, C) + R_l) I_C

What is small is done for all rows at once; a state of its own is only its n x n system. On a mesh,
a point is a mixture of three unknowns: W (n, U) of them, three in each row of W, makes
G(C, C) = W S W' - (local R / 2 pi) ln |x_i - x_j| of the smooth part S (U, U) of the Green function
between unknowns. Single precision serves for the n x n matrices: voltages come out to 2 uV.

Where contacts are slow, nearly equal states need not all be solved: some are, `_STEP` apart, and
rows between two of them are interpolated, each in its own ground condition; but never between a
state in which a point feeds an electrode and one in which it does not.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.linalg.lapack import sposv

from tomotactile_ros.sheet.contact_points import contact_points
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.sheet.image import image_excess
from tomotactile_ros.sheet.merge import Merged, Track, merge
from tomotactile_ros.sheet.transfer import Sheet
from tomotactile_ros.sheet.voltages import frame
from tomotactile_ros.support import memory

_AT_ONCE = 64  # states
_STEP = 2e-4  # m that a point moves between states that are solved, see docs/model.md
_RATIO = 1e-2  # by which a conductance changes meanwhile
_FAR = 1e6  # steps
_SHARED = 1.5  # elements that contacts move while states share unknowns
_OPEN = 1e18  # ohm, of a point that is not used
_BYTES = 64.0  # for each two points of a state
_LITTLE = 5e7  # bytes, that are there whenever Python is; to ask what is free takes 0.1 ms


def moving_rows(
    sheet: FemSheet,
    tracks: Sequence[Track],
    grounded: np.ndarray,
    drive_voltage: float,
    to_ground: np.ndarray,
) -> np.ndarray:
    """(L, E) potentials, V, of rows that are each taken of another state of the contacts.

    Parameters
    ----------
    tracks : of the contacts, a state for each row
    grounded : (L,) electrode that is grounded in each row
    to_ground : (L,) resistance between that electrode and ground in each row, ohm; infinite: open
    """
    out = np.zeros((len(grounded), sheet.layout.electrodes))
    together = isinstance(sheet, FemSheet) and sheet.shunting
    there = np.array([track.there for track in tracks])
    alike: dict[bytes, list[int]] = {}
    for row in np.flatnonzero(there.any(axis=0)).tolist():
        key = there[:, row].tobytes() if together and np.isfinite(to_ground[row]) else b""
        alike.setdefault(key, []).append(row)
    for key, rows in alike.items():
        chosen = [
            track.states(np.array(rows)) for track in tracks if not key or track.there[rows[0]]
        ]
        solve = _few_states if key else _one_by_one
        out[rows] = solve(sheet, chosen, grounded[rows], drive_voltage, to_ground[rows])
    return out


def _one_by_one(
    sheet: Sheet,
    tracks: Sequence[Track],
    grounded: np.ndarray,
    drive_voltage: float,
    to_ground: np.ndarray,
) -> np.ndarray:
    rows = []
    for i, (ground, wire) in enumerate(zip(grounded, to_ground)):
        contacts = [track.contact(i) for track in tracks if track.there[i]]
        how = {"grounded": [ground], "switch_resistance": wire, "own_reading": True}
        rows += [*frame(*contact_points(sheet, contacts), drive_voltage, **how)]
    return np.array(rows)


def _few_states(
    sheet: FemSheet,
    tracks: Sequence[Track],
    grounded: np.ndarray,
    drive_voltage: float,
    to_ground: np.ndarray,
) -> np.ndarray:
    """(L, E) from as many of the L states as it takes; all contacts are there in all of them."""
    path = _path(tracks)
    chosen = np.diff(np.floor(path), prepend=-1) > 0
    chosen[-1] = True
    if 2 * np.count_nonzero(chosen) > len(path):
        chosen[:] = True
    solved = np.flatnonzero(chosen)
    _check_memory(tracks, min(len(solved), _AT_ONCE))
    found = _merge(sheet, tracks, solved)
    unlike = np.flatnonzero((found.leads[1:] != found.leads[:-1]).any(axis=1))
    for gap in unlike[np.diff(solved)[unlike] > 1]:
        chosen[solved[gap] : solved[gap + 1]] = True
    if np.count_nonzero(chosen) > len(solved):
        solved = np.flatnonzero(chosen)
        found = _merge(sheet, tracks, solved)
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


def _merge(sheet: FemSheet, tracks: Sequence[Track], states: np.ndarray) -> Merged:
    return merge(sheet.layout, [track.states(states) for track in tracks], sheet.reach)


def _check_memory(tracks: Sequence[Track], states: int) -> None:
    points = sum(len(track.patches[1]) for track in tracks)
    what = f"contacts: {len(tracks)}, in {points} patches that change,"
    needed = _BYTES * states * points**2
    if needed > _LITTLE:
        memory.check(needed, what)


def _path(tracks: Sequence[Track]) -> np.ndarray:
    """(L,) how far the states have changed since the first one, in steps that must be solved."""
    steps = np.zeros(len(tracks[0].centers) - 1)
    for track in tracks:
        steps = np.maximum(steps, np.abs(np.diff(track.centers, axis=0)).max(axis=1) / _STEP)
        conductance = track.conductance
        unlike = conductance[1:] != conductance[:-1]
        if unlike.any():
            with np.errstate(divide="ignore", invalid="ignore"):
                ratio = np.abs(np.diff(np.log(conductance), axis=0)) / _RATIO
            ratio = np.where(unlike, np.minimum(np.nan_to_num(ratio, nan=_FAR), _FAR), 0.0)
            steps = np.maximum(steps, ratio.max(axis=1))
    return np.concatenate([[0.0], np.cumsum(steps)])


def _solve(
    sheet: FemSheet,
    found: Merged,
    state: np.ndarray,
    grounded: np.ndarray,
    drive_voltage: float,
    to_ground: np.ndarray,
) -> np.ndarray:
    """(P, E) potentials in `state` (P,) with `grounded` (P,) at ground, behind `to_ground` (P,)."""
    place = _on_mesh(sheet, found)
    system = _green(sheet, found, place)
    _put_electrodes(system, sheet, found, place)
    coupling = _to_electrode(sheet, found, place, state, grounded)
    own = sheet.electrode_electrode[grounded, grounded] + to_ground
    half = coupling - 0.5 * own[:, None]
    on_ground = found.owner[state] == grounded[:, None]
    current = np.empty_like(half)
    covered = (on_ground & found.active[state]).any(axis=1)
    for row in np.flatnonzero(covered):
        each = state[row]
        resistance = found.resistance[each]
        used = found.active[each] & (~on_ground[row] | (resistance + to_ground[row] > 0))
        current[row] = _own_currents(
            system[each].astype(float), resistance, used, half[row], drive_voltage
        )
    if not covered.all():
        some = ~covered
        current[some] = _currents(
            system, found.resistance, found.active, state[some], half[some], drive_voltage
        )
    out = _fed(sheet, found, place, state, current)
    out -= (coupling * current).sum(axis=1)[:, None]
    total = current.sum(axis=1)[:, None]
    return out + (own[:, None] - sheet.electrode_electrode[grounded]) * total


@dataclass(frozen=True, eq=False)
class _Place:
    """Where the n points of T states are on the mesh.

    nodes (U,) unknowns that occur; number, weights (3, T, n) which of them, and their parts in a
    point; local (T, n) sheet resistance around each, ohm/sq; excess (T, n), ohm, what the mesh
    lacks towards the nearest electrode. A point that feeds an electrode is the electrode's unknown.
    """

    nodes: np.ndarray
    number: np.ndarray
    weights: np.ndarray
    local: np.ndarray
    excess: np.ndarray


def _on_mesh(sheet: FemSheet, found: Merged) -> _Place:
    shape = found.owner.shape
    element, weights = sheet.mesh.locate(found.points.reshape(-1, 2))
    corners = sheet.unknown[sheet.mesh.triangles[element]]
    local = _sum(sheet.local[corners].T * weights.T).reshape(shape)
    excess = np.zeros(shape)
    near = np.nonzero((found.nearest >= 0) & (found.owner < 0))
    flat = near[0] * shape[1] + near[1]
    excess[near] = sheet.electrode_excess(
        found.points[near],
        found.radii[near[1]],
        corners[flat],
        weights[flat],
        found.nearest[near],
        local[near],
    )
    corners, weights = (
        np.ascontiguousarray(each.T).reshape(3, *shape) for each in (corners, weights)
    )
    on = found.owner >= 0
    corners[:, on] = found.owner[on]
    weights[:, on] = [[1.0], [0.0], [0.0]]
    used = np.zeros(len(sheet.where), np.bool_)
    used[corners] = True
    nodes = np.flatnonzero(used)
    number = np.empty(len(used), np.intp)
    number[nodes] = np.arange(len(nodes))
    return _Place(nodes, number[corners], weights, local, excess)


def _sum(three: np.ndarray) -> np.ndarray:
    """Sum over the first of the axes, which has three places."""
    return three[0] + three[1] + three[2]


def _green(sheet: FemSheet, found: Merged, place: _Place) -> np.ndarray:
    """(T, n, n) Green function between the points of each state, but for those on electrodes.

    Right in its upper triangle only.
    """
    out = _sandwich(sheet, found, place)
    least, most = place.local.min(), place.local.max()
    if most - least <= 1e-9 * most:
        scale = np.array(most / (2 * np.pi))
    else:
        local = (place.local / (4 * np.pi)).astype(np.float32)
        scale = local[:, :, None] + local[:, None, :]
    found.take_log(out, sheet.metric, scale)
    _add_images(out, sheet, found, place, scale)
    return out


def _add_images(
    out: np.ndarray, sheet: FemSheet, found: Merged, place: _Place, scale: np.ndarray
) -> None:
    """Add `scale` (T, n, n) or () times what images in electrodes exceed those of the mesh by."""
    layout = sheet.layout
    for electrode in np.unique(found.nearest[found.nearest >= 0]):
        apart = np.linalg.norm(found.points - layout.positions[electrode], axis=-1)
        beside = (apart >= layout.radius) & (apart < sheet.reach)
        beside &= (found.nearest == electrode) & found.active
        some = np.flatnonzero(beside.any(axis=0))
        if not len(some):
            continue
        number, weights = (
            np.moveaxis(each[:, :, some], 0, 2) for each in (place.number, place.weights)
        )
        corners = place.nodes[number]
        excess = image_excess(
            sheet, electrode, found.points[:, some], found.radii[some], corners, weights
        )
        chosen = np.ix_(np.arange(len(out)), some, some)
        excess *= scale[chosen] if scale.ndim else scale
        out[chosen] += excess * (beside[:, some, None] & beside[:, None, some])


def _sandwich(sheet: FemSheet, found: Merged, place: _Place) -> np.ndarray:
    """(T, n, n) W_t S W_t' for the symmetric smooth part S of the Green function of a mesh.

    States in which the contacts are nearly in the same places share their unknowns.
    """
    _, states, points = place.number.shape
    near = np.floor(found.way / (_SHARED * sheet.h)).astype(np.intp)
    group = np.cumsum(np.diff(near, prepend=near[0]) > 0)
    nodes, number = _of_each_group(place, group)
    smooth = sheet.smooth(nodes).astype(np.float32)
    size = nodes.shape[1]
    starts = np.arange(0, 3 * states * points + 1, 3)
    weights = place.weights.transpose(1, 2, 0).astype(np.float32).ravel()

    def mixing(part: np.ndarray, parts: int) -> sparse.csr_matrix:
        columns = (number + size * part[:, None]).transpose(1, 2, 0).ravel()
        shape = states * points, parts * size
        return sparse.csr_matrix((weights, columns, starts), shape)

    half = mixing(group, len(nodes)) @ smooth.reshape(-1, size)
    turned = np.ascontiguousarray(half.reshape(states, points, size).transpose(0, 2, 1))
    out = mixing(np.arange(states), states) @ turned.reshape(-1, points)
    return out.reshape(states, points, points)


def _of_each_group(place: _Place, group: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(G, U) unknowns in each group of states, (3, T, n) which of them points are mixed of.

    Groups with fewer of them than others have some unknown again.
    """
    here = np.zeros((group[-1] + 1, len(place.nodes)), bool)
    here[group[:, None], place.number] = True
    row, node = np.nonzero(here)
    several = np.bincount(row)
    at = np.arange(len(row)) - (np.cumsum(several) - several)[row]
    nodes = np.full((len(here), several.max()), place.nodes[0])
    nodes[row, at] = place.nodes[node]
    table = np.empty(here.shape, np.intp)
    table[row, node] = at
    return nodes, table[group[:, None], place.number]


def _put_electrodes(system: np.ndarray, sheet: FemSheet, found: Merged, place: _Place) -> None:
    """Exchange rows and columns of points on electrodes for what the electrodes see."""
    state, point = np.nonzero((found.owner >= 0) & found.active)
    if not len(state):
        return
    seen = _to_electrode(sheet, found, place, state, found.owner[state, point])
    system[state, point] = seen
    system[state, :, point] = seen


def _to_electrode(
    sheet: FemSheet, found: Merged, place: _Place, state: np.ndarray, electrode: np.ndarray
) -> np.ndarray:
    """(P, n) ohm, between all points of `state` (P,) and `electrode` (P,)."""
    between = sheet.to_electrodes[place.nodes[place.number[:, state]], electrode[:, None]]
    between *= place.weights[:, state]
    seen = _sum(between)
    seen += np.where(found.nearest[state] == electrode[:, None], place.excess[state], 0.0)
    return seen


def _fed(
    sheet: FemSheet, found: Merged, place: _Place, state: np.ndarray, current: np.ndarray
) -> np.ndarray:
    """(P, E) sum over the points of `state` (P,) of `_to_electrode` times `current` (P, n)."""
    count = len(place.nodes)
    number = place.number[:, state] + count * np.arange(len(state))[:, None]
    share = place.weights[:, state] * current
    fed = np.bincount(number.ravel(), share.ravel(), len(state) * count)
    out = fed.reshape(-1, count) @ sheet.to_electrodes[place.nodes]
    row, point = np.nonzero(place.excess[state])
    lack = place.excess[state[row], point] * current[row, point]
    np.add.at(out, (row, found.nearest[state[row], point]), lack)
    return out


def _currents(
    green: np.ndarray,
    resistance: np.ndarray,
    used: np.ndarray,
    state: np.ndarray,
    half: np.ndarray,
    drive_voltage: float,
) -> np.ndarray:
    """(P, n) current of each point, A, of rows with no point on their grounded electrodes.

    Z_l(i, j) + R_l = G(i, j) - half_i - half_j. One factorisation serves all rows of a state: with
    A = G + diag(r), a = A^-1 1, b = A^-1 half the current is (V0 + q) a + p b, p being its sum and
    q its product with `half`.

    green (T, n, n), of which the upper triangle counts, is lost; resistance, used (T, n); state
    (P,); half (P, n)
    """
    count = green.shape[1]
    own = green.reshape(len(green), -1)[:, :: count + 1]
    own += np.where(used, np.minimum(resistance, _OPEN), _OPEN)
    several = np.bincount(state, minlength=len(green))
    begin = np.cumsum(several + 1) - several - 1
    order = np.argsort(state, kind="stable")
    place = np.empty(len(state), np.intp)
    place[order] = np.arange(len(state)) + state[order] + 1
    right = np.empty((len(green) + len(state), count), np.float32)
    right[begin], right[place] = 1.0, half
    for each in np.flatnonzero(several).tolist():
        part = right[begin[each] : begin[each] + several[each] + 1]
        system = green[each]
        _, solved, failed = sposv(system.T, part.T, lower=1)
        if failed:
            solved = np.linalg.solve(np.triu(system) + np.triu(system, 1).T, part.T)
        part[:] = solved.T
    a, b = right[begin][state].astype(float), right[place].astype(float)
    alpha, beta, gamma = a.sum(axis=1), 1 - (half * a).sum(axis=1), (half * b).sum(axis=1)
    p = alpha * drive_voltage / (beta**2 - alpha * gamma)
    current = (p * beta / alpha)[:, None] * a + p[:, None] * b
    return np.where(used[state], current, 0.0)


def _own_currents(
    green: np.ndarray,
    resistance: np.ndarray,
    used: np.ndarray,
    half: np.ndarray,
    drive_voltage: float,
) -> np.ndarray:
    """(n,) of one row with a point on its grounded electrode, near a short circuit."""
    system = np.triu(green) + np.triu(green, 1).T - half - half[:, None]
    system = system[np.ix_(used, used)] + np.diag(resistance[used])
    current = np.zeros(len(used))
    current[used] = np.linalg.solve(system, np.full(len(system), drive_voltage))
    return current
