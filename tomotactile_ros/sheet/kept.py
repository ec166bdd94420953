"""The Green function between unknowns of a mesh, solved where it is first asked for and kept."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_MOST = 3000  # unknowns at a time (72 MB)
_COLUMNS = 128  # solved at a time


class KeptGreen:
    """Blocks of a symmetric matrix (count, count); `solve(feed)` gives columns for unit feeds."""

    def __init__(self, solve: Callable[[np.ndarray], np.ndarray], count: int):
        self._solve = solve
        self._place = np.full(count, -1)  # of an unknown in `_block`
        self._block = np.empty((0, 0))

    def prepare(self, unknowns: np.ndarray) -> None:
        """Solve for as many of the distinct `unknowns` (n,) as are kept at a time."""
        self._keep(unknowns[:_MOST])

    def among(self, unknowns: np.ndarray) -> np.ndarray:
        """(n, n) between distinct `unknowns` (n,)."""
        self._keep(unknowns)
        place = self._place[unknowns]
        return self._block[np.ix_(place, place)]

    def _keep(self, unknowns):
        missing = unknowns[self._place[unknowns] < 0]
        if not len(missing):
            return
        known = np.flatnonzero(self._place >= 0)
        if len(known) + len(missing) > _MOST:
            self._place[known] = -1
            known, missing = known[:0], unknowns
        together = np.concatenate([known[np.argsort(self._place[known])], missing])
        old, new = len(known), len(together)
        if new > len(self._block):
            larger = np.empty((2 * new, 2 * new))
            larger[:old, :old] = self._block[:old, :old]
            self._block = larger
        for first in range(old, new, _COLUMNS):
            part = together[first : first + _COLUMNS]
            feed = np.zeros((len(self._place), len(part)))
            feed[part, np.arange(len(part))] = 1.0
            self._block[:new, first : first + len(part)] = self._solve(feed)[together]
        self._block[old:new, :old] = self._block[:old, old:new].T
        self._place[missing] = np.arange(old, new)
