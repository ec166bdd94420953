"""Profile `auto`: the most accurate profile that meets the deadline on this machine, by
measurement.

How long they take is measured here. How accurate they are is not a matter of the machine: by the OSPA
distance of contacts, which ghosts and missed ones enter, they are in the order of `MEASURED` on the
sensor of the textbook and on a worn one, as `tomotactile bench` measures and says.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np

from tomotactile_ros.sheet.transfer import Transfer
from tomotactile_ros.sheet.voltages import frame

MEASURED = ("accurate", "balanced", "fast")  # nearest to the truth first
_ROUNDS = 15
_LONG = 0.5  # s of measurements, after which there are no more of a profile
_PLACES = (0.3, 0.65), (0.75, 0.3)  # of the contacts, in parts of the sheet's size
_STRENGTH = 1.0  # conductance of each contact, times the sheet resistance


def trial_frame(transfer: Transfer, resistance: float, noise: float, drive_voltage: float = 3.3):
    """(E, E) frame of two contacts on pixels of `transfer`, V, with `noise` (V rms)."""
    low, high = transfer.points.min(axis=0), transfer.points.max(axis=0)
    wanted = low + np.array(_PLACES) * (high - low)
    apart = ((transfer.points[:, None] - wanted) ** 2).sum(axis=-1)
    chosen = np.unique(apart.argmin(axis=0))
    voltages = frame(
        transfer.at(chosen), np.full(len(chosen), resistance / _STRENGTH), drive_voltage
    )
    return voltages + noise * np.random.default_rng(0).standard_normal(voltages.shape)


def median_times(works: dict[str, Callable[[], object]]) -> dict[str, float]:
    """Median time of each, s; in turn, so that a busy moment is not all that one of them sees.

    What takes long is not measured as often: its time is clear.
    """
    times: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(_ROUNDS):
        for name, work in works.items():
            if sum(times[name]) > _LONG:
                continue
            start = time.perf_counter()
            work()
            times[name].append(time.perf_counter() - start)
    return {name: float(np.median(each)) for name, each in times.items()}


def choose(times: dict[str, float], deadline: float) -> tuple[str, str]:
    """The most accurate profile within `deadline` (s), else the fastest; and a line for the log."""
    fitting = [profile for profile in MEASURED if times[profile] <= deadline]
    chosen = fitting[0] if fitting else min(times, key=times.__getitem__)
    figures = ", ".join(f"{profile} {1e3 * times[profile]:.2f} ms" for profile in MEASURED)
    verdict = "" if fitting else "; none meets it"
    return (
        chosen,
        f"profile {chosen} by measurement ({figures}; deadline {1e3 * deadline:g} ms{verdict})",
    )
