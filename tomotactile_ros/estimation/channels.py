"""Gains, offsets, resistances to ground and places of electrodes as unknowns of the fit, eliminated
before anything is solved.

They outnumber all else (five a channel), but each touches one column or one row of the readings
only: the blocks of their normal matrix are diagonal, but for what acts on columns against what acts
on rows.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from scipy.linalg import cho_factor, cho_solve

ALIKE = 0.5  # of the variance of resistances to ground is common to all: switches of one kind
KINDS = 5  # gain, offset, resistance to ground, and how far the electrode lies aside in x and y
_IN_COLUMNS, _IN_ROWS = (0, 1, 3, 4), (2, 3, 4, 5)  # what acts where


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


@dataclass(frozen=True, eq=False)
class Slopes:
    """Derivatives of the readings (L, n) by the channels.

    in_columns (4, L, n) by gain, offset and both ways aside of the electrode that is read; in_rows
        (3, L, n) by resistance and both ways aside of the one that is grounded, and by what else
        may act on rows, which counts as a kind more
    rows (L,) grounded electrode of each row
    """

    in_columns: np.ndarray
    in_rows: np.ndarray
    rows: np.ndarray

    @property
    def count(self) -> int:
        return self.in_columns.shape[2]

    @property
    def kinds(self) -> int:
        return KINDS + len(self.in_rows) - 3

    def beside(self, in_rows: np.ndarray) -> Slopes:
        """These and those by something more, (L, n), that acts on rows."""
        return replace(self, in_rows=np.concatenate([self.in_rows, in_rows[None]]))

    def scaled(self, units: tuple[np.ndarray, ...]) -> Slopes:
        """The same by channels in `units` (n,) of each kind."""
        columns = np.array([units[kind] for kind in _IN_COLUMNS])[:, None]
        rows = np.array([units[kind][self.rows] for kind in _IN_ROWS[:3]])[..., None]
        return Slopes(self.in_columns * columns, self.in_rows * rows, self.rows)

    def couplings(self, weighted: np.ndarray) -> np.ndarray:
        """(P, 5 n) block of the normal equations between parameters and channels; `weighted`
        (P, L, n) derivatives of the readings by the parameters, times the weights."""
        out = np.zeros((len(weighted), self.kinds, self.count))
        for kind, slope in zip(_IN_COLUMNS, self.in_columns):
            out[:, kind] += np.einsum("pln,ln->pn", weighted, slope)
        for kind, slope in zip(_IN_ROWS, self.in_rows):
            out[:, kind] += self._by_electrode(np.einsum("pln,ln->pl", weighted, slope))
        return out.reshape(len(weighted), self.kinds * self.count)

    def normal(self, weights: np.ndarray) -> np.ndarray:
        """(5 n, 5 n) normal matrix of the channels for `weights` (L, n)."""
        count, own = self.count, np.arange(self.count)
        out = np.zeros((self.kinds, count, self.kinds, count))
        columns, rows = weights * self.in_columns, weights * self.in_rows
        in_columns = np.einsum("kln,mln->kmn", columns, self.in_columns)
        in_rows = self._by_electrode(np.einsum("kln,mln->kml", rows, self.in_rows))
        for i, kind in enumerate(_IN_COLUMNS):
            for j, other in enumerate(_IN_COLUMNS):
                out[kind, own, other, own] += in_columns[i, j]
            for other, beside in zip(_IN_ROWS, self.in_rows):
                both = self._by_electrode((columns[i] * beside).T)
                out[kind, :, other] += both
                out[other, :, kind] += both.T
        for i, kind in enumerate(_IN_ROWS[: len(rows)]):
            for j, other in enumerate(_IN_ROWS[: len(rows)]):
                out[kind, own, other, own] += in_rows[i, j]
        return out.reshape(self.kinds * count, -1)

    def _by_electrode(self, by_row: np.ndarray) -> np.ndarray:
        """(P, n) sums over the rows of each electrode of `by_row` (P, L)."""
        return by_row if self._in_turn else by_row @ self._of_electrode

    @cached_property
    def _in_turn(self) -> bool:
        """Whether each electrode is grounded in the row of its own number."""
        return np.array_equal(self.rows, np.arange(self.count))

    @cached_property
    def _of_electrode(self) -> np.ndarray:
        """(L, n) 1 where the electrode is the one that is grounded in the row, else 0."""
        return (self.rows[:, None] == np.arange(self.count)).astype(float)


class ChannelFit:
    """The channels' part of the normal equations of one linearisation, eliminated.

    Parameters
    ----------
    columns (P, L, n) derivatives of the readings by all other parameters, times the weights
    weights (L, n); slopes : by the channels
    deviations : of the priors of each kind, (n,) each
    precision : `Prior.precision`; None: the channels are independent

    Attributes
    ----------
    normal (P, P) what the channels take off the normal matrix of all else
    back (5 n, P) how they follow all else, in units of their own
    """

    def __init__(self, columns, weights, slopes: Slopes, deviations, precision=None):
        self._slopes = slopes = slopes.scaled(deviations)
        self._scale = np.concatenate(deviations)
        self._weights = weights
        self._mixed = np.concatenate([slopes.couplings(each) for each in columns])
        normal = slopes.normal(weights)
        if precision is None:
            normal[np.diag_indices(len(normal))] += 1.0
        else:
            modes = len(precision) - len(normal)
            others = precision[:modes, modes:] * self._scale  # sheet against channels
            self._mixed[len(self._mixed) - modes :] += others
            normal += precision[modes:, modes:] * self._scale * self._scale[:, None]
        self._factor = cho_factor(normal)
        self.back = cho_solve(self._factor, self._mixed.T)
        self.normal = self._mixed @ self.back

    def beside(self, columns: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Of more parameters, with derivatives `columns` (m, L, n) times the weights: (m, 5 n) what
        couples them to the channels, and (5 n, m) how these follow them, in units of their own."""
        mixed = self._slopes.couplings(columns)
        return mixed, cho_solve(self._factor, mixed.T)

    def pulled(self, misfit: np.ndarray, pull: np.ndarray) -> tuple[np.ndarray, np.ndarray, float]:
        """Of a `misfit` (L, n) and what the priors pull the channels by, (5 n,): the channels' steps if
        nothing else moves, in units of their own; what that takes off the right side of all else,
        (P,); what it takes off the cost."""
        right = self._slopes.couplings((self._weights * misfit)[None])[0]
        right += self._scale * pull
        alone = cho_solve(self._factor, right)
        return alone, self._mixed @ alone, float(right @ alone)

    def step(self, alone: np.ndarray, others: np.ndarray) -> np.ndarray:
        """(5, n) steps of the channels that belong to the step `others` (P,) of all else; `alone`
        (5 n,) as `pulled` has it."""
        step = (alone - self.back @ others) * self._scale
        return step.reshape(KINDS, -1)
