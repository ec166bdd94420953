"""States of a sheet, and what is true of them, from the reference data."""

from __future__ import annotations

from dataclasses import dataclass

from tomotactile_ros.bench import reference_data
from tomotactile_ros.bench.reference import Admittance
from tomotactile_ros.layouts.layout import Layout


@dataclass(frozen=True, eq=False)
class States:
    """N states of sheets of `layout`: what the electrodes see, and the true contacts
    (`evaluation.scoring`)."""

    layout: Layout
    seen: list[Admittance]
    truths: list[list[dict]]

    def every(self, step: int) -> States:
        """Every `step`-th of them."""
        return States(self.layout, self.seen[::step], self.truths[::step], self.cases[::step])


def states(family: str, case: str | None = None, most: int | None = None) -> States:
    """The first `most` states of a family, of one of its cases or of all; InputError where there is
    no file of it."""
    data = reference_data.load(family)
    chosen = range(len(data)) if case is None else data.cases()[case].tolist()
    chosen = list(chosen)[:most]
    truths = [data.states[number]["contacts"] for number in chosen]
    return States(data.layout, [data.state(number) for number in chosen], truths)
