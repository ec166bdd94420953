"""Speed against accuracy: one row for each profile, resolution, number of ground conditions and layout."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import product

import numpy as np

from tomotactile_ros.bench import accuracy, timing
from tomotactile_ros.bench.conditions import spread_conditions
from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE, Trials
from tomotactile_ros.errors import InputError
from tomotactile_ros.layout import Layout, equal_grid, load_layout
from tomotactile_ros.reconstruction import Pipeline, Settings
from tomotactile_ros.yamlio import config_folders

PROFILES = ("fast", "balanced", "accurate")
RESOLUTIONS = (20, 40, 80)
CONDITIONS = (None, 32, 16, 8)
FAMILIES = ("equal", "optimized", "free")
ELECTRODES = (4, 8, 16)
DEFAULT_LAYOUT = "equal-8x8"
_SIDE, _SHEET = 0.2, 10000.0  # m, ohm/sq of a grid that is not installed
_FRAMES = 100  # timed at least


@dataclass(frozen=True)
class Case:
    """One row. `conditions` None: all electrodes are grounded in turn."""

    layout: str
    profile: str
    resolution: int
    conditions: int | None


def quick_cases() -> list[Case]:
    """Each profile, resolution and layout but the largest, and 16 conditions; all else at its default."""
    base = (DEFAULT_LAYOUT, "fast", 40, None)
    out = [Case(DEFAULT_LAYOUT, profile, 40, None) for profile in PROFILES]
    out += [Case(*base[:2], resolution, None) for resolution in RESOLUTIONS if resolution != 40]
    out.append(Case(*base[:3], 16))
    out += [Case(name, *base[1:]) for name in layout_names((4, 8)) if name != base[0]]
    return out


def full_cases() -> list[Case]:
    """Everything with everything; conditions only where there are more electrodes."""
    return [
        Case(name, profile, resolution, conditions)
        for name, profile, resolution, conditions in product(
            layout_names(ELECTRODES), PROFILES, RESOLUTIONS, CONDITIONS
        )
        if conditions is None or conditions < find_layout(name).electrodes
    ]


def layout_names(counts) -> list[str]:
    """Equal grids, and the optimised layouts that are installed, of n x n electrodes for n in `counts`."""
    installed = {
        path.stem for folder in config_folders("layouts") for path in folder.glob("*.yaml")
    }
    wanted = [(family, f"{family}-{n}x{n}") for n in counts for family in FAMILIES]
    return [name for family, name in wanted if family == "equal" or name in installed]


def find_layout(name: str) -> Layout:
    """An installed layout, or the equal grid of that name."""
    try:
        return load_layout(name)
    except InputError:
        family, _, size = name.partition("-")
        if family != "equal":
            raise
        rows, columns = (int(n) for n in size.split("x"))
        return equal_grid(rows, columns, (_SIDE, _SIDE), 0.1 * _SIDE / rows, _SHEET, name=name)


def settings_of(case: Case) -> Settings:
    return Settings(profile=case.profile, resolution=case.resolution, noise=NOISE, contact_law=LAW)


def measure(case: Case, trials: Trials, seconds: float) -> dict:
    """Figures of one row; times in s, memory in bytes, lengths in m."""
    layout, settings = trials.layout, settings_of(case)
    conditions = spread_conditions(layout, case.conditions)
    pipeline, setup = timing.timed(lambda: Pipeline(layout, settings))
    merit = accuracy.measure(pipeline, trials, conditions)
    frames = np.concatenate([trials.singles.frames, trials.pairs.frames])[:, conditions]
    calls = [lambda frame=frame: pipeline.process(frame, conditions, DRIVE) for frame in frames]
    per_frame = timing.summary(timing.durations(calls, _FRAMES, seconds))
    held = timing.memory(lambda: Pipeline(layout, settings))
    return asdict(case) | {"setup": setup, "frame": per_frame, "memory": held} | merit


def is_default(row: dict) -> bool:
    """Whether a row belongs to the profiles at their defaults."""
    return (row["layout"], row["resolution"], row["conditions"]) == (DEFAULT_LAYOUT, 40, None)


def front(rows: list[dict]) -> Iterator[dict]:
    """Rows of which none is both faster and more accurate (mean error of a contact's place)."""
    best = np.inf
    for row in sorted(rows, key=lambda row: row["frame"]["median"]):
        if row["contact_error"]["mean"] < best:
            best = row["contact_error"]["mean"]
            yield row
