"""The parts measured one after the other, with any methods side by side."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from itertools import chain

from tomotactile_ros.bench.sensor.parts import PARTS
from tomotactile_ros.bench.sensor.trial import Methods, Trial, measure, profiles
from tomotactile_ros.layouts.layout import Layout

Watch = Callable[[Iterable[Trial]], Iterable[Trial]]


def run(
    part: str, step: int = 1, methods: Sequence[Methods] = (profiles,), watch: Watch = iter
) -> list[dict]:
    """Rows of one of `PARTS` as plain data.

    step : every so manieth press
    methods : each makes reconstructions of a layout by their names, see `trial`
    watch : wraps the cases, to show progress
    """

    def every(layout: Layout) -> dict:
        return dict(chain.from_iterable(make(layout).items() for make in methods))

    return list(measure(watch(PARTS[part](step)), every))
