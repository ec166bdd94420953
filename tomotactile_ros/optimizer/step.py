"""What an optimizer hands over after every step, and what it leaves behind."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator, Sequence
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
    eta         s, estimate of the time left; 0 at the end
    posterior   expected errors of contacts, where the method goes by them
    """

    iteration: int
    total: int
    quality: LayoutQuality
    score: float
    best: bool
    eta: float
    posterior: Posterior | None = None

    @property
    def layout(self) -> Layout:
        return self.quality.layout

    @property
    def hwhm_map(self) -> np.ndarray:
        """(H, W) HWHM by contact position, m; NaN outside the outline."""
        return self.quality.hwhm_map

    @property
    def position_error_map(self) -> np.ndarray:
        """(H, W) position error by contact position, m; NaN outside the outline."""
        return self.quality.position_error_map

    @property
    def metrics(self) -> dict:
        if self.posterior is None:
            return self.quality.metrics
        return self.quality.metrics | {"touch": self.posterior.metrics}


class Clock:
    """Numbers the steps, remembers the lowest score and estimates the time left.

    total : number of steps, the start not counted
    efforts : (total + 1,) what each step takes, the start first, in any unit; None: all the same
    """

    def __init__(self, total: int, efforts: Sequence[float] | None = None):
        self.total = total
        self._efforts = np.ones(total + 1) if efforts is None else np.array(efforts, float)
        self._start = time.monotonic()
        self._lowest = np.inf

    def step(
        self,
        iteration: int,
        quality: LayoutQuality,
        score: float,
        allowed: bool = True,
        posterior: Posterior | None = None,
    ) -> Step:
        """The next step; the time left is in proportion to that of the steps so far, the start
        included.

        What is not `allowed` (a start that violates constraints) is the best only as long as there
        is nothing else.
        """
        counted = score if allowed else np.inf
        best = bool(counted < self._lowest) or iteration == 0
        self._lowest = min(counted, self._lowest)
        done, all_of_it = self._efforts[: iteration + 1].sum(), self._efforts.sum()
        left = (time.monotonic() - self._start) * float(all_of_it / done - 1)
        return Step(iteration, self.total, quality, float(score), best, left, posterior)


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
