"""One linear step from what the grounded electrodes would measure to an image (see `grounded`).

Data are the current y_n into each electrode from the driving layer and what contacts add to the
admittance between neighbouring electrodes. Both are linear in the effective conductances c of the
pixels,

    y_n = sum_k H_nk c_k,        Y_nl - Y0_nl = sum_k H_nk H_lk c_k,        c_k = 1 / (1/g_k +
    D_kk).

As H >= 0 and sum_n H_nk = 1, the second lies between 0 and y_n y_l / (y_n + y_l): so it is for a
single pixel, and that function is concave. What is outside is an error of Y0, and is cut off.

The image is the mean of a Gaussian field given the data, in Tikhonov's form

    c = P A^T (A P A^T + diag(lambda^2))^-1 d

with P a Gaussian smoothing about half as wide as electrodes are apart. P acts on rows and columns
of the image one after the other and passes few frequencies, P = (U S U^T) x (V T V^T): what depends
on the frame is computed in the leading modes and the image follows from U, V. lambda of a coupling
is its noise, or the error of Y0 if that is larger, in parts of the field's standard deviation,
which follows the strength of the frame.
"""

from __future__ import annotations

import math

import numpy as np
from scipy.spatial import cKDTree

from tomotactile_ros.layouts.grid import Grid
from tomotactile_ros.reconstruction.admittance import AdmittanceMeter, Grounded

_WIDTH = 0.5  # of the smoothing, in spacings of the electrodes
_FIELD = 0.22  # standard deviation of the field, per squared spacing, in parts of all contacts
_CURRENT_ERROR = 0.02  # how closely currents are followed, in parts of all contacts
_COUPLING_ERROR = 0.0067  # the same for couplings at the least
_MODEL_ERROR = 0.003  # of Y0, in parts of the sheet's conductance: electrodes, closed form
_UNTOUCHED_ERROR = 0.01  # of each coupling of the untouched sheet
_READY = 3  # levels that are prepared, those of usual contacts; others when a frame needs them
_LARGE = 2_000_000  # entries of A from which on only the first of them is
_NEGLIGIBLE = 1e-4  # of the largest gain of P: modes below are left out
_TINY = 1e-30  # S
_LEVELS = 16  # of lambda of the couplings, each twice the last


