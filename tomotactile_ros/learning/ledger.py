"""Touches that were learned from already: how often a touch counts.

Noise differs from frame to frame. What the model lacks (elements, patches, the shape of a finger)
does not: the same touch errs in the same way each time. Where the model's error has m times the
variance of the noise, k frames of one touch hold the information of

    k / (1 + k m)

frames without such errors, 1 / m at most, however long a load rests. What each frame adds is the
difference. A finger that has moved on by a part of the spacing, or presses clearly more or less,
errs differently and is another touch. Old touches fade, or a sensor that changes could never be
learned again.
"""

from __future__ import annotations

import numpy as np

from tomotactile_ros.estimation.touch import CONDUCTANCE, X, Y

# noise variances: share of what is left over that a touch in the same place shows again
_MODEL = 0.25
_APART = 0.2  # spacings from which on a touch is another one
_HARDER = 0.4  # of ln c, likewise
_FADING = 3600.0  # s in which what was counted falls to 1/e


class Ledger:
    """Touches that have been counted on a layout with spacing `pitch` (m)."""

    def __init__(self, pitch: float):
        self._pitch = pitch
        self._touches: list[list] = []  # contacts (k, 3) in units of difference, count, time

    def weight(self, contacts: np.ndarray, misfit: float, time: float = 0.0) -> float:
        """How much one more frame of `contacts` (k, 6) counts; `misfit` is its chi-squared a reading,
        `time` s."""
        model = max(misfit - 1.0, _MODEL)
        number = self._number(contacts, time)
        return _total(number + 1, model) - _total(number, model)

    def add(self, contacts: np.ndarray, time: float = 0.0) -> bool:
        """Count a frame; whether it is of a touch that had not been there."""
        found = self._find(contacts)
        if found is None:
            self._touches.append([self._key(contacts), 1.0, time])
            return True
        found[1] = found[1] * _faded(time - found[2]) + 1.0
        found[2] = max(time, found[2])
        return False

    @property
    def touches(self) -> int:
        """How many were counted, each in a place of its own."""
        return len(self._touches)

    def which(self, contacts: np.ndarray) -> int:
        """The number of the touch that a frame of `contacts` (k, 6) was counted for, from 0 on."""
        found = self._find(contacts)
        return next(i for i, touch in enumerate(self._touches) if touch is found)

    def _number(self, contacts, time):
        found = self._find(contacts)
        return 0.0 if found is None else found[1] * _faded(time - found[2])

    def _find(self, contacts):
        key = self._key(contacts)
        for touch in self._touches:
            if len(touch[0]) == len(key) and _same(touch[0], key):
                return touch
        return None

    def _key(self, contacts):
        units = np.array([self._pitch * _APART, self._pitch * _APART, _HARDER])
        return np.asarray(contacts)[:, [X, Y, CONDUCTANCE]] / units


def _same(first, second):
    difference = np.abs(first[:, None] - second).max(axis=2)
    return bool((difference.min(axis=0) < 1).all() and (difference.min(axis=1) < 1).all())


def _total(count, model):
    return count / (1 + count * model)


def _faded(seconds):
    return float(np.exp(-max(seconds, 0.0) / _FADING))
