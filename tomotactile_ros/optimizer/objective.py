"""What the free optimizer makes small.

Figures, each relative to the layout that one starts from, over all contact positions and for every
lambda^2:

    mean HWHM,   mean HWHM of the worst tenth,   mean position error,   and the noise gain

HWHM is the spread about the image's own centre and the position error the way from there to the
true position: together they are the blur about the true position. If asked for, one more figure:
the mean blur of scenes with two and with wide contacts (`scenes`). The score is a soft maximum of
all figures, each divided by its aim, so that none can be bought with another:

    log(mean(exp(s r))) / s,    s = 50

Figures and gradient are those of `figures`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.evaluation.paper_model import Contacts, default_contact_radius
from tomotactile_ros.grid import Grid
from tomotactile_ros.layout import Layout
from tomotactile_ros.optimizer.figures import Figures
from tomotactile_ros.optimizer.scenes import Scenes
from tomotactile_ros.sheet import make_sheet

SHARPNESS = 50.0


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

    def values(self, regularizations: int) -> np.ndarray:
        """One for every figure, in the order of `Figures.values`."""
        rows = [self.central] + [self.other] * (regularizations - 1)
        extra = [] if self.scenes is None else [self.scenes]
        return np.array([each for row in rows for each in (*row, self.noise_gain)] + extra)


DEFAULT_AIMS = Aims()


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
        aims: Aims = DEFAULT_AIMS,
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
        self.scenes = None if aims.scenes is None else Scenes(self.grid, reference.electrodes)
        self._radius = default_contact_radius(reference)
        if self.differentiable:
            self.contacts = Contacts(self.grid.pixels, self.size, self._radius)
        self._aims = aims.values(len(self.regularizations))
        self._start = 1.0
        cell = 0.01 * min(self.grid.cell_size)
        least = np.array([cell, cell, cell, 1e-12] * len(self.regularizations) + [cell])
        self._start = np.maximum(self.figures(reference.positions), least[: len(self._aims)])

    def figures(self, positions) -> np.ndarray:
        """Figures relative to the reference layout: four for each lambda^2, and that of scenes."""
        return Figures(self, positions).values / self._start

    def score(self, positions) -> float:
        """The score alone."""
        return _soft_maximum(self.figures(positions) / self._aims)[0]

    def __call__(self, positions) -> tuple[float, np.ndarray]:
        """Score, and its gradient (E, 2) per m, by positions with the symmetry of `positions`."""
        figures = Figures(self, positions)
        score, share = _soft_maximum(figures.values / self._start / self._aims)
        return score, figures.gradient(share / self._start / self._aims)

    def transfer(self, positions, symmetry):
        """`Transfer` from electrodes at `positions` to contacts at all pixels."""
        reference = self.reference
        if self.differentiable:
            return self.contacts.transfer(positions, reference.radius, symmetry)
        sheet = make_sheet(replace(reference, positions=positions), "fem")
        return sheet.transfer(self.grid.pixels, self._radius)


def _soft_maximum(ratios):
    weight = np.exp(SHARPNESS * (ratios - ratios.max()))
    score = ratios.max() + np.log(weight.mean()) / SHARPNESS
    return float(score), weight / weight.sum()
