"""The first look at a frame (`core/include/tomotactile/first_look.hpp`): which points are contacts, and
which are parts of one."""

from __future__ import annotations

import numpy as np
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import pdist

from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.observation import Rows
from tomotactile_ros.estimation.operator import SheetOperator

# of the squares: what points leave of small contacts, all together: 3e-4 to 3e-3 in part `crowd`,
# 1e-2 of wide ones
_LEFT = 3e-3
_DISTINCT = 0.7  # spacings between points that are contacts each, not parts of one
_ADJACENT = 2.2  # pixels: those nearer are taken for one contact at first
_WEAK = 0.03  # of the strongest; weaker ones wait until the strong ones are fitted
# of the strongest: what an uneven sheet looks like beside a contact is weaker; what is weaker than
# that is found beside those that are fitted
_STRONG = 0.3

Seen = list[tuple[np.ndarray, float]]  # place (2,), m, and conductance, S, strongest first


class FirstLook:
    """Contacts of one frame.

    Parameters
    ----------
    pixels (K, 2) : places, m, about `side` m apart; share (n, K) : H there
    rows : without what is known of gains and offsets (`Rows.corrected`)
    gain (n,), offset (n,) : standard deviations of what is not; offsets in parts of V0
    """

    def __init__(
        self,
        operator: SheetOperator,
        pixels: np.ndarray,
        share: np.ndarray,
        side: float,
        rows: Rows,
        gain: np.ndarray,
        offset: np.ndarray,
    ):
        self._pitch, self._side = operator.pitch, side
        self._core = compiled.FirstLook(
            operator.core, operator.expected, rows.core, gain, offset, pixels, share, side
        )
        self._slid: tuple[float, tuple] | None = None  # the last answer of `_points`

    def points(self, radius: float) -> Seen | None:
        """Points that explain all but what these leave of small contacts of `radius`, m; None where no
        few of them do."""
        places, strengths, left = self._points(radius)
        few = len(places) <= compiled.FEW
        if not len(places) or (few and left > _LEFT * self._core.total):
            return None
        points = self._gathered(places, strengths)
        return points if self._are_distinct(points) else None

    def strongest(self, radius: float) -> Seen:
        """The same of the strongest points that explain most, whatever they leave: an uneven sheet
        leaves more than small contacts do, and looks like weak ones or like a second one beside a
        single strong one. Empty where many are strong, or some of several near each other."""
        places, strengths, _ = self._points(radius)
        points = self._gathered(places, strengths)
        strong = [each for each in points if each[1] > _STRONG * points[0][1]]
        if len(strong) < compiled.FEW and self._are_distinct(strong):
            return strong
        single = not any(self._are_distinct([strong[0], each]) for each in strong[1:])
        return strong[:1] if single else []

    def contacts(self) -> Seen:
        """Contacts of any form, which together explain most, in parts about a spacing wide."""
        places, strengths, _ = self._core.contacts()
        return self._gathered(places, strengths)

    def image(self, share: np.ndarray) -> np.ndarray:
        """(K,) conductances, S, none below 0, with which contacts of `share` (n, K) explain most
        together: a linear image."""
        return self._core.image(share)

    def _points(self, radius: float) -> tuple[np.ndarray, np.ndarray, float]:
        if self._slid is None or self._slid[0] != radius:
            self._slid = radius, self._core.points(radius)
        return self._slid[1]

    def _are_distinct(self, points: Seen) -> bool:
        if len(points) < 2:
            return True
        apart = pdist(np.array([place for place, _ in points]))
        return bool(apart.min() > _DISTINCT * self._pitch)

    def _gathered(self, places: np.ndarray, strengths: np.ndarray) -> Seen:
        kept = strengths > _WEAK * strengths.max(initial=0.0)
        places, strengths = places[kept], strengths[kept]
        if len(places) > 1:
            tree = linkage(places, "single")
            group = fcluster(tree, _ADJACENT * self._side, "distance") - 1
        else:
            group = np.zeros(len(places), int)
        sums = np.bincount(group, strengths)
        found = []
        for each in np.argsort(-sums):
            of = group == each
            weights = strengths[of] / sums[each]
            found.append((weights @ places[of], float(sums[each])))
        return found
