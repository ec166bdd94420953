"""Fig. 3 of the article: the optimization of 4 x 4 and 8 x 8 electrodes in three models."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomotactile_ros.bench.paper.article import INDEPENDENT, REPORTED, SIDE
from tomotactile_ros.evaluation.layout_quality import LayoutQuality, evaluate_layout
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.optimizer import equalize

COUNTS = tuple(REPORTED)  # electrodes along a side
LABELS = "mean HWHM", "worst region", "mean PE"


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
            return REPORTED[4].updates
        return 1 + int(np.argmin([figures(step)[0] for step in self.steps[1:]]))

    @property
    def ratios(self) -> np.ndarray:
        """(3,) optimized over equal, of `LABELS`."""
        return figures(self.steps[self.best]) / figures(self.steps[0])

    @property
    def away(self) -> float:
        """Mean distance of the ratios from those of the article."""
        return float(np.abs(self.ratios - REPORTED[self.count].ratios).mean())

    @property
    def away_from_independent(self) -> float:
        """Largest distance of the ratios from those of the separate program."""
        return float(np.abs(self.ratios - INDEPENDENT[self.count][self.model]).max())


def optimize(count: int, model: str) -> Run:
    """Eq. 12 and Algorithm 1, as often as the article does them."""
    layout = load_layout(f"equal-{count}x{count}")
    updates = REPORTED[count].updates
    steps = equalize.equalize(layout, updates, model=equalize.MODELS[model])
    return Run(count, model, [step.quality for step in steps])


def nearest(runs: list[Run]) -> str:
    """The model whose ratios are nearest to those of the article, over both numbers."""
    models = dict.fromkeys(run.model for run in runs)
    return min(models, key=lambda model: sum(each.away for each in runs if each.model == model))


def nearest_in(runs: list[Run], figure: int) -> str:
    """The same for one of `LABELS` alone."""

    def away(model):
        mine = [each for each in runs if each.model == model]
        return sum(abs(each.ratios[figure] - REPORTED[each.count].ratios[figure]) for each in mine)

    return min(dict.fromkeys(run.model for run in runs), key=away)


def on_maps(layout: Layout) -> LayoutQuality:
    """A layout in the model with electrodes as single nodes."""
    return evaluate_layout(layout, model="point_nodes")
