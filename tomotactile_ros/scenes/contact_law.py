"""The law of the contact between the layers: conductance per area against pressure, and its memory.

Without memory it is the power law of Holm, g = c p^m. Hysteresis and creep make the same law see
another pressure than the true one,

    q(t) = H[p](t) + C[p](t)        g = c q^m,    g = 0 where p = 0

which is the operator of Krejci and Kuhnen (Inverse control of systems with hysteresis and creep,
IEE Proc. Control Theory Appl. 148, 2001, 185-192): a sum of plays and of first-order lags. The
plays have envelopes as in the generalised Prandtl-Ishlinskii model (Al Janaideh, Rakheja and Su,
IEEE/ASME Trans. Mechatronics 16, 2011, 734-744), here proportional to the pressure: p on the way
up, (1 + h) p on the way down. So the law without memory is the curve of a first loading, nothing is
left where nothing presses, and loops of any size are alike: the memory of a contact whose pressure
keeps its form is that of its force.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomotactile_ros.scenes.force_signal import Signal
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

_PLAYS = 8


@dataclass(frozen=True)
class Hysteresis:
    """Mean of 8 plays: the way down lies up to ``relative`` above the way up.

    The plays' widths are h = 2 relative (i - 1/2) / 8. Cycles from 0 to P and back enclose
    P^2 / 2 times the mean of h / (1 + h).
    """

    relative: float

    def __post_init__(self):
        checks.not_negative(self.relative, "relative", "number")

    @property
    def widths(self) -> np.ndarray:
        """(8,) h of each play."""
        return 2 * self.relative * (np.arange(_PLAYS) + 0.5) / _PLAYS

    def response(self, turns: list[float]) -> float:
        """Mean of the plays after a pressure has gone through ``turns``, in any unit."""
        state, widest = np.zeros(_PLAYS), 1 + self.widths
        for pressure in turns:
            state = np.maximum(pressure, np.minimum(widest * pressure, state))
        return float(state.mean())


@dataclass(frozen=True)
class Creep:
    """Under constant pressure the response grows by the part ``relative``, with ``times`` (s).

    Each time constant has an equal share: C = relative mean(z_j), z_j' = (p - z_j) / times_j.
    """

    relative: float
    times: tuple[float, ...]

    def __post_init__(self):
        checks.not_negative(self.relative, "relative", "number")
        object.__setattr__(self, "times", tuple(self.times))
        if not self.times:
            raise InputError("times: is empty, at least one time constant in s is needed")
        for i, tau in enumerate(self.times):
            checks.positive(tau, f"times[{i}]", "time in s")

    def response(self, signal: Signal, t: float) -> float:
        """What the lags add at the time ``t`` (s) of a signal."""
        return self.relative * sum(signal.lag(t, tau) for tau in self.times) / len(self.times)


@dataclass(frozen=True)
class ContactLaw:
    """Contact conductance per area against pressure, g = c p^m (Holm).

    Both end at `checks.LARGEST`. `conductance` and `pressure` are the law without memory.

    Parameters
    ----------
    coefficient : c, in S/m² per Pa^m.
    exponent : m.
    hysteresis, creep : what of the past the contact remembers; None: nothing.
    """

    coefficient: float
    exponent: float
    hysteresis: Hysteresis | None = None
    creep: Creep | None = None

    def __post_init__(self):
        checks.positive(self.coefficient, "coefficient", "number")
        checks.positive(self.exponent, "exponent", "number")

    @property
    def remembers(self) -> bool:
        """Whether the past matters."""
        return any(part is not None and part.relative > 0 for part in (self.hysteresis, self.creep))

    def felt(self, signal: Signal, t: float) -> float:
        """The pressure that the law sees at the time ``t`` (s) of a signal, in its unit."""
        now = signal.value(t)
        if now <= 0:
            return 0.0
        if self.hysteresis is not None:
            now = self.hysteresis.response(signal.turns(t))
        return now + (self.creep.response(signal, t) if self.creep is not None else 0.0)

    def conductance(self, pressure: np.ndarray | float) -> np.ndarray:
        """g in S/m² of a pressure in Pa; 0 where the pressure is not above 0."""
        with np.errstate(over="ignore"):
            g = self.coefficient * np.maximum(pressure, 0.0) ** self.exponent
        return np.minimum(g, checks.LARGEST)

    def pressure(self, conductance: np.ndarray | float) -> np.ndarray | float:
        """Pressure in Pa that belongs to g in S/m²; 0 where g is not above 0."""
        if isinstance(conductance, float):  # rows ask a thousand times a second
            return self._pressure(conductance)
        with np.errstate(over="ignore"):
            p = (np.maximum(conductance, 0.0) / self.coefficient) ** (1 / self.exponent)
        return np.minimum(p, checks.LARGEST)

    def _pressure(self, conductance: float) -> float:
        try:
            p = (max(conductance, 0.0) / self.coefficient) ** (1 / self.exponent)
        except OverflowError:
            return checks.LARGEST
        return min(p, checks.LARGEST)
