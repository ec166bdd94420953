"""Neumann Green function of a uniform rectangle in closed form.

`G(p; q)` is the potential at `p` of a unit current fed into a sheet of unit sheet resistance at `q`
and drained evenly over the whole sheet; its mean over the sheet is zero. Cosine series across the
short side, summed exactly: three image terms in logarithms (the only singular part) and a remainder
that is a short sum of products, `exp(-pi long/short) < 0.05` to the power of the mode.

A point with a radius is a small round cloud of charge. Two clouds see each other with
`ln |x|^2 + E1(|x|^2 / (e^gamma r^2))` in place of `ln |x|^2`, r^2 being the mean of their squared
radii: Gaussian clouds, which act on themselves like discs of these radii, and from a distance of
two radii on like points. This holds for mirror images behind a near rim as well. Because it is the
energy of real charges, matrices of it are positive definite however clouds overlap.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy.special import exp1

CLOUD = np.exp(np.euler_gamma)
_FAR = 12.0  # E1 is below 5e-7 from here on
FAR = CLOUD * _FAR  # squared distance of points, in parts of the squared radius
_SMALLEST = 1e-17  # relative size of the first neglected term of the remainder


def green_rectangle(
    points: ArrayLike, sources: ArrayLike, size: tuple[float, float], radius: ArrayLike = 0.0
) -> np.ndarray:
    """Green function of the rectangle `size` centred on the origin.

    Parameters
    ----------
    points : (P, 2) array, m
    sources : (Q, 2) array, m
    size : (a, b), m
    radius : mutual radius of each pair (`mutual_radius`), broadcasts to (P, Q), m

    Returns
    -------
    (P, Q) array, ohm per (ohm/sq). Multiply by the sheet resistance.
    """
    (x, y), (s, t), short, long = _oriented(points, sources, size)
    near = _near(x[:, None], y[:, None], s, t, short, long, radius)
    left, right = _remainder(x, y, s, t, short, long)
    return near + left @ right.T


def green_rectangle_self(
    points: ArrayLike, size: tuple[float, float], radius: ArrayLike
) -> np.ndarray:
    """(P,) diagonal of `green_rectangle(points, points, size, radius)`, `radius` scalar or (P,)."""
    (x, y), (s, t), short, long = _oriented(points, points, size)
    left, right = _remainder(x, y, s, t, short, long)
    return _near(x, y, s, t, short, long, radius) + np.einsum("pm,pm->p", left, right)


def mutual_radius(first: ArrayLike, second: ArrayLike) -> np.ndarray:
    """(P, Q) radius r that clouds of radii (P,) and (Q,) have for each other; scalars broadcast."""
    first, second = np.atleast_1d(first), np.atleast_1d(second)
    return np.sqrt(np.add.outer(first**2, second**2) / 2)


def softened(squared: np.ndarray, radius_squared: ArrayLike) -> np.ndarray:
    """Squared distances for the logarithm between clouds: x^2 exp(E1(x^2 / (e^gamma r^2)))."""
    return _soften(squared, radius_squared, lambda near: squared[near])


def _soften(
    measure: np.ndarray,
    radius_squared: ArrayLike,
    squared_distance: Callable[[np.ndarray], np.ndarray],
) -> np.ndarray:
    """`measure` for clouds, nearly x^2 where small; there x^2 is `squared_distance(near)`."""
    reach = CLOUD * np.broadcast_to(radius_squared, measure.shape)
    near = measure < _FAR * reach
    out = np.array(measure)
    ratio = squared_distance(near) / reach[near]
    apart = ratio > 1e-12
    clouds = reach[near] / CLOUD
    clouds[apart] = measure[near][apart] * np.exp(exp1(ratio[apart]))
    out[near] = clouds
    return out


def _oriented(
    points: ArrayLike, sources: ArrayLike, size: Sequence[float]
) -> tuple[np.ndarray, np.ndarray, float, float]:
    """Coordinates from the lower left corner, the one along the short side first."""
    points, sources = np.asarray(points, float), np.asarray(sources, float)
    order = [0, 1] if size[0] <= size[1] else [1, 0]
    sides = np.array(size, float)[order]
    return (points[:, order] + sides / 2).T, (sources[:, order] + sides / 2).T, *sides


def _near(
    x: np.ndarray,
    y: np.ndarray,
    s: np.ndarray,
    t: np.ndarray,
    short: float,
    long: float,
    radius: ArrayLike,
) -> np.ndarray:
    """The mode that is constant along the short side, and the nearest images of all the others."""
    ladder = ((y**2 + t**2) / (2 * long) - np.maximum(y, t) + long / 3) / short
    half = np.pi / (2 * short)
    even, odd = np.sin(half * x) * np.cos(half * s), np.cos(half * x) * np.sin(half * s)
    chords = 4 * (even - odd) ** 2, 4 * (even + odd) ** 2  # 2 - 2 cos(pi X / short), X = x -+ s
    gaps = (  # 1 - q, q = exp(-pi Y / short)
        -np.expm1(-2 * half * np.abs(y - t)),
        1 - np.exp(-2 * half * y) * np.exp(-2 * half * t),
        1 - np.exp(-2 * half * (long - y)) * np.exp(-2 * half * (long - t)),
    )
    radius_squared = (np.pi * np.asarray(radius) / short) ** 2
    product = np.ones(1)
    for gap in gaps:
        for chord in chords:

            def squared(
                near: np.ndarray, gap: np.ndarray = gap, chord: np.ndarray = chord
            ) -> np.ndarray:
                across = 2 * np.arcsin(np.minimum(np.sqrt(chord[near]) / 2, 1))
                with np.errstate(divide="ignore"):  # q rounded to 0: as good as infinitely far
                    return np.log1p(-gap[near]) ** 2 + across**2

            product = product * _soften(gap**2 + (1 - gap) * chord, radius_squared, squared)
    return ladder - np.log(product) / (4 * np.pi)


def _remainder(
    x: np.ndarray, y: np.ndarray, s: np.ndarray, t: np.ndarray, short: float, long: float
) -> tuple[np.ndarray, np.ndarray]:
    """What the three images leave out, as two thin matrices to be multiplied mode by mode.

    From cosh(k (long - d)) / sinh(k long) = e^-kd + 2 cosh(kd) / (e^(2k long) - 1) for d = |y - t|,
    and the same for y + t with both of its images kept apart.
    """
    modes = int(np.ceil(-np.log(_SMALLEST) / (np.pi * long / short)))
    k = np.pi / short * np.arange(1, modes + 1)
    decay = np.exp(-k * long)
    up, down = np.exp(k * (y[:, None] - long)), np.exp(-k * y[:, None])
    up_t, down_t = np.exp(k * (t[:, None] - long)), np.exp(-k * t[:, None])
    left = np.cos(k * x[:, None]) / (k * short)
    right = np.cos(k * s[:, None]) / -np.expm1(-2 * k * long)
    return (
        np.hstack([left * each for each in (up, down * decay, up * decay, down * decay)]),
        np.hstack([right * each for each in (down_t * decay, up_t, up_t * decay, down_t * decay)]),
    )
