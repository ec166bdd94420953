"""HWHM and position error of images, as in `evaluation.metrics`, with their derivatives.

The HWHM is a distance between two points that move with the image: where the contour crosses the
line between two pixels, and the centre of the set f >= h. The crossing has a derivative. The set is
a number of whole pixels; for the derivative of its centre their edge is smoothed over a tenth of
the maximum. Crossings nearly as far as the farthest share its derivative, so that it does not jump
from one to the other.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tomotactile_ros.grid import Grid

_EDGE = 0.05  # width of the smoothed edge, in parts of the maximum
_SHARE = 40.0  # crossings at 1 - 1/_SHARE of the largest distance count 1/e as much
_STEEP = 0.02  # smallest difference across a crossing that is believed, in parts of the maximum
_SMALL = 0.01  # of a cell: rounds the tip of |c - p|


class Sharpness:
    """HWHM and position error of images over the pixels of `grid`."""

    def __init__(self, grid: Grid):
        number = np.full(grid.shape, -1)
        number[grid.inside] = np.arange(np.count_nonzero(grid.inside))
        one = np.concatenate([number[:, :-1].ravel(), number[:-1].ravel()])
        other = np.concatenate([number[:, 1:].ravel(), number[1:].ravel()])
        inside = (one >= 0) & (other >= 0)
        self._one, self._other = one[inside], other[inside]
        self._pixels = grid.pixels
        self._cell = min(grid.cell_size)

    def __call__(self, images, positions) -> tuple[np.ndarray, np.ndarray, Callable]:
        """Widths, errors and the way back.

        Parameters
        ----------
        images : (K, n), with a positive maximum each; positions : (n, 2), m

        Returns
        -------
        (n,) HWHM, (n,) position error, and back(by_hwhm, by_error), which turns the derivatives
        (n,) of some number by these into its derivatives (K, n) by the images.
        """
        columns = np.arange(images.shape[1])
        peak = images.argmax(axis=0)
        top = images[peak, columns]
        above = images >= top / 2
        centre = (self._pixels.T @ above / above.sum(axis=0)).T
        image, edge = np.nonzero((above[self._one] != above[self._other]).T)
        one, other = self._one[edge], self._other[edge]
        first, second = images[one, image], images[other, image]
        t = (first - top[image] / 2) / (first - second)
        along = self._pixels[other] - self._pixels[one]
        arm = self._pixels[one] + t[:, None] * along - centre[image]
        distance = np.linalg.norm(arm, axis=1)
        hwhm = np.zeros(len(columns))
        np.maximum.at(hwhm, image, distance)
        for flat in np.flatnonzero(hwhm == 0):  # all above half of the maximum: no contour
            hwhm[flat] = np.linalg.norm(self._pixels - centre[flat], axis=1).max()
        offset = centre - positions
        error = np.linalg.norm(offset, axis=1)

        def back(by_hwhm, by_error):
            share = np.exp((distance / hwhm[image] - 1) * _SHARE)
            share *= by_hwhm[image] / np.bincount(image, share, len(columns))[image]
            unit = arm / distance[:, None]
            slope = share * (unit * along).sum(axis=1)
            least = _STEEP * top[image]
            gap = first - second
            gap = np.where(np.abs(gap) < least, least * np.sign(gap), gap)
            by_centre = (by_error / np.hypot(error, _SMALL * self._cell))[:, None] * offset
            np.add.at(by_centre, image, -share[:, None] * unit)
            relative = self._through_set(images / top, centre, by_centre)
            out = relative / top
            np.add.at(out, (one, image), slope * (1 - t) / gap)
            np.add.at(out, (other, image), slope * t / gap)
            out[peak, columns] -= (relative * images).sum(axis=0) / top**2
            out[peak, columns] -= np.bincount(image, slope / gap, len(columns)) / 2
            return out

        return hwhm, error, back

    def _through_set(self, images, centre, by_centre):
        """(K, n) derivative by images of maximum 1, through the pixels that belong to the set."""
        member = 1 / (1 + np.exp((0.5 - images) / _EDGE))
        reach = self._pixels @ by_centre.T - (centre * by_centre).sum(axis=1)
        return reach * member * (1 - member) / (_EDGE * member.sum(axis=0))
