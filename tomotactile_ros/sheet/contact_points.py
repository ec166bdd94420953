"""Contacts of finite size as points of a `Transfer`, with resistances to the driving layer."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from tomotactile_ros.sheet.transfer import Sheet, Transfer, electrode_of
from tomotactile_ros.support import memory

SAME = 1.0  # patches closer than this part of the smaller radius become one


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
    outline are left out; a patch that overlaps an electrode feeds it; patches in the same place
    conduct side by side.
    """
    patches = [each for each, _ in contacts]
    points, areas, radii = map(np.concatenate, zip((np.empty((0, 2)), [], []), *patches))
    conductance = np.concatenate(
        [np.empty(0), *(np.broadcast_to(g, len(each[1])) for each, g in contacts)]
    )
    inside = sheet.layout.outline.contains(points, 1e-9 * max(sheet.layout.outline.size))
    points, radii = points[inside], radii[inside]
    with np.errstate(invalid="ignore"):  # no area, infinite conductance: no contact
        flow = np.nan_to_num((areas * conductance)[inside], nan=0.0, posinf=np.inf)
    owner = electrode_of(points, sheet.layout, radii)
    points = np.where(owner[:, None] >= 0, sheet.layout.positions[owner], points)
    kept, group = _together(points, radii, owner)
    memory.check(40.0 * len(kept) ** 2, f"contacts: {len(contacts)}, in {len(kept)} patches,")
    with np.errstate(divide="ignore", over="ignore"):
        resistance = 1 / np.bincount(group, flow, len(kept))
    return sheet.transfer(points[kept], radii[kept]), resistance


def _together(
    points: np.ndarray, radii: np.ndarray, owner: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Indices of the points that stand for all, and for every point the one that stands for it."""
    first = np.arange(len(points))
    on, off = np.flatnonzero(owner >= 0), np.flatnonzero(owner < 0)
    leader = np.full(owner.max(initial=-1) + 1, len(points))
    np.minimum.at(leader, owner[on], on)
    first[on] = leader[owner[on]]
    if len(off) > 1:
        reach = SAME * radii[off].max()
        close = off[cKDTree(points[off]).query_pairs(reach, output_type="ndarray")]
        apart = np.linalg.norm(points[close[:, 0]] - points[close[:, 1]], axis=1)
        close = close[apart < SAME * radii[close].min(axis=1)]
        for one, other in close[np.lexsort(close.T[::-1])]:
            first[other] = first[one]
    kept = np.flatnonzero(first == np.arange(len(points)))
    return kept, np.searchsorted(kept, first)
