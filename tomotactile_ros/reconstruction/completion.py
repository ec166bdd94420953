"""Frames with missing readings: filled in so that sheet, contacts and all other readings agree.

A missing reading is replaced by what the image of the frame predicts, Z = (Y0 + H diag(c) H^T)^-1 in equation (a)
of `grounded`, and the image is made again. The first guess is the limit of weak contacts. Every reading that is
there is used as it is.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.reconstruction.admittance import AdmittanceMeter, Grounded
from tomotactile_ros.reconstruction.local import LocalImage

_ROUNDS = 4


def read_incomplete(
    meter: AdmittanceMeter, local: LocalImage, voltages: np.ndarray, drive_voltage: float
) -> Grounded:
    """`Grounded` of a frame (n, n) whose missing readings off the diagonal are NaN."""
    missing = ~np.isfinite(voltages)
    np.fill_diagonal(missing, False)
    measured = meter.read_weak(voltages.copy(), drive_voltage)
    share = meter.sheet.share
    for _ in range(_ROUNDS):
        conductance = np.maximum(local.image(measured), 0.0)
        scale = max(measured.total, 0.0) / max(float(conductance.sum()), 1e-300)
        admittance = meter.sheet.admittance + (share * (conductance * scale)) @ share.T
        admittance += 1e-9 * np.trace(admittance) * np.eye(len(admittance)) / len(admittance)
        impedance = np.linalg.inv(admittance)
        predicted = drive_voltage * (1 - impedance / np.diagonal(impedance)[:, None])
        measured = meter.read(np.where(missing, predicted, voltages), drive_voltage)
    return measured
