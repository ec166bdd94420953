"""What a complete frame tells whoever follows rows: sizes, wide contacts, what was missed or is not
there.

Rows have told of the sensor and of small contacts what the frame tells, which is the same readings:
they keep it, unless a resting contact is significantly elsewhere; then the frame is right, which
fits all rows at once. It tells sizes, contacts that rows missed, and which of theirs are none. Wide
contacts and shapes of several discs are not followed: rows take them for a part of the sheet until
the next frame.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from scipy.stats import chi2

from tomotactile_ros.estimation.estimator import RESTING, TOUCHING, Estimate
from tomotactile_ros.estimation.follow import Follower
from tomotactile_ros.estimation.forward import Prediction, Unknowns
from tomotactile_ros.estimation.row_model import RowModel
from tomotactile_ros.estimation.row_state import STATE, Belief, RowState
from tomotactile_ros.estimation.search import chosen
from tomotactile_ros.estimation.solver import RATES, Fit
from tomotactile_ros.estimation.touch import CONDUCTANCE, RADIUS, STRETCH, X, Y
from tomotactile_ros.estimation.tracks import REACH

_WIDE = 0.4  # spacings: discs with larger radii are more than one patch to electrodes
_STRETCHED = 0.3  # half the logarithm of the ratio of axes beyond which a shape is no disc
_CONTRADICTS = 1e-3  # probability of a difference as large between rows and the frame of the same
_FLOOR = 1e-7  # m²: differences below 0.3 mm are none


def corrected(follower: Follower, state: RowState, fit: Fit, estimate: Estimate, begun: float):
    """Takes a valid frame, whose first row was read at `begun` s and whose last is that of `state`,
    into `state`."""
    operator, unknowns = follower.operator, fit.unknowns
    lasts = 0.0 if fit.rows.times is None else float(fit.rows.times.max())
    seen = unknowns.after(lasts)
    is_wide = _wide(seen, operator.pitch)
    state.wide = _numbered(state, estimate, seen, is_wide, operator.pitch)
    belief, misfit = state.belief, max(1.0, fit.chi_squared / max(fit.rows.count, 1))
    free = set(range(belief.count))
    for i in np.flatnonzero(~is_wide):
        contact, (size, own) = seen.contacts[i], _covariance(fit, i, misfit)
        mean = np.array([contact[X], contact[Y], 0.0, 0.0, contact[CONDUCTANCE]])
        sizes = np.array([contact[RADIUS], size])
        own[[2, 3], [2, 3]] = np.square(RATES[0])
        apart = {j: np.hypot(*(belief.mean[STATE * j :][:2] - contact[:2])) for j in free}
        best = min(apart, key=apart.__getitem__, default=None)
        if best is None or apart[best] > REACH * operator.pitch:
            state.last += 1
            belief = belief.with_contact(mean, own, sizes, state.last, state.time)
            continue
        free.remove(best)
        belief = _agreed(belief, best, mean, own, sizes)
    for j in sorted(free, reverse=True):  # what began within the frame may not be known to it
        if belief.begun[j] <= begun:
            belief = belief.without(j)
    _look_again(follower, state, belief, chosen(seen, is_wide) if is_wide.any() else None)


def _agreed(belief: Belief, which: int, mean, covariance, sizes) -> Belief:
    """The contact `which` of rows with the size that the frame found, and with its place where they
    contradict."""
    at = slice(STATE * which, STATE * which + STATE)
    change = (mean - belief.mean[at])[:2]
    own = belief.covariance[at, at]
    resting = np.hypot(*belief.mean[at][2:4]) < RESTING + 3 * np.sqrt(own[2, 2] + own[3, 3])
    unlike = change @ np.linalg.solve(own[:2, :2] + covariance[:2, :2] + _FLOOR * np.eye(2), change)
    sized = belief.sizes.copy()
    sized[which] = sizes
    belief = replace(belief, sizes=sized)
    if not resting or unlike < chi2.isf(_CONTRADICTS, 2):
        return belief
    moved, spread = belief.mean.copy(), belief.covariance.copy()
    moved[at], spread[at], spread[:, at] = mean, 0.0, 0.0
    spread[at, at] = covariance
    return replace(belief, mean=moved, covariance=spread)


def _look_again(follower: Follower, state: RowState, belief: Belief, wide: Unknowns | None) -> None:
    """Goes on with `belief`, linear about what is known of the sensor by now."""
    operator = follower.operator
    known = state.model.known.moved(belief.shift, wide)
    background = None
    if wide is not None:
        touched = Prediction(operator, wide, np.arange(operator.count))
        background = np.linalg.inv(touched.impedance) - operator.admittance_of(wide.sheet)
    state.model = RowModel(operator, known, background)
    mean = belief.mean.copy()
    mean[STATE * belief.count :] = 0.0
    state.belief, state.unexplained = replace(belief, mean=mean), 0
    state.sums = follower.births.nothing()


def _wide(seen: Unknowns, pitch: float) -> np.ndarray:
    """(k,) bool, contacts that are more than a small disc alone."""
    contacts = seen.contacts
    radii = np.exp(contacts[:, RADIUS])
    out = (radii > _WIDE * pitch) | (np.hypot(*contacts[:, STRETCH:].T) > _STRETCHED)
    apart = np.hypot(*(contacts[:, None, :2] - contacts[:, :2]).transpose(2, 0, 1))
    touching = (apart < TOUCHING * np.add.outer(radii, radii)) & ~np.eye(len(radii), dtype=bool)
    return out | touching.any(axis=1)


def _covariance(fit: Fit, which: int, misfit: float):
    """Variance of ln a, and (5, 5) covariance of x, y, nothing of the velocity, ln c of a contact
    of a fit."""
    free = fit.unknowns.free
    first = int(np.count_nonzero(free[:which]))
    index = {int(each): first + k for k, each in enumerate(np.flatnonzero(free[which]))}
    own = np.zeros((STATE, STATE))
    at = np.ix_([0, 1, 4], [0, 1, 4])
    where = [index[X], index[Y], index[CONDUCTANCE]]
    own[at] = fit.covariance[np.ix_(where, where)] * misfit
    size = fit.covariance[index[RADIUS], index[RADIUS]] * misfit if RADIUS in index else 0.0
    return float(size), own


def _numbered(state: RowState, estimate: Estimate, seen: Unknowns, is_wide, pitch: float) -> list:
    """Contacts of the frame that have wide parts, with their numbers; see `RowState.wide`."""
    if not is_wide.any():
        return []
    before, found = list(state.wide), []
    centres = seen.contacts[is_wide, :2]
    radii = np.exp(seen.contacts[is_wide, RADIUS])
    for contact in estimate.contacts:
        here = np.array([contact.x, contact.y])
        if not (np.hypot(*(centres - here).T) < np.maximum(radii, contact.radius)).any():
            continue
        reach = REACH * pitch + contact.radius
        same = [w for w in before if np.hypot(w[2].x - contact.x, w[2].y - contact.y) < reach]
        if same:
            before.remove(same[0])
            number, began = same[0][:2]
        else:
            state.last += 1
            number, began = state.last, state.time
        found.append((number, began, contact))
    return found
