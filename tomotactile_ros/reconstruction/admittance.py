"""What a frame says about the sheet with all electrodes grounded: currents and couplings (see `grounded`).

The rows of rho = 1 - v / V0 are those of Z up to factors f. Symmetry asks for f_l rho_ln = f_n rho_nl; its sum over
n makes f a fixed point of f -> (rho^T f) / (rho 1), which a power iteration finds. Y is the inverse. Its factor is
known from electrodes between which nothing touches: most pairs of neighbours couple as on the untouched sheet.

Contacts so weak that noise spoils the inverse do not bend the potential, and all is linear:

    v_ln / V0 = t (G_ll - G_nl + b_n - b_l),      y = t Y0 b + t s

with t the sum of all conductances, b the potential of the contacts' share of current at the electrodes and s from
[Y0 s; s^T .] = [G_EE 1; 1^T 0]^-1. Means over rows and columns give t and b.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.linalg import lapack

from tomotactile_ros.reconstruction.grounded import GroundedSheet

_STEPS = 6  # of the power iteration; each gains about a digit
_COUPLED = 0.03  # electrodes are neighbours from this coupling coefficient on
_SINGLE = lapack.spotrf, lapack.spotri
_DOUBLE = lapack.dpotrf, lapack.dpotri
_NOISY = 0.1  # largest noise of an admittance, in parts of an electrode's own


@dataclass(frozen=True)
class Grounded:
    """What the grounded electrodes would measure.

    currents  : (n,) y, into each electrode from the driving layer per volt of drive, S
    couplings : (P,) Y - Y0 of neighbours, S; None where noise hides it
    noise     : standard deviation of an entry of Y, S
    asymmetry : root mean square contradiction to reciprocity, in parts of the noise
    """

    currents: np.ndarray
    couplings: np.ndarray | None
    noise: float
    asymmetry: float = 0.0

    @property
    def total(self) -> float:
        """Conductance of all contacts to the grounded electrodes, S."""
        return float(self.currents.sum())


class AdmittanceMeter:
    """Turns complete frames of the electrodes of `sheet` into `Grounded`; `noise` of a reading, V rms.

    Attributes
    ----------
    first, second : (P,) pairs of neighbouring electrodes.
    untouched : (P,) Y0 of each pair, S.
    amplification : noise of an entry of Y over noise of an entry of Z, S^2.
    largest_noise : of an entry of Y, S; with more, contacts count as weak.
    """

    def __init__(self, sheet: GroundedSheet, noise: float):
        self.sheet, self.noise = sheet, noise
        admittance = sheet.admittance
        own = np.sqrt(np.diagonal(admittance))
        coupling = -admittance / np.outer(own, own)
        self.second, self.first = np.nonzero(np.tril(coupling > _COUPLED, -1))
        self.untouched = admittance[self.second, self.first]
        self._place = np.ravel_multi_index((self.first, self.second), admittance.shape)
        self.amplification = float(np.median((admittance**2).sum(axis=1)))
        self.largest_noise = _NOISY * float(np.median(own)) ** 2
        self._prepare_weak()

    def read(self, voltages: np.ndarray, drive_voltage: float) -> Grounded:
        """`Grounded` of a complete frame (n, n), V, float64 or float32; its diagonal does not matter.

        Single precision is twice as fast and loses nothing to noise unless contacts are weak.
        """
        scaled = symmetric_scaling(voltages, drive_voltage, self.noise / drive_voltage)
        impedance = scaled + scaled.T
        contradiction = asymmetry(scaled, self.noise / drive_voltage)
        inverse = _inverse(impedance)
        if inverse is None:
            return self._read_weak_after(voltages, drive_voltage, contradiction)
        # LAPACK counts columns first: its lower triangle is the upper one here
        couplings = inverse.T.ravel()[self._place]
        ratios = couplings / self.untouched
        middle = len(ratios) // 2
        factor = float(np.partition(ratios, middle)[middle])
        factor = 1 / factor if factor > 0 else np.inf
        spread = self.noise / drive_voltage * float(impedance.diagonal().mean())
        noise = spread / factor * self.amplification
        if not 0 < noise < self.largest_noise:
            return self._read_weak_after(voltages, drive_voltage, contradiction)
        couplings = factor * couplings - self.untouched
        currents = factor * (inverse.sum(axis=0) + inverse.sum(axis=1) - inverse.diagonal())
        return Grounded(currents, couplings, noise, contradiction)

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
        noise = self.largest_noise if total <= 0 else max(self.largest_noise, self.noise / drive_voltage)
        return Grounded(currents, None, noise)

    def _prepare_weak(self):
        sheet = self.sheet
        green = sheet.transfer.electrode_electrode[np.ix_(sheet.used, sheet.used)]
        own = np.diagonal(green)
        self._step = own[:, None] - green
        self._apart = (self._step + self._step.T) / 2
        self._weak_admittance = sheet.admittance
        self._weak_share = sheet.rest_share


def symmetric_scaling(
    voltages: np.ndarray, drive_voltage: float, least: float, steps: int = _STEPS
) -> np.ndarray:
    """(n, n) f_l rho_ln, symmetric but for noise, with f of mean 1/2 on its diagonal.

    Parameters
    ----------
    voltages : (n, n) V; the diagonal does not matter
    least : the smallest rho that counts: the noise in parts of the drive voltage
    """
    ratio = np.multiply(voltages, -1.0 / drive_voltage)
    ratio += 1.0
    ratio.ravel()[:: len(ratio) + 1] = 1.0
    np.minimum(ratio, 1.0 + least, out=ratio)
    np.maximum(ratio, least, out=ratio)
    weight = 1.0 / ratio.sum(axis=1)
    factor = weight
    for _ in range(steps):
        factor = weight * (factor @ ratio)
    ratio *= (factor * (len(factor) / (2 * factor.sum())))[:, None]
    return ratio


def asymmetry(scaled: np.ndarray, noise: float) -> float:
    """Root mean square contradiction to reciprocity of `symmetric_scaling`, in parts of `noise` / drive voltage."""
    difference = (scaled - scaled.T).ravel()
    # f_l rho_ln and f_n rho_nl: each with the noise times its factor, which is about 1/2
    error = noise * np.sqrt(0.5 * difference.size)
    return float(np.sqrt(difference @ difference) / error)


def _inverse(matrix):
    """Lower triangle of the inverse; None where the matrix is not positive definite."""
    single = matrix.dtype == np.float32
    factorise, invert = _SINGLE if single else _DOUBLE
    factor, failed = factorise(matrix, lower=1)
    if not failed:
        inverse, failed = invert(factor, lower=1, overwrite_c=1)
    return None if failed else inverse


def _balance(rest, valid):
    """(n,) b with b_n - b_l closest to `rest` (l, n) where `valid`, in least squares."""
    weight = valid + valid.T.astype(float)
    laplacian = np.diag(weight.sum(axis=1)) - weight
    right = rest.sum(axis=0) - rest.sum(axis=1)
    count = len(rest)
    # electrodes that no reading ties to the others stay at the mean
    return np.linalg.lstsq(laplacian + np.ones((count, count)) / count, right, rcond=1e-12)[0]
