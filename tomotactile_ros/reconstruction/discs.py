"""Contacts as discs: place, conductance and size of each from the currents and couplings next to it.

Away from electrodes the shares H_n of a current fed in at a point are harmonic functions of its place, so nine
pixels tell them, and their derivatives, in between: H_n = h_n + Re(p_n z + q_n z^2 + ...) about a place, z = x + i y.
With that, equation (b) of `grounded` is for a disc of radius a and conductance per area g

    y_n = c h_n,      Y_nl - Y0_nl = c h_n h_l + s_1 Re(p_n p*_l) + s_2 Re(q_n q*_l),

    2 pi / (R c) = I_0(k) / (k I_1(k)) + X,    s_m = (2 pi m a^2m / R) I_m+1(k) / I_m-1(k),    k = a sqrt(g R)

with I the modified Bessel functions, of a disc that leaks evenly, and X the way from its rim to the grounded
electrodes. The mean of a harmonic function over a disc is that at its centre: currents tell place and c whatever the
size. A disc shows its size by what it short-circuits, s_m; the stronger it is, the more, and the more
the size matters for g. Where the couplings do not tell, the expected radius stands.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import lapack
from scipy.ndimage import binary_erosion, distance_transform_edt
from scipy.special import ive

from tomotactile_ros.grid import Grid
from tomotactile_ros.reconstruction.admittance import Grounded
from tomotactile_ros.reconstruction.local import LocalImage
from tomotactile_ros.reconstruction.nonnegative import current_error

_STEPS = 2  # of Gauss-Newton
_REACH = 0.2  # of a step, in spacings of the electrodes
_SIZES = 32  # radii that are compared
_SMALLEST, _LARGEST = 0.3, 0.7  # of them, in expected radii and in spacings
_USUAL = 0.4  # standard deviation of the logarithm of a radius about the expected one
_WAY_ERROR = 0.03  # of X
_EVEN = 0.25  # what a weak disc has above X
_LEAST = 0.01  # conductance of a disc, in parts of all
_TINY = 1e-30  # S
_K = np.geomspace(6.0, 1e-6, 1000)  # from as good as a bare conductor to nearly nothing
_INSIDE = ive(0, _K) / (_K * ive(1, _K))  # ascending
_LOG_K = np.log(_K)
_SHORTED = ive(2, _K) / ive(0, _K), ive(3, _K) / ive(1, _K)


class Shares:
    """Interpolation between the pixels of `grid`, exact for harmonic polynomials up to the third degree.

    `unit`: of the lengths in the weights, m. `usable`: whether there are nine pixels anywhere.
    """

    def __init__(self, grid: Grid):
        whole = binary_erosion(np.pad(grid.inside, 1), np.ones((3, 3)))[1:-1, 1:-1]
        self.usable = bool(whole.any())
        self._nearest = distance_transform_edt(~whole, return_distances=False, return_indices=True)
        self._number = np.cumsum(grid.inside).reshape(grid.shape) - 1
        self._inside = grid.inside
        self._left, _, _, self._top = grid.outline.bounds
        self.unit = math.sqrt(grid.cell_area)
        self._width, self._height = grid.cell_size
        places = [(x * self._width, y * self._height) for y in (1, 0, -1) for x in (-1, 0, 1)]
        nodes = [_harmonic(complex(x, y) / self.unit)[:, 0] for x, y in places]
        self._weights = np.linalg.inv(nodes).T

    def at(self, x: float, y: float) -> tuple[np.ndarray, np.ndarray]:
        """Pixels (9,) and weights (9, 5): of the value, Re p, -Im p, Re q, -Im q at x, y (m)."""
        row, column = self._cell(x, y)
        row = min(max(row, 0), len(self._inside) - 1)
        column = min(max(column, 0), len(self._inside[0]) - 1)
        row, column = self._nearest[:, row, column].tolist()
        across = x - self._left - (column + 0.5) * self._width
        up = y - self._top + (row + 0.5) * self._height
        weights = self._weights.dot(_harmonic(complex(across, up) / self.unit))
        return self._number[row - 1 : row + 2, column - 1 : column + 2].ravel(), weights

    def on_sheet(self, x: float, y: float) -> bool:
        """Whether the cell at x, y (m) is inside."""
        row, column = self._cell(x, y)
        height, width = self._inside.shape
        return 0 <= row < height and 0 <= column < width and bool(self._inside[row, column])

    def _cell(self, x, y):
        return math.floor((self._top - y) / self._height), math.floor(
            (x - self._left) / self._width
        )


@lru_cache(maxsize=8)
def shares_of(grid: Grid) -> Shares:
    """`Shares`, made once for each grid."""
    return Shares(grid)


def _harmonic(z):
    """(9, 5) value, Re p, -Im p, Re q, -Im q at z of 1, z, z^2, z^3 (real and imaginary parts), Re z^4 and |z|^2."""
    x, y = z.real, z.imag
    two = z * z
    three = z * two
    u, v, six, seven = two.real, two.imag, 6 * x, 6 * y
    return np.array(
        [
            [1.0, x, y, u, v, three.real, three.imag, u * u - v * v, u + y * y + y * y],
            [0.0, 1.0, 0.0, 2 * x, 2 * y, 3 * u, 3 * v, 4 * three.real, 2 * x],
            [0.0, 0.0, 1.0, -2 * y, 2 * x, -3 * v, 3 * u, -4 * three.imag, 2 * y],
            [0.0, 0.0, 0.0, 1.0, 0.0, six / 2, seven / 2, 6 * u, 0.0],
            [0.0, 0.0, 0.0, 0.0, 1.0, -seven / 2, six / 2, -6 * v, 0.0],
        ]
    ).T


@dataclass(frozen=True)
class Disc:
    """place (2,) m; conductance g a^2 pi, S; radius, m."""

    place: np.ndarray
    conductance: float
    radius: float


def fit_discs(
    local: LocalImage,
    measured: Grounded,
    places: list[tuple[float, float]],
    others: list[np.ndarray],
    change: np.ndarray,
    radius: float,
) -> list[Disc]:
    """Discs near `places`, m.

    Parameters
    ----------
    others : what each contact that is no disc adds to the currents, (n,) S
    change : (K,) what D of a disc of `radius` centred on each pixel has above that of the pixel, ohm
    radius : that is expected, m
    """
    sheet, first, second = local.meter.sheet, local.meter.first, local.meter.second
    left = None if measured.couplings is None else measured.couplings.astype(float)
    places, effective = _fit_places(local, measured, places, others)
    found = []
    for place, c in zip(places, effective):
        pixels, weights = shares_of(local.grid).at(*place)
        impedance = (sheet.impedance[pixels] + change[pixels]).dot(weights[:, 0])
        field = sheet.share[:, pixels].dot(weights)
        found.append((c, field, float(impedance)))
        if left is not None:
            point = field[:, 0]
            left -= c * point.take(first) * point.take(second)
    if left is not None:
        for currents in others:
            left -= currents[first] * currents[second] / max(float(currents.sum()), _TINY)
    sizes = [_size(local, measured.noise, left, *each, radius) for each in found]
    return [Disc(np.array(place), *size) for place, size in zip(places, sizes)]


def _fit_places(local, measured, places, others):
    """Places (x, y), m, and effective conductances, S, that the currents tell."""
    shares, share = shares_of(local.grid), local.meter.sheet.share
    reach = _REACH * local.spacing
    places, effective, least = list(places), [0.0] * len(places), _LEAST * measured.total
    weight = (current_error(local.meter, measured) ** -2.0)[:, None]
    wanted = measured.currents - sum(others) if others else measured.currents
    for _ in range(_STEPS):
        fields = []
        for place in places:
            pixels, weights = shares.at(*place)
            fields.append(share[:, pixels].dot(weights[:, :3]))
        matrix = fields[0] if len(fields) == 1 else np.concatenate(fields, axis=1)
        weighted = matrix * weight
        _, found, failed = lapack.dposv(weighted.T.dot(matrix), wanted.dot(weighted))
        if failed:
            break
        found = found.tolist()
        for i, (x, y) in enumerate(places):
            effective[i] = c = max(found[3 * i], least)
            if not c > 0:  # noise alone: nothing to move by
                continue
            along = [found[3 * i + 1] * shares.unit / c, found[3 * i + 2] * shares.unit / c]
            part = min(reach / max(math.hypot(*along), _TINY), 1.0)
            moved = x + part * along[0], y + part * along[1]
            if shares.on_sheet(*moved):
                places[i] = moved
    scale = max(float(wanted.sum()) / max(sum(effective), _TINY), 0.0)
    return places, [scale * c for c in effective]


def _size(local, noise, left, effective, field, impedance, radius):
    """Conductance, S, and radius, m, of a disc: means over radii, each counted by how well it explains `left`.

    Parameters
    ----------
    left : (P,) of the couplings when all contacts are points, S; None where noise hides them
    effective : c, S
    field : (n, 5) of H at its place, see `Shares.at`
    impedance : D if it had the expected `radius` (m), ohm
    """
    scale = 2 * math.pi / local.resistance
    sizes, cost, squared = _sizes(radius, local.spacing)
    inside = scale / max(effective, _TINY) - np.maximum(scale * impedance - _EVEN - sizes, -_EVEN)
    cost = cost + (np.maximum(_INSIDE[0] - inside, 0.0) / _WAY_ERROR) ** 2
    if left is not None:
        pairs = field.take(local.meter.first, axis=0) * field.take(local.meter.second, axis=0)
        shapes = np.array([left, pairs[:, 1] + pairs[:, 2], pairs[:, 3] + pairs[:, 4]])
        shapes *= 1 / np.sqrt(noise**2 + local.coupling_variance)
        squared = squared / shares_of(local.grid).unit ** 2
        amounts = np.ones((3, len(sizes)))
        amounts[1] = -scale * squared * np.interp(inside, _INSIDE, _SHORTED[0])
        amounts[2] = -2 * scale * squared**2 * np.interp(inside, _INSIDE, _SHORTED[1])
        squares = (shapes.dot(shapes.T).dot(amounts) * amounts).sum(axis=0)
        best = amounts[:, squares.argmin()].dot(shapes)
        seen = shapes[1] ** 2
        cost += (squares - squares.min()) / (1 + seen.dot(best**2) / max(seen.sum(), _TINY))
    weight = np.exp((cost.min() - cost) / 2)
    weight /= weight.sum()
    squared = math.exp(2 * weight.dot(np.interp(inside, _INSIDE, _LOG_K)))
    return math.pi * squared / local.resistance, radius * math.exp(weight.dot(sizes))


@lru_cache(maxsize=8)
def _sizes(radius, spacing):
    """(n,) logarithms of the radii that are compared, in parts of `radius`, their cost, and their squares, m^2."""
    largest = max(_LARGEST * spacing / radius, 1 / _SMALLEST)
    sizes = np.linspace(math.log(_SMALLEST), math.log(largest), _SIZES)
    return sizes, (sizes / _USUAL) ** 2, radius**2 * np.exp(2 * sizes)
