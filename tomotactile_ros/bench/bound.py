"""The Cramer-Rao bound of the places of contacts: what no estimate is better than.

The bound is that of the estimator's own forward model at the true places, radii and conductances of
all contacts of a frame, with sheet and channels unknown as it expects them before any frame (Fisher
information with priors; Van Trees 1968): root of the trace of the covariance of x and y. An
efficient estimate has a median error of 0.83 times that (a normal distribution in the plane). What
the bound leaves out is what the model errs, a sheet that is more uneven than expected, and what the
rim of the sheet cuts off a contact.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from tomotactile_ros.bench.trials import DRIVE, LAW, NOISE
from tomotactile_ros.estimation.arrangement import resting
from tomotactile_ros.estimation.equations import Linear
from tomotactile_ros.estimation.estimator import Estimator
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import Prediction
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.touch import CONDUCTANCE, PARAMETERS, Touches, patches_for
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.reconstruction import Settings

_DISC = np.array([True] * 4 + [False] * 2)  # what is unknown of a contact that is known to be round


class Bounds:
    """Of discs on an even sheet of one layout, in a frame that shows one state."""

    def __init__(self, layout: Layout):
        used = tuple(range(layout.electrodes))
        radius = Settings(noise=NOISE).contact_radius
        estimator = Estimator(layout, noise=NOISE, law=LAW, radius=radius)
        self._operator, self._prior = estimator.sensor_of(used, DRIVE)

    def places(self, truth: Sequence[dict]) -> np.ndarray:
        """(n,) m, of true contacts, see `reference_cases.truth`."""
        operator = self._operator
        contacts = np.zeros((len(truth), PARAMETERS))
        for contact, each in zip(contacts, truth, strict=True):
            contact[:4] = each["x"], each["y"], 0.0, np.log(each["radius"])
        across = tuple(patches_for(each["radius"], operator.pitch) for each in truth)
        touches = Touches(operator, contacts, across, np.zeros(operator.modes))
        resistances = np.array([1 / each["conductance"] for each in truth])
        contacts[:, CONDUCTANCE] = -np.log(resistances + touches.mean)
        free = np.tile(_DISC, (len(truth), 1))
        unknowns = resting(operator, self._prior).with_contacts(contacts, across, free)
        grounded = np.arange(operator.count)
        exact = Prediction(operator, unknowns, grounded, touches.stronger(contacts))
        weights = np.full(exact.readings.shape, (DRIVE / NOISE) ** 2)
        np.fill_diagonal(weights, 0.0)
        fit = Fit(operator, unknowns, Rows(exact.readings, weights, grounded), self._prior, exact)
        variances = np.diagonal(Linear(fit).covariance())[: 4 * len(truth)].reshape(-1, 4)
        return np.sqrt(variances[:, :2].sum(axis=1))
