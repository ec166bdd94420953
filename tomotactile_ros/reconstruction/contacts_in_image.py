"""Contacts in an image, told apart by its topology.

Every pixel belongs to the peak that steepest ascent leads to. A peak whose height above the saddle
to a higher neighbour (its prominence) is small is a part of that neighbour.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tomotactile_ros.layouts.grid import Grid

FLOOR = 0.2  # of the highest pixel; what is lower is no contact
PROMINENCE = 0.1  # least height above the saddle to a higher contact, in parts of the own peak


@dataclass(frozen=True)
class Blob:
    """A part of an image with one peak.

    pixels : (n,) the blob's pixels, numbers among the K pixels of the grid
    position : (2,) centre of the upper half, m
    centre : number of the pixel nearest to it
    peak : highest value
    area : of the upper half, m^2
    """

    pixels: np.ndarray
    position: np.ndarray
    centre: int
    peak: float
    area: float


def find_blobs(
    image: np.ndarray, grid: Grid, floor: float = FLOOR, prominence: float = PROMINENCE
) -> list[Blob]:
    """Blobs of `image` (H, W), 0 outside the outline, highest first."""
    top = float(image.max())
    if not top > 0:
        return []
    padded = np.zeros((image.shape[0] + 2, image.shape[1] + 2))
    padded[1:-1, 1:-1] = image
    flat, width = padded.ravel(), padded.shape[1]
    places = np.flatnonzero(flat > floor * top)
    places = places[np.argsort(-flat[places], kind="stable")]  # number 0 is the highest pixel
    values = flat[places]
    number = np.full(flat.size, len(places))
    number[places] = np.arange(len(places))
    around = number[places + _neighbours(width)]  # (8, n), n where below the floor
    basin = _climb(around)
    cells = places - width - 1 - 2 * (places // width - 1)
    if not basin.any():
        return [_blob(values, cells, grid)]
    owner = _join(values, around, basin, prominence)
    members = [owner == peak for peak in np.unique(owner)]
    return [_blob(values[own], cells[own], grid) for own in members]


@lru_cache(maxsize=8)
def _neighbours(width):
    around = [-width - 1, -width, -width + 1, -1, 1, width - 1, width, width + 1]
    return np.array(around)[:, None]


def _climb(around):
    """(n,) number of the peak that steepest ascent from each pixel leads to.

    Pixels are numbered from the highest, equal ones in the order of the image: the neighbour with
    the lowest number is the way up, and a plateau has one peak.
    """
    own = np.arange(around.shape[1])
    target = np.minimum(around.min(axis=0), own)
    if np.count_nonzero(target == own) == 1:
        return np.zeros_like(own)
    while True:
        further = target[target]
        if (further == target).all():
            return target
        target = further


def _join(values, around, basin, prominence):
    """(n,) `basin` with peaks of little prominence made part of what they lean on."""
    here = np.broadcast_to(np.arange(len(values)), around.shape)
    border = (around > here) & (np.append(basin, -1)[around] != basin) & (around < len(values))
    saddle = around[border]  # the lower pixel of each pair across a border
    order = np.argsort(saddle, kind="stable")
    owner = {int(peak): int(peak) for peak in np.unique(basin)}

    def root(peak):
        while owner[peak] != peak:
            peak = owner[peak]
        return peak

    pairs = zip(saddle[order], basin[here[border]][order], basin[saddle][order])
    seen = set()
    for low, first, second in pairs:
        first, second = sorted((root(int(first)), root(int(second))))
        if first == second or (first, second) in seen:
            continue
        seen.add((first, second))
        if values[second] - values[low] < prominence * values[second]:
            owner[second] = first
    roots = {peak: root(peak) for peak in owner}
    return np.array([roots[int(peak)] for peak in basin])


def _blob(values, cells, grid):
    """Blob of the image's `cells`, highest first."""
    height = float(values[0])
    core = int(np.searchsorted(-values, -height / 2, side="right"))
    places = grid.centres[cells[:core]]
    weights = values[:core] - (0.5 - 1e-9) * height
    position = weights @ places / weights.sum()
    x, y = (places - position).T
    number = _numbers(grid)
    centre = cells[(x * x + y * y).argmin()]
    return Blob(number[cells], position, int(number[centre]), height, core * grid.cell_area)


@lru_cache(maxsize=8)
def _numbers(grid):
    """(H W,) number of each cell among those inside."""
    if grid.inside.all():
        return np.arange(grid.inside.size)
    return np.cumsum(grid.inside.ravel()) - 1
