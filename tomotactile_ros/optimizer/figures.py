"""The figures of one layout, and their gradient by the electrode positions.

The gradient goes the way of the computation back: images -> blocks of M -> J'J (`gram`) -> G ->
positions. With S = (J'J + lambda^2 I)^-1 and M = I - lambda^2 S a change of J'J gives
dM = lambda^2 S d(J'J) S. Only the last link, G by the position of an electrode, is a central
difference of the closed form.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.evaluation.metrics import half_maximum
from tomotactile_ros.evaluation.paper_model import green, green_self
from tomotactile_ros.evaluation.point_spread import PointSpread, gram_blocks
from tomotactile_ros.evaluation.symmetry import find_symmetry
from tomotactile_ros.optimizer.scenes import SceneBlur
from tomotactile_ros.optimizer.sharpness import by_images

_WORST = 0.1
_STEP = 1e-6  # of the sheet's size


class Figures:
    """One evaluation on a `Lattice`: `values`, four for each lambda^2, then that of scenes."""

    def __init__(self, lattice, positions):
        self._positions = np.asarray(positions, float)
        self._size = lattice.reference.outline.size
        self._radius = lattice.reference.radius
        self._grid = grid = lattice.grid
        symmetry = find_symmetry(grid, self._positions) if lattice.differentiable else None
        transfer = lattice.transfer(self._positions, symmetry)
        blocks = gram_blocks(transfer, grid, symmetry)
        self._gram, self._symmetry = blocks.gram, blocks.symmetry
        self._targets = grid.pixels[self._symmetry.first]
        self._spreads = [PointSpread(blocks, each) for each in lattice.regularizations]
        self._found = [half_maximum(spread.images, grid) for spread in self._spreads]
        values = [each for both in zip(self._spreads, self._found) for each in self._four(*both)]
        self._scenes = None
        if lattice.scenes is not None:
            self._scenes = SceneBlur(lattice.scenes, self._spreads[0])
            values.append(self._scenes.value)
        self.values = np.array(values)

    def _four(self, spread, found):
        mean, tenth = self._weights(found.hwhm)
        error = np.linalg.norm(found.centre - self._targets, axis=1)
        return mean @ found.hwhm, tenth @ found.hwhm, mean @ error, spread.noise_gain

    def _weights(self, hwhm):
        """(n,) weights of the mean and of the mean of the worst tenth."""
        sizes = self._symmetry.sizes
        order = np.argsort(-hwhm, kind="stable")
        before = np.cumsum(sizes[order]) - sizes[order]
        tenth = np.zeros(len(sizes))
        tenth[order] = np.clip(_WORST * sizes.sum() - before, 0, sizes[order])
        return sizes / sizes.sum(), tenth / tenth.sum()

    def gradient(self, by_values) -> np.ndarray:
        """(E, 2) per m from the derivatives by `values`, for moves that keep the symmetry."""
        symmetry = self._symmetry
        by_block = [0.0] * len(symmetry.multiplicities)
        fours = by_values[: 4 * len(self._spreads)].reshape(-1, 4)
        for spread, found, by in zip(self._spreads, self._found, fours):
            for j, part in enumerate(self._through_images(spread, found, by)):
                by_block[j] = by_block[j] + part
        seed = symmetry.join(by_block).T * symmetry.sizes[:, None]
        if self._scenes is not None:
            seed += by_values[-1] * self._scenes.by_rows()
        return self._through_green(*self._gram.adjoint(symmetry.first, seed))

    def _through_images(self, spread, found, by):
        """Derivatives by the blocks of J'J from those by the four figures of one lambda^2."""
        symmetry, regularization = self._symmetry, spread.regularization
        mean, tenth = (each / symmetry.sizes for each in self._weights(found.hwhm))
        by_image = by_images(
            found,
            spread.images,
            self._targets,
            self._grid,
            by[0] * mean + by[1] * tenth,
            by[2] * mean,
        )
        by_total = by[3] / (2 * spread.noise_gain * len(symmetry.orbit))
        for part, s in zip(symmetry.split(by_image.T), spread.inverse):
            change = regularization * (part + part.T) / 2
            change += by_total * (2 * regularization * s - np.eye(len(s)))
            yield s @ change @ s

    def _through_green(self, by_point, by_between):
        """(E, 2) from the derivatives by G; one electrode of each kind stands for the others."""
        symmetry, size, radius = self._symmetry, self._size, self._radius
        kinds = symmetry.kinds
        stays = (symmetry.electrodes[:, kinds] == kinds).sum(axis=0)[:, None]
        by_point = _gather(by_point, symmetry.electrodes[:, kinds], symmetry.pixels) / stays
        both = by_between + by_between.T
        both = _gather(both, symmetry.electrodes[:, kinds], symmetry.electrodes) / stays
        own = both[np.arange(len(kinds)), kinds] / 2
        both[np.arange(len(kinds)), kinds] = 0
        step = _STEP * max(size)
        slope = np.zeros((len(kinds), 2))
        for axis in range(2):
            for sign in (1, -1):
                moved = self._positions[kinds] + sign * step * np.eye(2)[axis]
                values = by_point * green(moved, self._grid.pixels, size, radius)
                ties = both * green(moved, self._positions, size, radius)
                self_term = own * green_self(moved, size, radius)
                slope[:, axis] += sign * (values.sum(axis=1) + ties.sum(axis=1) + self_term)
        out = np.zeros(self._positions.shape)
        out[kinds] = slope / (2 * step)
        return out


def _gather(values, rows, columns):
    """Sum over the group of values[g rows][:, g columns]."""
    return sum(values[np.ix_(row, column)] for row, column in zip(rows, columns))
