"""Which electrodes a frame should ground, and in which order.

**Which**: a frame takes as long as it has rows. Rows are added one at a time, each time the one
that makes the expected place error of a contact (`evaluation.posterior`), mean over the sheet,
least. The choices are nested: eight rows are the first eight of sixteen.

**In which order**: jumping, as of `layouts.scan_order`. `after` says what that gains: the expected
place error from a few successive rows alone, wherever in the scan they begin.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tomotactile_ros.evaluation.layout_quality import LayoutQuality, evaluate_layout
from tomotactile_ros.evaluation.metrics import worst
from tomotactile_ros.evaluation.posterior import Conditions, Expectation, RowInformation, lattice
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.scan_order import spread
from tomotactile_ros.support import checks

PLACES = 6  # contacts along the longer side by which rows are chosen
FEW = 4  # successive rows after which a new touch should be known
_DIGITS = 9  # of a score: choices that rounding alone tells apart are the first of them


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
        self.information = RowInformation(expectation, lattice(layout, places))
        self._chosen: list[int] = []

    def best(self, count: int) -> list[int]:
        """The `count` electrodes to ground, the most telling first."""
        checks.integer(count, "conditions", 1, self.layout.electrodes)
        while len(self._chosen) < count:
            left = [e for e in range(self.layout.electrodes) if e not in self._chosen]
            costs = [
                self.information.figures([*self._chosen, electrode])[0].mean() for electrode in left
            ]
            scale = max(costs)
            self._chosen.append(left[int(np.argmin(np.round(np.array(costs) / scale, _DIGITS)))])
        return self._chosen[:count]

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
