"""Contacts as discs: place, conductance and size of each from the currents and couplings next to
it.

Away from electrodes the shares H_n of a current fed in at a point are harmonic functions of its
place, so nine pixels tell them, and their derivatives, in between: H_n = h_n + Re(p_n z + q_n z^2 +
...) about a place, z = x + i y. With that, equation (b) of `grounded` is for a disc of radius a and
conductance per area g

    y_n = c h_n,      Y_nl - Y0_nl = c h_n h_l + s_1 Re(p_n p*_l) + s_2 Re(q_n q*_l),

    2 pi / (R c) = I_0(k) / (k I_1(k)) + X,    s_m = (2 pi m a^2m / R) I_m+1(k) / I_m-1(k),    k = a
    sqrt(g R)

with I the modified Bessel functions, of a disc that leaks evenly, and X the way from its rim to the
grounded electrodes. The mean of a harmonic function over a disc is that at its centre: currents
tell place and c whatever the size. A disc shows its size by what it short-circuits, s_m; the
stronger it is, the more, and the more the size matters for g. Where the couplings do not tell, the
expected radius stands.

An uneven sheet changes couplings, too, but those next to each other alike. So errors of Y0 near a
disc count as a random field, and its mean at the disc, given what the disc leaves of the couplings,
corrects R there.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from scipy.linalg import lapack
from scipy.ndimage import binary_erosion, distance_transform_edt
from scipy.special import ive

from tomotactile_ros.estimation.reported import crowded, told
from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.reconstruction.admittance import AdmittanceMeter, Grounded
from tomotactile_ros.reconstruction.grounded_step import LocalImage

_STEPS = 2  # of Gauss-Newton
_REACH = 0.2  # of a step, in spacings of the electrodes
_SIZES = 32  # radii that are compared
_SMALLEST, _LARGEST = 0.3, 0.7  # of them, in expected radii and in spacings
_USUAL = 0.4  # standard deviation of the logarithm of a radius about the expected one
_NEAR = 2.0  # couplings that tell of a disc are no further away, in spacings
_UNEVEN = 0.1  # standard deviation of the logarithm of the sheet's conductance,
_ALIKE = 1.75  # its correlation length, in spacings,
_MOST_UNEVEN = 0.3  # and how far it may be from zero
_ROUNDS = 2  # of sizes and the sheet's conductance in turns
_WAY_ERROR = 0.03  # of X
_EVEN = 0.25  # what a weak disc has above X
_LEAST = 0.01  # conductance of a disc, in parts of all
_CURRENT_ERROR = 0.001  # in parts of all contacts: size and place of electrodes
_OWN_ERROR = 0.01  # in parts of the electrode's own current
_PLACE_ERROR = 0.025  # spacings, and
_FORCE_ERROR = 0.1  # of the force: standard deviations of what this model of a disc lacks
# the same of one that covers the centre of an electrode, where H is not harmonic; upwards half of that
_ON_ELECTRODE, _MORE_THERE = 0.5, 0.25
# expected radii, of its place: where currents enter on the electrode, they do not tell
_PLACE_THERE = 0.2
# 2 ln k from which on most of the current of a disc goes to an electrode under it, as far as sheet and contact
# share it: weaker ones are right to `_ON_ELECTRODE`
_STRONG = 2 * math.log(1.7)
_NEVER_LARGER = 0.975  # probability of a radius: a bound holds in 39 of 40
_TINY = 1e-30  # S
_K = np.geomspace(6.0, 1e-6, 1000)  # from as good as a bare conductor to nearly nothing
_INSIDE = ive(0, _K) / (_K * ive(1, _K))  # ascending
_LOG_K = np.log(_K)
_SHORTED = ive(2, _K) / ive(0, _K), ive(3, _K) / ive(1, _K)


class Shares:
    """Interpolation between the pixels of `grid`, exact for harmonic polynomials up to the third
    degree.

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
    """(9, 5) value, Re p, -Im p, Re q, -Im q at z of 1, z, z^2, z^3 (real and imaginary parts), Re
    z^4 and |z|^2."""
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
    """place (2,) m; conductance g a^2 pi, S; radius, m.

    covariance (2, 2) of the place, m^2; spread (2, 2) the same of the logarithms of conductance and
    radius; certainty : conductance in standard deviations
    """

    place: np.ndarray
    conductance: float
    radius: float
    covariance: np.ndarray
    spread: np.ndarray
    certainty: float


@dataclass(frozen=True)
class _Point:
    """What the currents tell of a disc: its place x, y, m, and c, S; H there (n, 5), see
    `Shares.at`, and D, ohm; covariance (3, 3) of ln c, x and y."""

    place: tuple[float, float]
    effective: float
    field: np.ndarray
    impedance: float
    covariance: np.ndarray


