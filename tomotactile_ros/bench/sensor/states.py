"""States of a sheet, and what is true of them, from the reference data."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, field

import numpy as np

from tomotactile_ros.bench import reference_data
from tomotactile_ros.bench.reference import Admittance, ReferenceSheet
from tomotactile_ros.bench.reference_cases import Press, truth
from tomotactile_ros.bench.reference_mesh import disc
from tomotactile_ros.layouts.layout import Layout

FINGER = 0.006  # m, radius


@dataclass(frozen=True, eq=False)
class States:
    """N states of sheets of `layout`: what the electrodes see, the true contacts
    (`evaluation.scoring`), and the case that each is one of."""

    layout: Layout
    seen: list[Admittance]
    truths: list[list[dict]]
    cases: list[str] = field(default_factory=list)

    def every(self, step: int) -> States:
        """Every `step`-th of them."""
        return States(self.layout, self.seen[::step], self.truths[::step], self.cases[::step])


def states(family: str | os.PathLike, case: str | None = None, most: int | None = None) -> States:
    """The first `most` states of a family, of one of its cases or of all, by its name or the path of
    its file; InputError where there is no file of it."""
    layout, content = reference_data.read(family, ("packed",), ("states",))
    chosen = [
        (Admittance.unpack(packed), state["contacts"], state["case"])
        for packed, state in zip(content["packed"], content["states"], strict=True)
        if case in (None, state["case"])
    ][:most]
    seen, truths, cases = zip(*chosen)
    return States(layout, list(seen), list(truths), list(cases))


def cases(family: str) -> list[str]:
    """Of a family, in the order of its file."""
    _, content = reference_data.read(family, (), ("states",))
    return list(dict.fromkeys(state["case"] for state in content["states"]))


def fingers(sheet: ReferenceSheet, places: Iterable[np.ndarray], random) -> States:
    """States of a sheet of the reference model, solved: at each of the places a disc of 6 mm,
    pressed with 0.5 to 3 N."""
    area = np.pi * FINGER**2
    presses = [Press(disc(at, FINGER), "disc", random.uniform(0.5, 3.0) / area) for at in places]
    seen = [sheet.solve([(press.shape, press.conductance)]) for press in presses]
    truths = [[truth(press, sheet.layout.outline)] for press in presses]
    return States(sheet.layout, seen, truths)
