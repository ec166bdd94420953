"""Contacts in an image, told apart by its topology.

Every pixel belongs to the peak that steepest ascent leads to. A peak whose height above the saddle to a
higher neighbour (its prominence) is small is a part of that neighbour.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomotactile_ros.grid import Grid

FLOOR = 0.3  # of the highest pixel; what is lower is no contact
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
    floor = floor * top
    flat = image.ravel()
    labels, peaks = _basins(image)
    peaks = peaks[flat[peaks] > floor]
    owner = _merge(flat, labels.reshape(image.shape), peaks, floor, prominence)
    number = np.cumsum(grid.inside.ravel()) - 1
    blobs = []
    for peak in np.unique(owner):
        pixels = np.flatnonzero(np.isin(labels, peaks[owner == peak]) & (flat > floor))
        blobs.append(_blob(flat, pixels, peak, grid, number))
    return sorted(blobs, key=lambda blob: -blob.peak)


def _basins(image):
    """(H W,) index of the peak above each pixel, and the (n,) peaks."""
    height, width = image.shape
    padded = np.full((height + 2, width + 2), -np.inf)
    padded[1:-1, 1:-1] = image
    best = image.copy()
    index = np.arange(image.size).reshape(image.shape)
    target = index.copy()
    for dy in (-1, 0, 1):
        for dx in (-1, 0, 1):
            if dy or dx:
                other = padded[1 + dy : height + 1 + dy, 1 + dx : width + 1 + dx]
                # among equals the first index wins, so that a plateau has one peak
                higher = (other > best) | ((other == best) & (dy * width + dx < 0) & (target == index))
                best = np.where(higher, other, best)
                target = np.where(higher, index + dy * width + dx, target)
    target = target.ravel()
    while True:
        further = target[target]
        if np.array_equal(further, target):
            return target, np.unique(target)
        target = further


def _merge(flat, labels, peaks, floor, prominence):
    """(n,) index of the peak that each peak belongs to, at last itself."""
    pairs = []
    for first, second in (
        (labels[:, :-1], labels[:, 1:]),
        (labels[:-1], labels[1:]),
        (labels[:-1, :-1], labels[1:, 1:]),
        (labels[:-1, 1:], labels[1:, :-1]),
    ):
        pairs.append((first, second))
    image = flat.reshape(labels.shape)
    lows = (
        np.minimum(image[:, :-1], image[:, 1:]),
        np.minimum(image[:-1], image[1:]),
        np.minimum(image[:-1, :-1], image[1:, 1:]),
        np.minimum(image[:-1, 1:], image[1:, :-1]),
    )
    saddles = []
    for (first, second), low in zip(pairs, lows):
        border = (first != second) & (low > floor)
        saddles += zip(low[border].tolist(), first[border].tolist(), second[border].tolist())
    owner = {int(peak): int(peak) for peak in peaks}

    def root(peak):
        while owner[peak] != peak:
            peak = owner[peak]
        return peak

    for low, first, second in sorted(saddles, reverse=True):
        first, second = root(first), root(second)
        if first == second:
            continue
        lower, higher = sorted((first, second), key=lambda p: flat[p])
        if flat[lower] - low < prominence * flat[lower]:
            owner[lower] = higher
    return np.array([root(int(peak)) for peak in peaks])


def _blob(flat, pixels, peak, grid, number):
    height = flat[peak]
    core = pixels[flat[pixels] >= height / 2]
    weights = flat[core] - (0.5 - 1e-9) * height
    position = weights @ grid.centres[core] / weights.sum()
    centre = core[np.argmin(((grid.centres[core] - position) ** 2).sum(axis=1))]
    area = len(core) * grid.cell_area
    return Blob(number[pixels], position, int(number[centre]), float(height), area)
