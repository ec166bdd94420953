"""Where contacts are looked at: places and pairs all over a sheet, on no lattice of electrodes."""

from __future__ import annotations

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.support.errors import InputError

CONTACT_RADIUS = 0.005  # m, a fingertip
PLACES = 10  # contacts along the longer side
PAIR_PITCHES = 0.6  # two contacts where pitches differ: 40 mm with 4 x 4 electrodes on 200 mm


def usual_apart(layout: Layout) -> float:
    """Distance of two contacts, m, that tells layouts of so many electrodes apart: 0.6 spacings of
    as many spread evenly, rim to rim where they are a square grid."""
    return PAIR_PITCHES * float(np.sqrt(layout.outline.area) / (np.sqrt(layout.electrodes) - 1))


def has_room_for_pairs(layout: Layout, apart: float, radius: float) -> bool:
    """Whether two discs of `radius`, m, lie on the sheet `apart`, m, from each other anywhere."""
    return len(pairs(layout, lattice(layout, PLACES, radius), apart, radius)[0]) > 0


def has_room(layout: Layout, radius: float) -> bool:
    """Whether a disc of `radius`, m, lies wholly on the sheet anywhere that is looked at."""
    try:
        return len(lattice(layout, PLACES, radius)) > 0
    except InputError:
        return False


def lattice(layout: Layout, places: int, radius: float = CONTACT_RADIUS) -> np.ndarray:
    """(P, 2) middles, m, of discs of `radius` (m) that lie wholly on the sheet, `places` along its
    longer side.

    One to a cell, moved within it by a fixed share (additive recurrence of the plastic number,
    Roberts 2018), so that no lattice of electrodes is favoured. (A disc across the rim shows where
    the part of it lies that is on the sheet; where the rest is, nothing tells.)
    """
    xmin, ymin, xmax, ymax = layout.outline.bounds
    low, high = np.array([xmin, ymin]) + radius, np.array([xmax, ymax]) - radius
    if not np.all(high > low):
        raise _no_room(radius)
    columns, rows = np.maximum(1, np.round(places * (high - low) / (high - low).max())).astype(int)
    x, y = np.meshgrid(np.arange(columns), np.arange(rows))
    share = np.arange(1, columns * rows + 1)[:, None] * np.array([0.7548776662, 0.5698402910]) % 1
    at = (np.column_stack([x.ravel(), y.ravel()]) + share) / [columns, rows]
    points = low + at * (high - low)
    found = points[_on_sheet(layout, points, radius)]
    if not len(found):
        raise _no_room(radius)
    return found


def _no_room(radius):
    return InputError(
        f"contact radius: no disc of {radius:g} m has room on the sheet; a smaller one may have"
    )


def _on_sheet(layout, points, radius):
    """(P,) which discs at `points` (P, 2) lie wholly on the sheet."""
    return layout.outline.holds(points, radius - 1e-9 * max(layout.outline.size))


def pairs(
    layout: Layout, centres: np.ndarray, apart: float, radius: float
) -> tuple[np.ndarray, np.ndarray]:
    """Middles (Q, 2) and ways (Q, 2), m, of pairs of discs of `radius`, m, about `centres` that lie on
    the sheet, each turned another way."""
    angle = 2 * 2.399963 * np.arange(len(centres))  # twice the golden angle
    middles, ways = centres, apart * np.column_stack([np.cos(angle), np.sin(angle)])
    there = np.ones(len(middles), bool)
    for sign in (1, -1):
        there &= _on_sheet(layout, middles + sign * ways / 2, radius)
    return middles[there], ways[there]
