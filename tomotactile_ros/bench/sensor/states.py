"""States of a sheet, and what is true of them: solved by the reference model, or from the reference data."""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from tomotactile_ros.bench import reference_data
from tomotactile_ros.bench.reference import Admittance, ReferenceSheet
from tomotactile_ros.bench.reference_cases import Family, Press, State, truth
from tomotactile_ros.bench.reference_mesh import disc
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.scenes.sheet_field import conductance_of

FINGER = 0.006  # m, radius


@dataclass(frozen=True, eq=False)
class States:
    """N states of sheets of `layout`: what the electrodes see, the true contacts
    (`evaluation.scoring`), and the case that each is one of."""

    layout: Layout
    seen: list[Admittance]
    truths: list[list[dict]]
    cases: list[str]

    def every(self, step: int) -> States:
        """Every `step`-th of them."""
        return States(self.layout, self.seen[::step], self.truths[::step], self.cases[::step])

    def save(self, path: str | os.PathLike) -> None:
        """Write them as `states` reads them."""
        packed = np.array([each.packed for each in self.seen], np.float32)
        both = zip(self.cases, self.truths, strict=True)
        words = [{"case": case, "contacts": truth} for case, truth in both]
        reference_data.write(path, self.layout, {"packed": packed}, {"states": words})


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


def solved(family: Family, h: float | None = None) -> States:
    """All states of a family by the reference model of element size `h`, m."""
    layout = family.layout
    sheets = [
        ReferenceSheet(layout, conductance_of(layout, each.field, each.variation), h=h)
        for each in family.sheets
    ]
    seen, truths = [], []
    for state in family.states:
        contacts = [(press.shape, press.conductance) for press in state.contacts]
        seen.append(sheets[state.sheet].solve(contacts))
        truths.append([truth(press, layout.outline) for press in state.contacts])
    return States(layout, seen, truths, [state.case for state in family.states])


def fingers(layout: Layout, places: Iterable[np.ndarray], random) -> States:
    """At each of the places a disc of 6 mm, pressed with 0.5 to 3 N on an even sheet, solved."""
    area = np.pi * FINGER**2
    presses = [Press(disc(at, FINGER), "disc", random.uniform(0.5, 3.0) / area) for at in places]
    return solved(Family(layout, [State("fingers", [press]) for press in presses]))
