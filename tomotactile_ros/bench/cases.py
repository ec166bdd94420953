"""Which combinations of profile and layout are measured."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

from tomotactile_ros.bench.trials import make_pipeline
from tomotactile_ros.layouts.layout import Layout, equal_grid, load_layout
from tomotactile_ros.reconstruction import Pipeline
from tomotactile_ros.support.errors import InputError

PROFILES = ("fast", "balanced", "accurate")
DEFAULT_LAYOUT = "equal-8x8"
LAYOUTS = ("equal-4x4", "optimized-4x4", "free-4x4", "optimized-8x8", "free-8x8")  # besides
_SIDE, _SHEET = 0.2, 10000.0  # m, ohm/sq of a grid that is not installed


@dataclass(frozen=True)
class Case:
    """One row."""

    layout: str
    profile: str = "fast"

    def __str__(self):
        return f"{self.layout}, {self.profile}"

    def pipeline(self) -> Pipeline:
        return make_pipeline(find_layout(self.layout), self.profile)


CASES = (*(Case(DEFAULT_LAYOUT, profile) for profile in PROFILES), *map(Case, LAYOUTS))


def is_default(row: dict) -> bool:
    """Whether a measured row is one of the profiles on the default layout."""
    return row["layout"] == DEFAULT_LAYOUT


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
