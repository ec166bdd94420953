"""Columns of a text beside the readings: times, the grounded electrode, a counter."""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

TIME_UNITS = {"s": 1.0, "ms": 1e-3, "us": 1e-6}
_MOST = 2  # columns
_TIME = re.compile(r"^t$|(?<![a-z])time|time(?![a-z])|stamp|second", re.IGNORECASE)
_UNIT = re.compile(r"(?<![a-z])(ms|us|µs)(?![a-z])|(milli|micro)", re.IGNORECASE)
_LONGEST = 1.0  # s from line to line, beyond which times are probably not in s


@dataclass(eq=False)
class Columns:
    """values (R, C) without such columns, and for each line its time, s, and its grounded electrode,
    None where there is no such column."""

    values: np.ndarray
    times: np.ndarray | None = None
    grounded: np.ndarray | None = None
    told: list[str] = field(default_factory=list)


def take_off(
    values: np.ndarray,
    names: tuple[str, ...],
    widths: tuple[int, ...],
    electrodes: int,
    time_unit: str | None = None,
) -> Columns:
    """The columns before the last `widths` ones (one of them), if there are one or two.

    names : of the columns, or none; time_unit : of `TIME_UNITS`, None: as the name says it
    """
    extra = next((values.shape[1] - w for w in widths if 0 < values.shape[1] - w <= _MOST), 0)
    if values.shape[1] in widths or not extra:
        return Columns(values)
    found = Columns(values[:, extra:])
    for number in range(extra):
        column, name = values[:, number], names[number] if len(names) > number else ""
        label = f"column {number + 1}" + (f" ({checks.show(name).strip(chr(39))})" if name else "")
        if np.isnan(column).any():
            raise InputError(
                f"{label}: holds no number in some lines, and there are {values.shape[1]} columns for "
                f"{' or '.join(map(str, widths))} readings: leave out the columns that are none"
            )
        steps = np.diff(column)
        if not _TIME.search(name) and (steps == 1).all():
            found.told.append(f"{label} counts lines, left out")
        elif (steps >= 0).all() and (steps > 0).any():
            unit = time_unit or _unit_of(name)
            if unit not in TIME_UNITS:
                raise InputError(
                    f"time_unit: {checks.show(unit)} is none of {', '.join(TIME_UNITS)}"
                )
            found.times = column * TIME_UNITS[unit]
            step = float(np.median(np.diff(found.times)))
            if time_unit is None and step > _LONGEST:
                raise InputError(f"{label}: lines {step:g} s apart? If not, --time-unit ms or us")
            found.told.append(f"times of lines from {label}, in {unit}")
        elif (
            (column == np.round(column)).all() and 0 <= column.min() and column.max() <= electrodes
        ):
            one = int(column.max() == electrodes)  # counted from 1
            found.grounded = column.astype(int) - one
            found.told.append(
                f"grounded electrodes from {label}" + (", counted from 1" if one else "")
            )
        else:
            raise InputError(
                f"{label}: is neither time nor grounded electrode, and there are {values.shape[1]} columns for "
                f"{' or '.join(map(str, widths))} readings: leave it out"
            )
    return found


def without_end(values: np.ndarray, widths: tuple[int, ...]) -> np.ndarray:
    """Lines (R, C) without an empty last column, which a separator at their ends makes; kept where it is
    that of a reading, as lines of one of `widths` readings need it.

    Behind other columns both fit: own readings that are missing begin with the first reading of a line.
    """
    empty = np.isnan(values).all(axis=0)
    rest = values.shape[1] - 1
    if not empty[-1] or rest + 1 in widths:
        return values
    extra = next((rest - w for w in widths if 0 <= rest - w <= _MOST), 0)
    return values if empty[:-1].any() and not empty[extra] else values[:, :-1]


def _unit_of(name: str) -> str:
    unit = _UNIT.search(name)
    if not unit:
        return "s"
    return "ms" if unit.group(0).lower() in ("ms", "milli") else "us"
