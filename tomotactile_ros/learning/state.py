"""What is known about one sensor: a normal distribution of all that makes it differ from its layout.

    theta = (sheet (J,), gain (E,), offset (E,) V, resistance (E,) ohm, aside x and y (E,) m)

with one mean and one covariance (D, D), D = J + 5 E: what is confused with each other stays so. In
time it is a random walk (`walked`), never wider than what is expected of a sensor of which nothing
is known.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tomotactile_ros.estimation.as_cut import COUNT, Tears
from tomotactile_ros.estimation.channels import KINDS, ChannelPrior
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import Prior

# of a sensor of which nothing is known
WIDE = ChannelPrior(gain=0.05, offset=0.005, resistance=250.0, aside=0.01)
PARTS = "sheet", "gain", "offset", "resistance", "aside_x", "aside_y"
SHEET_WALK = 5e-3  # per root hour, logarithm of conductance: make settles, fabric creeps
GAIN_WALK = 2e-4  # relative, per root hour: resistors of 100 ppm / K in a room
OFFSET_WALK = 2e-4  # V per root hour
RESISTANCE_WALK = 2.0  # ohm per root hour
ASIDE_WALK = 2e-5  # m per root hour: fabric that is worn
# V, of offsets from one touch to the next, beyond what was learned: amplifiers warm up, mains hum. A touch
# tells its own offsets to a tenth of that
OFFSET_WANDER = 1e-3
_HOUR = 3600.0  # s


@dataclass(frozen=True, eq=False)
class SensorState:
    """A sensor of `modes` coefficients of the sheet and E electrodes.

    mean : (D,); covariance : (D, D)
    expected : (D,) standard deviations of a sensor of which nothing is known
    touches, frames, idle : what it has been learned from; time : stamp of the last of it, s
    tears : of the sheet, x and y of both ends of each, m
    left_out : what touches that were kept out are likelier without, and is as expected (`kept_out`)
    """

    modes: int
    mean: np.ndarray
    covariance: np.ndarray
    expected: np.ndarray
    touches: int = 0
    frames: int = 0
    idle: int = 0
    time: float = 0.0
    left_out: tuple[str, ...] = ()
    tears: Tears = ()

    @classmethod
    def unknown(cls, operator: SheetOperator, channels: ChannelPrior | None = None) -> SensorState:
        """Nothing has been learned of any electrode of the layout; `channels`: `WIDE`, by default."""
        channels = channels or WIDE.for_layout(operator.layout)
        count = operator.layout.electrodes
        every = np.arange(count)
        widths = channels.deviations(operator, 1.0, every)
        expected = np.concatenate([operator.deviation, *widths])
        mean = np.zeros(len(expected))
        mean[operator.modes : operator.modes + count] = 1.0
        covariance = np.diag(expected**2)
        resistances = slice(operator.modes + 2 * count, operator.modes + 3 * count)
        covariance[resistances, resistances] = channels.covariance_of_resistances(operator, every)
        aside = slice(operator.modes + 3 * count, None)
        covariance[aside, aside] = channels.covariance_of_places(operator, every)
        return cls(operator.modes, mean, covariance, expected)

    @property
    def electrodes(self) -> int:
        """Number of electrodes E."""
        return (len(self.mean) - self.modes) // KINDS

    @property
    def deviation(self) -> np.ndarray:
        """(D,) standard deviations."""
        return np.sqrt(self.covariance.diagonal())

    def slice(self, part: str) -> slice:
        """Where one of `PARTS` is, or of the sheet: `uneven`, with its anisotropy, and `cut`."""
        count = self.electrodes
        if part == "sheet":
            return slice(0, self.modes)
        if part in ("uneven", "cut"):
            cut = self.modes - COUNT
            return slice(0, cut) if part == "uneven" else slice(cut, self.modes)
        first = self.modes + (PARTS.index(part) - 1) * count
        return slice(first, first + count)

    def __getitem__(self, part: str) -> np.ndarray:
        return self.mean[self.slice(part)]

    def std(self, part: str) -> np.ndarray:
        """Standard deviations of a part."""
        return self.deviation[self.slice(part)]

    def std_across(self, at: np.ndarray) -> np.ndarray:
        """(n,) standard deviations of what the first F coefficients of the sheet make at `at` (n, F)."""
        count = at.shape[1]
        return np.sqrt(np.einsum("nj,jk,nk->n", at, self.covariance[:count, :count], at))

    def std_of_differences(self, part: str) -> np.ndarray:
        """Standard deviations of a part against its own mean: what is known of it but for what is
        common to all."""
        where = self.slice(part)
        covariance = self.covariance[where, where]
        rows = covariance.mean(axis=1)
        variances = covariance.diagonal() - 2 * rows + rows.mean()
        return np.sqrt(np.maximum(variances, 0.0))

    def known(self, part: str) -> np.ndarray:
        """Share of what was not known before that is known now, 0 to 1, of each number of a
        part."""
        where = self.slice(part)
        return 1 - np.minimum(self.deviation[where] / self.expected[where], 1.0)

    def spread(self, part: str, by: float) -> SensorState:
        """The same with `by` times the deviations of a part."""
        units = np.ones(len(self.mean))
        units[self.slice(part)] = by
        return replace(self, covariance=self.covariance * np.outer(units, units))

    def evidence(self, parts: Sequence[str], before: SensorState) -> float:
        """By how much the logarithm of the evidence of what was read is larger with `parts` unknown, as `before`
        anything was read, than with them as expected: that of their density where they are expected, before over
        after (Savage and Dickey)."""
        where = np.concatenate([np.arange(len(self.mean))[self.slice(part)] for part in parts])
        scale = before.deviation[where]
        apart = (self.mean - before.mean)[where] / scale
        after, prior = (
            state.covariance[np.ix_(where, where)] / np.outer(scale, scale)
            for state in (self, before)
        )
        told = apart @ cho_solve(cho_factor(after), apart)
        narrowed = np.linalg.slogdet(after)[1] - np.linalg.slogdet(prior)[1]
        return float(told + narrowed) / 2

    def indices(self, used: np.ndarray) -> np.ndarray:
        """Numbers in theta of the sheet and of the channels of the electrodes `used` (n,)."""
        count, used = self.electrodes, np.asarray(used, int)
        return np.concatenate(
            [np.arange(self.modes), *(self.modes + i * count + used for i in range(KINDS))]
        )

    def prior(self, operator: SheetOperator, drive: float, like: Prior) -> Prior:
        """What the estimator is to expect of the electrodes in use; `like`: of contacts."""
        used = operator.used
        return replace(
            like,
            learned=self.touches > 0,
            sheet=self["sheet"].copy(),
            sheet_deviation=self.std("sheet"),
            gain=self["gain"][used],
            offset=self["offset"][used] / drive,
            resistance=self["resistance"][used],
            aside=np.array([self["aside_x"][used], self["aside_y"][used]]),
            deviations=(
                self.std("gain")[used],
                np.hypot(self.std("offset")[used], OFFSET_WANDER) / drive,
                np.hypot(self.std("resistance")[used], operator.inexact),
                self.std("aside_x")[used],
                self.std("aside_y")[used],
            ),
            precision=self._precision(operator, drive),
        )

    def _precision(self, operator, drive):
        """Inverse covariance of the sheet and of the channels in use, offsets in parts of
        `drive`; what electrodes as modelled err in one frame is in that of resistances, and how
        offsets wander in that of offsets."""
        used = operator.used
        key = (used.tobytes(), drive)
        if key not in self._precisions:
            where = self.indices(used)
            covariance = self.covariance[np.ix_(where, where)]
            offsets, resistances = (
                self.modes + np.arange(len(used)) + i * len(used) for i in (1, 2)
            )
            covariance[offsets, offsets] += OFFSET_WANDER**2
            covariance[resistances, resistances] += operator.inexact**2
            scale = np.sqrt(covariance.diagonal())
            correlation = covariance / scale[:, None] / scale
            inverse = cho_solve(cho_factor(correlation), np.eye(len(where)))
            scale[self.modes + len(used) : self.modes + 2 * len(used)] /= drive
            self._precisions.clear()  # one set of electrodes is in use at a time
            self._precisions[key] = (inverse + inverse.T) / 2 / scale[:, None] / scale
        return self._precisions[key]

    @cached_property
    def _precisions(self) -> dict:
        return {}

    def corrected(self, voltages: np.ndarray, tared: bool = False) -> np.ndarray:
        """(L, E) V without what gains and offsets do to them; `tared`: offsets are off them
        already."""
        return (voltages if tared else voltages - self["offset"]) / self["gain"]

    def walked(self, seconds: float) -> SensorState:
        """The same after `seconds` of which nothing is known."""
        count, hours = self.electrodes, max(seconds, 0.0) / _HOUR
        rates = np.concatenate(
            [
                np.full(self.modes - COUNT, SHEET_WALK),
                np.zeros(COUNT),  # once cut and printed
                np.full(count, GAIN_WALK),
                np.full(count, OFFSET_WALK),
                np.full(count, RESISTANCE_WALK),
                np.full(2 * count, ASIDE_WALK),
            ]
        )
        return self._wider(rates**2 * hours)

    def widened(self) -> SensorState:
        """The same after something happened to it: as uncertain as a new one, about what is
        known."""
        return self._wider(self.expected**2)

    def _wider(self, variances) -> SensorState:
        """With `variances` (D,) more, at most those of a sensor of which nothing is known."""
        covariance = self.covariance + np.diag(variances)
        shrink = np.minimum(self.expected / np.sqrt(covariance.diagonal()), 1.0)
        return replace(self, covariance=covariance * shrink[:, None] * shrink)

    def at(self, time: float) -> SensorState:
        """The same, the last of which was learned at `time`, s."""
        return replace(self, time=float(time))

    def with_sheet_of(self, other: SensorState) -> SensorState:
        """The same channels on the sheet of `other`, independent of it."""
        where = self.slice("sheet")
        mean, covariance = self.mean.copy(), self.covariance.copy()
        mean[where] = other["sheet"]
        covariance[where] = covariance[:, where] = 0.0
        covariance[where, where] = other.covariance[where, where]
        return replace(self, mean=mean, covariance=covariance)

    def learned(self, mean: np.ndarray, covariance: np.ndarray) -> SensorState:
        """The same with another distribution."""
        return replace(self, mean=mean, covariance=(covariance + covariance.T) / 2)

    def told(self, where: np.ndarray, mean: np.ndarray, covariance: np.ndarray) -> SensorState:
        """The same where the parameters at `where` (n,) have another `mean` (n,) and `covariance`
        (n, n): what is known of the others for given values of these stays, and they follow."""
        others = np.setdiff1d(np.arange(len(self.mean)), where)
        own = self.covariance[np.ix_(where, where)]
        follow = np.linalg.solve(own, self.covariance[np.ix_(where, others)]).T
        means, all_of_it = self.mean.copy(), self.covariance.copy()
        means[others] += follow @ (mean - self.mean[where])
        means[where] = mean
        all_of_it[np.ix_(others, others)] += follow @ (covariance - own) @ follow.T
        all_of_it[np.ix_(others, where)] = follow @ covariance
        all_of_it[np.ix_(where, others)] = covariance @ follow.T
        all_of_it[np.ix_(where, where)] = covariance
        return self.learned(means, all_of_it)
