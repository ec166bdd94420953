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
    if highest <= 1e3 * limit:
        return "mV"
    if highest <= 1e6 * limit:
        return "uV"
    raise InputError(
        f"unit: readings up to {plain(highest, 4)} are neither V, mV nor uV at a drive voltage of "
        f"{drive_voltage:g} V: which number stands for a missing reading (--missing)?"
    )
