"""Which combinations of profile, resolution, ground conditions and layout are measured, and which
make no sense."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache
from itertools import product

import numpy as np

from tomotactile_ros.bench.trials import LAW, NOISE
from tomotactile_ros.layouts.layout import Layout, equal_grid, load_layout
from tomotactile_ros.optimizer.equalize import equalize
from tomotactile_ros.optimizer.grounding import drop_order
from tomotactile_ros.reconstruction import Settings
from tomotactile_ros.support.errors import InputError

PROFILES = ("fast", "balanced", "accurate")
RESOLUTIONS = (20, 40, 80)
CONDITIONS = (None, 32, 16, 8)
FAMILIES = ("equal", "optimized", "free")
ELECTRODES = (4, 8, 16)
DEFAULT_LAYOUT = "equal-8x8"
_SIDE, _SHEET = 0.2, 10000.0  # m, ohm/sq of a grid that is not installed


@dataclass(frozen=True)
class Case:
    """One row. `conditions` None: all electrodes are grounded in turn."""

    layout: str
    profile: str = "fast"
    resolution: int = 40
    conditions: int | None = None

    def __str__(self):
        grounds = "all" if self.conditions is None else self.conditions
        return f"{self.layout}, {self.profile}, {self.resolution}², {grounds} grounds"

    @property
    def settings(self) -> Settings:
        return Settings(self.profile, resolution=self.resolution, noise=NOISE, contact_law=LAW)

    @property
    def is_slow(self) -> bool:
        """Whether a frame takes so long that fewer contacts have to do."""
        return self.profile == "accurate" and self.resolution > 40


def quick_cases() -> list[Case]:
    """Each profile, resolution and layout but the largest, and 16 conditions; all else at its
    default."""
    return [
        *(Case(DEFAULT_LAYOUT, profile) for profile in PROFILES),
        *(Case(DEFAULT_LAYOUT, resolution=cells) for cells in RESOLUTIONS if cells != 40),
        Case(DEFAULT_LAYOUT, conditions=16),
        *(Case(name) for name in layout_names((4, 8)) if name != DEFAULT_LAYOUT),
    ]


def full_cases() -> list[Case]:
    """Everything with everything that makes sense, ordered by layout and resolution."""
    return [
        Case(name, profile, resolution, conditions)
        for name, resolution, profile, conditions in product(
            layout_names(ELECTRODES), RESOLUTIONS, PROFILES, CONDITIONS
        )
        if conditions is None or conditions < find_layout(name).electrodes
    ]


def is_default(row: dict) -> bool:
    """Whether a measured row belongs to the profiles at their defaults."""
    return (row["layout"], row["resolution"], row["conditions"]) == (DEFAULT_LAYOUT, 40, None)


def left_out(cases: list[Case]) -> list[str]:
    """A line for each choice that `full_cases` would measure everywhere and does not."""
    names = list(dict.fromkeys(case.layout for case in cases))
    lines = [
        f"{family}-{n}x{n}: not measured, no such layout is installed"
        for n, family in product(ELECTRODES, FAMILIES)
        if f"{family}-{n}x{n}" not in names
    ]
    for name in names:
        count = find_layout(name).electrodes
        needless = [str(n) for n in CONDITIONS if n is not None and n >= count]
        if needless:
            lines.append(
                f"{name}: not measured with {' and '.join(needless)} ground conditions, "
                f"{count} are all that it has"
            )
    return lines


def layout_names(counts) -> list[str]:
    """Layouts of n x n electrodes for n in `counts`, those that there are."""
    return [
        f"{family}-{n}x{n}" for n in counts for family in FAMILIES if _exists(f"{family}-{n}x{n}")
    ]


def _exists(name):
    try:
        find_layout(name)
    except InputError:
        return False
    return True


@cache
def find_layout(name: str) -> Layout:
    """An installed layout; equal grids, and these improved by the paper's method, of any size."""
    try:
        return load_layout(name)
    except InputError:
        family, _, size = name.partition("-")
        if family not in ("equal", "optimized"):
            raise
        rows, columns = (int(n) for n in size.split("x"))
        if family == "equal":
            radius = 0.1 * _SIDE / rows
            return equal_grid(rows, columns, (_SIDE, _SIDE), radius, _SHEET, name=name)
        steps = equalize(find_layout(f"equal-{size}"))
        best = min(steps, key=lambda step: step.score)
        return replace(best.quality.layout, name=name)


@cache
def _drop_order(name):
    return drop_order(find_layout(name))


def grounded(case: Case) -> np.ndarray:
    """(L,) electrodes that are grounded: those that the optimizer keeps, in the order of the
    layout."""
    count = find_layout(case.layout).electrodes
    if case.conditions is None:
        return np.arange(count)
    return np.sort(_drop_order(case.layout)[count - case.conditions :])
