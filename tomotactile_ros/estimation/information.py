"""What one frame says of the sensor, its contacts marginal.

At a fit with contacts c and sensor theta the readings are linear, v = f + J_c dc + J_theta dtheta.
Contacts enter anew in each frame, with the prior that the estimator gives them; eliminated (Schur
complement) they leave the information

    L = J_theta^T W J_theta - J_theta^T W J_c (J_c^T W J_c + P_c^-1)^-1 J_c^T W J_theta

and the same of the gradient. A resting load is in c: it says nothing but what all else agrees with.
Frames add up (batch Gauss-Newton with contacts eliminated, as bundle adjustment does with cameras;
Triggs et al. 2000) or follow each other (information filter). Channels touch one column or one row
of the readings each: no dense derivative is formed. What electrodes as modelled err in this frame
(`SheetOperator.inexact`) is eliminated likewise, and how the pressure under discs differs from an even
one (`pressure_modes`).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import block_diag, cho_factor, cho_solve

from tomotactile_ros.estimation.equations import contact_priors
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.pressure_modes import pressure_modes
from tomotactile_ros.estimation.prior import Prior


@dataclass(frozen=True, eq=False)
class Information:
    """Of one frame, in the units of `SensorState`, of the electrodes in use only.

    matrix (d, d), vector (d,): information and gradient at the point where it was taken
    chi_squared : of the fit, once contacts have followed; readings : of the fit
    """

    matrix: np.ndarray
    vector: np.ndarray
    chi_squared: float
    readings: int


def information(
    operator: SheetOperator,
    unknowns: Unknowns,
    rows: Rows,
    prior: Prior,
    drive: float,
    uneven: float = 0.0,
    more: np.ndarray | None = None,
) -> Information:
    """Information of `rows` at `unknowns`; `prior` of contacts is used, that of the sensor is not.

    uneven : standard deviation of each of the `pressure_modes` of discs, 0: discs are even
    more : (m, L, n) derivatives of the readings by what else the sheet may be; they follow its coefficients
    """
    fit = Fit(operator, unknowns, rows, prior)
    prediction, weights, misfit = fit.prediction, rows.weights, fit.misfit
    contacts, sheet = prediction.contact_columns(), prediction.sheet_columns()
    if uneven and len(unknowns.contacts) and unknowns.bond is None:
        contacts = np.concatenate(
            [
                contacts,
                uneven * prediction.pressure_columns([pressure_modes(a) for a in unknowns.across]),
            ]
        )
    slopes = fit.slopes.beside(_by_electrode(fit))
    if more is not None:
        sheet = np.concatenate([sheet, more])
    free, modes, count = len(contacts), len(sheet), operator.count
    columns = np.concatenate([contacts, sheet])
    first = free + modes
    weighted = columns * weights
    flat = weighted.reshape(first, -1)
    between, sensor = slopes.couplings(weighted), slopes.normal(weights)
    sensor[-count:, -count:] += np.diag(operator.inexact**-2.0)
    normal = np.block([[flat @ columns.reshape(first, -1).T, between], [between.T, sensor]])
    right = np.concatenate([flat @ misfit.ravel(), slopes.couplings((weights * misfit)[None])[0]])
    mixed, own = normal[:-count, -count:], normal[-count:, -count:].diagonal()
    right = right[:-count] - mixed @ (right[-count:] / own)
    normal = normal[:-count, :-count] - (mixed / own) @ mixed.T
    _in_units(normal, right, slice(first + count, first + 2 * count), drive)
    return _without_contacts(fit, normal, right, free)


def _by_electrode(fit: Fit) -> np.ndarray:
    """(L, n) derivatives of the readings by the impedance of their row's electrode, 1/ohm.

    Where the grounded electrode itself is read, it tells its resistance from its impedance.
    """
    prediction, u, grounded = fit.prediction, fit.unknowns, fit.rows.grounded
    out = u.gain * prediction.ratio / prediction.own[:, None]
    out[np.arange(len(grounded)), grounded] = (
        -u.gain[grounded] * u.resistance[grounded] / prediction.own**2
    )
    return out


def _in_units(normal: np.ndarray, right: np.ndarray, offset: slice, drive: float) -> None:
    """From offsets in parts of the drive voltage to V."""
    normal[offset] /= drive
    normal[:, offset] /= drive
    right[offset] /= drive


def _without_contacts(fit: Fit, normal: np.ndarray, right: np.ndarray, free: int) -> Information:
    readings = fit.rows.count
    if not free:
        return Information(normal, right, fit.chi_squared, readings)
    curvature, pull = contact_priors(fit)
    modes = free - len(pull)
    curvature = block_diag(curvature, np.eye(modes))
    pull = np.concatenate([pull, np.zeros(modes)])
    own = normal[:free, :free] + curvature
    scale = 1 / np.sqrt(own.diagonal())
    factor = cho_factor(own * scale[:, None] * scale)
    mixed, rest = normal[:free, free:], normal[free:, free:]
    back = scale[:, None] * cho_solve(factor, scale[:, None] * mixed)
    start = scale * cho_solve(factor, scale * (right[:free] + pull))
    follows = scale * cho_solve(factor, scale * right[:free])
    return Information(
        rest - mixed.T @ back,
        right[free:] - mixed.T @ start,
        fit.chi_squared - float(right[:free] @ follows),
        readings,
    )
