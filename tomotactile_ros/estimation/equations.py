"""Normal equations at a fit (`core/include/tomotactile/equations.hpp` has the formulas).

`Equations` are what they have whatever the readings are: normal, inverse (F + J, F + J) of contacts and
sheet, channels marginal; by_ways (F, k) and response(misfits) (F, m) how contacts answer; score(fit,
free), unevenness(fit).
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.fit import Fit
from tomotactile_ros.estimation.forward import Unknowns

Equations: Any = compiled.Equations
REACH, REACH_STRENGTH = compiled.REACH, compiled.REACH_STRENGTH
SIMILAR, FIRST_DAMPING = compiled.SIMILAR, compiled.FIRST_DAMPING
# spacings that contacts move before it is asked anew whether they are needed, and which are one
SAME = 0.1


def similar(
    contacts: np.ndarray, others: np.ndarray, pitch: float, within: float = SIMILAR
) -> bool:
    """Whether contacts (k, 6) are nearly the same as others, one by one."""
    return compiled.similar(contacts, others, pitch, within)


def contact_priors(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """What the priors of the contacts' free parameters and rates add to the normal matrix, (F, F), and
    to its right side, (F,)."""
    return fit.core.contact_priors


class Contacts:
    """Normal equations of the contacts alone at a fit, the sensor as it is there; `step(damping)`
    solves them.

    Attributes
    ----------
    free : number of the contacts' free parameters; normal (P, P), right (P,) of all parameters
    beside : what all that is not a parameter here takes off the cost
    promise : what an undamped step takes off the cost, to first order
    promised, whole : of the last step: how much the cost should fall by the linear model; whether
        the step is hardly damped and not limited
    """

    def __init__(self, fit: Fit):
        self._take(fit, compiled.Linear.of_contacts(fit.core))

    def _take(self, fit: Fit, core: Any) -> None:
        self.fit, self._core = fit, core
        self.free: int = core.free
        self.normal: np.ndarray = core.normal
        self.right: np.ndarray = core.right
        self.beside: float = core.beside

    def step(self, damping: float) -> Unknowns:
        """Where the damped step leads."""
        unknowns, self.promised, self.whole = self._core.step(damping)
        return Unknowns(**unknowns)

    def after(self, step: np.ndarray) -> tuple[Unknowns, float]:
        """Where a `step` (P,) leads, as much of it as one linearisation holds for, and how many times as long it is."""
        unknowns, longer = self._core.after(step)
        return Unknowns(**unknowns), longer

    @property
    def promise(self) -> float:
        return self._core.promise


class Linear(Contacts):
    """The same of contacts and sheet, channels eliminated; `known` : equations of a fit nearby, of which all is taken
    where they serve. `anew` : only what does not depend on contacts; False: all of the same parameters wherever they are.

    equations : all of them but the right side
    """

    def __init__(self, fit: Fit, known: Any = None, anew: bool | None = None):
        self._take(fit, compiled.Linear.of_all(fit.core, known, anew))
        self.equations: Any = self._core.equations

    def covariance(self) -> np.ndarray:
        """(F, F) of the contacts' free parameters."""
        return self._core.covariance()
