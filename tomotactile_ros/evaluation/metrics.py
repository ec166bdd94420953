"""How sharp and how accurate the image of one contact is.

For a contact at p and its image f (Kojima et al. 2023, section 2.2): h is half of the maximum, c
the centre of mass of all pixels with f >= h, HWHM the largest distance from c to the contour f = h,
and the position error PE = |c - p|. The paper leaves three things open; here the set need not be
connected, its pixels weigh the same, and the contour runs straight between crossings found by
linear interpolation between neighbouring pixels (then the farthest point is always a crossing). The
rim of the sheet is no contour.

HWHM alone rewards images that are sharp at the wrong place. The blur is the root mean square
distance of the squared image from the true position: it grows with the width and with the error of
position.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomotactile_ros.layouts.grid import Grid

_CHUNK = 256  # images at a time: bounds the memory of the temporaries


@dataclass(frozen=True, eq=False)
class Quality:
    """Quality of the images of contacts at P positions, all in m.

    positions (P, 2), hwhm (P,), position_error (P,), blur (P,)
    """

    positions: np.ndarray
    hwhm: np.ndarray
    position_error: np.ndarray
    blur: np.ndarray


def quality(images, positions, grid: Grid) -> Quality:
    """HWHM, position error and blur of each image.

    Parameters
    ----------
    images : (P, K) values of the pixels inside the outline, any unit
    positions : (P, 2) where the contacts are, m
    grid : the image's cells

    Returns
    -------
    Quality. An image without a positive value shows nothing: its centre is the middle of
    the sheet and its HWHM the distance to the farthest pixel.
    """
    images = np.asarray(images, float)
    positions = np.asarray(positions, float).reshape(-1, 2)
    parts = [
        half_maximum(np.ascontiguousarray(images[start : start + _CHUNK].T), grid)
        for start in range(0, len(images), _CHUNK)
    ]
    hwhm = np.concatenate([part.hwhm for part in parts])
    centre = np.concatenate([part.centre for part in parts])
    error = np.linalg.norm(centre - positions, axis=1)
    return Quality(positions, hwhm, error, blur(images, positions, grid))


def blur(images, positions, grid: Grid) -> np.ndarray:
    """(P,) root mean square distance from `positions` (P, 2) of the squared `images` (P, K), m."""
    weight = np.square(images)
    x, y = grid.pixels.T
    moments = weight @ np.column_stack([np.ones(len(x)), x, y, x**2 + y**2])
    p = np.asarray(positions, float)
    total = np.where(moments[:, 0] > 0, moments[:, 0], 1.0)
    middle = moments[:, 1:3] / total[:, None]
    square = moments[:, 3] / total - 2 * (middle * p).sum(axis=1) + (p**2).sum(axis=1)
    return np.sqrt(np.maximum(square, 0))


def worst(values) -> float:
    """Mean of the largest tenth of the values."""
    values = np.sort(np.ravel(values))
    return float(values[-max(1, round(0.1 * len(values))) :].mean())


def statistics(values) -> dict[str, float]:
    """Mean, worst tenth (its mean) and worst of the values."""
    return {
        "mean": float(np.mean(values)),
        "worst_tenth": worst(values),
        "worst": float(np.max(values)),
    }


@dataclass(frozen=True, eq=False)
class HalfMaximum:
    """What n images have at half of their maximum.

    peak (n,) pixel of the maximum, top (n,) its value, centre (n, 2) of all pixels above, m;
    hwhm (n,) largest distance from it to a crossing, m.

    Crossings of the contour, C in all images: `image` (C,) where, between the pixels `one` and
    `other` (C,), at the part `t` (C,) of the way, `arm` (C, 2) from the centre, m
    """

    peak: np.ndarray
    top: np.ndarray
    centre: np.ndarray
    hwhm: np.ndarray
    image: np.ndarray
    one: np.ndarray
    other: np.ndarray
    t: np.ndarray
    arm: np.ndarray


def half_maximum(images, grid: Grid) -> HalfMaximum:
    """Contours and centres of `images` (K, n)."""
    columns = np.arange(images.shape[1])
    peak = images.argmax(axis=0)
    top = images[peak, columns]
    above = (images >= top / 2) & (top > 0)
    centre = (grid.pixels.T @ above / np.maximum(above.sum(axis=0), 1)).T
    first, second = _neighbours(grid)
    edge, image = np.nonzero(above[first] != above[second])
    one, other = first[edge], second[edge]
    here, there = images[one, image], images[other, image]
    t = (here - top[image] / 2) / (here - there)
    arm = grid.pixels[one] + t[:, None] * (grid.pixels[other] - grid.pixels[one]) - centre[image]
    hwhm = np.zeros(len(columns))
    np.maximum.at(hwhm, image, np.linalg.norm(arm, axis=1))
    for flat in np.flatnonzero(hwhm == 0):  # no contour
        hwhm[flat] = np.linalg.norm(grid.pixels - centre[flat], axis=1).max()
    return HalfMaximum(peak, top, centre, hwhm, image, one, other, t, arm)


def _neighbours(grid):
    """Indices of pixels side by side, and one above the other."""
    number = np.full(grid.shape, -1)
    number[grid.inside] = np.arange(np.count_nonzero(grid.inside))
    first = np.concatenate([number[:, :-1].ravel(), number[:-1].ravel()])
    second = np.concatenate([number[:, 1:].ravel(), number[1:].ravel()])
    both = (first >= 0) & (second >= 0)
    return first[both], second[both]
