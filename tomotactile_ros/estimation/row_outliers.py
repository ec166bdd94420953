"""Readings of a row that its contacts contradict: a channel may be wrong instead of something new on
the sheet.

A wire that is exchanged or broken, a channel that is stuck, interference on one wire: such a reading
may be anything from 0 V to the drive voltage, equally likely. For each reading, that is compared with
the Gaussian in which it was expected, all other readings given. With the precision A = S^-1 of the
misfit e, leaving out reading k takes

    (A e)_k^2 / A_kk - ln(A_kk)

from e^T A e + ln det S, exactly as long as nothing is linearised anew, and leaves the Schur complement
of A_kk for the next one. What it costs is what `WRONG` says. That is the mixture of a sharp and a flat
density by which outliers are usually modelled (Box and Tiao 1968), with the most likely component
instead of the sum of all.
"""

from __future__ import annotations

import numpy as np
from scipy.linalg.lapack import dpotri, dtrtrs

WRONG = 1e-3  # probability that a given row has a given reading wrong: one of 64 once in 16 rows


def outliers(
    misfit: np.ndarray, root: np.ndarray, valid: np.ndarray, most: int
) -> tuple[list[int], float]:
    """Which readings of a row, `most` of them, are rather wrong than what was expected, and by how much
    that lowers -2 ln(likelihood).

    misfit (n,); root (n, n) lower Cholesky factor of its covariance; valid (n,) bool, of readings
    """
    price = -2 * np.log(WRONG) - np.log(2 * np.pi)
    white = dtrtrs(root, misfit, lower=1)[0]
    widest = float((root**2).sum(axis=1).max(initial=1e-300, where=valid))
    if white @ white + np.log(widest) <= price:  # no reading can take more
        return [], 0.0
    precision = _inverse(root)
    weighted, diagonal = precision @ misfit, precision.diagonal().copy()
    found: list[int] = []
    gained = 0.0
    while len(found) < most:
        gains = weighted**2 / np.maximum(diagonal, 1e-300) - np.log(np.maximum(diagonal, 1e-300))
        gains[~valid] = -np.inf
        gains[found] = -np.inf
        worst = int(gains.argmax())
        if gains[worst] <= price:
            break
        found.append(worst)
        gained += float(gains[worst]) - price
        column = precision[:, worst] / diagonal[worst]
        weighted = weighted - column * weighted[worst]
        precision = precision - np.outer(column, precision[worst])
        diagonal = precision.diagonal().copy()
    return found, gained


def _inverse(root: np.ndarray) -> np.ndarray:
    """(n, n) inverse of root root^T, of a lower triangle."""
    lower = np.tril(dpotri(root, lower=1)[0])
    return lower + np.tril(lower, -1).T
