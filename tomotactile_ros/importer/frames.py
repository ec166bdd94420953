"""One importer: whatever holds the readings of a layout becomes frames, and what was guessed is
told, a line each, with the option that says otherwise."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from tomotactile_ros.devices.recording import check_unit, save_recording
from tomotactile_ros.frames_file import DEFAULT_DRIVE, FramesFile
from tomotactile_ros.importer.axes import (
    USUAL,
    Arranged,
    arrange,
    exchange,
    grounded_where_missing,
    named,
    rows_of_a_frame,
)
from tomotactile_ros.importer.exchanged import look_exchanged
from tomotactile_ros.importer.leading import Columns, take_off, without_end
from tomotactile_ros.importer.orders import in_order
from tomotactile_ros.importer.tables import Table, read_table
from tomotactile_ros.importer.units import doubt_of_shares, in_volts, refuse_differences
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.reconstruction.mistakes import are_exchanged, refuse_mistakes
from tomotactile_ros.reconstruction.settings import Settings
from tomotactile_ros.support import checks
from tomotactile_ros.support.checks import plain
from tomotactile_ros.support.errors import InputError, complaints_at

_SHOWN = 16  # electrodes of a list


@dataclass(frozen=True, eq=False)
class Imported:
    """frames, and told : what they were taken for, one line each."""

    frames: FramesFile
    told: list[str]
    layout: Layout

    def save(self, path: str | os.PathLike) -> None:
        """Write `frames.npz`."""
        save_recording(path, self.layout, self.frames)


def import_frames(
    source: str | os.PathLike | np.ndarray,
    layout: Layout,
    *,
    axes: str | None = None,
    grounded: Sequence[int] | None = None,
    order: str | None = None,
    rotated: bool = False,
    unit: str | None = None,
    bits: int | None = None,
    full_scale: float | None = None,
    missing: Sequence[str] = (),
    variable: str | None = None,
    drive_voltage: float = DEFAULT_DRIVE,
    row_period: float | None = None,
    rate: float | None = None,
    time_unit: str | None = None,
) -> Imported:
    """Frames of `layout` from a file (CSV, TSV, .mat, .npy, rosbag2) or an array of another program.

    Parameters
    ----------
    source : path, or numbers of any shape
    axes : N (frames), L (rows) and E (electrodes) in the order of the indices, slowest first, `NLE`
        for rows of electrodes one below the other; None: from the shape, from where the grounded
        electrodes' own readings lie, and from the signs of currents, or assumed and told so
    grounded : (L,) electrode of each row, from 0; None: from a column, from which readings are
        missing, or as the layout scans
    order : `pyeit` or `eidors`, of whose measurements the readings are; rotated : their `rotate_meas`
    unit : `V`, `mV`, `uV` or `counts`; None: guessed; bits : of counts; full_scale : V of the highest
    missing : what stands for a missing reading; variable : name of an array in a file of several,
        or topic of a bag
    drive_voltage : V
    row_period : s from row to row; rate : frames a second; None: from a column of times, or not known
    time_unit : `s`, `ms` or `us` of that column; None: from its name

    Raises InputError for what is no such file, or no frame of the layout, and says what would be
    right.
    """
    if isinstance(source, (str, os.PathLike)):
        place, table = f"{source}: ", read_table(source, variable, [str(each) for each in missing])
    else:
        place, table = "", Table(np.array(source, float))
        for each in missing:
            np.copyto(table.values, np.nan, where=table.values == float(each))
    with complaints_at(place):
        checks.positive(drive_voltage, "drive_voltage", "voltage in V")
        columns = _columns(table, layout, order, time_unit)
        told = [*table.told, *columns.told]
        if infinite := np.count_nonzero(np.isinf(columns.values)):
            columns.values = np.where(np.isinf(columns.values), np.nan, columns.values)
            told.append(f"infinite readings taken for missing: {infinite}")
        chosen, how = _grounded(columns, layout, grounded)
        found = _arranged(columns.values, chosen, layout, axes, order, rotated)
        chosen, how = _checked_ground(found.voltages, chosen, how)
        voltages, line = in_volts(found.voltages, drive_voltage, unit, bits, full_scale)
        refuse_differences(voltages, chosen, drive_voltage, not missing)
        voltages[:, np.arange(len(chosen)), chosen] = np.nan
        line += "" if unit else doubt_of_shares(voltages, drive_voltage)
        check_unit("", voltages, drive_voltage)
        known: bool | None = None
        if axes is None and order is None and _may_be_exchanged(chosen, how, layout):
            noise, square = Settings().noise, voltages[:, np.argsort(chosen)]
            exchanged = look_exchanged(square, noise, Settings().threshold * noise)
            if exchanged is None:  # the layout may tell, but only the one way
                exchanged = are_exchanged(layout, voltages, chosen, drive_voltage, noise) or None
            known = exchanged is not None
            if exchanged:
                voltages, chosen = voltages.transpose(0, 2, 1), np.argsort(chosen)
                found = replace(found, axes=exchange(found.axes))
        told += [
            found.told or _axes_told(found, len(chosen), axes is not None, known),
            f"grounded {how}: {_listed(chosen)}",
            line,
        ]
        refuse_mistakes(layout, voltages, chosen, drive_voltage, Settings().noise)
        period, stamps, line = _times(columns.times, len(voltages), len(chosen), row_period, rate)
        told.append(line)
    frames = FramesFile(
        voltages, chosen.astype(np.uint16), drive_voltage, stamps, row_period=period, lawless=True
    )
    return Imported(frames, told, layout)


def _columns(table: Table, layout: Layout, order: str | None, time_unit: str | None) -> Columns:
    """The readings without columns of something else."""
    if not table.has_columns:
        return Columns(np.atleast_1d(np.squeeze(table.values)), table.times)
    each, rows = layout.electrodes, {layout.electrodes, len(layout.grounded)}
    widths = [each, *(each * count for count in rows)]
    if order is not None:
        widths += [each - 1, *((each - 1) * count for count in rows)]
    values = without_end(table.values, tuple(widths))
    columns = take_off(values, table.names, tuple(widths), each, time_unit)
    if values.shape != table.values.shape:
        columns.told.append(f"column {values.shape[1] + 1} is empty, left out")
    columns.values = np.atleast_1d(np.squeeze(columns.values))
    return columns


def _grounded(
    columns: Columns, layout: Layout, given: Sequence[int] | None
) -> tuple[np.ndarray, str]:
    """(L,) electrode of each row of a frame, and where that is known from."""
    if given is not None:
        return checks.order(given, "grounded", layout.electrodes), "as given"
    if columns.grounded is not None:
        repeated = rows_of_a_frame(columns.grounded)
        return checks.order(repeated, "grounded", layout.electrodes), "from their column"
    values = columns.values
    if values.shape[-1] == layout.electrodes:
        seen = grounded_where_missing(values.reshape(-1, layout.electrodes))
        order = None if seen is None else rows_of_a_frame(seen)
        if order is not None:
            return order, "where readings are missing"
    whole = values.size % (len(layout.grounded) * layout.electrodes) == 0
    order = layout.grounded if whole else np.arange(layout.electrodes)
    return order, f"assumed as {layout.name} scans (--grounded)"


def _checked_ground(voltages: np.ndarray, grounded: np.ndarray, how: str) -> tuple[np.ndarray, str]:
    """The same, from readings that are missing in all frames where it was assumed so far."""
    if not how.startswith("assumed"):
        return grounded, how
    seen = grounded_where_missing(np.where(np.isnan(voltages).all(axis=0), np.nan, 0.0))
    return (grounded, how) if seen is None else (seen, "where readings are missing")


def _arranged(
    values: np.ndarray,
    grounded: np.ndarray,
    layout: Layout,
    axes: str | None,
    order: str | None,
    rotated: bool,
) -> Arranged:
    """(N, L, E) readings, and how they lay."""
    if order is not None:
        voltages, told = in_order(values, grounded, layout.electrodes, order, rotated)
        return Arranged(voltages, told=told)
    if rotated:
        raise InputError("rotated: only readings in the order of pyeit or eidors are (--order)")
    found = arrange(values, grounded, layout.electrodes, axes)
    return replace(found, voltages=found.voltages.copy())


def _may_be_exchanged(grounded: np.ndarray, how: str, layout: Layout) -> bool:
    """Whether rows and electrodes would look alike if they were exchanged: not where the lines of a
    text name what is grounded, or the grounded electrodes' own readings lay elsewhere."""
    if how == "from their column" or len(grounded) != layout.electrodes:
        return False
    return how == "where readings are missing" or np.array_equal(grounded, np.argsort(grounded))


