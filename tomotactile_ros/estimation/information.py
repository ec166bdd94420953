"""What one frame says of the sensor, its contacts marginal.

At a fit with contacts c and sensor theta the readings are linear, v = f + J_c dc + J_theta dtheta.
Contacts enter anew in each frame, with the prior that the estimator gives them; eliminated (Schur
complement) they leave the information

    L = J_theta^T W J_theta - J_theta^T W J_c (J_c^T W J_c + P_c^-1)^-1 J_c^T W J_theta

and the same of the gradient. A resting load is in c: it says nothing but what all else agrees with.
Frames add up (batch Gauss-Newton with contacts eliminated, as bundle adjustment does with cameras;
Triggs et al. 2000) or follow each other (information filter). Channels touch one column or one row
of the readings each: no dense derivative is formed. What electrodes as modelled err in this frame
(`SheetOperator.inexact`) is eliminated likewise.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import cho_factor, cho_solve

from tomotactile_ros.estimation.forward import Prediction, Unknowns
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.solver import Fit, Prior, Rows, contact_priors


@dataclass(frozen=True, eq=False)
class Information:
    """Of one frame, in the units of `SensorState`, of the electrodes in use only.

    matrix (d, d), vector (d,): information and gradient at the point where it was taken
    back (F, d), start (F,): contacts' step = start - back @ (step of theta)
    chi_squared, readings : of the fit
    """

    matrix: np.ndarray
    vector: np.ndarray
    back: np.ndarray
    start: np.ndarray
    chi_squared: float
    readings: int


def information(
    operator: SheetOperator, unknowns: Unknowns, rows: Rows, prior: Prior, drive: float
) -> Information:
    """Information of `rows` at `unknowns`; `prior` of contacts is used, that of the sensor is
    not."""
    fit = Fit(operator, unknowns, rows, prior)
    prediction, weights, misfit = fit.prediction, rows.weights, fit.misfit
    contacts, sheet, by_gain, by_resistance, by_electrode = _derivatives(
        prediction, unknowns, rows.grounded
    )
    free, modes, count = len(contacts), operator.modes, operator.count
    columns = np.concatenate([contacts, sheet])
    flat = columns.reshape(len(columns), -1)
    weighted = flat * weights.ravel()
    size = free + modes + 3 * count
    normal = np.zeros((size, size))
    right = np.zeros(size)
    dense = slice(0, free + modes)
    normal[dense, dense] = weighted @ flat.T
    right[dense] = weighted @ misfit.ravel()
    to_rows = np.zeros((count, len(rows.grounded)))
    to_rows[rows.grounded, np.arange(len(rows.grounded))] = 1.0
    first = free + modes
    gain, offset, resistance = (slice(first + i * count, first + (i + 1) * count) for i in range(3))
    weighted = weighted.reshape(columns.shape)
    normal[dense, gain] = np.einsum("pln,ln->pn", weighted, by_gain)
    normal[dense, offset] = weighted.sum(axis=1)
    normal[dense, resistance] = np.einsum("pln,ln->pl", weighted, by_resistance) @ to_rows.T
    by_row = weights * by_resistance
    normal[gain, gain] = np.diag((weights * by_gain**2).sum(axis=0))
    normal[gain, offset] = np.diag((weights * by_gain).sum(axis=0))
    normal[offset, offset] = np.diag(weights.sum(axis=0))
    normal[gain, resistance] = (to_rows @ (by_row * by_gain)).T
    normal[offset, resistance] = (to_rows @ by_row).T
    normal[resistance, resistance] = np.diag(to_rows @ (by_row * by_resistance).sum(axis=1))
    upper = np.triu(normal)
    normal = upper + np.triu(normal, 1).T
    right[gain] = (weights * by_gain * misfit).sum(axis=0)
    right[offset] = (weights * misfit).sum(axis=0)
    right[resistance] = to_rows @ (by_row * misfit).sum(axis=1)
    by_row = weights * by_electrode
    mixed = np.concatenate(
        [
            np.einsum("pln,ln->pl", weighted, by_electrode) @ to_rows.T,
            (to_rows @ (by_row * by_gain)).T,
            (to_rows @ by_row).T,
            np.diag(to_rows @ (by_row * by_resistance).sum(axis=1)),
        ]
    )
    own = to_rows @ (by_row * by_electrode).sum(axis=1) + operator.inexact**-2.0
    right -= mixed @ (to_rows @ (by_row * misfit).sum(axis=1) / own)
    normal -= (mixed / own) @ mixed.T
    _in_units(normal, right, slice(first + count, first + 2 * count), drive)
    return _without_contacts(fit, normal, right, free)


def _derivatives(prediction: Prediction, unknowns: Unknowns, grounded: np.ndarray):
    """Of the readings (.., L, n): by contacts (F, ..), sheet (J, ..), gain of their column,
    resistance of their row, and impedance of their row's electrode.

    Where the grounded electrode itself is read, it tells its resistance from its impedance.
    """
    ratio = prediction.ratio
    by_resistance = unknowns.gain * ratio / prediction.own[:, None]
    by_electrode = by_resistance.copy()
    by_electrode[np.arange(len(grounded)), grounded] = (
        -unknowns.gain[grounded] * unknowns.resistance[grounded] / prediction.own**2
    )
    return (
        prediction.contact_columns(),
        prediction.sheet_columns(),
        1 - ratio,
        by_resistance,
        by_electrode,
    )


def _in_units(normal, right, offset, drive):
    """From offsets in parts of the drive voltage to V."""
    normal[offset] /= drive
    normal[:, offset] /= drive
    right[offset] /= drive


def _without_contacts(fit, normal, right, free) -> Information:
    readings = fit.rows.count
    if not free:
        nothing = np.zeros((0, len(normal))), np.zeros(0)
        return Information(normal, right, *nothing, fit.chi_squared, readings)
    curvature, pull = contact_priors(fit)
    own = normal[:free, :free] + np.diag(curvature)
    scale = 1 / np.sqrt(own.diagonal())
    factor = cho_factor(own * scale[:, None] * scale)
    mixed, rest = normal[:free, free:], normal[free:, free:]
    back = scale[:, None] * cho_solve(factor, scale[:, None] * mixed)
    start = scale * cho_solve(factor, scale * (right[:free] + pull))
    return Information(
        rest - mixed.T @ back,
        right[free:] - mixed.T @ start,
        back,
        start,
        fit.chi_squared,
        readings,
    )
