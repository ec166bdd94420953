"""Which electrodes a frame should ground, and in which order.

**Which**: a frame takes as long as it has rows. Rows are added one at a time, each time the one
that makes the expected place error of a contact (`evaluation.posterior`), mean over the sheet,
least; then each row gives way to another one as long as that gains something (exchange algorithm,
Fedorov 1972), those tried first that tell most by the slopes of the error.

**How good that is**: the error is convex in how often each row is taken. Its least value over all
shares of rows, none above one, is a bound on every choice of so many rows; `Chooser.least` finds
it from below (Frank and Wolfe 1956; the linear model at any point is a bound, too).

**In which order**: jumping, as of `layouts.scan_order`. `after` says what that gains: the expected
place error from a few successive rows alone, wherever in the scan they begin.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tomotactile_ros.evaluation.layout_quality import LayoutQuality, evaluate_layout
from tomotactile_ros.evaluation.metrics import worst
from tomotactile_ros.evaluation.places import lattice
from tomotactile_ros.evaluation.posterior import Conditions, Expectation, RowInformation
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.scan_order import spread
from tomotactile_ros.support import checks

PLACES = 6  # contacts along the longer side by which rows are chosen
FEW = 4  # successive rows after which a new touch should be known
_DIGITS = 9  # of a score: choices that rounding alone tells apart are the first of them
_TRIES = 512  # of exchanges while each row is looked at once
_LITTLE = 1e-4  # gain for which no row is exchanged
_CLIMBS, _HALVINGS = 60, 8  # steps to the bound at most, and the length of each
_NEAR = 0.02  # of the error: so far the bound may lie below what it bounds


@dataclass(frozen=True, eq=False)
class Scan:
    """A frame of fewer rows.

    grounded : (L,) electrodes to ground, row after row
    quality : of images (eq. 1 of the paper) from these rows
    place, force : (P,) expected errors of contacts, m and relative
    """

    grounded: np.ndarray
    quality: LayoutQuality
    place: np.ndarray
    force: np.ndarray

    @property
    def speed(self) -> float:
        """Frames per second, relative to a scan of all electrodes."""
        return self.quality.layout.electrodes / len(self.grounded)

    @property
    def metrics(self) -> dict:
        """Mean and worst tenth of the place error, m, and of the force's."""
        return {
            name: {"mean": float(values.mean()), "worst_tenth": worst(values)}
            for name, values in (("place", self.place), ("force", self.force))
        }


class Chooser:
    """What each row of `layout` tells of contacts all over the sheet."""

    def __init__(self, layout: Layout, conditions: Conditions | None = None, places: int = PLACES):
        self.layout = layout
        expectation = Expectation(layout, conditions)
        centres = lattice(layout, places, expectation.conditions.radius)
        self.information = RowInformation(expectation, centres)
        self._chosen: list[int] = []  # one by one
        self._best: dict[int, list[int]] = {}

    def best(self, count: int) -> list[int]:
        """The `count` electrodes to ground."""
        checks.integer(count, "conditions", 1, self.layout.electrodes)
        if count not in self._best:
            self._best[count] = self._exchanged(self._one_by_one(count))
        return list(self._best[count])

    def least(self, count: int) -> float:
        """What no choice of `count` rows comes below, m: mean place error over the sheet."""
        every = self.layout.electrodes
        checks.integer(count, "conditions", 1, every)
        shares, bound = np.full(every, count / every), 0.0
        for _ in range(_CLIMBS):
            error, slopes = self.information.mean_place(shares)
            corner = np.zeros(every)
            corner[np.argsort(slopes)[:count]] = 1.0
            bound = max(bound, error - float(slopes @ (shares - corner)))
            if error - bound < _NEAR * error:
                break
            shares = self._least_between(shares, corner)
        return bound

    def _one_by_one(self, count):
        chosen = self._chosen
        while len(chosen) < count:
            left = [e for e in range(self.layout.electrodes) if e not in chosen]
            costs = [self._error([*chosen, electrode]) for electrode in left]
            chosen.append(left[int(np.argmin(np.round(np.array(costs) / max(costs), _DIGITS)))])
        return chosen[:count]

    def _exchanged(self, chosen):
        """`chosen` with rows exchanged until that gains nothing."""
        error, unchanged, candidates = self._error(chosen), 0, max(1, _TRIES // len(chosen))
        while unchanged < len(chosen) < self.layout.electrodes:
            kept, leaves = chosen[1:], chosen[0]
            weights = np.bincount(kept, minlength=self.layout.electrodes).astype(float)
            slopes = self.information.mean_place(weights)[1]
            others = [e for e in np.argsort(slopes).tolist() if e not in chosen]
            trials = [[*kept, e] for e in others[:candidates]]
            costs = np.array([self._error(each) for each in trials])
            best = int(costs.argmin())
            gains = costs[best] < error * (1 - _LITTLE)
            chosen = trials[best] if gains else [*kept, leaves]
            error, unchanged = (float(costs[best]), 0) if gains else (error, unchanged + 1)
        return chosen

    def _least_between(self, start, end):
        """Where the error is least on the way between two sets of shares (E,), by halves."""
        low, high = 0.0, 1.0
        for _ in range(_HALVINGS):
            middle = (low + high) / 2
            slopes = self.information.mean_place(start + middle * (end - start))[1]
            low, high = (middle, high) if slopes @ (end - start) < 0 else (low, middle)
        return start + low * (end - start)

    def _error(self, grounded):
        return float(self.information.figures(grounded)[0].mean())

    def after(self, order: Sequence[int], rows: int = FEW) -> float:
        """Expected place error, m, from `rows` successive rows: mean over places and beginnings."""
        twice = [*order, *order]
        rows = min(rows, len(order))
        found = [self.information.figures(twice[i : i + rows])[0] for i in range(len(order))]
        return float(np.mean(found))


def scans(
    layout: Layout, counts: Sequence[int], chooser: Chooser | None = None, **evaluation
) -> Iterator[Scan]:
    """The best scans of `counts` rows each; evaluation : keywords of `evaluate_layout`."""
    chooser = chooser or Chooser(layout)
    for count in counts:
        best = chooser.best(count)
        order = np.array(spread(layout.positions, best))
        quality = evaluate_layout(layout, grounded=np.sort(order), **evaluation)
        yield Scan(order, quality, *chooser.information.figures(order.tolist()))
