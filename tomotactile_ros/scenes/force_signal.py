"""A force in the course of time, in parts of its nominal value, piece by piece.

Each piece is a + b s + A sin(w s), s since its beginning. So what a memory needs of the past
is known without steps in time: the turning points (for hysteresis) and the exact answer of a
first-order lag, z' = (f - z) / tau (for creep).
"""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Piece:
    """``offset + slope s + amplitude sin(rate s)`` for ``duration`` s."""

    duration: float
    offset: float = 0.0
    slope: float = 0.0
    amplitude: float = 0.0
    rate: float = 0.0  # rad/s

    def value(self, s: float) -> float:
        """At ``s`` seconds after the beginning of the piece."""
        wave = self.amplitude * math.sin(self.rate * s) if self.amplitude else 0.0
        return self.offset + self.slope * s + wave

    def turns(self, s: float) -> list[float]:
        """Values at the beginning, at the extremes of the wave until ``s``, and at ``s``."""
        found = [self.value(0.0)]
        if self.amplitude:
            half = math.pi / self.rate
            at = 0.5 * half
            while at < s:
                found.append(self.value(at))
                at += half
        return [*found, self.value(s)]

    def lag(self, s: float, tau: float, z: float) -> float:
        """The lag's state at ``s`` if it was ``z`` at the beginning."""
        return self._steady(s, tau) + (z - self._steady(0.0, tau)) * math.exp(-s / tau)

    def _steady(self, s, tau):
        """The lag's answer once its beginning is forgotten."""
        answer = self.offset + self.slope * (s - tau)
        if self.amplitude:
            angle, slow = self.rate * s, self.rate * tau
            answer += self.amplitude * (math.sin(angle) - slow * math.cos(angle)) / (1 + slow**2)
        return answer


@dataclass(frozen=True)
class Signal:
    """Pieces one after the other, from time 0 on; before, the value is 0.

    Parameters
    ----------
    pieces : their durations, s, cover all times that are asked for, or one period.
    period : s, after which they begin anew; None: never.
    """

    pieces: tuple[Piece, ...]
    period: float | None = None

    def value(self, t: float) -> float:
        """At the time ``t`` (s)."""
        piece, s = self._until(self._folded(t)[1])[-1]
        return piece.value(s)

    def turns(self, t: float) -> list[float]:
        """Values between which the signal went up or down without a turn, until ``t`` (s).

        Of whole periods only one is told: a hysteresis that forgets what was exceeded since (it
        "wipes out") is the same after one as after many.
        """
        periods, t = self._folded(t)
        found = [0.0]
        for end in [self.period] * min(periods, 1) + [t]:
            for piece, s in self._until(end):
                found += piece.turns(s)
        return found

    def lag(self, t: float, tau: float) -> float:
        """State at ``t`` (s) of a lag with the time constant ``tau`` (s), at rest at time 0."""
        periods, t = self._folded(t)
        z = 0.0
        if self.period is not None and periods:
            kept = math.exp(-self.period / tau)  # of a state, after one period
            z = self._lag(self.period, tau, 0.0) * _geometric(kept, periods)
        return self._lag(t, tau, z)

    def _lag(self, end, tau, z):
        for piece, s in self._until(end):
            z = piece.lag(s, tau, z)
        return z

    def _folded(self, t):
        """Number of whole periods before ``t``, and the time since the last of them."""
        if self.period is None:
            return 0, t
        periods, rest = divmod(t, self.period)
        return int(periods), rest

    def _until(self, end):
        """The pieces that have begun by ``end``, each with the time spent in it."""
        passed = []
        for piece in self.pieces:
            passed.append((piece, min(piece.duration, end)))
            end -= piece.duration
            if end < 0:
                break
        return passed


def _geometric(ratio, count):
    """1 + ratio + ... + ratio^(count - 1)."""
    return count if ratio == 1.0 else (1 - ratio**count) / (1 - ratio)
