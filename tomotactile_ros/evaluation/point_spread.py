"""Images of single contacts at every pixel: the columns of one matrix, by blocks of its symmetry.

The image of a bare contact at pixel k, one step of eq. 1 of Kojima et al. 2023, is V0 times
column k of

    M = (J'J + lambda^2 I)^-1 J'J = I - lambda^2 S,        S = (J'J + lambda^2 I)^-1

J'J comes from `gram`, its blocks from `symmetry`: on the square one eighth of the contacts is
enough, and instead of one 1600 x 1600 matrix four of about 200 and one of 400 are inverted.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.linalg import lapack

from tomotactile_ros.evaluation.gram import Gram
from tomotactile_ros.evaluation.metrics import Quality, quality
from tomotactile_ros.evaluation.symmetry import Symmetry, find_symmetry
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.support.errors import InputError

LEAST_REGULARIZATION = 1e-9  # below, J'J + lambda^2 I loses its inverse to rounding
MOST_CELLS = 400  # contact positions along the longer side
REGULARIZATION = 1000.0  # lambda^2 of the paper
RESOLUTION = 40  # contact positions, and pixels, along the longer side


@dataclass(frozen=True, eq=False)
class Blocks:
    """J'J of all pixels of `grid`, in the `blocks` of its `symmetry`."""

    grid: Grid
    gram: Gram
    symmetry: Symmetry
    blocks: list[np.ndarray]


def gram_blocks(transfer, grid: Grid, symmetry: Symmetry | None = None, grounded=None) -> Blocks:
    """J'J for the pixels of `grid`, which are also the points of `transfer`.

    symmetry : of the transfer, none is used without it; grounded : (L,) ground conditions, all
    without it; must have the symmetry
    """
    symmetry = symmetry or find_symmetry(grid, np.array([[np.pi, np.e]]))
    gram = Gram(transfer, grounded)
    return Blocks(grid, gram, symmetry, symmetry.split(gram.rows(symmetry.first)))


class PointSpread:
    """M, and S block by block in `inverse`, for one lambda^2, the `regularization`."""

    def __init__(self, blocks: Blocks, regularization: float = REGULARIZATION):
        self.grid, self.symmetry = blocks.grid, blocks.symmetry
        self.regularization = float(regularization)
        self.inverse = [self._invert(block) for block in blocks.blocks]

    def _invert(self, block):
        """S of one block of J'J."""
        matrix = (block + block.T) / 2
        matrix[np.diag_indices_from(matrix)] += self.regularization
        factor, info = lapack.dpotrf(matrix, lower=True, overwrite_a=True)
        if info:
            raise InputError(
                "regularization: is too small for this layout, J'J + lambda^2 I has no inverse"
            )
        inverse, _ = lapack.dpotri(factor, lower=True, overwrite_c=True)
        return np.tril(inverse) + np.tril(inverse, -1).T

    @cached_property
    def images(self) -> np.ndarray:
        """(K, n) images of unit contacts at the pixels `symmetry.first`, V per V."""
        first = self.symmetry.first
        out = -self.regularization * self.symmetry.join(self.inverse)
        out[first, np.arange(len(first))] += 1
        return out

    def apply(self, vectors) -> np.ndarray:
        """M @ `vectors` (K, m)."""
        out = np.empty_like(vectors)
        for element in self.symmetry.pixels:
            out[element[self.symmetry.first]] = self.images.T @ vectors[element]
        return out

    @cached_property
    def noise_gain(self) -> float:
        """Noise of a pixel per noise of a reading, V per V: root mean square over the pixels."""
        total = sum(
            count * (np.trace(s) - self.regularization * np.vdot(s, s))
            for count, s in zip(self.symmetry.multiplicities, self.inverse)
        )
        return float(np.sqrt(total / len(self.symmetry.orbit)))

    def quality(self) -> Quality:
        """HWHM, position error and blur of the contacts at all K pixels."""
        first, orbit = self.symmetry.first, self.symmetry.orbit
        one = quality(self.images.T, self.grid.pixels[first], self.grid)
        return Quality(
            self.grid.pixels, one.hwhm[orbit], one.position_error[orbit], one.blur[orbit]
        )
