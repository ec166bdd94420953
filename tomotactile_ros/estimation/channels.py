"""Gains, offsets and resistances to ground as unknowns of the fit, eliminated before anything is
solved.

They outnumber all else (three a channel), but each touches one column or one row of the readings
only: the blocks of their normal matrix are diagonal, but for gains against resistances.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

ALIKE = 0.5  # of the variance of resistances to ground is common to all: switches of one kind


@dataclass(frozen=True)
class ChannelPrior:
    """Standard deviations before anything is known, and what is expected.

    gain : relative; published electronics contradict reciprocity by 0.8 to 7 %
    offset : V; the input offset of common converters and amplifiers
    resistance : ohm; an analogue switch has some tens to hundreds
    """

    gain: float = 0.03
    offset: float = 0.003
    resistance: float = 200.0

    def precision_of_resistances(self, count: int) -> np.ndarray:
        """(n, n) inverse covariance of `count` resistances, of whose variance `ALIKE` is common."""
        own = self.resistance**2 * (1 - ALIKE)
        common = np.full((count, count), ALIKE / (1 - ALIKE + ALIKE * count))
        return (np.eye(count) - common) / own


def couplings(columns, slopes, rows, resistance_deviation) -> np.ndarray:
    """(P, 3 n) block of the normal equations between parameters and gains, offsets, resistances,
    these in units of their deviations.

    columns (P, L, n) derivatives of the readings by the parameters, times the weights; the rest as
    for `ChannelFit`
    """
    gain, resistance = slopes
    count = columns.shape[2]
    to_rows = np.zeros((len(rows), count))
    to_rows[np.arange(len(rows)), rows] = 1.0
    return np.concatenate(
        [
            np.einsum("pln,ln->pn", columns, gain),
            columns.sum(axis=1),
            np.einsum("pln,ln->pl", columns, resistance) @ to_rows * resistance_deviation,
        ],
        axis=1,
    )


class ChannelFit:
    """The channels' part of the normal equations of one linearisation, eliminated.

    Parameters
    ----------
    mixed (P, 3 n) what `couplings` says of all other parameters; weights (L, n)
    slopes : gain (L, n), resistance (L, n) derivatives of a reading by the gain of its column and
        by the resistance of its row; offsets have 1
    rows (L,) grounded electrode of each row
    deviations : of the priors of gains, offsets, resistances, (n,) each
    precision : `Prior.precision`; None: the channels are independent

    Attributes
    ----------
    normal (P, P) what the channels take off the normal matrix of all else
    """

    def __init__(self, mixed, weights, slopes, rows, deviations, precision=None):
        gain, resistance = slopes
        count = weights.shape[1]
        self._count, self._weights = count, weights
        self._by_gain = weights * gain
        # resistances in units of their deviations: of the electrode that is grounded in the row
        in_rows = resistance * deviations[2][rows, None]
        self._by_row = by_row = weights * in_rows
        normal = np.zeros((3 * count, 3 * count))
        first, second, third = (slice(i * count, (i + 1) * count) for i in range(3))
        own = np.arange(count)
        normal[own, own] = (self._by_gain * gain).sum(axis=0)
        normal[own, count + own] = normal[count + own, own] = self._by_gain.sum(axis=0)
        normal[count + own, count + own] = weights.sum(axis=0)
        np.add.at(
            normal,
            (2 * count + rows, 2 * count + rows),
            (by_row * in_rows).sum(1),
        )
        self._to_rows = np.zeros((count, len(rows)))
        self._to_rows[rows, np.arange(len(rows))] = 1.0
        normal[third, first] = self._to_rows @ (by_row * gain)
        normal[third, second] = self._to_rows @ by_row
        normal[first, third] = normal[third, first].T
        normal[second, third] = normal[third, second].T
        self._mixed = mixed
        self._scale = np.concatenate([np.ones(2 * count), deviations[2]])
        if precision is None:
            everything = np.arange(3 * count)
            normal[everything, everything] += (self._scale / np.concatenate(deviations)) ** 2
        else:
            modes = len(precision) - 3 * count
            others = precision[:modes, modes:] * self._scale  # sheet against channels
            self._mixed[len(self._mixed) - modes :] += others
            normal += precision[modes:, modes:] * self._scale * self._scale[:, None]
        self._factor = cho_factor(normal)
        self._back = cho_solve(self._factor, self._mixed.T)
        self.normal = self._mixed @ self._back

    def pulled(self, misfit: np.ndarray, pull: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Of a `misfit` (L, n) and what the priors pull the channels by, (3 n,): the channels' steps if
        nothing else moves, in units of their own; what that takes off the right side of all else,
        (P,); what it takes off the cost."""
        right = np.concatenate(
            [
                (self._by_gain * misfit).sum(axis=0),
                (self._weights * misfit).sum(axis=0),
                self._to_rows @ (self._by_row * misfit).sum(axis=1),
            ]
        )
        right += self._scale * pull
        alone = cho_solve(self._factor, right)
        return alone, self._mixed @ alone, float(right @ alone)

    def step(
        self, alone: np.ndarray, others: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Steps of gain, offset and resistance that belong to the step `others` (P,) of all else;
        `alone` (3 n,) as `pulled` has it."""
        step = (alone - self._back @ others) * self._scale
        return tuple(step.reshape(3, self._count))
