"""Frames without some of their readings, completed so that everything measured stays as it is.

A missing reading whose mirror image was measured follows from reciprocity. What remains are pairs
of electrodes without either, and the rows of conditions that were not scanned (electrodes U; all
others are S). There Z is chosen so that its inverse is what sheet and contacts say, Y = Y0 + H
diag(c) H^T, with the contacts c of the image:

    Z_UU = (Y_UU)^-1 + Z_US (Z_SS)^-1 Z_SU,        dZ_nl = (Z^-1 - Y)_nl / (Y_nn Y_ll + Y_nl^2).

Image and completion take turns. Y is known but for the factor of Z, which follows from neighbours
that were measured.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.reconstruction.admittance import (
    AdmittanceMeter,
    Grounded,
    symmetric_scaling,
)
from tomotactile_ros.reconstruction.local import LocalImage
from tomotactile_ros.reconstruction.nonnegative import nonnegative_image
from tomotactile_ros.reconstruction.rows import LEAST_ROWS, RowReader, scanned_rows

_ROUNDS = 8
_ENOUGH = 0.002  # change of the currents, in parts of all, at which it ends
_PAIR_STEPS = 3
_TINY = 1e-60
_KEPT = 8  # sets of rows
_LEAST_PAIRS = 6  # of measured neighbours, for the factor


class _Completion:
    """Z of one incomplete frame, (n, n), with unknown entries filled in by `fill`."""

    def __init__(self, voltages, drive_voltage, least):
        valid = np.isfinite(voltages)
        np.fill_diagonal(valid, False)
        self.scanned = valid.any(axis=1)
        rows, other = np.flatnonzero(self.scanned), np.flatnonzero(~self.scanned)
        self._rows, self._other = rows, other
        own = np.ix_(rows, rows)
        mutual = valid[own] & valid[own].T
        frame = np.where(np.isfinite(voltages), voltages, 0.0)
        part = np.where(mutual, frame[own], drive_voltage)
        factor = 2 * symmetric_scaling(part, drive_voltage, least).diagonal()
        ratio = np.clip(1 - frame[rows] / drive_voltage, least, 1.0)
        scaled = factor[:, None] * ratio
        known = valid[rows]
        count = known[:, rows].astype(float) + known[:, rows].T
        total = np.where(known, scaled, 0.0)
        self.impedance = np.zeros(valid.shape)
        self.impedance[own] = (total[:, rows] + total[:, rows].T) / np.maximum(count, 1)
        self.impedance[rows, rows] = factor
        self.impedance[np.ix_(rows, other)] = total[:, other]
        self.impedance[np.ix_(other, rows)] = total[:, other].T
        unknown = np.zeros(valid.shape, bool)
        unknown[own] = count == 0
        unknown[np.ix_(rows, other)] = ~known[:, other]
        unknown[np.ix_(other, rows)] = ~known[:, other].T
        np.fill_diagonal(unknown, False)
        self._first, self._second = np.nonzero(np.triu(unknown | unknown.T))

    def guess(self, typical: np.ndarray) -> float:
        """Unknown pairs from resistances between electrodes, `typical` (n, n) ohm; the factor of
        Z."""
        own = self.impedance.diagonal()
        known = np.zeros(own.shape, bool)
        known[self._rows] = True
        usable = np.outer(known, known)
        np.fill_diagonal(usable, False)
        usable[self._first, self._second] = usable[self._second, self._first] = False
        if not usable.any():
            return 0.0
        apart = own[:, None] + own - 2 * self.impedance
        factor = float(np.median(apart[usable] / typical[usable]))
        i, j = self._first, self._second
        fill = (own[i] + own[j] - factor * typical[i, j]) / 2
        lone = ~(known[i] & known[j])  # own impedance of one of them is unknown
        fill[lone] = np.median(self.impedance[usable])
        self.impedance[i, j] = self.impedance[j, i] = fill
        return factor

    def fill(self, admittance: np.ndarray) -> np.ndarray:
        """Unknown entries for which the inverse there is `admittance` (n, n); the inverse
        (n, n)."""
        self._fill_rows(admittance)
        inverse = _inverse(self.impedance)
        i, j = self._first, self._second
        for _ in range(_PAIR_STEPS if len(i) else 0):
            change = inverse[i, j] - admittance[i, j]
            change /= np.maximum(inverse[i, i] * inverse[j, j] + inverse[i, j] ** 2, _TINY)
            self.impedance[i, j] += change
            self.impedance[j, i] += change
            self._fill_rows(admittance)
            inverse = _inverse(self.impedance)
        return inverse

    def _fill_rows(self, admittance):
        rows, other = self._rows, self._other
        if len(other):
            solved = np.linalg.solve(
                self.impedance[np.ix_(rows, rows)], self.impedance[np.ix_(rows, other)]
            )
            own = np.linalg.inv(admittance[np.ix_(other, other)])
            self.impedance[np.ix_(other, other)] = (
                own + self.impedance[np.ix_(other, rows)] @ solved
            )


def read_rows(
    local: LocalImage, voltages: np.ndarray, scanned: np.ndarray, drive_voltage: float, sharp: bool
) -> Grounded:
    """`Grounded` of a frame (n, n), V, that is complete in the rows `scanned` (n,); `sharp` as in
    `rows`."""
    found = None
    if LEAST_ROWS <= np.count_nonzero(scanned) < len(scanned):
        key = scanned.tobytes()
        if key not in local.readers:
            if len(local.readers) >= _KEPT:
                local.readers.pop(next(iter(local.readers)))
            local.readers[key] = RowReader(local, scanned)
        try:
            found = local.readers[key].read(voltages, drive_voltage, sharp)
        except np.linalg.LinAlgError:
            found = None
    if found is None:
        return local.meter.read_weak(np.array(voltages, float), drive_voltage)
    return found


def read_incomplete(
    meter: AdmittanceMeter, local: LocalImage, voltages: np.ndarray, drive_voltage: float
) -> Grounded:
    """`Grounded` of a frame (n, n), V, whose missing readings off the diagonal are NaN."""
    scanned = scanned_rows(voltages)
    if scanned is not None:
        return read_rows(local, voltages, scanned, drive_voltage, sharp=True)
    weak = meter.read_weak(voltages.copy(), drive_voltage)
    least = meter.noise / drive_voltage
    if np.count_nonzero(np.isfinite(voltages).any(axis=1)) < LEAST_ROWS:
        return weak
    try:
        found = _take_turns(meter, local, _Completion(voltages, drive_voltage, least), least)
    except np.linalg.LinAlgError:
        found = None
    return weak if found is None else found


def _take_turns(meter, local, completion, least):
    sheet = meter.sheet
    factor = completion.guess(sheet.resistance_between())
    scanned = completion.scanned
    neighbours = scanned[meter.first] & scanned[meter.second]
    if np.count_nonzero(neighbours) < _LEAST_PAIRS:
        neighbours = scanned[meter.first] | scanned[meter.second]
    admittance, measured = sheet.admittance + _slight(sheet.admittance), None
    for _ in range(_ROUNDS):
        if not factor > 0:
            return None
        inverse = completion.fill(admittance / factor)
        wanted = admittance[meter.second, meter.first][neighbours]
        ratio = float(np.median(inverse[meter.second, meter.first][neighbours] / wanted))
        factor = float(np.sqrt(factor / ratio)) if ratio > 0 else 0.0
        matrix = factor * inverse
        before, currents = measured, matrix.sum(axis=1)
        spread = least * abs(float(completion.impedance.diagonal().mean()))
        noise = spread / max(factor, 1e-300) * meter.amplification
        if not meter.is_possible(matrix, noise):
            return None
        couplings = matrix[meter.second, meter.first] - meter.untouched
        measured = Grounded(currents, couplings, noise)
        if before is not None:
            change = np.abs(measured.currents - before.currents).max()
            if change < _ENOUGH * measured.total:
                break
        conductance = nonnegative_image(local, measured, local.image(measured).astype(float))
        admittance = sheet.admittance + (sheet.share * conductance) @ sheet.share.T
        admittance += _slight(sheet.admittance)
    return measured


def _inverse(matrix):
    inverse = np.linalg.inv(matrix)
    if not (np.abs(inverse) < 1 / _TINY).all():
        raise np.linalg.LinAlgError("singular")
    return inverse


def _slight(admittance):
    """A conductance to the drive so slight that it only keeps blocks regular."""
    return 1e-9 * np.diag(admittance.diagonal())
