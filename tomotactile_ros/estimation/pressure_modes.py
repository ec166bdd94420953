"""How the pressure under a contact may differ from an even one: Zernike polynomials on its unit disc.

No finger is an even disc. Relative to its mean, its pressure is 1 + sum_q b_q m_q(r, t) with the
polynomials of Noll (1976, J. Opt. Soc. Am. 66, 207), orthonormal over the disc; the first, a constant,
is the mean itself and left out.
"""

from __future__ import annotations

from collections.abc import Iterator
from functools import lru_cache
from math import factorial, sqrt

import numpy as np

from tomotactile_ros.estimation.disc import cut

# radial degree of the modes of pressure; 2, 4, 5 and 6 were tried: a resting disc of 30 mm over an
# electrode moves the sheet by 12.8 deviations with 2, 9.0 with 4; more than 4 changes little
ORDER = 4


@lru_cache(maxsize=32)
def pressure_modes(across: int) -> np.ndarray:
    """(Q, P) values of the modes on the patches of a contact cut as `cut` does, without their mean."""
    points, area, _ = cut(across)
    values = np.array(list(_modes(points)))
    return values - (values @ area)[:, None]


def _modes(points: np.ndarray) -> Iterator[np.ndarray]:
    r, t = np.hypot(*points.T), np.arctan2(points[:, 1], points[:, 0])
    for n in range(1, ORDER + 1):
        for m in range(n % 2, n + 1, 2):
            radial = _radial(n, m, r)
            if m == 0:
                yield sqrt(n + 1) * radial
            else:
                yield sqrt(2 * n + 2) * radial * np.cos(m * t)
                yield sqrt(2 * n + 2) * radial * np.sin(m * t)


def _radial(n: int, m: int, r: np.ndarray) -> np.ndarray:
    parts = (
        (-1) ** k
        * factorial(n - k)
        / (factorial(k) * factorial((n + m) // 2 - k) * factorial((n - m) // 2 - k))
        * r ** (n - 2 * k)
        for k in range((n - m) // 2 + 1)
    )
    return sum(parts, np.zeros_like(r))
