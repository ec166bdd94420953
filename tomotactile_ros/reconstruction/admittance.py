"""What a frame says about the sheet with all electrodes grounded: currents and couplings (see
`grounded`).

The rows of rho = 1 - v / V0 are those of Z up to factors f. Symmetry asks for f_l rho_ln = f_n
rho_nl; its sum over n makes f a fixed point of f -> (rho^T f) / (rho 1), which a few steps of a
power iteration find; under wide or strong contacts they would be many, and the linear system is
solved. Y is the inverse. Its factor is known from electrodes between which nothing touches: most
pairs of neighbours couple as on the untouched sheet.

Contacts so weak that noise spoils the inverse do not bend the potential, and all is linear:

    v_ln / V0 = t (G_ll - G_nl + b_n - b_l),      y = t Y0 b + t s

with t the sum of all conductances, b the potential of the contacts' share of current at the
electrodes and s from [Y0 s; s^T .] = [G_EE 1; 1^T 0]^-1. Means over rows and columns give t and b.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
from scipy.linalg import blas, lapack

from tomotactile_ros.reconstruction.grounded import GroundedSheet

_STEPS = 4  # of the power iteration at least; each gains about a digit where contacts are small
_MOST_STEPS = 10  # of it at most
_CLOSE = 1e-4  # relative change of f in the last step up to which they suffice
_COUPLED = 0.03  # electrodes are neighbours from this coupling coefficient on
_SINGLE = lapack.spotrf, blas.strsm, blas.ssyrk, blas.ssymv
_DOUBLE = lapack.dpotrf, blas.dtrsm, blas.dsyrk, blas.dsymv
_DISTANT = 0.08  # electrodes are distant below this coupling coefficient
_LARGEST = 1e12  # largest admittance that counts, in parts of an electrode's own
_NOISY = 0.1  # largest noise of an admittance, in parts of an electrode's own


@dataclass(frozen=True)
class Grounded:
    """What the grounded electrodes would measure.

    currents  : (n,) y, into each electrode from the driving layer per volt of drive, S
    couplings : (P,) Y - Y0 of neighbours, S; None where noise hides it
    noise     : standard deviation of an entry of Y, S
    asymmetry : root mean square contradiction to reciprocity, in parts of the noise
    entries   : (n n) upper triangle of Y, S, row by row; None for weak contacts
    """

    currents: np.ndarray
    couplings: np.ndarray | None
    noise: float
    asymmetry: float = 0.0
    entries: np.ndarray | None = None

    @cached_property
    def total(self) -> float:
        """Conductance of all contacts to the grounded electrodes, S."""
        return float(self.currents.sum())


class AdmittanceMeter:
    """Turns complete frames of the electrodes of `sheet` into `Grounded`; `noise` of a reading, V
    rms.

    Attributes
    ----------
    first, second : (P,) pairs of neighbouring electrodes.
    untouched : (P,) Y0 of each pair, S.
    amplification : noise of an entry of Y over noise of an entry of Z, S^2.
    own : median admittance of an electrode on the untouched sheet, S.
    scale : (n, n) geometric mean of both electrodes' own admittances, S.
    largest_noise : of an entry of Y, S; with more, contacts count as weak.
    largest : entry of Y, S; larger ones come from readings that contradict each other.
    """

    def __init__(self, sheet: GroundedSheet, noise: float):
        self.sheet, self.noise = sheet, noise
        admittance = sheet.admittance
        own = np.sqrt(np.diagonal(admittance))
        coupling = -admittance / np.outer(own, own)
        self.second, self.first = np.nonzero(np.tril(coupling > _COUPLED, -1))
        self.untouched = admittance[self.second, self.first]
        self._place = np.ravel_multi_index((self.first, self.second), admittance.shape)
        distant = np.nonzero(np.triu(coupling < _DISTANT, 1))
        self._distant = np.ravel_multi_index(distant, admittance.shape)
        self.scale = np.outer(own, own)
        self._distant_scale = self.scale[distant]
        self.amplification = float(np.median((admittance**2).sum(axis=1)))
        self.own = float(np.median(own)) ** 2
        self.largest_noise, self.largest = _NOISY * self.own, _LARGEST * self.own
        self._prepare_weak()

    def read(self, voltages: np.ndarray, drive_voltage: float) -> Grounded:
        """`Grounded` of a complete frame (n, n), V, float64 or float32; its diagonal does not
        matter.

        Single precision is twice as fast and loses nothing to noise unless contacts are weak.
        """
        least = self.noise / drive_voltage
        impedance, contradiction = symmetric_part(
            symmetric_scaling(voltages, drive_voltage, least), least
        )
        inverse = _inverse(impedance)
        if inverse is None:
            return self._read_weak_after(voltages, drive_voltage, contradiction)
        # BLAS counts columns first: its lower triangle is the upper one here
        flat = inverse.T.ravel()
        couplings = flat.take(self._place)
        ratios = couplings / self.untouched
        middle = len(ratios) // 2
        ratios.partition(middle)
        ratio = float(ratios[middle])
        factor = 1 / ratio if ratio > 0 else np.inf
        noise = least / factor * self.amplification  # the mean own impedance is 1
        if not (noise < self.largest_noise and 0 < factor < self.largest):
            return self._read_weak_after(voltages, drive_voltage, contradiction)
        couplings = factor * couplings - self.untouched
        currents = _routines(inverse)[3](factor, inverse, np.ones(len(inverse)), lower=1)
        flat *= factor
        return Grounded(currents, couplings, noise, contradiction, flat)

    def excess(self, measured: Grounded) -> float:
        """Largest coupling of distant electrodes, in parts of their own admittance.

        Contacts only lower couplings; noise, or wires that are swapped, raise them.
        """
        if measured.entries is None:
            return 0.0
        return -float((measured.entries.take(self._distant) / self._distant_scale).min(initial=0.0))

    def far_couplings(self, measured: Grounded) -> np.ndarray:
        """(n, n) coupling of distant electrodes, in parts of their own admittance, 0 for others; one
        triangle of it is filled."""
        far = np.zeros(self.scale.shape)
        if measured.entries is not None:
            couplings = -measured.entries.take(self._distant) / self._distant_scale
            far.ravel()[self._distant] = couplings
        return far

    def scaled(self, impedance: np.ndarray) -> np.ndarray:
        """(n, n) Y, S, of Z that is known but for a factor."""
        inverse = np.linalg.inv(impedance)
        return inverse / np.median(inverse[self.first, self.second] / self.untouched)

    def _read_weak_after(self, voltages, drive_voltage, contradiction):
        weak = self.read_weak(np.array(voltages, float), drive_voltage)
        return replace(weak, asymmetry=contradiction)

    def read_weak(self, voltages: np.ndarray, drive_voltage: float) -> Grounded:
        """The limit of weak contacts, also for frames with NaN off the diagonal."""
        ratio = voltages / drive_voltage
        np.fill_diagonal(ratio, np.nan)
        valid = np.isfinite(ratio)
        both = valid & valid.T
        if not both.any():
            both, symmetric = valid, np.where(valid, ratio, 0.0)
        else:
            symmetric = np.where(both, (ratio + ratio.T) / 2, 0.0)
        scale = max(float((self._apart[both] ** 2).sum()), 1e-300)
        total = max(float((symmetric * self._apart)[both].sum()) / scale, 0.0)
        rest = np.where(valid, ratio - total * self._step, 0.0)
        bent = _balance(rest, valid)
        currents = self._weak_admittance @ bent + total * self._weak_share
        noise = (
            self.largest_noise
            if total <= 0
            else max(self.largest_noise, self.noise / drive_voltage)
        )
        return Grounded(currents, None, noise)

    def _prepare_weak(self):
        sheet = self.sheet
        green = sheet.transfer.electrode_electrode[np.ix_(sheet.used, sheet.used)]
        own = np.diagonal(green)
        self._step = own[:, None] - green
        self._apart = (self._step + self._step.T) / 2
        self._weak_admittance = sheet.admittance
        self._weak_share = sheet.rest_share


def symmetric_scaling(voltages: np.ndarray, drive_voltage: float, least: float) -> np.ndarray:
    """(n, n) f_l rho_ln, symmetric but for noise, with f of mean 1/2 on its diagonal.

    Parameters
    ----------
    voltages : (n, n) V; the diagonal does not matter
    least : the smallest rho that counts: the noise in parts of the drive voltage
    """
    drop = drive_voltage - voltages
    drop.ravel()[:: len(drop) + 1] = drive_voltage
    np.minimum(drop, drive_voltage * (1.0 + least), out=drop)
    np.maximum(drop, drive_voltage * least, out=drop)
    ones = np.ones(len(drop), drop.dtype)
    sums = drop.dot(ones)
    weight = ones / sums
    factor = weight
    for step in range(1, _MOST_STEPS + 1):
        before = factor
        factor = factor.dot(drop)
        factor *= weight
        if step >= _STEPS:
            before -= factor
            if before.dot(before) <= _CLOSE**2 * factor.dot(factor):
                break
    else:
        factor = _fixed_point(drop, sums, factor)
    factor *= len(factor) / (2 * drive_voltage * factor.dot(ones))
    drop *= factor[:, None]
    return drop


def _fixed_point(drop, sums, near):
    """(n,) f > 0 with rho^T f = (rho 1) f, or `near` where there is none."""
    system = drop - drop[0, 0]  # rho - diag(rho 1) loses rank; this fixes the sum of f
    system.ravel()[:: len(drop) + 1] -= sums
    try:
        found = np.linalg.solve(system.T, np.full(len(sums), -1.0, system.dtype))
    except np.linalg.LinAlgError:
        return near
    return found if 0 < found.min() and found.max() < np.inf else near


def symmetric_part(scaled: np.ndarray, noise: float) -> tuple[np.ndarray, float]:
    """Z (n, n) of `symmetric_scaling`, and how far that contradicts reciprocity.

    The contradiction is the root mean square of its asymmetry in parts of `noise`, in parts of the
    drive voltage.
    """
    impedance = scaled + scaled.T
    difference = 2 * scaled
    difference -= impedance
    difference = difference.ravel()
    factor = scaled.diagonal()
    # f_l rho_ln and f_n rho_nl: each has the noise times its factor
    error = noise * math.sqrt(2 * len(scaled) * factor.dot(factor))
    return impedance, math.sqrt(difference.dot(difference)) / error


def _inverse(matrix):
    """Lower triangle of the inverse L^-T L^-1; None where the matrix is not positive definite."""
    factorise, divide, multiply, _ = _routines(matrix)
    factor, failed = factorise(matrix.T, lower=1)
    if failed:
        return None
    root = divide(1.0, factor, _identity(len(matrix), matrix.dtype), lower=1, side=1)
    return multiply(1.0, root, trans=1, lower=1)


def _routines(matrix):
    return _SINGLE if matrix.itemsize == 4 else _DOUBLE


@lru_cache(maxsize=8)
def _identity(count, dtype):
    return np.eye(count, dtype=dtype, order="F")


def _balance(rest, valid):
    """(n,) b with b_n - b_l closest to `rest` (l, n) where `valid`, in least squares."""
    weight = valid + valid.T.astype(float)
    laplacian = np.diag(weight.sum(axis=1)) - weight
    right = rest.sum(axis=0) - rest.sum(axis=1)
    count = len(rest)
    # electrodes that no reading ties to the others stay at the mean
    return np.linalg.lstsq(laplacian + np.ones((count, count)) / count, right, rcond=1e-12)[0]
