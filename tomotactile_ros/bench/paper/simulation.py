"""Fig. 3 of the article: the optimization of 4 x 4 and 8 x 8 electrodes, model by model."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tomotactile_ros.bench.paper.article import REPORTED, SIDE
from tomotactile_ros.evaluation.layout_quality import LayoutQuality
from tomotactile_ros.evaluation.metrics import half_maximum
from tomotactile_ros.evaluation.point_nodes import point_nodes_transfer
from tomotactile_ros.evaluation.point_spread import RESOLUTION, PointSpread, gram_blocks
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.optimizer import equalize

COUNTS = tuple(REPORTED)  # electrodes along a side
LABELS = "mean HWHM", "worst region", "mean PE"
_INSET = 0.005  # m, from the rim to the outermost contacts in `fem-inset`


def figures(quality: LayoutQuality) -> np.ndarray:
    """(3,) of `LABELS`, in % of the side."""
    hwhm = quality.metrics["hwhm"]
    error = quality.metrics["position_error"]["mean"]
    return 100 / SIDE * np.array([hwhm["mean"], hwhm["worst_region"], error])


@dataclass(frozen=True, eq=False)
class Run:
    """All updates of one optimization, the start first."""

    count: int
    model: str
    steps: list[LayoutQuality]

    @property
    def best(self) -> int:
        """The update with the best mean HWHM, as the article chooses; of 4 x 4 its third."""
        if self.count == 4:
            return REPORTED[4].best
        return 1 + int(np.argmin([figures(step)[0] for step in self.steps[1:]]))

    @property
    def layout(self) -> Layout:
        """Of the best update."""
        return self.steps[self.best].layout

    @property
    def ratios(self) -> np.ndarray:
        """(3,) optimized over equal, of `LABELS`."""
        return figures(self.steps[self.best]) / figures(self.steps[0])

    @property
    def differences(self) -> np.ndarray:
        """(3,) of the ratios from those of the article."""
        return self.ratios - REPORTED[self.count].ratios

    @property
    def away(self) -> float:
        """Mean distance of the ratios from those of the article."""
        return float(np.abs(self.differences).mean())


def optimize(count: int, model: str) -> Run:
    """Eq. 12 and Algorithm 1, as often as the article does them."""
    layout = load_layout(f"equal-{count}x{count}")
    evaluation: dict = {"model": equalize.MODELS[model.removesuffix("-inset")]}
    if model.endswith("-inset"):
        pixels = Grid.for_outline(layout.outline, RESOLUTION).pixels
        evaluation["contacts"] = pixels * (SIDE / 2 - _INSET) / pixels.max()
    steps = equalize.equalize(layout, REPORTED[count].updates, **evaluation)
    return Run(count, model, [step.quality for step in steps])


def nearest(runs: Sequence[Run], figure: int | None = None) -> str:
    """The model whose ratios, or that of one of `LABELS`, are nearest to the article's, over `runs`."""

    def away(model):
        mine = [np.abs(run.differences) for run in runs if run.model == model]
        return sum(each.mean() if figure is None else each[figure] for each in mine)

    return min(dict.fromkeys(run.model for run in runs), key=away)


@dataclass(frozen=True, eq=False)
class Spread:
    """The image of one contact: `image` (H, W) relative to its maximum, contact and centre (2,), m,
    hwhm and error, m."""

    layout: Layout
    image: np.ndarray
    contact: np.ndarray
    centre: np.ndarray
    hwhm: float

    @property
    def error(self) -> float:
        return float(np.linalg.norm(self.centre - self.contact))


def spreads(layout: Layout, count: int) -> dict[str, Spread]:
    """Images of contacts in the middle of the sheet, of a region at its side, and of one at its corner
    (of the equal grid), electrodes as single nodes."""
    grid = Grid.for_outline(layout.outline, RESOLUTION)
    images = PointSpread(gram_blocks(point_nodes_transfer(layout, grid), grid)).images
    edge = SIDE / 2 * (1 - 1 / (count - 1))
    out = {}
    for name, place in {"centre": (0, 0), "side": (edge, 0), "corner": (edge, edge)}.items():
        pixel = int(np.linalg.norm(grid.pixels - place, axis=1).argmin())
        image = images[:, pixel]
        half = half_maximum(image[:, None], grid)
        shown = grid.fill(image / image.max())
        out[name] = Spread(layout, shown, grid.pixels[pixel], half.centre[0], float(half.hwhm[0]))
    return out
