"""Which combinations of profile and layout are measured."""

from __future__ import annotations

from dataclasses import dataclass

from tomotactile_ros.bench.trials import make_pipeline
from tomotactile_ros.layouts.layout import load_layout
from tomotactile_ros.reconstruction import Pipeline

PROFILES = ("fast", "balanced", "accurate")
DEFAULT_LAYOUT = "equal-8x8"
LAYOUTS = ("equal-4x4", "optimized-4x4", "free-4x4", "optimized-8x8", "free-8x8")  # besides


@dataclass(frozen=True)
class Case:
    """One row."""

    layout: str
    profile: str = "fast"

    def __str__(self):
        return f"{self.layout}, {self.profile}"

    def pipeline(self) -> Pipeline:
        return make_pipeline(load_layout(self.layout), self.profile)


CASES = (*(Case(DEFAULT_LAYOUT, profile) for profile in PROFILES), *map(Case, LAYOUTS))


def is_default(row: dict) -> bool:
    """Whether a measured row is one of the profiles on the default layout."""
    return row["layout"] == DEFAULT_LAYOUT
