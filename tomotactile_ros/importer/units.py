"""Readings in volts, whatever unit they were written in.

Nothing on the sheet is above the drive voltage: what is, is in another unit. Whole numbers above it
are counts of a converter or whole millivolts, which only the user knows apart, unless they reach
what no millivolts of the sheet do.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.support import checks
from tomotactile_ros.support.checks import plain
from tomotactile_ros.support.errors import InputError

UNITS = ("V", "mV", "uV", "counts")
_SCALES = {"V": 1.0, "mV": 1e-3, "uV": 1e-6}
_ABOVE = 1.1  # times the drive voltage: readings of noise and gains end below
_MOST_BITS = 24
_STRONGEST = 26.0  # V: few sensors are driven with more, and few that are touched read less in mV
_TOUCHED = 0.05  # times the drive voltage, above which something touches


def in_volts(
    values: np.ndarray,
    drive_voltage: float,
    unit: str | None = None,
    bits: int | None = None,
    full_scale: float | None = None,
) -> tuple[np.ndarray, str]:
    """Readings in V, NaN where there is none, and a line that says what they were taken for.

    unit : of `UNITS`; None: guessed; bits : of the converter, of counts; full_scale : V that its
        highest count stands for, the drive voltage without it
    """
    valid = np.abs(values[np.isfinite(values)])
    if not valid.size:
        raise InputError("none of the readings is a number")
    highest = float(valid.max())
    if unit is None and (bits is not None or full_scale is not None):
        unit = "counts"
    how = "as given" if unit else "guessed, --unit"
    if unit is None:
        unit = _guessed(valid, highest, drive_voltage)
    if unit not in UNITS:
        raise InputError(f"unit: {checks.show(unit)} is none of {', '.join(UNITS)}")
    if unit != "counts":
        told = f"unit {unit} ({how}), readings up to {plain(highest, 4)} {unit}"
        return values * _SCALES[unit], told
    if bits is None:
        raise InputError(
            f"bits: of how many bits are the counts? They reach {highest:g}: --bits "
            f"{max(8, int(highest).bit_length())} or more"
        )
    bits = checks.integer(bits, "bits", 1, _MOST_BITS)
    if highest > 2**bits - 1:
        raise InputError(
            f"bits: a converter of {bits} bits ends at {2**bits - 1}, readings at {highest:g}"
        )
    full = drive_voltage if full_scale is None else full_scale
    checks.positive(full, "full_scale", "voltage in V")
    return values * (full / 2**bits), (
        f"unit counts of {bits} bits, {2**bits} for {full:g} V, readings up to {highest:g}"
    )


def _guessed(valid: np.ndarray, highest: float, drive_voltage: float) -> str:
    limit = _ABOVE * drive_voltage
    whole = bool((valid == np.round(valid)).all())
    if highest <= limit and not (whole and highest > 0):
        return "V"
    if whole and highest > 1e3 * limit:
        return "counts"
    if whole and highest > 0:
        least = max(8, int(highest).bit_length())
        raise InputError(
            f"unit: whole numbers up to {highest:g}: counts of a converter (--unit counts --bits "
            f"{least} or more) or millivolts (--unit mV)?"
        )
    for unit, larger, scale in (("mV", "V", 1e3), ("uV", "mV", 1e6)):
        if highest <= scale * limit:
            if highest <= scale * _STRONGEST / 1e3:
                raise InputError(
                    f"unit: readings up to {plain(highest, 4)}: {larger} of a sensor that is driven with more than "
                    f"{drive_voltage:g} V (--drive-voltage), or {unit} of one that hardly anything touches (--unit {unit})?"
                )
            return unit
    raise InputError(
        f"unit: readings up to {plain(highest, 4)} are neither V, mV nor uV at a drive voltage of "
        f"{drive_voltage:g} V: which number stands for a missing reading (--missing)?"
    )


def refuse_differences(
    voltages: np.ndarray, grounded: np.ndarray, drive_voltage: float, marks: bool
) -> None:
    """Refuse frames (N, L, E), V, that are no readings against the ground; `marks`: what is missing may
    have a number that nobody has told."""
    own = voltages[:, np.arange(len(grounded)), grounded]
    others = voltages.copy()
    others[:, np.arange(len(grounded)), grounded] = np.nan
    read = others[np.isfinite(others)]
    most = np.abs(read).max(initial=0.0)
    if most > _TOUCHED * drive_voltage and np.mean(read < -0.2 * most) > _TOUCHED:
        hint = ", or a number for missing readings (--missing)" if marks else ""
        raise InputError(
            f"readings down to {plain(read.min(), 4)} V, and none is below the ground: are these differences of "
            f"neighbours (--order pyeit or eidors), or from a reference{hint}?"
        )
    highest = np.nanmax(np.where(np.isfinite(others), others, -np.inf), axis=2)
    if np.median(np.nan_to_num(own)) > 0.1 * drive_voltage and np.mean(own >= highest) > 0.5:
        raise InputError(
            "grounded: the grounded electrodes read most, which are at 0 V: are these V0 - v, or 1 - v / V0, of "
            "readings v at a drive voltage V0? Give v, or the electrodes that are grounded (--grounded)"
        )


def doubt_of_shares(voltages: np.ndarray, drive_voltage: float) -> str:
    """The end of a line about readings that may be shares of the drive voltage; else nothing."""
    highest = float(np.nanmax(voltages))
    if drive_voltage > _ABOVE and _TOUCHED * drive_voltage < highest <= 1.0:
        return "; if these are shares of the drive voltage, 0 to 1: --drive-voltage 1"
    return ""
