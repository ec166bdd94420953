"""A disc that covers an electrode in part, as one patch.

What lies on the electrode feeds it through 1/g alone, the rest through the sheet as well, so that current
prefers the electrode. With f the part of the area on the electrode, H the mean share of the rest, D the
mean impedance among it and g the conductance of the whole, the shares of the disc are

    w e + (1 - w) H,    w : 1 - w  =  f : (1 - f) / (1 + (1 - f) g D)

with e the electrode. f and H come from patches, as in `touch`; D, that of a disc as far from an electrode
amid the sheet, is worked out once for each step of the distance.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from tomotactile_ros.estimation.disc import unit_patches
from tomotactile_ros.estimation.induced import RIM
from tomotactile_ros.estimation.operator import SheetOperator
from tomotactile_ros.estimation.touch import Touches, part_beyond

_ACROSS = 6  # patches to the width of a disc
_STEPS = 16  # to a spacing: distances from the electrode at which D is worked out
_ALIKE = 0.1  # of ln a: D is that of the next tenth
_TURNED = 0.4  # radians from x: the way from the electrode there, along no axis of a grid
_LEAST = 1e-3  # of the area of a disc: less beside the electrode is nothing
_KEPT = 256  # distances and radii


@dataclass(frozen=True)
class Covered:
    """What of a disc lies on an electrode.

    electrode : number, of those in use
    part : f; slopes (2,) its change with the place, 1/m; among : D, ohm
    """

    electrode: int
    part: float
    slopes: np.ndarray
    among: float

    def weighed(self, share: np.ndarray, slopes: np.ndarray, off: np.ndarray, strength: float):
        """Shares (n,) of the disc and their slopes (2, n), 1/m, with those of what lies beside the
        electrode; `off` (2,) as far, m, from where this is of, ln c `strength`."""
        on = min(max(self.part + float(off @ self.slopes), 0.0), 1.0)
        way = max(np.exp(-strength) - (1 - on) ** 2 * self.among, 1e-3 * np.exp(-strength))  # 1/g
        rest = (1 - on) / (1 + (1 - on) * self.among / way)
        most = on + rest
        own = on / most
        by_part = (rest + on * rest**2 / max(1 - on, 1e-9) ** 2) / most**2
        bent = by_part * self.slopes
        found = (1 - own) * share
        found[self.electrode] += own
        steep = (1 - own) * slopes - np.outer(bent, share)
        steep[:, self.electrode] += bent
        return found, steep


class Rims:
    """Of the electrodes of an operator; made ready for discs of `radius`, m."""

    def __init__(self, operator: SheetOperator, radius: float):
        self._operator, self._radius = operator, operator.layout.radius
        self._centres = operator.layout.positions[operator.used]
        self._amid = int(np.hypot(*self._centres.T).argmin())
        self._step = operator.pitch / _STEPS
        self._known: dict[tuple[int, int], float] = {}
        for step in range(int((radius + self._radius) / self._step) + 2):
            self._among_at(step, self._class(np.log(radius)))

    def covered(self, x: float, y: float, size: float):
        """What a disc with ln a `size` covers of an electrode, and of what lies beside it the shares (n,)
        and their slopes (2, n), 1/m, on an even sheet; None where it reaches none or is on it whole."""
        apart = np.array([x, y]) - self._centres
        squared = np.einsum("ed,ed->e", apart, apart)
        which = int(squared.argmin())
        distance, radius = float(np.sqrt(squared[which])), float(np.exp(size))
        if not self._radius - radius < distance < self._radius + radius:
            return None
        unit, area, width = unit_patches(_ACROSS)
        places = np.array([x, y]) + radius * unit
        way = places - self._centres[which]
        depth = np.hypot(*way.T)
        off, rises = part_beyond((depth - self._radius) / (radius * width))
        steep = (area * rises / (radius * width * np.maximum(depth, 1e-12)))[:, None] * way
        weight = off * area
        if weight.sum() < _LEAST:
            return None
        covered = Covered(
            which, 1 - float(weight.sum()), -steep.sum(axis=0), self._among(distance, size)
        )
        return covered, *self._mean_shares(places, weight, steep)

    def _mean_shares(self, places: np.ndarray, weight: np.ndarray, steep: np.ndarray):
        """Shares (n,) and slopes (2, n), 1/m, of patches at `places` (P, 2), those on an electrode moved to its
        rim, with a `weight` (P,) that changes by `steep` (P, 2), 1/m, as they move."""
        there = weight > 0
        weight, steep = weight[there], steep[there]
        beside, distance, _, way, on = self._operator.placed(places[there])
        potentials, slopes = self._operator.potentials(beside)
        if on.any():  # these move along the rim
            out = way[on].T[..., None]
            along = slopes[:, on] - out * (out * slopes[:, on]).sum(axis=0)
            least = 0.1 * self._radius  # in the middle they do not know which way to move
            slopes[:, on] = along * (RIM * self._radius / np.maximum(distance[on], least))[:, None]
        total, inverse = weight.sum(), self._operator.bordered[:-1]
        mean = weight @ potentials / total
        changes = (weight @ slopes + steep.T @ (potentials - mean)) / total
        return mean @ inverse[:, :-1].T + inverse[:, -1], changes @ inverse[:, :-1].T

    def _among(self, distance: float, size: float) -> float:
        """Mean D, ohm, of what lies beside an electrode of a disc `distance`, m, from it."""
        steps = distance / self._step
        low, sized = int(steps), self._class(size)
        beyond = steps - low
        return (1 - beyond) * self._among_at(low, sized) + beyond * self._among_at(low + 1, sized)

    def _class(self, size: float) -> int:
        return round(size / _ALIKE)

    def _among_at(self, step: int, sized: int) -> float:
        """The same so many steps from it, of a disc of a class of sizes."""
        found = self._known.get((step, sized))
        if found is None:
            if len(self._known) >= _KEPT:
                self._known.clear()
            turned = np.array([np.cos(_TURNED), np.sin(_TURNED)])
            place = self._centres[self._amid] + step * self._step * turned
            disc = np.array([[*place, 0.0, sized * _ALIKE, 0.0, 0.0]])
            touches = Touches(self._operator, disc, (_ACROSS,), np.zeros(self._operator.modes))
            weight = touches.weight / max(float(touches.weight.sum()), 1e-12)
            found = self._known[step, sized] = float(weight @ touches.impedance @ weight)
        return found
