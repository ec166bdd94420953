"""Contacts of finite size as points of a `Transfer`, with resistances to the driving layer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.sheet.transfer import Sheet, Transfer
from tomotactile_ros.support import memory

SAME = 1.0  # patches closer than this part of the smaller radius become one
# radii of a half disc from its straight side to its centroid: so far from the rim of an electrode that goes
# through the middle of a patch is what of this lies beside it
_HALF = 4 / (3 * np.pi)
# radii of an electrode in which potentials fall under a contact, 1 / sqrt(g R): where it is less, all of a patch
# that reaches the electrode feeds it; both hold what lies beside it at the drive voltage
_SHORT = 0.25
# part of a patch: less is rounding, by which a bare conductor would feed an electrode
_TOUCH = 1e-9


Patches = tuple[np.ndarray, np.ndarray, np.ndarray]


def contact_points(
    sheet: Sheet, contacts: Sequence[tuple[Patches, ArrayLike]]
) -> tuple[Transfer, np.ndarray]:
    """Where the patches of any number of contacts meet the sheet.

    Parameters
    ----------
    contacts : for each what `Contact.patches` returns, and its conductance, S/m^2, one or that of
        each patch; infinity for a bare conductor at the drive voltage

    Returns
    -------
    Transfer of n points; (n,) resistance of each to the driving layer, ohm. Patches outside the
    outline are left out; what of a patch lies on an electrode feeds it, by a point of its own, and
    the rest the sheet (`beside_electrodes`); patches in the same place conduct side by side.
    """
    layout = sheet.layout
    patches = [each for each, _ in contacts]
    points, areas, radii = map(np.concatenate, zip((np.empty((0, 2)), [], []), *patches))
    conductance = np.concatenate(
        [np.empty(0), *(np.broadcast_to(g, len(each[1])) for each, g in contacts)]
    )
    inside = layout.outline.contains(points, 1e-9 * max(layout.outline.size)) & (conductance > 0)
    points, areas, radii = points[inside], areas[inside], radii[inside]
    conductance = conductance[inside]
    apart, nearest = layout.nearest(points)
    beside, places = beside_electrodes(layout, points, areas, radii, conductance, apart, nearest)
    off = np.flatnonzero(beside > 0)
    kept, group = _together(points[off], radii[off])
    kept = off[kept]
    of_sheet = flow(areas * beside, conductance)
    onto = np.bincount(nearest, flow(areas * (1 - beside), conductance), layout.electrodes)
    met = np.unique(nearest[beside < 1])
    memory.check(40.0 * len(kept) ** 2, f"contacts: {len(contacts)}, in {len(kept)} patches,")
    with np.errstate(divide="ignore", over="ignore"):
        resistance = 1 / np.append(np.bincount(group, of_sheet[off], len(kept)), onto[met])
    places = np.concatenate([places[kept], layout.positions[met]])
    radii = np.append(radii[kept], np.full(len(met), layout.radius))
    return sheet.transfer(places, radii), resistance


def flow(areas: np.ndarray, conductance: np.ndarray) -> np.ndarray:
    """(...) S, of patches of `areas`, m², with `conductance`, S/m²; no area conducts nothing."""
    with np.errstate(invalid="ignore"):  # no area, infinite conductance
        return np.nan_to_num(areas * conductance, nan=0.0, posinf=np.inf)


def beside_electrodes(
    layout: Layout,
    points: np.ndarray,
    areas: np.ndarray,
    radii: np.ndarray,
    conductance: np.ndarray,
    apart: np.ndarray,
    nearest: np.ndarray,
) -> tuple[np.ndarray, np.ndarray]:
    """What part of patches lies beside electrodes, and where it is.

    Patches are taken for discs, electrodes too: two circles share a lens.

    Parameters
    ----------
    points : (..., 2) of patches of `areas`, m², that act like discs of `radii`, m, with `conductance`, S/m²
        (...,); `apart` (...,) m from the centre of the electrode `nearest`, infinite where none is near

    Returns
    -------
    (...,) part of each; (..., 2) m, `points` themselves, or moved away from the rim of an electrode where the
    middle of a patch is on it or beyond (all of a patch is the electrode's, if that is off the sheet).
    """
    radius, own = layout.radius, np.sqrt(np.broadcast_to(areas, apart.shape) / np.pi)
    beside = np.ones(apart.shape)
    near = np.nonzero(apart < radius + own)
    d, r = np.maximum(apart[near], 1e-12 * radius), own[near]
    with np.errstate(divide="ignore", invalid="ignore"):
        first = np.clip((d * d + r * r - radius**2) / (2 * d * r), -1, 1)
        second = np.clip((d * d + radius**2 - r * r) / (2 * d * radius), -1, 1)
        first, second = np.arccos(first), np.arccos(second)
        lens = r**2 * (first - np.sin(2 * first) / 2) + radius**2 * (
            second - np.sin(2 * second) / 2
        )
        shared = np.where(r > 0, lens / (np.pi * r * r), d < radius)
    shared[shared < _TOUCH], shared[shared > 1 - _TOUCH] = 0, 1
    beside[near] = 1 - shared
    falls = 1 / np.sqrt(np.maximum(conductance * layout.sheet_resistance, 1e-300))
    beside[(falls < _SHORT * radius) & (apart < radius + radii)] = 0
    held = np.nonzero(apart < radius + _HALF * own)
    if not len(held[0]):
        return beside, points
    places = np.array(points)
    centres = layout.positions[nearest[held]]
    way = points[held] - centres
    length = np.linalg.norm(way, axis=-1, keepdims=True)
    moved = centres + (radius + _HALF * own[held])[:, None] * way / np.maximum(length, 1e-300)
    on_sheet = (length[:, 0] > 0) & layout.outline.contains(moved)
    beside[held] *= on_sheet
    places[held] = np.where(on_sheet[:, None], moved, points[held])
    return beside, places


def _together(points: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the points that stand for all, and for every point the one that stands for it."""
    first = np.arange(len(points))
    if len(points) > 1:
        close = cKDTree(points).query_pairs(SAME * radii.max(), output_type="ndarray")
        apart = np.linalg.norm(points[close[:, 0]] - points[close[:, 1]], axis=1)
        close = close[apart < SAME * radii[close].min(axis=1)]
        for one, other in close[np.lexsort(close.T[::-1])]:
            first[other] = first[one]
    kept = np.flatnonzero(first == np.arange(len(points)))
    return kept, np.searchsorted(kept, first)
