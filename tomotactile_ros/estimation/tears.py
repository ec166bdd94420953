"""Where a sheet is torn, from touches that no contacts explain.

The couplings of the electrodes, the entries of Y off its diagonal, tell of the sheet wherever nothing
touches between two of them. Rows of rho = 1 - v are those of Z up to factors; symmetry tells these, and
Y is the inverse, up to a factor that most couplings have in common (as `reconstruction.admittance` has
it). The median of several touches in different places is the sheet's.

A cut across the potentials takes current off (a crack of length l, normal e; topological derivative,
Amstutz, Horchani and Masmoudi 2005):

    dY_nk = -(pi l^2 / 4 R) (e . grad H_n) (e . grad H_k)

The place and direction that explain most of what couplings lack are where the search for both ends
begins; there the sheet is solved with the cut by finite elements. How much couplings may err otherwise
(unevenness, outline) is `_ERR`; outliers count by their size alone. From there on readings tell the ends,
as unknowns beside contacts and sensor (`refined`): couplings have the currents of contacts in them.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import suppress

import numpy as np
from scipy.linalg import cho_factor, cho_solve
from scipy.optimize import least_squares

from tomotactile_ros.estimation.as_cut import Tears, torn
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.information import information
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.solver import solve
from tomotactile_ros.estimation.uneven import bordered_inverse
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.sheet.fem import FemSheet
from tomotactile_ros.support.errors import InputError

_ERR = 0.05  # of the logarithm of a coupling: uneven sheets have 0.05 to 0.2
_STEPS = 60  # of the fixed point of the factors of rows
_LEAST = 1e-3  # of a coupling: less is as good as none
_PER_PITCH = 4  # places to one spacing of the electrodes, where a tear may begin
_DIRECTIONS = 8  # over half a turn
_LENGTHS = 0.6, 1.5, 3.0  # spacings that a tear is tried with
_ROUGH = 3e-3  # m: ends are known to that by couplings, at best
_NEAR = 3e-4  # m: the same by readings
_STEP = 0.01  # spacings: of a derivative, whose error moves the end by as much
_TRIED = 15  # steps of a search, of five solutions each
_HELPS = 0.75  # of what couplings are off by: what is left at most, of a tear that is one
_REFINED = 4  # steps of ends by readings themselves
MOST = 2  # tears
# the same of one where it begins: of tears that are there 0.4 to 0.8, of swapped wires and second ones that are not 0.96
# and more
_BEGUN = 0.9
# of what readings leave beyond noise, what they leave at most with tears that are some
EXPLAIN = 0.5


def couplings(
    operator: SheetOperator, frames: np.ndarray, gain: np.ndarray, offset: np.ndarray
) -> np.ndarray:
    """(n, n) S, couplings of the sheet as `frames` (F, n, n) show them, in parts of the drive voltage, row l
    with electrode l grounded; `gain` (n,), `offset` (n,)."""
    own, seen = np.arange(operator.count), operator.seen
    ratios = []
    for frame in frames:
        share = 1 - (frame - offset) / gain
        share[own, own] = 1.0
        if not np.isfinite(share).all():
            continue
        factor, sums = np.ones(len(own)), share.sum(axis=1)
        for _ in range(_STEPS):
            factor = share.T @ factor / sums
            factor /= factor.mean()
        impedance = factor[:, None] * share
        try:
            found = np.linalg.inv((impedance + impedance.T) / 2)
        except np.linalg.LinAlgError:
            continue
        ratio = np.where(seen, found / np.where(seen, operator.expected, 1.0), np.nan)
        ratios.append(ratio / np.nanmedian(ratio))
    if not ratios:
        return operator.expected
    return np.where(seen, np.median(ratios, axis=0), 1.0) * operator.expected


def find_tears(operator: SheetOperator, measured: np.ndarray) -> Tears:
    """Tears beside those of the `operator` that explain the couplings `measured` (n, n), S; none where none
    does."""
    seen, whole = np.triu(operator.seen, 1), operator.cut
    wanted = _logarithm(measured[seen] / operator.expected[seen])
    even = _couplings(whole, operator.used)
    tears: Tears = ()
    now = np.zeros(len(wanted))
    while len(tears) < MOST:
        lacking = np.zeros(seen.shape)
        lacking[seen] = (np.exp(wanted) - np.exp(now)) * operator.expected[seen]
        begun = _begin(operator, lacking + lacking.T)

        def told(ends: np.ndarray, others: Tears = tears) -> np.ndarray:
            x, y, to_x, to_y = map(float, ends)
            try:
                found = _couplings(torn(whole, (*others, (x, y, to_x, to_y))), operator.used)
            except InputError:  # a part is cut off
                return np.full(len(wanted), np.inf)
            return _logarithm(found[seen] / even[seen])

        starts = [begun(length * operator.pitch) for length in _LENGTHS]
        costs = [_cost(told(ends) - wanted) for ends in starts]
        if min(costs) > _BEGUN * _cost(now - wanted):
            break
        best, then = _nearest(told, wanted, starts[int(np.argmin(costs))], operator.pitch)
        if not _cost(then - wanted) <= _HELPS * _cost(now - wanted):
            break
        tears = (*tears, _on_sheet(whole.outline, best))
        now = told(np.array(tears[-1]), tears[:-1])
    return tears


def refined(fits: Sequence[Fit], made: Callable[[Tears], SheetOperator]) -> tuple[Tears, list[Fit]]:
    """Ends that explain the readings of `fits` best, contacts and sensor of each following, and the fits then;
    `made` the operator of a sheet with other tears."""
    best, length = list(fits), np.inf
    for _ in range(_REFINED):
        step = _ends_of(best)
        length = float(np.abs(step).max())
        tears = _moved(best[0].operator.tears, step)
        with suppress(InputError):  # the sheet is in pieces
            operator = made(tears)
            found = [solve(operator, fit.unknowns, fit.rows, fit.prior) for fit in best]
            if sum(fit.cost for fit in found) < sum(fit.cost for fit in best):
                best = found
                if length > _NEAR:
                    continue
        break
    return best[0].operator.tears, best


def _ends_of(fits: Sequence[Fit]) -> np.ndarray:
    """(T, 4) m, a step of Gauss and Newton of the ends of the tears that `fits` have."""
    operator = fits[0].operator
    ends = np.array(operator.tears)
    step, modes = _STEP * operator.pitch, operator.modes
    normal, right = np.eye(ends.size) / operator.pitch**2, np.zeros(ends.size)
    beside = []
    for each in np.eye(ends.size):
        way = step * each.reshape(ends.shape)
        try:
            beside.append((operator.torn_beside(_moved(operator.tears, way)), step))
        except InputError:
            beside.append((operator.torn_beside(_moved(operator.tears, -way)), -step))
    for fit in fits:
        slopes = [
            (fit.misfit - Fit(other, fit.unknowns, fit.rows, fit.prior).misfit) / by
            for other, by in beside
        ]
        found = information(operator, fit.unknowns, fit.rows, fit.prior, 1.0, more=np.array(slopes))
        own = np.arange(modes, modes + ends.size)
        rest = np.delete(np.arange(len(found.vector)), own)
        of_sensor = found.matrix[np.ix_(rest, rest)] + fit.prior.matrix
        pull = found.vector[rest] - fit.prior.pull(fit.prior.apart(fit.unknowns))
        mixed = found.matrix[np.ix_(own, rest)]
        scale = 1 / np.sqrt(of_sensor.diagonal())
        factor = cho_factor(of_sensor * np.outer(scale, scale))
        back = scale[:, None] * cho_solve(factor, scale[:, None] * mixed.T)
        normal += found.matrix[np.ix_(own, own)] - mixed @ back
        right += found.vector[own] - back.T @ pull
    return np.linalg.solve(normal, right).reshape(ends.shape)


def _moved(tears: Tears, by: np.ndarray) -> Tears:
    """With ends that are `by` (T, 4), m, elsewhere."""
    return tuple((float(x), float(y), float(u), float(v)) for x, y, u, v in np.array(tears) + by)


def _on_sheet(outline: Outline, ends: np.ndarray) -> tuple[float, float, float, float]:
    """The part of a tear that is on the sheet."""
    parts = outline.parts_of(ends.reshape(2, 2))
    x, y, to_x, to_y = np.concatenate([parts[0][0], parts[-1][-1]]).tolist() if parts else ends
    return float(x), float(y), float(to_x), float(to_y)


def _couplings(layout: Layout, used: np.ndarray) -> np.ndarray:
    """(n, n) Y of the electrodes `used` (n,) of an even sheet, S."""
    return bordered_inverse(FemSheet(layout).electrode_electrode, used)[:-1, :-1]


def _logarithm(ratio: np.ndarray) -> np.ndarray:
    return np.log(np.maximum(ratio, _LEAST))


def _cost(off: np.ndarray) -> float:
    """Of logarithms that are `off`, in deviations; of those that are far off their size."""
    return float((2 * (np.sqrt(1 + (off / _ERR) ** 2) - 1)).sum())


def _nearest(
    told: Callable[[np.ndarray], np.ndarray], wanted: np.ndarray, start: np.ndarray, pitch: float
) -> tuple[np.ndarray, np.ndarray]:
    """The ends (4,), m, near `start` that tell the logarithms `wanted`, and what they tell."""
    known: dict[bytes, np.ndarray] = {}

    def off(ends: np.ndarray) -> np.ndarray:
        known[ends.tobytes()] = there = told(ends)
        return (there - wanted) / _ERR

    def slopes(ends: np.ndarray) -> np.ndarray:
        here, columns = known[ends.tobytes()], []
        for step in _STEP * pitch * np.eye(4):
            beside, length = told(ends + step), step.sum()
            if not np.isfinite(beside).all():
                beside, length = told(ends - step), -length
            slope = (beside - here) / length / _ERR
            columns.append(np.where(np.isfinite(slope), slope, 0.0))
        return np.column_stack(columns)

    found = least_squares(
        off,
        start,
        slopes,
        loss="soft_l1",
        x_scale=pitch,
        xtol=_ROUGH / float(np.abs(start).max()),
        ftol=1e-3,
        max_nfev=_TRIED,
    )
    return found.x, known[found.x.tobytes()]


def _begin(operator: SheetOperator, lacking: np.ndarray) -> Callable[[float], np.ndarray]:
    """Where a small cut explains most of what couplings are `lacking`, (n, n), S: (4,) both ends of a tear by
    its length, m."""
    outline = operator.layout.outline
    grid = Grid.for_outline(outline, int(max(outline.size) / operator.pitch * _PER_PITCH) + 1)
    places = grid.pixels
    _, slopes = operator.shares(places, 1e-3 * operator.layout.radius)
    own = np.abs(operator.expected).mean()
    weight = np.where(operator.seen, 1 / (np.abs(operator.expected) + own / 10) ** 2, 0.0)
    best: tuple[float, np.ndarray, np.ndarray] | None = None
    for turn in np.pi / _DIRECTIONS * np.arange(_DIRECTIONS):
        normal = np.array([np.cos(turn), np.sin(turn)])
        across = np.einsum("d,dnk->nk", normal, slopes)
        along = np.einsum("nk,nk->k", (weight * lacking) @ across, across)
        size = np.einsum("nk,nk->k", weight @ across**2, across**2)
        gained = np.where(along < 0, along**2 / np.maximum(size, 1e-300), 0.0)
        at = int(gained.argmax())
        if best is None or gained[at] > best[0]:
            best = float(gained[at]), places[at], normal
    assert best is not None
    _, middle, normal = best
    way = np.array([-normal[1], normal[0]]) / 2
    return lambda length: np.concatenate([middle - length * way, middle + length * way])


def lines(tears: Sequence[tuple[float, float, float, float]]) -> list[str]:
    """Each in words."""
    return [
        "the sheet is torn from ({:+.0f}, {:+.0f}) to ({:+.0f}, {:+.0f}) mm".format(
            *(1e3 * each for each in tear)
        )
        for tear in tears
    ]
