"""What the free optimizer makes small, with its gradient by the electrode positions.

Figures, each relative to the layout that one starts from, over all contact positions and for every
lambda^2:

    mean HWHM,   mean HWHM of the worst tenth,   mean position error,   and the noise gain

HWHM is the spread about the image's own centre and the position error the way from there to the
true position: together they are the blur about the true position. The score is a soft maximum of
all figures, each divided by its aim, so that none can be bought with another:

    log(mean(exp(s r))) / s,    s = 25

The gradient goes the way of the computation back: images -> blocks of M -> J'J (`gram`) -> G ->
positions. With S = (J'J + lambda^2 I)^-1 and M = I - lambda^2 S a change of J'J gives
dM = lambda^2 S d(J'J) S. Only the last link, G by the position of an electrode, is a central
difference of the closed form.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.evaluation.metrics import half_maximum
from tomotactile_ros.evaluation.paper_model import (
    default_contact_radius,
    green,
    green_self,
    transfer_of,
)
from tomotactile_ros.evaluation.point_spread import PointSpread, gram_blocks
from tomotactile_ros.evaluation.symmetry import find_symmetry
from tomotactile_ros.grid import Grid
from tomotactile_ros.layout import Layout
from tomotactile_ros.optimizer.sharpness import by_images
from tomotactile_ros.sheet import make_sheet

SHARPNESS = 25.0
_WORST = 0.1
_STEP = 1e-6  # of the sheet's size


@dataclass(frozen=True)
class Aims:
    """Figures relative to those of the reference layout that count as equally good.

    `central` for the lambda^2 that the layout is made for, `other` for those it is to carry over
    to: mean HWHM, worst tenth, mean position error. `noise_gain` is that of the noise gain, for all
    of them.

    Electrodes that leave the rim are better for all figures but one: at a tenth of lambda^2
    contacts between the rim and the electrodes are drawn to these. How much of that is allowed is
    `other[2]`.
    """

    central: tuple[float, float, float] = (0.8, 0.8, 0.72)
    other: tuple[float, float, float] = (0.95, 0.95, 1.0)
    noise_gain: float = 1.5


class Objective:
    """Score of electrode positions: in the paper's model on a uniform rectangle, and by finite
    elements on every other outline.

    Finite elements have no gradient, and their mesh, which changes with the electrodes, roughens
    the score by some tenths of a per cent.

    Parameters
    ----------
    reference : layout whose figures are 1; gives outline and radius
    regularizations : lambda^2 values, the first is the one that the layout is made for
    resolution : contact positions, and pixels, along the longer side; lambda^2 is scaled to mean
        the same
    """

    def __init__(
        self,
        reference: Layout,
        regularizations=(1000.0, 100.0, 10000.0),
        aims: Aims = Aims(),
        *,
        resolution: int = 40,
    ):
        self.reference = reference
        self.size = reference.outline.size
        self.differentiable = reference.outline.is_uniform_rectangle
        self.grid = Grid.for_outline(reference.outline, resolution)
        finest = Grid.for_outline(reference.outline, 40)
        scale = len(self.grid.pixels) / len(finest.pixels)
        self.regularizations = [scale * each for each in regularizations]
        self._contact_radius = default_contact_radius(reference)
        if self.differentiable:
            self._self = green_self(self.grid.pixels, self.size, self._contact_radius)
        self._aims = _aim_rows(aims, len(self.regularizations))
        self._start = 1.0
        self._start = np.maximum(self.figures(reference.positions), _least(self.grid))

    def figures(self, positions) -> np.ndarray:
        """(lambdas, 4) the figures relative to the reference layout: see the head of this file."""
        return _Images(self, positions).figures / self._start

    def score(self, positions) -> float:
        """The score alone."""
        return _soft_maximum(self.figures(positions) / self._aims)[0]

    def __call__(self, positions) -> tuple[float, np.ndarray]:
        """Score, and its gradient (E, 2) per m, by positions with the symmetry of `positions`."""
        images = _Images(self, positions)
        score, share = _soft_maximum(images.figures / self._start / self._aims)
        return score, images.gradient(share / self._start / self._aims)

    def transfer(self, positions, symmetry):
        """`Transfer` from electrodes at `positions` to contacts at all pixels."""
        reference, pixels = self.reference, self.grid.pixels
        if not self.differentiable:
            sheet = make_sheet(replace(reference, positions=positions), "fem")
            return sheet.transfer(pixels, self._contact_radius)
        return transfer_of(positions, reference.radius, self.size, pixels, self._self, symmetry)


def _least(grid):
    """(4,) figures of a reference layout that count as nothing: a hundredth of a cell, no noise."""
    cell = 0.01 * min(grid.cell_size)
    return np.array([cell, cell, cell, 1e-12])


def _aim_rows(aims, count):
    rows = [aims.central] + [aims.other] * (count - 1)
    return np.array([[*row, aims.noise_gain] for row in rows])


def _soft_maximum(ratios):
    weight = np.exp(SHARPNESS * (ratios - ratios.max()))
    score = ratios.max() + np.log(weight.mean()) / SHARPNESS
    return float(score), weight / weight.sum()


class _Images:
    """One evaluation: everything that the gradient needs again."""

    def __init__(self, objective: Objective, positions):
        self.objective, self.positions = objective, np.asarray(positions, float)
        grid = objective.grid
        symmetry = find_symmetry(grid, self.positions) if objective.differentiable else None
        transfer = objective.transfer(self.positions, symmetry)
        blocks = gram_blocks(transfer, grid, symmetry)
        self.gram, self.symmetry = blocks.gram, blocks.symmetry
        self.targets = grid.pixels[self.symmetry.first]
        self.spreads = [PointSpread(blocks, each) for each in objective.regularizations]
        self.contours = [half_maximum(spread.images, grid) for spread in self.spreads]
        self.figures = np.array([self._figures(*each) for each in zip(self.spreads, self.contours)])

    def _weights(self, hwhm):
        """(n,) weights of the mean and of the mean of the worst tenth."""
        sizes = self.symmetry.sizes
        order = np.argsort(-hwhm, kind="stable")
        before = np.cumsum(sizes[order]) - sizes[order]
        tenth = np.zeros(len(sizes))
        tenth[order] = np.clip(_WORST * sizes.sum() - before, 0, sizes[order])
        return sizes / sizes.sum(), tenth / tenth.sum()

    def _figures(self, spread, found):
        mean, tenth = self._weights(found.hwhm)
        error = np.linalg.norm(found.centre - self.targets, axis=1)
        return mean @ found.hwhm, tenth @ found.hwhm, mean @ error, spread.noise_gain

    def gradient(self, by_figures):
        """(E, 2) from the derivatives (lambdas, 4) by the figures."""
        symmetry, sizes = self.symmetry, self.symmetry.sizes
        by_block = [0.0] * len(symmetry.multiplicities)
        for spread, found, by in zip(self.spreads, self.contours, by_figures):
            mean, tenth = self._weights(found.hwhm)
            by_hwhm, by_error = (by[0] * mean + by[1] * tenth) / sizes, by[2] * mean / sizes
            grid = self.objective.grid
            by_image = by_images(found, spread.images, self.targets, grid, by_hwhm, by_error)
            by_total = by[3] / (2 * spread.noise_gain * len(symmetry.orbit))
            regularization = spread.regularization
            for j, (part, s) in enumerate(zip(symmetry.split(by_image.T), spread.inverse)):
                change = regularization * (part + part.T) / 2
                change += by_total * (2 * regularization * s - np.eye(len(s)))
                by_block[j] = by_block[j] + s @ change @ s
        seed = symmetry.join(by_block).T * sizes[:, None]
        return self._through_green(*self.gram.adjoint(symmetry.first, seed))

    def _through_green(self, by_point, by_between):
        """(E, 2) from the derivatives by G; one electrode of each kind stands for the others."""
        symmetry, objective = self.symmetry, self.objective
        kinds, radius = symmetry.kinds, objective.reference.radius
        stays = (symmetry.electrodes[:, kinds] == kinds).sum(axis=0)[:, None]
        by_point = _gather(by_point, symmetry.electrodes[:, kinds], symmetry.pixels) / stays
        both = by_between + by_between.T
        both = _gather(both, symmetry.electrodes[:, kinds], symmetry.electrodes) / stays
        own = both[np.arange(len(kinds)), kinds] / 2
        both[np.arange(len(kinds)), kinds] = 0
        step = _STEP * max(objective.size)
        slope = np.zeros((len(kinds), 2))
        for axis in range(2):
            for sign in (1, -1):
                moved = self.positions[kinds] + sign * step * np.eye(2)[axis]
                values = by_point * green(moved, objective.grid.pixels, objective.size, radius)
                ties = both * green(moved, self.positions, objective.size, radius)
                self_term = own * green_self(moved, objective.size, radius)
                slope[:, axis] += sign * (values.sum(axis=1) + ties.sum(axis=1) + self_term)
        out = np.zeros(self.positions.shape)
        out[kinds] = slope / (2 * step)
        return out


def _gather(values, rows, columns):
    """Sum over the group of values[g rows][:, g columns]."""
    return sum(values[np.ix_(row, column)] for row, column in zip(rows, columns))
