"""Lattice cells and patches of the unit disc, and how many cells a length is cut into."""

import math
from functools import lru_cache

import numpy as np

from tomotactile_ros.layouts.region import MAX_CELLS, Region, regular_polygon
from tomotactile_ros.scenes.contact_patches import STRIP, disc_rim, join
from tomotactile_ros.scenes.profile import patch_means
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

_LEAST_CELLS = 3  # along each side of a contact's bounding box; a disc keeps all 9


def cells_along(length: float, spacing: float) -> int:
    """Number of lattice cells over a length, none longer than ``spacing`` (m)."""
    count = length / spacing if spacing > 0 else math.nan
    if not count <= MAX_CELLS:
        checks.positive(spacing, "spacing", "length in m")
        raise InputError(too_fine(spacing))
    return max(_LEAST_CELLS, math.ceil(count * (1 - 1e-12)))


def too_fine(spacing: float) -> str:
    """What to say of a ``spacing`` (m) that makes too many cells."""
    return f"spacing: {spacing:g} m cuts a contact into more than {MAX_CELLS} cells"


@lru_cache(maxsize=64)
def unit_disc_cells(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Cells of the unit disc under a lattice of count x count: (Q, 2) points, (Q,) areas."""
    if count**2 > MAX_CELLS:
        raise InputError(too_fine(2 / count) + " of a disc of radius 1")
    points, areas = Region(regular_polygon(1.0)).cells(count, count)
    return points, areas * (math.pi / areas.sum())


@lru_cache(maxsize=64)
def unit_disc_patches(across: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Patches of the unit disc, ``across`` to its width: points (Q, 2), areas and radii (Q,)."""
    spacing = np.ptp(regular_polygon(1.0), axis=0).max() / across
    cells, areas = unit_disc_cells(cells_along(2.0, spacing))
    return join(*disc_rim(spacing), cells, areas, spacing)


@lru_cache(maxsize=64)
def unit_disc_pressures(profile: str, across: int) -> np.ndarray:
    """(Q,) mean pressures on these patches, in parts of the mean over the disc."""
    points, areas, _ = unit_disc_patches(across)
    pressures = patch_means(profile, points, areas, 2 / across * STRIP)
    pressures.setflags(write=False)
    return pressures
