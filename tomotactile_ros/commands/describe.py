"""What stands in files that hold neither frames nor images: sensors, contact laws, tares, searches."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from datetime import datetime, timezone
from pathlib import Path

import numpy as np

from tomotactile_ros.estimation.operator import operator_for
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.learning import findings
from tomotactile_ros.learning.file import load_sensor
from tomotactile_ros.optimizer.work import kept_in
from tomotactile_ros.reconstruction.calibration import load_calibration
from tomotactile_ros.reconstruction.tare_file import load_tare
from tomotactile_ros.support import checks
from tomotactile_ros.support.checks import plain
from tomotactile_ros.support.errors import InputError

_FOOT = 0.005  # m, radius of the contact that a law is shown for
_FORCES = 1.0, 10.0  # N, of it
_LENGTHS = "spacing", "margin", "keep_out", "radius_range", "contact_radius", "apart"
_UNITS = {"noise": "V", "sheet_resistance": "ohm/sq"}
_LEFT_OUT = ("method", "start")  # of what a search was asked for: shown before


def known_layout(layout_id: str, layout: str | None) -> Layout | None:
    """The layout that is named, or an installed one or a file of the name in `layout_id`."""
    if layout is not None:
        return load_layout(layout)
    try:
        return load_layout(layout_id.partition("#")[0])
    except InputError:
        return None


def describe_sensor(path: Path, content: Mapping, layout: str | None) -> Iterator[str]:
    """Lines: what was learned of a sensor."""
    name = checks.show(content.get("layout")).strip("'")
    yield f"sensor learned with layout {name}"
    found = known_layout(str(content.get("layout")), layout)
    if found is None:
        yield "  no layout of that name is here: --layout, a file or an installed name, shows what was learned"
        return
    state = load_sensor(path, found)
    if state.time > 0:
        yield f"  last touch {_when(state.time)}"
    operator = operator_for(found)
    for line in findings.of_state(state, operator, np.arange(found.electrodes)):
        yield f"  {line}"


def describe_calibration(path: Path) -> Iterator[str]:
    """Lines: the contact law, and what it makes of a force."""
    law = load_calibration(path)
    yield f"contact law g = {law.coefficient:.4g} S/m2 (p / Pa)^{law.exponent:.4g}"
    area = np.pi * _FOOT**2
    for force in _FORCES:
        conductance = area * float(law.conductance(force / area))
        yield (
            f"  {force:g} N on a disc of {1e3 * _FOOT:g} mm radius: {plain(force / area / 1e3)} kPa, "
            f"{plain(1e3 * conductance)} mS"
        )


def describe_tare(path: Path, arrays: Mapping[str, np.ndarray]) -> Iterator[str]:
    """Lines: what a node keeps of an untouched sheet; its picture follows."""
    layout_id, electrodes = str(arrays["layout_id"]), arrays["baseline"].shape[-1]
    tare = load_tare(path, layout_id, electrodes)
    valid = 1e3 * tare.baseline[np.isfinite(tare.baseline)]
    yield f"tare of {layout_id}: mean of {tare.frames} frames, {_when(tare.stamp)}"
    if valid.size:
        yield f"  readings {plain(valid.min())} to {plain(valid.max())} mV, median {plain(np.median(valid))} mV"


def describe_search(path: Path) -> Iterator[str]:
    """Lines: what a search for a layout was asked for, and how far it has come."""
    try:
        asked, kept = kept_in(path)
    except (ValueError, RecursionError):
        raise InputError(f"{path}: is no state of a search") from None
    method, start = (checks.show(asked.get(key)).strip("'") for key in ("method", "start"))
    yield f"search {method}, from {start}: {len(kept)} results are known"
    for key, value in asked.items():
        if key not in _LEFT_OUT:
            yield f"  {key:17} {_asked(key, value)}"
    yield "  the same 'tomotactile optimize' with --resume goes on from here"


def _asked(key: str, value: object) -> str:
    """A setting of a search with its unit, lengths in mm."""
    unit = "mm" if key in _LENGTHS else _UNITS.get(key, "")
    try:
        numbers = np.array(value, float) * (1e3 if unit == "mm" else 1.0)
    except (TypeError, ValueError):
        return checks.show(value, 100)
    if not unit or not numbers.size or np.isnan(numbers).any():
        return checks.show("none" if value in (None, []) else value, 100).strip("'")
    return f"{_listed(numbers.tolist())} {unit}"


def _listed(numbers: float | list) -> str:
    """Numbers in lists in lists as a person writes them."""
    if isinstance(numbers, list):
        return f"[{', '.join(map(_listed, numbers))}]"
    return plain(numbers, 6)


def _when(stamp: float) -> str:
    return datetime.fromtimestamp(stamp, timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
