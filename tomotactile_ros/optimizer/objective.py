"""What the free optimizer makes small.

Figures, each relative to the layout that one starts from, over all contact positions and for every
lambda^2:

    mean HWHM,   mean HWHM of the worst tenth,   mean position error,   and the noise gain

HWHM is the spread about the image's own centre and the position error the way from there to the
true position: together they are the blur about the true position. If asked for, one more figure:
the mean blur of scenes with two and with wide contacts (`scenes`). The score is a soft maximum of
all figures, each divided by its aim, so that none can be bought with another:

    log(mean(exp(s r))) / s,    s = 50

Contacts are sharp within a few millimetres of an electrode, so that one lattice of contact
positions rewards electrodes that lie on it. Every figure is therefore the mean over several
lattices. Figures and gradient on one are those of `figures`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.evaluation.paper_model import Contacts, default_contact_radius
from tomotactile_ros.evaluation.point_spread import REGULARIZATION, RESOLUTION
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.optimizer.figures import Figures
from tomotactile_ros.optimizer.scenes import Scenes
from tomotactile_ros.sheet import make_sheet

SHARPNESS = 50.0
OTHERS = 0.1, 10.0  # lambda^2 that a layout has to carry over to, relative to the one wanted
_LATTICES = 1.0, 1.075  # contact positions along the longer side, relative to `resolution`
_LEAST = 1e-6  # m, or V per V: what a figure of the reference counts as at least


@dataclass(frozen=True)
class Aims:
    """Figures relative to those of the reference layout that count as equally good.

    `central` for the lambda^2 that the layout is made for, `other` for those it is to carry over
    to: mean HWHM, worst tenth, mean position error. `noise_gain` is that of the noise gain, for all
    of them. `scenes` is that of the blur of scenes, which count with it only.

    Electrodes that leave the rim are better for all figures but one: at a tenth of lambda^2
    contacts between the rim and the electrodes are drawn to these. How much of that is allowed is
    `other[2]`.
    """

    central: tuple[float, float, float] = (0.8, 0.8, 0.72)
    other: tuple[float, float, float] = (0.95, 0.95, 1.0)
    noise_gain: float = 1.5
    scenes: float | None = None

    def values(self) -> np.ndarray:
        """One for every figure, in the order of `Figures.values`."""
        rows = [self.central] + [self.other] * len(OTHERS)
        extra = [] if self.scenes is None else [self.scenes]
        return np.array([each for row in rows for each in (*row, self.noise_gain)] + extra)


DEFAULT_AIMS = Aims()


class Objective:
    """Score of electrode positions: in closed form on a uniform rectangle, and by finite
    elements on every other outline.

    Finite elements have no gradient, and their mesh, which changes with the electrodes, roughens
    the score by some tenths of a per cent: more than one lattice would make worthwhile.

    Parameters
    ----------
    reference : layout whose figures are 1; gives outline and radius
    regularization : lambda^2 that the layout is made for
    resolution : contact positions, and pixels, along the longer side
    """

    def __init__(
        self,
        reference: Layout,
        regularization: float = REGULARIZATION,
        aims: Aims = DEFAULT_AIMS,
        *,
        resolution: int = RESOLUTION,
    ):
        self.reference = reference
        self.differentiable = reference.outline.is_uniform_rectangle
        regularizations = [factor * regularization for factor in (1.0, *OTHERS)]
        self._aims = aims.values()
        self._lattices, self._units = [], []
        for factor in _LATTICES if self.differentiable else _LATTICES[:1]:
            grid = Grid.for_outline(reference.outline, round(factor * resolution))
            lattice = Lattice(reference, grid, regularizations, scenes=aims.scenes is not None)
            self._lattices.append(lattice)
            self._units.append(np.maximum(Figures(lattice, reference.positions).values, _LEAST))

    def figures(self, positions) -> np.ndarray:
        """Figures relative to the reference layout: four for each lambda^2, and that of scenes."""
        return self._mean([Figures(lattice, positions) for lattice in self._lattices])

    def score(self, positions) -> float:
        """The score alone."""
        return _soft_maximum(self.figures(positions) / self._aims)[0]

    def __call__(self, positions) -> tuple[float, np.ndarray]:
        """Score, and its gradient (E, 2) per m, by positions with the symmetry of `positions`."""
        found = [Figures(lattice, positions) for lattice in self._lattices]
        score, share = _soft_maximum(self._mean(found) / self._aims)
        share = share / self._aims / len(found)
        slopes = [each.gradient(share / unit) for each, unit in zip(found, self._units)]
        return score, np.sum(slopes, axis=0)

    def _mean(self, found):
        return np.mean([each.values / unit for each, unit in zip(found, self._units)], axis=0)


class Lattice:
    """Contacts at all pixels of `grid`, for electrodes like those of `reference` anywhere.

    regularizations : lambda^2 values for 40 pixels along the longer side; scaled to mean the same
    """

    def __init__(self, reference: Layout, grid: Grid, regularizations, *, scenes: bool = False):
        self.reference, self.grid = reference, grid
        usual = Grid.for_outline(reference.outline, RESOLUTION)
        scale = len(grid.pixels) / len(usual.pixels)
        self.regularizations = [scale * each for each in regularizations]
        self.scenes = Scenes(grid, reference.electrodes) if scenes else None
        self.differentiable = reference.outline.is_uniform_rectangle
        self._radius = default_contact_radius(reference)
        if self.differentiable:
            self._contacts = Contacts(grid.pixels, reference.outline.size, self._radius)

    def transfer(self, positions, symmetry):
        """`Transfer` from electrodes at `positions` to the contacts."""
        reference = self.reference
        if self.differentiable:
            return self._contacts.transfer(positions, reference.radius, symmetry)
        sheet = make_sheet(replace(reference, positions=positions), "fem")
        return sheet.transfer(self.grid.pixels, self._radius)


def _soft_maximum(ratios):
    weight = np.exp(SHARPNESS * (ratios - ratios.max()))
    score = ratios.max() + np.log(weight.mean()) / SHARPNESS
    return float(score), weight / weight.sum()
