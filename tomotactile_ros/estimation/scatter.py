"""How much readings scatter, from what a fit leaves over, whatever the model lacks.

What the model lacks in a row changes slowly from an electrode to its neighbour, and what a channel
or a row has wrong is the same for all that it reads. In

    D = z_ln - z_ln' - z_l'n + z_l'n',    n' and l' the neighbours of n and l

of what is left over, in standard deviations, both are gone; of noise that is independent from
reading to reading four times its variance is left. Near a contact and where rows are of several
states D is more than that, for a small part of the readings: the largest quarter is not counted
(the variance of a trimmed sample, here of a normal one; Huber 1981, chapter 5).
"""

from __future__ import annotations

import numpy as np
from scipy.special import chdtr, chdtri

from tomotactile_ros.estimation.fit import Fit

_FEWEST = 20  # differences: of fewer the variance is off by more than 40 %
_COUNTED = 0.75  # of the differences
# variance of the smaller part of a standard normal sample
_OF_NORMAL = float(chdtr(3, chdtri(1, 1 - _COUNTED))) / _COUNTED
# Of readings that are 0 V but for noise, a converter cuts off what is below: half of them are 0, and so
# much of their variance is left (1/2 - 1/(2 pi), trimmed: 0.31 for all converters from 8 bits on)
_MANY, _LEFT = 0.25, 0.31


def scatter(fit: Fit) -> float | None:
    """Variance of the readings' noise in parts of what it was taken for; None where too little was
    read to tell."""
    operator, rows = fit.operator, fit.rows
    read = rows.weights > 0
    places = operator.layout.positions[operator.used]
    found = variance_of(np.sqrt(rows.weights) * fit.misfit, read, rows.grounded, places)
    cut_off = np.count_nonzero(rows.readings[read] == 0) > _MANY * np.count_nonzero(read)
    return found / _LEFT if cut_off and found is not None else found


def variance_of(
    z: np.ndarray, read: np.ndarray, grounded: np.ndarray, places: np.ndarray
) -> float | None:
    """Variance of the noise in `z` (L, n), what is left over of rows with electrodes `grounded` (L,) at
    `places` (n, 2), where `read` (L, n)."""
    beside = _neighbours(places)
    at = np.full(len(places), -1)
    at[grounded] = np.arange(len(grounded))  # the last one of each
    below = at[beside[grounded]]
    along, both = z - z[:, beside], read & read[:, beside]
    across, all_four = along - along[below], both & both[below] & (below >= 0)[:, None]
    for difference, valid, times in ((across, all_four, 4.0), (along, both, 2.0)):
        if np.count_nonzero(valid) >= _FEWEST:
            return _variance(difference[valid]) / times
    return None


def _variance(sample: np.ndarray) -> float:
    """Of a normal sample (m,) with mean 0, of which up to a quarter may be anything."""
    counted = int(_COUNTED * len(sample))
    return float(np.partition(sample**2, counted)[:counted].mean()) / _OF_NORMAL


def _neighbours(places: np.ndarray) -> np.ndarray:
    """(n,) which of `places` (n, 2) is the nearest to each."""
    apart = np.hypot(*(places[:, None] - places).transpose(2, 0, 1))
    np.fill_diagonal(apart, np.inf)
    return apart.argmin(axis=1)
