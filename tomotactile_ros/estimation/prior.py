"""What is expected of contacts, sheet and channels before the readings: means and covariance."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.channels import KINDS, SENSOR, ChannelPrior
from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.operator import SheetOperator

_HELD = 1e-2  # of the deviations of a sensor that is held
# m/s, m/s, 1/s: a hand slides at up to 1 m/s, and presses or lets go within 0.1 s
RATES = 0.3, 0.3, 10.0


@dataclass(frozen=True)
class Prior:
    """What is expected before the readings.

    radius, spread : median of contacts' radii, m, and standard deviation of their logarithm
    stretch : standard deviation of p and q of a contact that is no disc
    rates : (3,) of how fast x and y change, m/s, and ln c, 1/s
    sheet, sheet_deviation : (J,) means and standard deviations of the sheet's coefficients
    gain, offset, resistance : (n,) means, 1, parts of V0, ohm; aside (2, n) m
    deviations : (n,) standard deviation of each of them, aside in x and y last
    precision : (J + 5 n, J + 5 n) inverse covariance of sheet, gains, offsets, resistances and ways
        aside, of which the deviations are the marginal ones; None: all are independent
    learned : whether all this is of this very sensor: contacts are then fitted first, the sensor is
        only trimmed
    """

    radius: float
    spread: float
    stretch: float
    sheet: np.ndarray
    sheet_deviation: np.ndarray
    gain: np.ndarray
    offset: np.ndarray
    resistance: np.ndarray
    aside: np.ndarray
    deviations: tuple[np.ndarray, ...]
    rates: tuple[float, float, float] = RATES
    learned: bool = False
    precision: np.ndarray | None = None

    @cached_property
    def core(self) -> Any:
        return compiled.Prior(
            self.radius,
            self.spread,
            self.stretch,
            np.array(self.rates),
            np.concatenate([self.sheet, self.gain, self.offset, self.resistance, *self.aside]),
            np.concatenate([self.sheet_deviation, *self.deviations]),
            self.precision,
            len(self.sheet),
        )

    def held(self, groups: Iterable[str] = SENSOR) -> Prior:
        """The same with what is in `groups`, of `SENSOR`, as good as certain."""
        modes = len(self.sheet)
        units = np.ones(modes + KINDS * len(self.gain))
        by_kind = units[modes:].reshape(KINDS, -1)
        for group in groups:
            by_kind[list(SENSOR[group])] = _HELD
            if group == "sheet":
                units[:modes] = _HELD
        deviations = zip(by_kind, self.deviations)
        precision = self.precision
        return replace(
            self,
            sheet_deviation=units[:modes] * self.sheet_deviation,
            deviations=tuple(unit * each for unit, each in deviations),
            precision=None if precision is None else precision / np.outer(units, units),
        )

    def with_offsets_off(self, by: float) -> Prior:
        """The same sensor with offsets that may be `by` (in parts of V0) off as well, each by itself:
        what is known of several together is left out."""
        gain, offset, *others = self.deviations
        return replace(self, deviations=(gain, np.hypot(offset, by), *others), precision=None)

    def told(self, found: Unknowns, information: np.ndarray) -> Prior:
        """The sensor as it was `found`, with what rows say of it: `information` (J + 5 n, J + 5 n)
        in the units of `precision`."""
        precision = self.matrix + information
        deviation = np.sqrt(np.linalg.inv(precision).diagonal())
        modes = len(self.sheet)
        return replace(
            self,
            sheet=found.sheet,
            gain=found.gain,
            offset=found.offset,
            resistance=found.resistance,
            aside=found.aside,
            sheet_deviation=deviation[:modes],
            deviations=tuple(deviation[modes:].reshape(KINDS, -1)),
            precision=precision,
        )

    def apart(self, unknowns: Unknowns) -> np.ndarray:
        """(J + 5 n,) what sheet, gains, offsets, resistances and ways aside are more than
        expected."""
        expected = self.sheet, self.gain, self.offset, self.resistance, *self.aside
        found = (
            unknowns.sheet,
            unknowns.gain,
            unknowns.offset,
            unknowns.resistance,
            *unknowns.aside,
        )
        return np.concatenate([now - mean for now, mean in zip(found, expected)])

    @property
    def matrix(self) -> np.ndarray:
        """(J + 5 n, J + 5 n) `precision`, of independent ones, too."""
        if self.precision is not None:
            return self.precision
        return np.diag(np.concatenate([self.sheet_deviation, *self.deviations]) ** -2.0)

    def pull(self, apart: np.ndarray) -> np.ndarray:
        """(J + 5 n,) inverse covariance times `apart`."""
        return self.matrix @ apart

    @classmethod
    def unknown(
        cls, operator: SheetOperator, channels: ChannelPrior, radius: float, drive: float
    ) -> Prior:
        """Nothing has been learned of this sensor; its switches are of one kind."""
        count, modes = operator.count, operator.modes
        deviations = channels.deviations(operator, drive)
        precision = np.diag(np.concatenate([operator.deviation, *deviations]) ** -2.0)
        resistances = slice(modes + 2 * count, modes + 3 * count)
        precision[resistances, resistances] = np.linalg.inv(
            channels.covariance_of_resistances(operator)
        )
        aside = slice(modes + 3 * count, None)
        precision[aside, aside] = channels.precision_of_places(operator)
        return cls(
            radius,
            0.6,
            0.25,
            np.zeros(operator.modes),
            operator.deviation,
            np.ones(count),
            np.zeros(count),
            np.zeros(count),
            np.zeros((2, count)),
            deviations,
            precision=precision,
        )
