"""Arrangements of electrodes beside grids (`layout.equal_grid`): a ring, and spread evenly over any outline.

Lengths are rounded to a picometre: the same numbers give the same file on every machine.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import MAX_ELECTRODES, Layout, half_sides, rounded
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

USUAL_SIZE = 0.2, 0.2  # m, of a grid's sheet where nothing is said
MAX_SPREAD = 1024  # electrodes over an outline
_CELLS = 20  # along the longer side for each electrode along it, while electrodes are spread
_SWEEPS = 100


def electrode_ring(
    count: int,
    circle: float,
    radius: float,
    sheet_resistance: float,
    inset: float = 0.0,
    name: str | None = None,
    unusual_size: bool = False,
) -> Layout:
    """Equally spaced electrodes on a circle around the centre of a round sheet.

    Parameters
    ----------
    count : number of electrodes, at least 3.
    circle : radius of the sheet, m.
    radius, sheet_resistance : as in :class:`Layout`.
    inset : distance of the centres from the rim, m.
    unusual_size : as of :class:`Outline`.

    Electrode 0 lies on the +x axis, the others follow counter-clockwise.
    """
    count = checks.integer(count, "ring", 3, MAX_ELECTRODES)
    outline = Outline.circle(circle, unusual_size=unusual_size)
    reach, _ = half_sides(outline, inset)
    angle = 2 * np.pi * np.arange(count) / count
    positions = rounded(reach * np.column_stack([np.cos(angle), np.sin(angle)]))
    return Layout(name or f"ring-{count}", outline, sheet_resistance, radius, positions)


def spread_electrodes(
    count: int,
    outline: Outline,
    radius: float | None,
    sheet_resistance: float,
    inset: float = 0.0,
    name: str | None = None,
) -> Layout:
    """Electrodes spread evenly over any outline: each in the middle of what is nearest to it.

    Parameters
    ----------
    count : number of electrodes, at least 2.
    radius : m; None: `usual_radius`. sheet_resistance : as in :class:`Layout`.
    inset : least distance of a centre from the rim, m.

    Centroidal Voronoi cells by Lloyd's method (1982) from points each as far as can be from those
    before it: the outermost lie half a spacing inside the rim.
    """
    count = checks.integer(count, "electrodes", 2, MAX_SPREAD)
    checks.not_negative(inset, "inset", "length in m")
    cells = Grid.for_outline(outline, min(int(_CELLS * np.sqrt(count)) + _CELLS, 400)).pixels
    cells = cells[outline.rim_distance(cells) >= inset]
    if len(cells) < 4 * count:
        raise InputError(f"inset: {inset:g} m leaves no room for {count} electrodes")
    chosen = [0]
    away = np.linalg.norm(cells - cells[0], axis=1)
    while len(chosen) < count:
        chosen.append(int(np.argmax(away)))
        away = np.minimum(away, np.linalg.norm(cells - cells[chosen[-1]], axis=1))
    places = cells[chosen]
    for _ in range(_SWEEPS):
        owner = cKDTree(places).query(cells)[1]
        size = np.maximum(np.bincount(owner, minlength=count), 1)[:, None]
        middle = np.column_stack([np.bincount(owner, c, count) for c in cells.T]) / size
        on = outline.holds(middle, inset)
        places = np.where(on[:, None], middle, places)  # of a bent cell it may lie in a hole
    places = rounded(places)
    if radius is None:
        radius = usual_radius(float(cKDTree(places).query(places, k=2)[0][:, 1].min()), False)
    return Layout(name or f"spread-{count}", outline, sheet_resistance, radius, places)


def usual_radius(pitch: float, few: bool) -> float:
    """Radius of an electrode, m: 5 mm for ``few`` of them and 2.5 mm otherwise, as in Kojima et
    al. 2023, but no more than a tenth of the ``pitch`` (m)."""
    return float(rounded(min(0.005 if few else 0.0025, pitch / 10)))
