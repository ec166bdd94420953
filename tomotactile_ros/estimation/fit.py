"""A point of the search: unknowns, what they predict, and what is left of the readings."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np

from tomotactile_ros.estimation.channels import Slopes
from tomotactile_ros.estimation.forward import Prediction, Unknowns
from tomotactile_ros.estimation.motion import predicted
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.estimation.touch import CONDUCTANCE, RADIUS, STRETCH


class Fit:
    """A point with its misfit.

    Attributes
    ----------
    unknowns, prediction; misfit (L, n) reading minus prediction; chi_squared of the readings; cost
        with the priors
    covariance (F, F) of the contacts' free parameters, all else marginal; None before `solve`
    steps, work : of the `solve` or `approach` that ended here, the number of steps and that of patches
        in all evaluations of the forward model; 0 before
    equations : the last ones of `solve`, None before
    promised : what one more contact would take off the cost to first order, as far as that was
        asked
    needed (k, 6) : its contacts as they were when the readings were last asked whether they need them
        all, and did; None: not asked
    """

    def __init__(
        self,
        operator: SheetOperator,
        unknowns: Unknowns,
        rows: Rows,
        prior: Prior,
        prediction: Prediction | None = None,
    ):
        self.operator, self.unknowns, self.rows, self.prior = operator, unknowns, rows, prior
        self.prediction = prediction or predicted(operator, unknowns, rows.grounded, rows.times)
        self.misfit = rows.readings - self.prediction.readings
        self.chi_squared = float((rows.weights * self.misfit**2).sum())
        self.cost = self.chi_squared + self._of_priors()
        self.covariance = self.equations = None
        self.steps, self.work, self.promised = 0, 0, 0.0
        self.needed: np.ndarray | None = None

    def weighed(self, rows: Rows) -> Fit:
        """The same point as one of `rows` that differ in their weights only."""
        other = copy(self)
        other.rows = rows
        other.chi_squared = float((rows.weights * self.misfit**2).sum())
        other.cost = self.cost - self.chi_squared + other.chi_squared
        return other

    def freed(self, free: np.ndarray) -> Fit:
        """The same point with other parameters of the contacts `free` (k, 6)."""
        other = copy(self)
        other.unknowns = replace(self.unknowns, free=free)
        other.prediction = self.prediction.freed(other.unknowns)
        other.covariance = None
        return other

    def of(self, unknowns: Unknowns, rows: Rows, prior: Prior) -> Fit:
        """The fit of `unknowns` and other rows: what is predicted is only worked out where it is not the
        same."""
        known = self.prediction
        same = self.unknowns.same_point(unknowns) and np.array_equal(
            self.rows.grounded, rows.grounded
        )
        return Fit(self.operator, unknowns, rows, prior, known.freed(unknowns) if same else None)

    def with_strengths(self, strengths: np.ndarray) -> Fit:
        """A fit of the same rows by the same contacts at rest, which conduct `strengths` (k,), S."""
        contacts = self.unknowns.contacts.copy()
        contacts[:, CONDUCTANCE] = np.log(strengths)
        return self.in_place(replace(self.unknowns, contacts=contacts))

    def in_place(self, unknowns: Unknowns) -> Fit:
        """The fit of the same rows at `unknowns` whose contacts rest and differ in their conductance
        only."""
        touches = self.prediction.touches.on(unknowns.sheet).stronger(unknowns.contacts)
        found = Prediction(self.operator, unknowns, self.rows.grounded, touches)
        return Fit(self.operator, unknowns, self.rows, self.prior, found)

    @property
    def of_sensor(self) -> float:
        """What the prior of the sensor takes of the cost."""
        apart = self.prior.apart(self.unknowns)
        return float(apart @ self.prior.pull(apart))

    def _of_priors(self) -> float:
        u, prior = self.unknowns, self.prior
        cost = self.of_sensor
        contacts = u.contacts
        if u.bond is not None:
            strengths = np.exp(contacts[:, CONDUCTANCE])
            return float(cost + strengths @ u.bond @ strengths)
        cost += (((contacts[:, RADIUS] - np.log(prior.radius)) / prior.spread) ** 2).sum()
        cost += ((contacts[:, STRETCH:] / prior.stretch) ** 2).sum()
        cost += ((u.rates / prior.rates) ** 2).sum()
        return float(cost)

    @property
    def doubt(self) -> float:
        """What a significant change of the cost is to be multiplied with: 1 where noise explains
        the misfit.

        What the model lacks makes all readings of an electrode err together; its excess counts once
        for each.
        """
        return self.doubt_after(0.0)

    def doubt_after(self, explained: float) -> float:
        """`doubt` if so much less of chi-squared were left over."""
        excess = self.chi_squared - explained - self.rows.count
        return 1.0 + max(excess, 0.0) / self.operator.count

    @property
    def slopes(self) -> Slopes:
        """Derivatives of the readings by the channels."""
        u, prediction = self.unknowns, self.prediction
        columns, rows = prediction.aside
        driven = (prediction.readings - u.offset) / u.gain
        in_columns = np.array([driven, np.ones_like(driven), *(u.gain * columns)])
        in_rows = u.gain * np.array([prediction.ratio / prediction.own[:, None], *rows])
        return Slopes(in_columns, in_rows, self.rows.grounded)
