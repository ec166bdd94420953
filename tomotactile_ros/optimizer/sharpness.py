"""Derivatives of HWHM and position error (`evaluation.metrics`) by the images.

The HWHM is a distance between two points that move with the image: where the contour crosses the
line between two pixels, and the centre of the set f >= h. The crossing has a derivative. The set is
a number of whole pixels; for the derivative of its centre their edge is smoothed over a tenth of
the maximum. Crossings nearly as far as the farthest share its derivative, so that it does not jump
from one to the other.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.evaluation.metrics import HalfMaximum
from tomotactile_ros.layouts.grid import Grid

_EDGE = 0.05  # width of the smoothed edge, in parts of the maximum
_SHARE = 40.0  # crossings at 1 - 1/_SHARE of the largest distance count 1/e as much
_STEEP = 0.02  # smallest difference across a crossing that is believed, in parts of the maximum
_SMALL = 0.01  # of a cell: rounds the tip of |c - p|


def by_images(found: HalfMaximum, images, positions, grid: Grid, by_hwhm, by_error) -> np.ndarray:
    """(K, n) derivative of some number by `images` (K, n), with a positive maximum each.

    Parameters
    ----------
    found : the images' contours
    positions : (n, 2) of the contacts, m
    by_hwhm, by_error : (n,) the number's derivatives by the HWHM and position error of each image
    """
    pixels, image, one, other, t = grid.pixels, found.image, found.one, found.other, found.t
    columns, top = np.arange(images.shape[1]), found.top
    distance = np.linalg.norm(found.arm, axis=1)
    share = np.exp((distance / found.hwhm[image] - 1) * _SHARE)
    share *= by_hwhm[image] / np.bincount(image, share, len(columns))[image]
    unit = found.arm / distance[:, None]
    slope = share * (unit * (pixels[other] - pixels[one])).sum(axis=1)
    gap = images[one, image] - images[other, image]
    least = _STEEP * top[image]
    gap = np.where(np.abs(gap) < least, least * np.sign(gap), gap)
    offset = found.centre - positions
    error = np.hypot(np.linalg.norm(offset, axis=1), _SMALL * min(grid.cell_size))
    by_centre = (by_error / error)[:, None] * offset
    np.add.at(by_centre, image, -share[:, None] * unit)
    relative = _through_set(images / top, pixels, found.centre, by_centre)
    out = relative / top
    np.add.at(out, (one, image), slope * (1 - t) / gap)
    np.add.at(out, (other, image), slope * t / gap)
    out[found.peak, columns] -= (relative * images).sum(axis=0) / top**2
    out[found.peak, columns] -= np.bincount(image, slope / gap, len(columns)) / 2
    return out


def _through_set(images, pixels, centre, by_centre):
    """(K, n) derivative by images of maximum 1, through the pixels that belong to the set."""
    member = 1 / (1 + np.exp((0.5 - images) / _EDGE))
    reach = pixels @ by_centre.T - (centre * by_centre).sum(axis=1)
    return reach * member * (1 - member) / (_EDGE * member.sum(axis=0))
