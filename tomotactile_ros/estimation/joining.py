"""Which of the discs of a fit are one contact.

A palm, a plate or a ring is found as several discs beside each other. Two discs are two contacts
only where the readings say that nothing presses between them: a disc that would fill the gap, as
strong for its area as both, is tried. To first order what it may conduct follows from the normal
equations of the fit with it, all else of contacts, sheet and channels free (Schur complement): if
an estimate so large lies within the deviation, both are one. Where first order says no and the gap is
narrow, all else is fitted anew beside the disc: neighbours that give way to it may leave no trace. Two
long ones are no fingertips, but parts of something; they are two things only if the readings ask for
one more contact, by the evidence that a contact needs anywhere. Discs that touch at some time are one
anyway, and two round ones alone were compared with one ellipse before.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from tomotactile_ros.estimation.arrangement import are_long, chosen, with_cells
from tomotactile_ros.estimation.equations import Linear
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.reported import are_bare
from tomotactile_ros.estimation.shape import columns
from tomotactile_ros.estimation.touch import (
    CONDUCTANCE,
    PARAMETERS,
    RADIUS,
    STRETCH,
    patches_for,
    stretch,
)

# of what two contacts reach towards each other: nearer ones are one; the ends of rectangles are where they are
TOUCHING = 1.15
# of what the harder of two presses: the other does no less if a disc and cells are one
_SADDLE = 0.5
_SURE = 3.0  # standard deviations: what lies within may be
_FAINT = 1e-2  # of what would fill a gap: where the derivative is taken
_RIM = 90  # points of a rim: some mm from each other where a contact is as long as a hand
_NARROW = 0.5  # spacings: wider gaps, and those wider than the narrower disc, show to first order


def groups(
    fit: Fit,
    allows: Callable[[Unknowns, Fit, bool], bool] | None,
    known: np.ndarray | None = None,
) -> np.ndarray:
    """(k,) number of the contact that each disc or cell of a fit belongs to; `allows` says whether the
    readings of a fit allow other contacts as well, or do not ask for one contact more than those; None: only
    those that touch are one.

    known : (k,) the same as far as it is known: of the cells
    """
    contacts, bars = fit.unknowns.contacts, np.array(fit.unknowns.across) < 0
    if len(contacts) < 2:
        return np.zeros(len(contacts), int)
    reach = _reaches(contacts, bars)
    most = np.where(bars, 1.0, TOUCHING)[:, None] * reach
    touching = _nearest(fit) < most + most.T
    reach = reach + reach.T
    gaps = _apart(contacts) - reach
    long = are_long(contacts)
    for i, j in np.argwhere(np.triu(long[:, None] | long, 1)):
        gap = cdist(_rim(contacts[i], bars[i]), _rim(contacts[j], bars[j])).min()
        gaps[i, j] = gaps[j, i] = min(gaps[i, j], gap)
        narrow = sum(np.exp(contacts[[i, j], RADIUS] - np.hypot(*contacts[[i, j], STRETCH:].T)))
        touching[i, j] |= gap < (TOUCHING - 1) * narrow
        touching[j, i] = touching[i, j]
    beside = np.triu(gaps < fit.operator.pitch, 1)
    if known is not None:
        press = np.triu(_press(fit, known), 1)[: fit.unknowns.alone]
        beside[fit.unknowns.alone :] = False
        beside[: fit.unknowns.alone] &= press
        touching &= beside | beside.T
        touching |= known[:, None] == known
    near = np.argwhere(~touching & beside & (allows is not None))
    if known is not None:
        # of discs in the place of parts of a shape it was asked before whether they are one
        near = _between(near[near[:, 1] >= fit.unknowns.alone], gaps, known)
    if (len(contacts) > 2 or long.any()) and len(near):
        may_be = _filled(fit, near)
        for i, j in near[may_be]:
            touching[i, j] = touching[j, i] = True
        widths = 2 * np.exp((contacts[:, RADIUS] + _unsure(fit))[near].min(axis=1))
        most = np.minimum(_NARROW * fit.operator.pitch, widths)
        narrow = near[~may_be & (gaps[tuple(near.T)] < most)]
        for i, j in narrow[np.argsort(gaps[tuple(narrow.T)])]:
            group = connected_components(touching, directed=False)[1]
            if group[i] == group[j]:
                continue
            filled = _with_fillings(fit, np.array([[i, j]]))
            if allows and allows(filled, fit, bool(long[i] and long[j])):
                touching[i, j] = touching[j, i] = True
    return connected_components(touching, directed=False)[1]


def _unsure(fit: Fit) -> np.ndarray:
    """(k,) deviations of the logarithms of radii; 0 where they are not estimated, or the fit is not solved."""
    free = fit.unknowns.free
    out = np.zeros(free.shape)
    if len(fit.covariance):
        out[free] = np.sqrt(fit.covariance.diagonal()[: np.count_nonzero(free)])
    return out[:, RADIUS]


def _press(fit: Fit, known: np.ndarray) -> np.ndarray:
    """(k, k) whether the second presses, for its area, half as hard as the first and the hardest of its contact: cells
    that do not are no part of the gap's side."""
    contacts = fit.unknowns.contacts
    density = contacts[:, CONDUCTANCE] - 2 * contacts[:, RADIUS]
    hardest = np.array([density[known == each].max() for each in known])
    return density > np.log(_SADDLE) + np.minimum(density[:, None], hardest)


