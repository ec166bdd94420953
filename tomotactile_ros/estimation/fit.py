"""A point of the search: unknowns, what they predict, and what is left of the readings."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np

from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.forward import Unknowns
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.prior import Prior
from tomotactile_ros.support.interrupt import check


class Fit:
    """A point with its misfit.

    `core` : where it is known already, of the same operator, rows and prior; then `unknowns` may be None

    Attributes
    ----------
    unknowns, prediction; misfit (L, n) reading minus prediction; chi_squared of the readings; cost
        with the priors
    covariance (F, F) of the contacts' free parameters, all else marginal; empty before `solve`
    steps, work : of the `solve` or `approach` that ended here, the number of steps and that of patches
        in all evaluations of the forward model; 0 before
    equations : the last ones of `solve`, None before
    promised : what one more contact would take off the cost to first order, as far as that was
        asked
    lasting : a fit of the next rows begins with this one: the same, also with cells that conduct nothing by these rows
    needed (k, 6) : its contacts as they were when the readings were last asked whether they need them
        all, and did; None: not asked
    begun : of one of cells where it was found from, by which its evidence is counted; None: of others
    """

    def __init__(
        self,
        operator: SheetOperator,
        unknowns: Unknowns | None,
        rows: Rows,
        prior: Prior,
        prediction: Any = None,
        core: Any = None,
    ):
        check()
        self.operator, self.rows, self.prior = operator, rows, prior
        if core is None:
            core = compiled.Fit(operator.core, unknowns, rows.core, prior.core, prediction)
        self.core = core
        self.unknowns = unknowns or Unknowns(**core.unknowns)
        self.chi_squared: float = core.chi_squared
        self.cost: float = core.cost
        self.covariance = np.empty((0, 0))
        self.equations: Any = None
        self.steps, self.work, self.promised = 0, 0.0, 0.0
        self._lasting: Fit | None = None
        self.needed: np.ndarray | None = None
        self.begun: Fit | None = None

    @property
    def lasting(self) -> Fit:
        return self._lasting or self

    @lasting.setter
    def lasting(self, other: Fit) -> None:
        self._lasting = None if other is self else other

    @cached_property
    def prediction(self) -> Any:
        return self.core.prediction

    @cached_property
    def misfit(self) -> np.ndarray:
        return self.core.misfit

    def weighed(self, rows: Rows) -> Fit:
        """The same point as one of `rows` that differ in their weights only."""
        weighed = self.core.weighed(rows.core)
        return Fit(self.operator, self.unknowns, rows, self.prior, core=weighed)

    def of(self, unknowns: Unknowns, rows: Rows, prior: Prior) -> Fit:
        """The fit of `unknowns` and other rows: what is predicted is only worked out where it is not the
        same."""
        same = self.unknowns.same_point(unknowns) and np.array_equal(
            self.rows.grounded, rows.grounded
        )
        return Fit(self.operator, unknowns, rows, prior, self.prediction if same else None)

    def at(self, unknowns: Unknowns) -> Fit:
        """The fit of the same rows at other `unknowns`."""
        return Fit(self.operator, unknowns, self.rows, self.prior, core=self.core.at(unknowns))

    @property
    def of_sensor(self) -> float:
        """What the prior of the sensor takes of the cost."""
        return self.core.of_sensor

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
    def slopes(self) -> Any:
        """Derivatives of the readings by the channels: in_columns (4, L, n), in_rows (3, L, n), and what
        follows of them (`core/include/tomotactile/channels.hpp`)."""
        return self.core.slopes
