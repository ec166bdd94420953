"""Fig. 4 of the article: conductors on a sheet of 8 x 8 electrodes, and their images by eq. 1.

Frames come from another model than images, which are made as the article describes, with electrodes
and contacts as single nodes of a mesh. A computed sheet has no wrinkles and no bad joints, which the
article names for its own images; `trials` changes what may matter, one thing at a time.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tomotactile_ros.bench.paper.article import SIDE
from tomotactile_ros.evaluation.gram import Gram
from tomotactile_ros.evaluation.metrics import Quality, quality
from tomotactile_ros.evaluation.paper_model import Contacts, paper_transfer
from tomotactile_ros.evaluation.point_nodes import point_nodes_transfer
from tomotactile_ros.evaluation.point_spread import REGULARIZATION, RESOLUTION
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.scenes.scene import Scene, load_scene
from tomotactile_ros.sheet.sensitivity import Sensitivity
from tomotactile_ros.sheet.transfer import Transfer
from tomotactile_ros.simulation import Simulator

CONDUCTORS = {place: f"experiment-{place}" for place in ("centre", "side", "corner")}
_LETTER = np.array([[-6, -6], [6, -6], [6, -3], [-3, -3], [-3, 6], [-6, 6]]) / 100
SHAPES = {  # bare conductors, too; the article shows its own in a figure only, m
    "wide": [Contact("rectangle", center=(0.0, 0.0), size=(0.06, 0.04), angle=20.0)],
    "L-shape": [Contact("polygon", points=_LETTER)],
    "two points": [Contact("disc", center=(x, 0.0), radius=0.0025) for x in (-0.05, 0.05)],
}
_RADIUS = 0.0025  # m, of the article's conductor
_PLACES = 25  # of conductors all over a region
_COARSE = 30  # nodes along a side instead of 40
_JOINT = 1e4  # ohm, median of bad joints: one square of the sheet
_SPREADS = 1.0, 2.0  # of their logarithm
_SEED = 50


@dataclass(frozen=True, eq=False)
class Image:
    """One image: `potential` (H, W), V; hwhm and error, m, of a single conductor, else None."""

    layout: Layout
    scene: Scene
    potential: np.ndarray
    hwhm: float | None
    error: float | None


@dataclass(frozen=True, eq=False)
class Trial:
    """HWHM by conductor, m: (n,) on the equal grid, and as many on the optimized one."""

    words: str
    hwhm: dict[str, tuple[np.ndarray, np.ndarray]]

    def ratio(self, place: str) -> float:
        """Median of optimized over equal, conductor by conductor."""
        return float(np.median(self._ratios(place)))

    def limits(self, place: str) -> tuple[float, float]:
        """Between which 90 % of these ratios lie."""
        low, high = np.percentile(self._ratios(place), (5, 95))
        return float(low), float(high)

    def _ratios(self, place):
        equal, optimized = self.hwhm[place]
        return optimized / equal


class OneStep:
    """Images by eq. 1 with the J of `transfer`, whose points are the pixels of `grid`."""

    def __init__(self, transfer: Transfer, grid: Grid, regularization: float = REGULARIZATION):
        self.grid = grid
        self._sensitivity = Sensitivity(transfer)
        square = Gram(transfer).rows(np.arange(len(grid.pixels)))
        square[np.diag_indices_from(square)] += regularization
        self._factor = cho_factor(square)

    def images(self, frames) -> np.ndarray:
        """(n, K) of frames (n, L, E), V."""
        products = np.array([self._sensitivity.adjoint(frame) for frame in frames])
        return cho_solve(self._factor, products.T).T

    def quality(self, frames, places) -> Quality:
        """Of the images of single contacts at `places` (n, 2), m."""
        return quality(self.images(frames), places, self.grid)


def images(layout: Layout) -> dict[str, Image]:
    """Of `CONDUCTORS` and `SHAPES` on `layout`, frames by finite elements with discs as electrodes."""
    grid = Grid.for_outline(layout.outline, RESOLUTION)
    step = OneStep(point_nodes_transfer(layout, grid), grid)
    scenes = {name: load_scene(file) for name, file in CONDUCTORS.items()}
    for name, contacts in SHAPES.items():  # under the conditions of the experiment
        scenes[name] = replace(scenes["centre"], contacts=tuple(contacts))
    out = {}
    for name, scene in scenes.items():
        # all rows at once: nothing moves
        frame = Simulator(layout, scene, row_period=0.0).frame(0.0)
        (potential,) = step.images([frame])
        hwhm = error = None
        if name in CONDUCTORS:
            (contact,) = scene.truth(0.0)
            found = quality(potential[None], [[contact["x"], contact["y"]]], grid)
            hwhm, error = float(found.hwhm[0]), float(found.position_error[0])
        out[name] = Image(layout, scene, grid.fill(potential), hwhm, error)
    return out


def trials(equal: Layout, optimized: dict[str, Layout]) -> list[Trial]:
    """Conductors all over a region of the equal grid, frames by the closed form without noise.

    optimized : by what it was optimized in; the first is what all trials but those of the others take
    """
    grid = Grid.for_outline(equal.outline, RESOLUTION)
    coarse = Grid.for_outline(equal.outline, _COARSE)
    usual, *others = optimized.values()
    two = equal, usual
    nodes = [point_nodes_transfer(each, grid) for each in two]
    step = [OneStep(each, grid) for each in nodes]
    scaled = REGULARIZATION * (_COARSE / RESOLUTION) ** 2
    steps = {
        "images by the closed form": [
            OneStep(paper_transfer(each, grid.pixels), grid) for each in two
        ],
        f"mesh of {_COARSE} × {_COARSE} nodes, λ² scaled to mean the same": [
            OneStep(point_nodes_transfer(each, coarse), coarse, scaled) for each in two
        ],
        **{
            f"λ² = {weight:,.0f}": [OneStep(each, grid, weight) for each in nodes]
            for weight in (REGULARIZATION / 10, REGULARIZATION * 10)
        },
    }
    out = [Trial("nothing", _of(two, step, _RADIUS))]
    out += [Trial(words, _of(two, each, _RADIUS)) for words, each in steps.items()]
    out += [
        Trial(f"conductor of {1e3 * radius:g} mm radius", _of(two, step, radius))
        for radius in (0.001, 0.005)
    ]
    for name, layout in zip(list(optimized)[1:], others, strict=True):
        own = [step[0], OneStep(point_nodes_transfer(layout, grid), grid)]
        out.append(Trial(f"layout optimized by: {name}", _of((equal, layout), own, _RADIUS)))
    for spread in _SPREADS:
        random = np.random.default_rng(_SEED)
        drawn = random.normal(0, spread, (2, _PLACES, equal.electrodes))
        joints = _JOINT / equal.sheet_resistance * np.exp(drawn)
        words = (
            f"joints between electrodes and sheet of {1e-3 * _JOINT:g} kΩ (median; deviation of the "
            f"logarithm {spread:g}), other boards for each conductor"
        )
        out.append(Trial(words, _of(two, step, _RADIUS, joints)))
    return out


def _of(layouts, steps, radius, joints=(None, None)):
    """HWHM of both layouts for each of `CONDUCTORS`."""
    half = (
        SIDE / (np.sqrt(layouts[0].electrodes) - 1) / 2
    )  # of an equal grid's pitch, from rim to rim
    out = {}
    for name, file in CONDUCTORS.items():
        (contact,) = load_scene(file).truth(0.0)
        moves = np.random.default_rng(_SEED).uniform(-half, half, (_PLACES, 2))
        places = np.array([contact["x"], contact["y"]]) + moves
        first, second = (
            step.quality(_frames(layout, places, radius, joint), places).hwhm
            for layout, step, joint in zip(layouts, steps, joints, strict=True)
        )
        out[name] = first, second
    return out


def _frames(layout, places, radius, joints=None):
    """(n, L, E) readings of bare conductors of `radius`, m, at each of `places`, in parts of the drive
    voltage, `joints` (n, L) lying between the grounded electrode and ground, in squares of the sheet."""
    transfer = Contacts(places, layout.outline.size, radius).transfer(
        layout.positions, layout.radius
    )
    added = np.zeros((len(places), layout.electrodes)) if joints is None else joints
    own = transfer.self_impedance().T + added
    out = np.empty((len(places), layout.electrodes, layout.electrodes))
    for ground in range(layout.electrodes):
        lifted = transfer.impedance(ground).T + added[:, ground, None]
        out[:, ground] = lifted / own[:, ground, None]
    return out
