"""Which combinations of profile, resolution, ground conditions and layout are measured."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np

from tomotactile_ros.bench.trials import LAW, NOISE
from tomotactile_ros.layouts.layout import Layout, equal_grid, load_layout
from tomotactile_ros.optimizer.grounding import drop_order
from tomotactile_ros.reconstruction import Settings
from tomotactile_ros.support.errors import InputError

PROFILES = ("fast", "balanced", "accurate")
DEFAULT_LAYOUT = "equal-8x8"
LAYOUTS = ("equal-4x4", "optimized-4x4", "free-4x4", "optimized-8x8", "free-8x8")  # besides
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


# each profile, resolution and layout, and 16 conditions; all else at its default
CASES = (
    *(Case(DEFAULT_LAYOUT, profile) for profile in PROFILES),
    *(Case(DEFAULT_LAYOUT, resolution=cells) for cells in (20, 80)),
    Case(DEFAULT_LAYOUT, conditions=16),
    *map(Case, LAYOUTS),
)


def is_default(row: dict) -> bool:
    """Whether a measured row belongs to the profiles at their defaults."""
    return (row["layout"], row["resolution"], row["conditions"]) == (DEFAULT_LAYOUT, 40, None)


@cache
def find_layout(name: str) -> Layout:
    """An installed layout; equal grids of any size."""
    try:
        return load_layout(name)
    except InputError:
        if not name.startswith("equal-"):
            raise
        rows, columns = (int(n) for n in name.removeprefix("equal-").split("x"))
        return equal_grid(rows, columns, (_SIDE, _SIDE), 0.1 * _SIDE / rows, _SHEET, name=name)


@cache
def grounded(case: Case) -> np.ndarray:
    """(L,) electrodes that are grounded: those that the optimizer keeps, in the order of the
    layout."""
    layout = find_layout(case.layout)
    if case.conditions is None:
        return np.arange(layout.electrodes)
    return np.sort(drop_order(layout)[layout.electrodes - case.conditions :])