def fit_discs(
    local: LocalImage,
    measured: Grounded,
    places: list[tuple[float, float]],
    change: np.ndarray,
    radius: float,
) -> list[Disc]:
    """Discs near `places`, m.

    Parameters
    ----------
    change : (K,) what D of a disc of `radius` (m) centred on each pixel has above that of the
        pixel, ohm
    radius : that is expected of each, m
    """
    sheet, first, second = local.meter.sheet, local.meter.first, local.meter.second
    left = None if measured.couplings is None else measured.couplings.astype(float)
    found = []
    for place, c, covariance in zip(*_fit_places(local, measured, places)):
        pixels, weights = shares_of(local.grid).at(*place)
        impedance = (sheet.impedance[pixels] + change[pixels]).dot(weights[:, 0])
        field = sheet.share[:, pixels].dot(weights)
        found.append(_Point(place, max(c, _TINY), field, float(impedance), covariance))
        if left is not None:
            point = field[:, 0]
            left -= c * point.take(first) * point.take(second)
    return [_sized(local, measured.noise, left, point, radius) for point in found]


def _fit_places(local, measured, places):
    """Places (x, y), m, and effective conductances c, S, that the currents tell, and the covariance
    (3, 3) of ln c and of each place, as large as what is left of the currents says."""
    shares, share = shares_of(local.grid), local.meter.sheet.share
    reach = _REACH * local.spacing
    places, effective, least = list(places), [0.0] * len(places), _LEAST * measured.total
    covariances = [np.full((3, 3), np.nan)] * len(places)
    weight = (current_error(local.meter, measured) ** -2.0)[:, None]
    wanted = measured.currents
    for _ in range(_STEPS):
        fields = []
        for place in places:
            pixels, weights = shares.at(*place)
            fields.append(share[:, pixels].dot(weights[:, :3]))
        matrix = fields[0] if len(fields) == 1 else np.concatenate(fields, axis=1)
        weighted = matrix * weight
        factor, found, failed = lapack.dposv(weighted.T.dot(matrix), wanted.dot(weighted))
        if failed:
            break
        left = wanted - matrix.dot(found)
        spare = max(len(wanted) - len(found), 1)
        excess = max(float((left * left).dot(weight[:, 0])) / spare, 1.0)
        inverse = excess * lapack.dpotri(factor)[0]
        found = found.tolist()
        for i, (x, y) in enumerate(places):
            effective[i] = c = max(found[3 * i], least)
            if not c > 0:  # noise alone: nothing to move by
                continue
            upper = inverse[3 * i : 3 * i + 3, 3 * i : 3 * i + 3]
            units = np.array([1.0, shares.unit, shares.unit]) / c
            covariances[i] = (np.triu(upper) + np.triu(upper, 1).T) * np.outer(units, units)
            along = [found[3 * i + 1] * shares.unit / c, found[3 * i + 2] * shares.unit / c]
            part = min(reach / max(math.hypot(*along), _TINY), 1.0)
            moved = x + part * along[0], y + part * along[1]
            if shares.on_sheet(*moved):
                places[i] = moved
    scale = max(float(wanted.sum()) / max(sum(effective), _TINY), 0.0)
    return places, [scale * c for c in effective], covariances


