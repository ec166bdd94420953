"""What was read: rows of readings with their weights, electrodes that were grounded, and times."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tomotactile_ros.core import compiled


@dataclass(frozen=True)
class Rows:
    """What was read: L rows of the n electrodes in use.

    readings (L, n) in parts of V0; weights (L, n) one over the variance of the noise, 0 where
        nothing was read
    grounded (L,) electrode in use that is grounded in each row
    times (L,) s, of each row against the time for which contacts are estimated; None where all were
        read at once
    """

    readings: np.ndarray
    weights: np.ndarray
    grounded: np.ndarray
    times: np.ndarray | None = None

    @cached_property
    def core(self) -> Any:
        return compiled.Rows(self.readings, self.weights, self.grounded, self.times)

    @property
    def count(self) -> int:
        """Number of readings."""
        return int(np.count_nonzero(self.weights))

    @property
    def last(self) -> float:
        """Time of the last row, s; 0 where all were read at once."""
        return 0.0 if self.times is None else float(self.times.max())

    def corrected(self, channels: Any) -> Rows:
        """What channels without gains and offsets would have read; `channels` has both: `Prior`,
        `Unknowns`."""
        read = (self.readings - channels.offset) / channels.gain
        return replace(self, readings=np.where(self.weights > 0, read, 0.0))

    def part(self, chosen: slice | np.ndarray) -> Rows:
        """Only the rows `chosen`; contacts are estimated for the middle of their time."""
        times = None if self.times is None else self.times[chosen]
        if times is not None and len(times):
            times = times - (times.min() + times.max()) / 2
        return Rows(self.readings[chosen], self.weights[chosen], self.grounded[chosen], times)
