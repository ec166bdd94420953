"""How sharp and how true an image of one contact is.

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

from tomotactile_ros.grid import Grid

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
        _half_maximum(images[start : start + _CHUNK], grid)
        for start in range(0, len(images), _CHUNK)
    ]
    hwhm = np.concatenate([part[0] for part in parts])
    centre = np.concatenate([part[1] for part in parts])
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


def worst(values, part: float = 0.1) -> float:
    """Mean of the largest `part` of the values."""
    values = np.sort(np.ravel(values))
    return float(values[-max(1, round(part * len(values))) :].mean())


def statistics(values) -> dict[str, float]:
    """Mean, worst tenth (its mean) and worst of the values."""
    return {
        "mean": float(np.mean(values)),
        "worst_tenth": worst(values),
        "worst": float(np.max(values)),
    }


def _half_maximum(images, grid):
    """(P,) HWHM and (P, 2) centre of images (P, K)."""
    top = images.max(axis=1, keepdims=True)
    above = (images >= top / 2) & (top > 0)
    count = np.maximum(above.sum(axis=1), 1)
    centre = above @ grid.pixels / count[:, None]
    farthest = np.zeros(len(images))
    inside = grid.inside
    number = np.full(grid.shape, -1)
    number[inside] = np.arange(np.count_nonzero(inside))
    for first, second in ((number[:, :-1], number[:, 1:]), (number[:-1], number[1:])):
        pair = np.flatnonzero((first >= 0) & (second >= 0))
        first, second = first.ravel()[pair], second.ravel()[pair]
        image, edge = np.nonzero(above[:, first] != above[:, second])
        if len(image):
            one, other = first[edge], second[edge]
            half = top[image, 0] / 2
            here, there = images[image, one] - half, images[image, other] - half
            t = (here / (here - there))[:, None]
            crossing = grid.pixels[one] * (1 - t) + grid.pixels[other] * t
            distance = np.linalg.norm(crossing - centre[image], axis=1)
            np.maximum.at(farthest, image, distance)
    flat = np.flatnonzero(farthest == 0)
    if len(flat):
        apart = np.linalg.norm(grid.pixels - centre[flat, None], axis=2)
        farthest[flat] = apart.max(axis=1)
    return farthest, centre