def _sized(local, noise, left, point, radius) -> Disc:
    """Mean over radii, each counted by how well it explains `left` and how near it is to `radius`.

    Parameters
    ----------
    left : (P,) of the couplings when all contacts are points, S; None where noise hides them
    radius : that is expected, m, and that of the disc whose D `point` has
    """
    scale = 2 * math.pi / local.resistance
    sizes, squared = _sizes(radius, local.spacing)
    way = np.maximum(scale * point.impedance - _EVEN - sizes, -_EVEN)
    inside = scale / point.effective - way
    conductance, misfit = 1.0, 0.0  # of the sheet at each radius, in parts of the usual one
    if left is not None:
        product, uneven = _compared(local, noise, left, point)
        for _ in range(_ROUNDS):
            amounts = _shorted(
                scale * conductance, squared / shares_of(local.grid).unit ** 2, inside
            )
            misfit = (product.dot(amounts) * amounts).sum(axis=0)
            change = np.minimum(np.maximum(uneven.dot(amounts), -_MOST_UNEVEN), _MOST_UNEVEN)
            conductance = np.exp(change)
            inside = scale * conductance / point.effective - way
    cost = misfit + (sizes / _USUAL) ** 2
    cost += (np.maximum(_INSIDE[0] - inside, 0.0) / _WAY_ERROR) ** 2
    weight = np.exp((cost.min() - cost) / 2)
    weight /= weight.sum()
    total = 2 * np.interp(inside, _INSIDE, _LOG_K) + np.log(conductance)
    both = np.array([total, sizes])
    means = both.dot(weight)
    apart = both - means[:, None]
    spread = (apart * weight).dot(apart.T)
    # ln g follows ln c and the way to the electrodes the faster, the nearer to a bare conductor
    typical = max(float(weight.dot(inside)), _WAY_ERROR)
    ends = np.interp([0.98 * typical, 1.02 * typical], _INSIDE, _LOG_K)
    steep = 2 * float(ends[0] - ends[1]) / (0.04 * typical)
    by_strength = (scale / point.effective * steep) ** 2 * point.covariance[0, 0]
    spread[0, 0] += by_strength + (_WAY_ERROR * steep) ** 2 + _FORCE_ERROR**2
    found = math.pi * math.exp(means[0]) / local.resistance
    spread[0, 0] += crowded(found, local.resistance) ** 2
    aside = float(np.hypot(*(local.electrodes - point.place).T).min())
    covers = aside < radius * math.exp(means[1])
    spread[0, 0] += covers * _ON_ELECTRODE**2
    # also where one of the expected radius would be a bare conductor: which of both, hardly shows
    usual = int(np.abs(sizes).argmin())
    most = max(found, math.pi * math.exp(total[usual]) / local.resistance)
    bare = told(most, max(1 / point.effective - 1 / most, 0.0), local.resistance)[1]
    hidden = not bare and covers and max(means[0], total[usual]) > _STRONG
    if bare or hidden:
        # known from below alone: as one of the largest radius that is not excluded
        spread[0, 0] = math.inf
        large = int(np.searchsorted(np.cumsum(weight), _NEVER_LARGER))
        covers = aside < radius * math.exp(sizes[large])
        way = np.interp(inside[large] + np.array([0.0, 2.0]) * _WAY_ERROR, _INSIDE, _LOG_K)
        less = 2 * (way[0] - way[1]) + 2 * math.hypot(_FORCE_ERROR, covers * _MORE_THERE)
        found = min(found, math.pi * math.exp(total[large] - less) / local.resistance)
    place_error = math.hypot(_PLACE_ERROR * local.spacing, covers * _PLACE_THERE * radius)
    return Disc(
        np.array(point.place),
        found,
        radius * math.exp(means[1]),
        point.covariance[1:, 1:] + place_error**2 * np.eye(2),
        spread,
        float(point.covariance[0, 0]) ** -0.5,
    )


def _shorted(scale, squared, inside):
    """(3, n) amounts of `left` and of both moments that leave nothing, for n squared radii, in
    units of `Shares`."""
    amounts = np.ones((3, len(squared)))
    amounts[1] = -scale * squared * np.interp(inside, _INSIDE, _SHORTED[0])
    amounts[2] = -2 * scale * squared**2 * np.interp(inside, _INSIDE, _SHORTED[1])
    return amounts


def _compared(local, noise, left, point):
    """(3, 3) Q and (3,) q: `amounts` a of `_shorted` have the misfit a Q a and show the sheet's
    conductance exp(q a)."""
    reach = _ALIKE * local.spacing
    x, y = (local.middles - point.place).T / reach
    squared = x * x + y * y
    near = np.flatnonzero(squared < (_NEAR / _ALIKE) ** 2)
    if not len(near):
        return np.zeros((3, 3)), np.zeros(3)
    first, second = local.meter.first[near], local.meter.second[near]
    pairs = point.field.take(first, axis=0) * point.field.take(second, axis=0)
    shapes = np.array([left[near], pairs[:, 1] + pairs[:, 2], pairs[:, 3] + pairs[:, 4]])
    here = _UNEVEN * np.exp(-squared[near] / 2) * local.meter.untouched[near]
    x, y = x[near], y[near]
    covariance = np.multiply.outer(x, x)
    covariance += np.multiply.outer(y, y)
    np.exp(covariance, out=covariance)
    covariance *= here
    covariance *= here[:, None]
    covariance.ravel()[:: len(near) + 1] += local.coupling_variance[near] + noise**2
    _, solved, _ = lapack.dposv(covariance, shapes.T)
    return shapes.dot(solved), _UNEVEN * here.dot(solved)


def current_error(meter: AdmittanceMeter, measured: Grounded) -> np.ndarray:
    """(n,) how far the currents can be trusted, S."""
    currents = measured.currents
    noise = measured.noise**2 * float(currents.dot(currents)) / meter.amplification
    model = _CURRENT_ERROR * measured.total + _OWN_ERROR * np.abs(currents)
    return np.sqrt(model**2 + noise)


@lru_cache(maxsize=8)
def _sizes(radius, spacing):
    """(n,) logarithms of the radii that are compared, in parts of `radius`, and their squares,
    m^2."""
    largest = max(_LARGEST * spacing / radius, 1 / _SMALLEST)
    sizes = np.linspace(math.log(_SMALLEST), math.log(largest), _SIZES)
    return sizes, radius**2 * np.exp(2 * sizes)
