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
from scipy.ndimage import binary_erosion, distance_transform_edt
from scipy.special import ive

from tomotactile_ros.grid import Grid
from tomotactile_ros.reconstruction.admittance import Grounded
from tomotactile_ros.reconstruction.local import LocalImage
from tomotactile_ros.reconstruction.nonnegative import current_error

_STEPS = 2  # of Gauss-Newton
_REACH = 0.35  # of a place from where the image has it, in spacings of the electrodes
_Y0_ERROR = 0.02  # of the untouched sheet's couplings; what does not fit adds to it
_SHEET_ERROR = 0.003  # the same in parts of the sheet's conductance
_SCALE = np.linspace(0.0, 1.0, 32)  # of the radii that are compared
_SMALLEST, _LARGEST = 0.3, 0.7  # of them, in expected radii and in spacings
_USUAL = 0.4  # standard deviation of the logarithm of a radius about the expected one
_WAY_ERROR = 0.03  # of X
_EVEN = 0.25  # what a weak disc has above X
_LEAST = 0.01  # conductance of a disc, in parts of all
_TINY = 1e-30  # S
_K = np.geomspace(6.0, 0.01, 400)
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
    """(9, 5) value, Re p, -Im p, Re q, -Im q at z of 1, Re z^m, Im z^m up to nine, and |z|^2 for what is left."""
    square = z * z
    powers = [(1, 0, 0), (z, 1, 0), (square, 2 * z, 1), (square * z, 3 * square, 3 * z)]
    powers.append((square * square, 4 * square * z, 6 * square))
    rows = [(f.real, p.real, -p.imag, q.real, -q.imag) for f, p, q in powers]
    rows += [(f.imag, p.imag, p.real, q.imag, q.real) for f, p, q in powers[1:4]]
    rows.append((abs(square), 2 * z.real, 2 * z.imag, 0.0, 0.0))
    return np.array(rows)


@dataclass(frozen=True)
class Disc:
    """place (2,) m; conductance g a^2 pi, S; radius, m."""

    place: np.ndarray
    conductance: float
    radius: float


def fit_discs(
    local: LocalImage,
    measured: Grounded,
    places: np.ndarray,
    effective: np.ndarray,
    others: np.ndarray,
    change: np.ndarray,
    radius: float,
) -> list[Disc]:
    """Discs near `places` (B, 2), m.

    Parameters
    ----------
    effective : (B,) effective conductances c to start with, S
    others : (n, F) what each contact that is no disc adds to the currents, S
    change : (K,) what D of a disc of `radius` centred on each pixel has above that of the pixel, ohm
    radius : that is expected, m
    """
    meter, found = local.meter, []
    left = None if measured.couplings is None else measured.couplings.astype(float)
    places, effective = _fit_places(local, measured, places, effective, others.sum(axis=1))
    for place in places.tolist():
        pixels, weights = shares_of(local.grid).at(*place)
        impedance = (meter.sheet.impedance[pixels] + change[pixels]).dot(weights[:, 0])
        found.append((meter.sheet.share[:, pixels].dot(weights), float(impedance)))
    if left is not None:
        points = [c * field[:, 0] for c, (field, _) in zip(effective, found)]
        for currents in [*points, *others.T]:
            total = max(float(currents.sum()), _TINY)
            left -= currents[meter.first] * currents[meter.second] / total
    sizes = [
        _size(local, measured.noise, left, *each, radius) for each in zip(effective, *zip(*found))
    ]
    return [Disc(place, *size) for place, size in zip(places, sizes)]


def _fit_places(local, measured, places, effective, others):
    """Places (B, 2), m, and effective conductances (B,), S, of which currents without `others` (n,) speak."""
    shares, share = shares_of(local.grid), local.meter.sheet.share
    start, reach = places, _REACH * local.spacing
    effective = np.maximum(effective, _LEAST * measured.total)
    weight = 1 / current_error(local.meter, measured)
    wanted = (measured.currents - others) * weight
    for _ in range(_STEPS):
        columns = []
        for place, c in zip(places.tolist(), effective.tolist()):
            pixels, weights = shares.at(*place)
            columns.append(share[:, pixels].dot(weights[:, :3] * [1.0, c, c]))
        matrix = np.hstack(columns) * weight[:, None]
        gram = matrix.T.dot(matrix)
        gram.ravel()[:: len(gram) + 1] *= 1 + 1e-6
        found = np.linalg.solve(gram, wanted.dot(matrix)).reshape(-1, 3)
        effective = np.maximum(found[:, 0], _LEAST * measured.total)
        moved = np.clip(places + shares.unit * found[:, 1:], start - reach, start + reach)
        on_sheet = [shares.on_sheet(*place) for place in moved.tolist()]
        places = np.where(np.array(on_sheet)[:, None], moved, places)
    total = measured.total - others.sum()
    return places, effective * max(total / max(effective.sum(), _TINY), 0.0)


def _size(local, noise, left, effective, field, impedance, radius):
    """Conductance, S, and radius, m, of a disc: means over radii, each counted by how well it explains `left`.

    Parameters
    ----------
    left : (P,) of the couplings when all contacts are points, S; None where noise hides them
    effective : c, S
    field : (n, 5) of H at its place, see `Shares.at`
    impedance : D if it had the expected `radius` (m), ohm
    """
    scale = 2 * np.pi / local.resistance
    largest = max(_LARGEST * local.spacing, radius / _SMALLEST) / radius
    sizes = math.log(_SMALLEST) + _SCALE * math.log(
        largest / _SMALLEST
    )  # logarithm, from radius on
    way = scale * impedance - _EVEN - sizes
    inside = scale / max(effective, _TINY) - np.maximum(way, -_EVEN)
    cost = (sizes / _USUAL) ** 2
    cost += (np.maximum(_INSIDE[0] - inside, 0.0) / _WAY_ERROR) ** 2
    if left is not None:
        first, second = local.meter.first, local.meter.second
        pairs = field[first] * field[second]
        error = noise**2 + (_SHEET_ERROR / local.resistance) ** 2
        error = np.sqrt(error + (_Y0_ERROR * local.meter.untouched) ** 2)
        shapes = np.array([left, pairs[:, 1] + pairs[:, 2], pairs[:, 3] + pairs[:, 4]]) / error
        squared = np.exp(2 * sizes) * (radius / shares_of(local.grid).unit) ** 2
        shorted = [np.interp(inside, _INSIDE, table) for table in _SHORTED]
        amounts = np.array(
            [
                np.ones(len(_SCALE)),
                -scale * squared * shorted[0],
                -2 * scale * squared**2 * shorted[1],
            ]
        )
        squares = (shapes.dot(shapes.T).dot(amounts) * amounts).sum(axis=0)
        best = amounts[:, squares.argmin()].dot(shapes)
        seen = shapes[1] ** 2
        cost += (squares - squares.min()) / (1 + seen.dot(best**2) / max(seen.sum(), _TINY))
    weight = np.exp((cost.min() - cost) / 2)
    weight /= weight.sum()
    squared = math.exp(2 * weight.dot(np.interp(inside, _INSIDE, _LOG_K)))
    return math.pi * squared / local.resistance, radius * math.exp(weight.dot(sizes))