def _axes_told(found: Arranged, rows: int, given: bool, known: bool | None) -> str:
    """The line about axes; known : whether the readings tell rows from electrodes, None where something
    else does."""
    line = f"{len(found.voltages)} frames of {rows} rows, axes {named(found.axes)}"
    line += {None: "", True: ", by the readings", False: ", assumed, not known"}[known]
    options = [f"--axes {found.axes}"] if found.axes != USUAL or found.others else []
    options += [f"{', '.join(found.others)} fits as well"] if found.others else []
    if known is False:
        options.append(f"if not, --axes {exchange(found.axes)}")
    return line + (f" ({'; '.join(options)})" if options and not given else "")


def _times(
    lines: np.ndarray | None, frames: int, rows: int, row_period: float | None, rate: float | None
) -> tuple[float, np.ndarray | None, str]:
    """Row period, s, and (N,) stamps, s, of frames, and what is known of them."""
    stamps = None
    if lines is not None and len(lines) == frames * rows and rows > 1:
        each = lines.reshape(frames, rows)
        stamps = each[:, 0]
        if row_period is None:
            row_period = float(np.median(np.diff(each, axis=1)))
    elif lines is not None and len(lines) == frames:
        stamps = lines
    if rate is not None:
        stamps = np.arange(frames) / checks.positive(rate, "rate", "number of frames per second")
    period = (
        0.0 if row_period is None else checks.not_negative(row_period, "row_period", "time in s")
    )
    rows_told = (
        f"{plain(1e3 * period, 4)} ms apart" if period else "taken for all at once (--row-period)"
    )
    told = (
        "of unknown times (--rate)"
        if stamps is None
        else f"from {stamps[0]:.6g} to {stamps[-1]:.6g} s"
    )
    return period, stamps, f"rows {rows_told}, frames {told}"


def _listed(grounded: np.ndarray) -> str:
    if np.array_equal(grounded, np.arange(len(grounded))):
        return f"0 to {len(grounded) - 1} in turn"
    shown = " ".join(map(str, grounded[:_SHOWN].tolist()))
    return shown + (" ..." if len(grounded) > _SHOWN else "")
