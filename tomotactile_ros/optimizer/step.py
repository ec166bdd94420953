"""What an optimizer hands over after every step, and what it leaves behind."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.evaluation.layout_quality import LayoutQuality
from tomotactile_ros.evaluation.posterior import Posterior
from tomotactile_ros.layouts.layout import Layout


@dataclass(frozen=True, eq=False)
class Step:
    """State of an optimization after `iteration` of `total` steps; iteration 0 is the start.

    quality     of the step's layout
    score       what the method makes small
    best        whether no earlier step had a lower score
    posterior   expected errors of contacts, where the method goes by them
    """

    iteration: int
    total: int
    quality: LayoutQuality
    score: float
    best: bool
    posterior: Posterior | None = None

    @property
    def layout(self) -> Layout:
        return self.quality.layout

    @property
    def metrics(self) -> dict:
        if self.posterior is None:
            return self.quality.metrics
        return self.quality.metrics | {"touch": self.posterior.metrics}


class Steps:
    """Numbers the steps of an optimization and remembers the lowest score.

    total : number of steps, the start not counted
    """

    def __init__(self, total: int):
        self._total, self._count, self._lowest = total, 0, np.inf

    def next(
        self,
        quality: LayoutQuality,
        score: float,
        posterior: Posterior | None = None,
        allowed: bool = True,
    ) -> Step:
        """The next step. What is not `allowed` (a start that violates constraints) is the best only
        as long as there is nothing else."""
        counted, number = score if allowed else np.inf, self._count
        best = bool(counted < self._lowest) or number == 0
        self._lowest, self._count = min(counted, self._lowest), number + 1
        return Step(number, self._total, quality, float(score), best, posterior)


def best_of(
    steps: Iterator[Step], watch: Callable[[Step], object] | None = None
) -> tuple[list[Step], Step]:
    """Run an optimization; Ctrl-C after the first step ends it and keeps what is there.

    Parameters
    ----------
    steps : as the optimizers yield them; watch : called with every step

    Returns
    -------
    All steps, the start included, and the one with the lowest score. KeyboardInterrupt while
    there is only the start is passed on.
    """
    history: list[Step] = []
    try:
        for step in steps:
            history.append(step)
            if watch is not None:
                watch(step)
    except KeyboardInterrupt:
        if len(history) < 2:
            raise
    return history, [step for step in history if step.best][-1]


def finished(layout: Layout, name: str, method: str, settings: dict, history, best: Step) -> Layout:
    """`layout` under its new name, with its origin: method, settings, figures before and after."""
    provenance = {
        "algorithm": method,
        "settings": rounded(settings, 12) | {"evaluation": best.quality.settings},
        "metrics": {"before": rounded(history[0].metrics), "after": rounded(best.metrics)},
        "steps": [
            {
                "iteration": step.iteration,
                "score": rounded(step.score),
                "hwhm_mean": rounded(step.metrics["hwhm"]["mean"]),
                "hwhm_worst_region": rounded(step.metrics["hwhm"]["worst_region"]),
                "position_error_mean": rounded(step.metrics["position_error"]["mean"]),
            }
            for step in history
        ],
        "software": "tomotactile_ros",
    }
    return replace(layout, name=name, provenance=provenance)


def ratio(before: float, after: float) -> float:
    """`after` relative to `before`; 1 where both are 0, as errors on very coarse grids are."""
    return after / before if before else 1.0 if after == before else np.inf


def rounded(value, digits: int = 5):
    """Numbers of nested plain data with `digits` significant digits."""
    if isinstance(value, dict):
        return {key: rounded(each, digits) for key, each in value.items()}
    if isinstance(value, (list, tuple)):
        return [rounded(each, digits) for each in value]
    return float(f"{value:.{digits}g}") if isinstance(value, float) else value
