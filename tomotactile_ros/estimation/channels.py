"""What is expected of gains, offsets, resistances to ground and places of electrodes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

ALIKE = 0.5  # of the variance of resistances to ground is common to all: switches of one kind
KINDS = 5  # gain, offset, resistance to ground, and how far the electrode lies aside in x and y


@dataclass(frozen=True)
class ChannelPrior:
    """Standard deviations before anything is known, and what is expected.

    gain : relative; published electronics contradict reciprocity by 0.8 to 7 %
    offset : V; the input offset of common converters and amplifiers
    resistance : ohm; an analogue switch has some tens to hundreds
    aside : spacings, in x and in y; what electrodes lie beside their places in the layout: 0.1 mm at
        8 x 8 on 200 mm, as well as they can be made
    """

    gain: float = 0.03
    offset: float = 0.003
    resistance: float = 200.0
    aside: float = 3e-3

    def precision_of_resistances(self, count: int) -> np.ndarray:
        """(n, n) inverse covariance of `count` resistances, of whose variance `ALIKE` is common."""
        own = self.resistance**2 * (1 - ALIKE)
        common = np.full((count, count), ALIKE / (1 - ALIKE + ALIKE * count))
        return (np.eye(count) - common) / own

    def deviations(self, count: int, drive: float, pitch: float) -> tuple[np.ndarray, ...]:
        """(n,) of each kind; offsets in parts of the `drive` voltage, ways aside in m with electrodes
        `pitch`, m, apart."""
        aside = self.aside * pitch
        each = self.gain, self.offset / drive, self.resistance, aside, aside
        return tuple(np.full(count, deviation) for deviation in each)