def _between(pairs: np.ndarray, gaps: np.ndarray, known: np.ndarray) -> np.ndarray:
    """Of `pairs` (m, 2) the nearest of each contact and each disc."""
    pairs = pairs[np.argsort(gaps[tuple(pairs.T)])]
    sides = np.column_stack([pairs[:, 0], known[pairs[:, 1]]])
    return pairs[np.unique(sides, axis=0, return_index=True)[1]]


def _apart(contacts: np.ndarray) -> np.ndarray:
    """(k, k) distances of contacts (k, 6), m."""
    return np.hypot(*(contacts[:, None, :2] - contacts[:, :2]).transpose(2, 0, 1))


def _reaches(contacts: np.ndarray, bars: np.ndarray) -> np.ndarray:
    """(k, k) m: how far the first of two contacts (k, 6) reaches from its centre towards the
    other's; `bars` (k,) are rectangles."""
    ways = contacts[:, :2] - contacts[:, None, :2]
    apart = np.maximum(np.hypot(*ways.transpose(2, 0, 1)), 1e-12)
    shapes = np.array([stretch(each) for each in contacts]).reshape(-1, 2, 2)
    shrunk = np.einsum("kde,kje->kjd", np.linalg.inv(shapes), ways)
    lengths = np.hypot(*shrunk.transpose(2, 0, 1))
    for i in np.flatnonzero(bars):  # sides of a rectangle of the ellipse's area
        along = np.linalg.eigh(shapes[i])[1]
        lengths[i] = np.abs(shrunk[i] @ along).max(axis=1) / (np.sqrt(np.pi) / 2)
    return apart / np.maximum(lengths, 1e-12)


def _rim(contact: np.ndarray, bar: bool) -> np.ndarray:
    """(m, 2) m, points all along the rim of a contact (6,), a rectangle if it is a `bar`."""
    angles = np.linspace(0.0, 2 * np.pi, _RIM, endpoint=False)
    rim, shape = np.stack([np.cos(angles), np.sin(angles)], axis=-1), np.array(stretch(contact))
    shape = shape.reshape(2, 2)
    if bar:
        rim *= np.sqrt(np.pi) / 2 / np.abs(rim).max(axis=1, keepdims=True)
        shape = shape @ np.linalg.eigh(shape)[1]
    return contact[:2] + rim @ shape.T


def _nearest(fit: Fit) -> np.ndarray:
    """(k, k) distances of the contacts of a fit, m: the least of those before, amid and after the
    rows, if they move. Discs that come to touch each other have never been two things."""
    u, times = fit.unknowns, fit.rows.times
    if times is None or not u.moving.any():
        return _apart(u.contacts)
    moments = float(times.min()), 0.0, float(times.max())
    return np.min([_apart(u.after(each).contacts) for each in moments], axis=0)


def _with_fillings(fit: Fit, pairs: np.ndarray, part: float = 1.0) -> Unknowns:
    """The contacts of a fit and behind its discs fixed ones that fill the gaps between the discs `pairs`
    (m, 2), no wider than the narrower of both, and conduct `part` of what these do for their
    area."""
    u, pitch = fit.unknowns, fit.operator.pitch
    radii = np.exp(u.contacts[:, RADIUS])
    density = np.exp(u.contacts[:, CONDUCTANCE]) / radii**2
    first, second = pairs.T
    reach = _reaches(u.contacts, np.array(u.across) < 0)
    way = u.contacts[second, :2] - u.contacts[first, :2]
    apart = np.hypot(*way.T)
    gaps = np.maximum(apart - reach[first, second] - reach[second, first], 0.0)
    middles = (reach[first, second] + gaps / 2) / apart
    places = u.contacts[first, :2] + way * middles[:, None]
    narrower = np.minimum(radii[first], radii[second])
    widths = np.maximum(gaps / 2, narrower / 2)
    filling = np.minimum(density[first], density[second]) * widths * np.minimum(widths, narrower)
    added = np.zeros((len(pairs), PARAMETERS))
    added[:, :2], added[:, RADIUS] = places, np.log(widths)
    added[:, CONDUCTANCE] = np.log(part * filling)
    across = [patches_for(width, pitch) for width in widths]
    fillings = u.with_contacts(added, across, np.zeros(added.shape, bool))
    order = np.arange(len(u.contacts))
    discs = with_cells(chosen(u, order < u.alone), fillings)
    return with_cells(discs, chosen(u, order >= u.alone))


def _filled(fit: Fit, pairs: np.ndarray) -> np.ndarray:
    """(m,) whether something may press between the discs `pairs` (m, 2), to first order."""
    tried, alone = _with_fillings(fit, pairs, _FAINT), fit.unknowns.alone
    tried.free[alone : alone + len(pairs), CONDUCTANCE] = True
    there = Fit(fit.operator, tried, fit.rows, fit.prior)
    linear, last = Linear(there), columns(there)[alone : alone + len(pairs)]
    rest = np.delete(np.arange(len(linear.normal)), last)
    mixed = linear.normal[np.ix_(rest, last)]
    back = np.linalg.solve(linear.normal[np.ix_(rest, rest)], mixed)
    left = linear.normal[last, last] - np.einsum("rl,rl->l", mixed, back)
    right = linear.right[last] - linear.right[rest] @ back
    found = 1 + right / left  # in parts of what it began with
    # of how bare ones share a current readings tell little, and the model errs at their rims
    doubt = np.where(are_bare(fit)[pairs].any(axis=1), fit.doubt, fit.chi_squared / fit.rows.count)
    deviation = np.sqrt(np.maximum(doubt, 1.0) / left)
    return (found + _SURE * deviation) * _FAINT > 1.0