class LocalImage:
    """Linear images of `Grounded` measurements on `grid`.

    Attributes
    ----------
    forward : (D, K) A, the data of a unit conductance in each pixel.
    spacing : median distance of neighbouring electrodes, m.
    resistance : of the sheet, ohm/sq.
    coupling_variance : (P,) S^2, of Y0 between neighbours on an even sheet.
    middles : (P, 2) places midway between neighbours, m.
    typical_impedance : median of D over the pixels, ohm.
    """

    def __init__(self, meter: AdmittanceMeter, grid: Grid, positions, resistance: float):
        self.meter, self.grid, self.resistance = meter, grid, resistance
        sheet = meter.sheet
        share = sheet.share
        self.forward = np.vstack([share, share[meter.first] * share[meter.second]])
        self.electrodes = np.asarray(positions)
        used = self.electrodes[sheet.used]
        self.middles = (used[meter.first] + used[meter.second]) / 2
        self.spacing = float(np.median(cKDTree(positions).query(positions, k=2)[0][:, 1]))
        self._smooth()
        self._model_error = _MODEL_ERROR / resistance
        self.coupling_variance = (_UNTOUCHED_ERROR * meter.untouched) ** 2 + self._model_error**2
        self.typical_impedance = float(np.median(sheet.impedance))
        self._levels: dict[int, np.ndarray] = {}
        self._areas: dict[int, float] = {}
        for level in range(_READY if self.forward.size < _LARGE else 1):
            self._inverse_of(level)

    def _smooth(self):
        """P A^T in the modes of P, (modes, D), and A P A^T, (D, D)."""
        sigma = _WIDTH * self.spacing / np.array(self.grid.cell_size[::-1])
        scale = 2 * np.pi * sigma.prod() * (_FIELD * self.grid.cell_area / self.spacing**2) ** 2
        shape = self.grid.shape
        (down, gain_down), (across, gain_across) = map(_modes, shape, sigma)
        images = np.zeros((len(self.forward), shape[0] * shape[1]))
        images[:, self.grid.inside.ravel()] = self.forward
        modes = down.T @ images.reshape(-1, *shape) @ across
        gain = scale * np.outer(gain_down, gain_across)
        self._smoothed = (modes * gain).reshape(len(modes), -1).T
        self._normal = modes.reshape(len(modes), -1) @ self._smoothed
        self._down = np.ascontiguousarray(down, np.float32)
        self._across = np.ascontiguousarray(across.T, np.float32)
        self._inside = None if self.grid.inside.all() else self.grid.inside.ravel()

    def expand(self, modes: np.ndarray) -> np.ndarray:
        """(K,) image from its modes."""
        image = self._down.dot(modes.reshape(self._down.shape[1], -1)).dot(self._across).ravel()
        return image if self._inside is None else image[self._inside]

    def level(self, measured: Grounded) -> int:
        """Which of the precomputed lambda fits the noise of this frame."""
        if measured.couplings is None:
            return _LEVELS - 1
        error = math.hypot(measured.noise, self._model_error)
        least = max(_COUPLING_ERROR * measured.total, 1e-300)
        return min(max(round(math.log2(error / least)), 0), _LEVELS - 1)

    def regularization(self, level: int) -> float:
        """lambda^2 of the couplings, in parts of the squared conductance of all contacts."""
        return (_COUPLING_ERROR * 2.0**level) ** 2

    def image(self, measured: Grounded) -> np.ndarray:
        """(K,) float32 effective conductance of each pixel, S; may be slightly negative."""
        inverse = self._inverse_of(self.level(measured))
        currents = measured.currents
        count = len(currents)
        data = np.empty(inverse.shape[1], np.float32)
        data[:count] = currents
        if measured.couplings is not None and len(data) > count:
            positive = np.maximum(data[:count], _TINY)
            first, second = positive[self.meter.first], positive[self.meter.second]
            most = first * second
            first += second
            most /= first
            np.minimum(np.maximum(measured.couplings, 0.0), most, out=data[count:])
        return self.expand(inverse.dot(data))

    def point_area(self, measured: Grounded) -> float:
        """Area of the upper half of a point's image, m^2: the median over a few places."""
        level = self.level(measured)
        if level not in self._areas:
            inverse = self._inverse_of(level)
            places = np.linspace(0, self.forward.shape[1] - 1, 64).astype(int)
            modes = (inverse @ self.forward[: inverse.shape[1], places]).T
            images = map(self.expand, modes)
            count = np.median([np.count_nonzero(image > image.max() / 2) for image in images])
            self._areas[level] = float(count * self.grid.cell_area)
        return self._areas[level]

    def _inverse_of(self, level):
        """(modes, D) float32 reconstruction matrix; without couplings where lambda is largest."""
        if level not in self._levels:
            count = len(self.meter.sheet.used)
            kept = count if level == _LEVELS - 1 else len(self.forward)
            error = np.full(kept, np.sqrt(self.regularization(level)))
            error[:count] = _CURRENT_ERROR
            system = self._normal[:kept, :kept] + np.diag(error**2)
            inverse = np.linalg.solve(system, self._smoothed[:, :kept].T).T
            self._levels[level] = inverse.astype(np.float32, order="C")
        return self._levels[level]


def _modes(count, sigma):
    """(count, m) leading modes of a Gaussian smoothing of `count` cells, sigma in cells, and their
    gains (m,)."""
    apart = np.subtract.outer(np.arange(count), np.arange(count)) / sigma
    gains, modes = np.linalg.eigh(np.exp(-(apart**2) / 2) / (math.sqrt(2 * math.pi) * sigma))
    kept = gains > _NEGLIGIBLE * gains[-1]
    return modes[:, kept], gains[kept]
