"""Frames with some of the ground conditions only: rows S were scanned, rows U were not.

Of Z = Y^-1 the rows S are known but for a factor. In blocks, with T = Z_SS^-1 Z_SU, which is free
of the factor phi,

    Y_SU = -T Y_UU,        Y_SS = phi Z_SS^-1 + T Y_UU T^T,

so that the measured part of the currents y = Y 1 is exact, y_U = Y_UU (1 - T^T 1). Only Y_UU is to
be guessed: Y0_UU + H_U diag(c) H_U^T with the contacts c of the image, in turns with the image. phi
follows from pairs in S for which phi Z_SS^-1 is what sheet and contacts say, Y_SS - T Y_UU T^T; the
median over pairs bears contacts that are missed.

The linear image is blurred, which puts too much of a contact between electrodes. A few
multiplicative steps towards the non-negative image from its square (A^T d / A^T A c, which keeps c
>= 0) are nearly as good as that image itself. Rounds are stretched by half: each one would go about
two thirds of the way.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.reconstruction.admittance import (
    Grounded,
    symmetric_part,
    symmetric_scaling,
)
from tomotactile_ros.reconstruction.local import LocalImage
from tomotactile_ros.reconstruction.nonnegative import (
    nonnegative_image,
    solve_nonnegative,
    weighted_data,
)

_ROUNDS = 8
_SHORT_ROUNDS = 4  # with multiplicative steps
_STEPS = 15  # of them in a round
_STRETCH = 1.5
_ENOUGH = 0.002  # change of the currents, in parts of all, at which it ends
_COUPLED = 0.03  # coupling coefficient of the pairs that tell phi
_SUPPORT = 0.2  # of the linear image's maximum
_KEPT = 0.1  # of the highest pixel after them, to end with the non-negative image of the rest
_TINY = 1e-30
LEAST_ROWS = 3


class RowReader:
    """What depends only on the rows `scanned` (n,) bool; at least three of them, and at least one
    not.

    Every matrix here has S first: `order` (n,) are the electrodes.
    """

    def __init__(self, local: LocalImage, scanned: np.ndarray):
        self._local, self.rows = local, np.flatnonzero(scanned)
        self.order = np.concatenate([self.rows, np.flatnonzero(~scanned)])
        self._count = len(self.rows)
        self._sheet = local.meter.sheet.admittance[np.ix_(self.order, self.order)]
        self._back = place = np.argsort(self.order)
        meter = local.meter
        self._pairs = np.ravel_multi_index(
            (place[meter.first], place[meter.second]), self._sheet.shape
        )
        own, mutual, other = self._blocks(self._sheet)
        reduced = own - mutual @ np.linalg.solve(other, mutual.T)
        scale = np.sqrt(reduced.diagonal())
        coupling = -reduced / np.outer(scale, scale)
        np.fill_diagonal(coupling, 0.0)
        least = min(_COUPLED, 0.5 * float(coupling.max()))
        self._telling = np.flatnonzero(np.triu(coupling >= least, 1))

    def read(self, voltages: np.ndarray, drive_voltage: float, sharp: bool) -> Grounded | None:
        """`Grounded` of a frame (n, n), V, complete in its rows; None where contacts are too weak
        to invert.

        `sharp` : by the non-negative image until nothing changes.
        """
        meter, count = self._local.meter, self._count
        least = meter.noise / drive_voltage
        part = voltages[np.ix_(self.rows, self.order)].astype(float)
        own = np.ascontiguousarray(part[:, :count])
        impedance, contradiction = symmetric_part(
            symmetric_scaling(own, drive_voltage, least), least
        )
        factor = impedance.diagonal()
        mutual = factor[:, None] * np.clip(1 - part[:, count:] / drive_voltage, least, 1.0)
        inverse = np.linalg.inv(impedance)
        transfer = inverse @ mutual
        spread = least * float(factor.mean()) * meter.amplification
        contacts, measured = 0.0, None
        for number in range(_ROUNDS if sharp else _SHORT_ROUNDS):
            exact = number > _SHORT_ROUNDS - 2
            if measured is not None:
                added = self._added(self._image(measured, sharp, exact))
                contacts = contacts + (1.0 if exact else _STRETCH) * (added - contacts)
            admittance, phi = self._complete(self._sheet + contacts, inverse, transfer)
            noise = spread / phi if phi > 0 else np.inf
            if not meter.is_possible(admittance, noise):
                return None
            currents = admittance.sum(axis=1)[self._back]
            couplings = admittance.ravel()[self._pairs] - meter.untouched
            before, measured = measured, Grounded(currents, couplings, noise, contradiction)
            if before is not None and exact:
                change = np.abs(currents - before.currents).max()
                if change < _ENOUGH * measured.total:
                    break
        return measured

    def _complete(self, wanted, inverse, transfer):
        """Y (n, n) from `wanted`, what sheet and contacts say of it, Z_SS^-1 and T; phi."""
        count = self._count
        own, _, other = self._blocks(wanted)
        passed = transfer @ other
        through = passed @ transfer.T
        tell = self._telling
        phi = float(np.median((own - through).ravel()[tell] / inverse.ravel()[tell]))
        admittance = wanted.copy()
        admittance[:count, :count] = phi * inverse + through
        admittance[:count, count:] = -passed
        admittance[count:, :count] = -passed.T
        return admittance, phi

    def _image(self, measured, sharp, exact):
        """(K,) c of each pixel, S."""
        image = self._local.image(measured)
        if sharp and exact:
            return nonnegative_image(self._local, measured, image.astype(float))
        data, weight = weighted_data(self._local, measured)
        active = np.flatnonzero(image > _SUPPORT * image.max())
        matrix = self._local.columns[active][:, : len(data)] * weight.astype(np.float32)
        upwards = np.maximum(matrix @ (data * weight).astype(np.float32), 0.0)
        values = image[active] ** 2
        values *= measured.total / max(float(values.sum()), _TINY)
        for _ in range(_STEPS):
            values = values * upwards / np.maximum(matrix @ (values @ matrix), _TINY)
        if exact:
            kept = values > _KEPT * values.max()
            active = active[kept]
            values = solve_nonnegative(matrix[kept].T.astype(float), data * weight)
        out = np.zeros(len(image))
        out[active] = values
        return out

    def _added(self, values):
        """(n, n) H diag(c) H^T."""
        active = np.flatnonzero(values)
        share = self._local.columns[active][:, : len(self.order)]
        added = (share.T * values[active].astype(np.float32)) @ share
        return added[np.ix_(self.order, self.order)].astype(float)

    def _blocks(self, matrix):
        count = self._count
        return matrix[:count, :count], matrix[:count, count:], matrix[count:, count:]


def scanned_rows(voltages: np.ndarray) -> np.ndarray | None:
    """(n,) bool, rows of a frame (n, n) that were scanned; None if other readings than whole rows
    are missing."""
    valid = np.isfinite(voltages)
    count = np.count_nonzero(valid, axis=1) + ~valid.diagonal()
    scanned = count > 1
    return scanned if np.count_nonzero(scanned) * len(valid) == count[scanned].sum() else None
