"""One scan of the sheet: what files, devices, simulation, learning and reconstruction hand on."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.support.errors import InputError

DEFAULT_DRIVE = 3.3  # V


@dataclass(frozen=True, eq=False)
class Frame:
    """Electrodes grounded one after another, all others read.

    Attributes
    ----------
    voltages : (L, E) V
        One row per ground condition; NaN where there is no valid reading. The grounded electrode's
        own entry may hold what it reads, or NaN.
    grounded : (L,)
        The grounded electrode of each row.
    sequence : int
        Counts frames at their source; gaps are lost frames.
    stamp : float, s
        Start of the frame's first row; NaN where it is not known.
    drive_voltage : float, V
    row_period : float, s
        Row i was taken at stamp + i * row_period; 0: all at once, or not known.
    """

    voltages: np.ndarray
    grounded: np.ndarray
    sequence: int = 0
    stamp: float = math.nan
    drive_voltage: float = DEFAULT_DRIVE
    row_period: float = 0.0


def stacked(
    frames: Iterable[Frame] | ArrayLike,
    grounded: ArrayLike | None = None,
    drive_voltage: float | None = None,
) -> tuple[np.ndarray, np.ndarray, float]:
    """(N, L, E) V, (L,) and V, of frames that agree in grounded electrodes and drive voltage.

    frames : or (N, L, E) V, where the others are given
    """
    if grounded is not None:
        drive = DEFAULT_DRIVE if drive_voltage is None else drive_voltage
        return np.asarray(frames, float), np.asarray(grounded, int), drive
    several: list[object] = list(frames) if isinstance(frames, Iterable) else []
    given = [each for each in several if isinstance(each, Frame)]
    if not given or len(given) < len(several):
        raise InputError(
            "frames: at least one Frame is needed, or arrays with grounded and the drive voltage"
        )
    first = given[0]
    for number, each in enumerate(given):
        if not np.array_equal(each.grounded, first.grounded):
            raise InputError(f"frames[{number}]: has other ground conditions than the first one")
        if each.drive_voltage != first.drive_voltage:
            raise InputError(
                f"frames[{number}]: was driven with {each.drive_voltage:g} V, the first one with "
                f"{first.drive_voltage:g} V"
            )
    voltages = np.array([each.voltages for each in given], float)
    return voltages, np.asarray(first.grounded, int), first.drive_voltage
