"""How many electrodes, and how many rows of them in a frame: what each costs in place error.

For each number of electrodes the layout is an equal grid where the number is a square and the sheet
a rectangle, else electrodes spread evenly over the outline. Rows are chosen one by one (`scan`).
Errors are those expected by the estimator's own model (`evaluation.posterior`): a real sensor is
not better, and how much worse it is says docs/layouts.md.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass

from tomotactile_ros.evaluation.metrics import worst
from tomotactile_ros.evaluation.posterior import Conditions
from tomotactile_ros.layouts.arrangements import spread_electrodes
from tomotactile_ros.layouts.layout import Layout, equal_grid
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.optimizer.scan import Chooser
from tomotactile_ros.support import checks

FEWEST = 4  # electrodes


@dataclass(frozen=True, eq=False)
class Choice:
    """One layout with one number of rows: frame_time, s; place and worst_tenth, m; force,
    relative."""

    layout: Layout
    rows: tuple[int, ...]
    frame_time: float
    place: float
    worst_tenth: float
    force: float


def explore(
    outline: Outline,
    counts: Sequence[int],
    radius: float,
    sheet_resistance: float,
    row_period: float,
    conditions: Conditions | None = None,
) -> Iterator[list[Choice]]:
    """For each number of electrodes the choices with 2, 4, 8, ... rows, and with all.

    Raises InputError for numbers of electrodes that do not fit.
    """
    checks.positive(row_period, "row_period", "time in s")
    for count in counts:
        layout = layout_of(count, outline, radius, sheet_resistance)
        chooser = Chooser(layout, conditions)
        found = []
        for rows in (*(2**k for k in range(1, (count - 1).bit_length())), count):
            chosen = list(range(count)) if rows == count else chooser.best(rows)
            place, force = chooser.information.figures(chosen)
            mean, tenth = float(place.mean()), worst(place)
            time = rows * row_period
            found.append(Choice(layout, tuple(chosen), time, mean, tenth, float(force.mean())))
        yield found


def layout_of(count: int, outline: Outline, radius: float, sheet_resistance: float) -> Layout:
    """The layout that is judged: an equal grid from rim to rim, or electrodes spread evenly."""
    side = math.isqrt(count)
    if side * side == count and outline.is_uniform_rectangle:
        size = outline.size
        return equal_grid(side, side, size, radius, sheet_resistance, name=f"equal-{count}")
    return spread_electrodes(count, outline, radius, sheet_resistance, name=f"spread-{count}")


def answer(
    choices: Sequence[Choice], place: float, frame_time: float | None = None
) -> Choice | None:
    """The fewest electrodes, and with them the fewest rows, whose worst tenth is expected to be
    below `place` (m) within `frame_time` (s); None where there are none."""
    good = [
        each
        for each in choices
        if each.worst_tenth <= place
        and (frame_time is None or each.frame_time <= frame_time * (1 + 1e-9))
    ]
    return min(good, key=lambda each: (each.layout.electrodes, len(each.rows)), default=None)
