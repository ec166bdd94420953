"""Other arrangements of contacts, to begin a fit with: one more, one less, several as one, one as two."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace

import numpy as np
from scipy.sparse.csgraph import connected_components
from scipy.spatial.distance import cdist

from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.touch import (
    CONDUCTANCE,
    LONGEST,
    RADIUS,
    SHEAR,
    STRETCH,
    patches_for,
    patches_of,
)
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.region import enclosed

_DISC = np.array([True] * 4 + [False] * 2)  # parameters of a disc that are free
_OVERLAP = 0.9  # of the larger radius: contacts nearer to each other are one
CLOSE = 1.5  # spacings: contacts nearer to each other are tried as one
# half the logarithm of the ratio of axes from which on several contacts are tried as an ellipse
LONG = 0.3


def with_disc(
    unknowns: Unknowns,
    place: Iterable[float],
    strength: float,
    radius: float,
    pitch: float,
    moving: bool = False,
) -> Unknowns:
    """The same with a disc at `place` (2,), m, of conductance `strength`, S, and `radius`, m, at the
    end; `pitch` of the electrodes, m, here and below."""
    contact = np.array([*place, np.log(strength), np.log(radius), 0.0, 0.0])
    return unknowns.joined_by(contact, patches_for(radius, pitch), _DISC, moving)


def other_sides(place: np.ndarray, centre: np.ndarray) -> np.ndarray:
    """(3, 2) m, where a contact at `place` (2,) beside an electrode at `centre` (2,) would be on its three
    other sides: there readings are much the same."""
    x, y = place - centre
    return centre + np.array([[-x, -y], [-y, x], [y, -x]])


def beyond(place: np.ndarray, layout: Layout, used: np.ndarray) -> np.ndarray:
    """(m, 2) m, on which other sides of the electrode next to a contact at `place` (2,) it may be where
    few electrodes tell them apart: beyond the outermost of those in use, or it is there itself."""
    centres = layout.positions[used]
    starts = other_sides(place, centres[np.hypot(*(centres - place).T).argmin()])
    starts = starts[layout.outline.contains(starts)]
    amid = enclosed(np.vstack([place, starts]), centres, layout.radius)
    return starts[~amid[1:]] if amid[0] else starts


def as_discs(unknowns: Unknowns, radii: np.ndarray, pitch: float) -> Unknowns:
    """Discs of `radii` (k,), m, in the place of the contacts."""
    contacts = unknowns.contacts.copy()
    contacts[:, RADIUS], contacts[:, STRETCH:] = np.log(radii), 0.0
    across = tuple(patches_for(radius, pitch) for radius in radii)
    free = np.tile(_DISC, (len(contacts), 1))
    return replace(unknowns, contacts=contacts, across=across, free=free)


def halved(
    unknowns: Unknowns, which: int, radius: float, pitch: float, moving: bool = False
) -> Unknowns | None:
    """The same with two discs of `radius`, m, in the place of contact `which`, at the end of all; None
    if that is not long."""
    contact = unknowns.contacts[which]
    if float(np.hypot(*contact[STRETCH:])) <= LONG:
        return None
    # moments of two points half a long axis from the middle are those of the ellipse
    strength = float(np.exp(contact[CONDUCTANCE])) / 2
    out = chosen(unknowns, np.arange(len(unknowns.contacts)) != which)
    for place in _along(contact)[[0, 2]]:
        out = with_disc(out, place, strength, radius, pitch, moving)
    return out


def are_long(contacts: np.ndarray) -> np.ndarray:
    """(k,) which of `contacts` (k, 6) may be two beside each other, or a part of something longer."""
    return np.hypot(*contacts[:, STRETCH:].T) > LONG


def clusters(contacts: np.ndarray, pitch: float) -> np.ndarray:
    """(k,) number of the cluster of contacts near each other that each of `contacts` (k, 6) is in; of long ones
    their ends count as well."""
    places = np.array([_along(each) for each in contacts]).reshape(-1, 2)
    apart = cdist(places, places).reshape(len(contacts), 3, len(contacts), 3).min(axis=(1, 3))
    return connected_components(apart <= CLOSE * pitch, directed=False)[1]


def _along(contact: np.ndarray) -> np.ndarray:
    """(3, 2) m, both ends of a contact (6,) that is long, half a long axis from the middle, and that."""
    long = float(np.hypot(*contact[STRETCH:]))
    angle = np.arctan2(contact[SHEAR], contact[STRETCH]) / 2
    way = (long > LONG) * np.exp(contact[RADIUS] + long) / 2
    return contact[:2] + way * np.array([[-1], [0], [1]]) * [np.cos(angle), np.sin(angle)]


def most_together(places: np.ndarray, pitch: float) -> int:
    """How many of `places` (k, 2), m, are in the largest cluster of such near each other."""
    near = cdist(places, places) <= CLOSE * pitch
    return (
        int(np.bincount(connected_components(near, directed=False)[1]).max()) if len(places) else 0
    )


def clustered(unknowns: Unknowns, pitch: float) -> Unknowns:
    """The same with one wide contact for each cluster of contacts near each other."""
    if len(unknowns.contacts) < 2:
        return unknowns
    group = clusters(unknowns.contacts, pitch)
    for each in np.unique(group):
        of = np.flatnonzero(group == each)
        if len(of) > 1:
            unknowns = gathered(unknowns, of, pitch)
            group = np.append(np.delete(group, of), each)
    return unknowns


def overlaps(contacts: np.ndarray, which: int) -> bool:
    """Whether a contact and another one lie on each other, so that they are one thing that
    presses."""
    others = np.delete(contacts, which, axis=0)
    apart = np.hypot(*(others[:, :2] - contacts[which, :2]).T)
    reach = np.exp(np.maximum(others[:, RADIUS], contacts[which, RADIUS]))
    return bool((apart < _OVERLAP * reach).any())


def merged(unknowns: Unknowns, which: int, bare: np.ndarray) -> Unknowns:
    """The same without contact `which`, whose place its nearest neighbour takes over by its part in the
    conductance of both, or in their area where one of them is `bare` (k,): of such ones readings do not
    tell what they conduct."""
    contacts = unknowns.contacts.copy()
    apart = np.hypot(*(contacts[:, :2] - contacts[which, :2]).T)
    apart[which] = np.inf
    nearest = int(apart.argmin())
    both = contacts[[which, nearest]]
    filled = bare[[which, nearest]].any()
    own, other = np.exp(2 * both[:, RADIUS] if filled else both[:, CONDUCTANCE])
    if own > 0.1 * other:
        part = own / (own + other)
        contacts[nearest, :2] += part * (contacts[which, :2] - contacts[nearest, :2])
    keep = np.arange(len(contacts)) != which
    return chosen(replace(unknowns, contacts=contacts), keep)


def gathered(unknowns: Unknowns, which: np.ndarray, pitch: float, blurred: float = 0.0) -> Unknowns:
    """The same with one contact in the place of those `which` (m,): as strong as all of them, an
    ellipse of their moments, if these differ by more than how far they may be `blurred`, m²."""
    contacts = unknowns.contacts[which]
    strengths = np.exp(contacts[:, CONDUCTANCE])
    share = strengths / strengths.sum()
    place = share @ contacts[:, :2]
    apart = contacts[:, :2] - place
    # a disc of radius a has the moments a^2 / 4
    moments = (apart * share[:, None]).T @ apart
    own = float(share @ np.exp(2 * contacts[:, RADIUS])) / 4
    value, axis = np.linalg.eigh(moments)
    narrow, long = np.maximum(value - blurred, 0.0) + own
    stretch = min(np.log(long / narrow) / 4, LONGEST)
    value += own
    angle = 2 * np.arctan2(axis[1, 1], axis[0, 1])
    form = unknowns.free[which[0]].copy()
    form[STRETCH:] = stretch > LONG
    p, q = stretch * np.array([np.cos(angle), np.sin(angle)]) * form[STRETCH]
    radius = 2 * (value[0] * value[1]) ** 0.25 if form[STRETCH] else np.sqrt(2 * value.sum())
    one = np.array([*place, np.log(strengths.sum()), np.log(radius), p, q])
    rest = chosen(unknowns, np.delete(np.arange(len(unknowns.contacts)), which))
    moving = bool(unknowns.moving[which].any())
    joined = rest.joined_by(one, patches_of(one, pitch), form, moving)
    joined.rates[-1] = share @ unknowns.rates[which]
    return joined


def one_of(cells: Unknowns, which: np.ndarray, others: Unknowns, pitch: float) -> Unknowns:
    """`others` and a disc or an ellipse in the place of the `cells` `which` (k,) of a shape.

    A point half way between two cells is shown as both, with a moment of a quarter of their squared distance.
    """
    contacts = cells.contacts[which]
    blurred = np.pi / 4 * float(np.exp(2 * contacts[0, RADIUS]))
    discs = np.tile(_DISC, (len(contacts), 1))
    part = cells.with_contacts(contacts, np.array(cells.across)[which].tolist(), discs)
    one = gathered(part, np.arange(len(contacts)), pitch, blurred)
    return others.joined_by(one.contacts[0], one.across[0], one.free[0])


def chosen(unknowns: Unknowns, keep: np.ndarray) -> Unknowns:
    """The same with only the contacts `keep` (mask or indices)."""
    across = tuple(np.array(unknowns.across, int)[keep].tolist())
    kept = unknowns.with_contacts(unknowns.contacts[keep], across, unknowns.free[keep])
    kept = replace(kept, rates=unknowns.rates[keep], moving=unknowns.moving[keep])
    if unknowns.bond is None:
        return kept
    cells = np.arange(len(unknowns.contacts))[keep]
    cells = cells[cells >= unknowns.alone] - unknowns.alone
    bond = np.linalg.inv(np.linalg.inv(unknowns.bond)[np.ix_(cells, cells)])
    return replace(kept, bond=bond if len(cells) else None)


def with_cells(discs: Unknowns, cells: Unknowns) -> Unknowns:
    """`discs` and, behind them, the cells of a shape, on the sensor of these."""
    both = cells.with_contacts(
        np.vstack([discs.contacts, cells.contacts]),
        (*discs.across, *cells.across),
        np.vstack([discs.free, cells.free]),
    )
    return replace(both, bond=cells.bond)


def as_known(unknowns: Unknowns, prior: Prior | Unknowns) -> Unknowns:
    """The same contacts; sheet and channels as expected, or as other unknowns have them."""
    return replace(
        unknowns,
        sheet=prior.sheet,
        gain=prior.gain,
        offset=prior.offset,
        resistance=prior.resistance,
        aside=prior.aside,
    )


def resting(operator: SheetOperator, prior: Prior) -> Unknowns:
    """No contact; sheet and channels as expected."""
    return as_known(Unknowns.at_rest(operator), prior)
