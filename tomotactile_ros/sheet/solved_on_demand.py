"""A matrix between unknowns of a mesh, solved where it is first asked for and kept."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

_MOST = 3000  # unknowns at a time (72 MB)
_COLUMNS = 128  # solved at a time
_MANY = 0.2  # of all


class KeptGreen:
    """Blocks of a symmetric matrix (count, count).

    Parameters
    ----------
    solve : its columns for unit feeds (count, n).
    among : block (n, n) between chosen unknowns (n,), for less than their columns cost.
    known : (n, m) what is added to it between two lists of unknowns.
    """

    def __init__(
        self,
        solve: Callable[[np.ndarray], np.ndarray],
        among: Callable[[np.ndarray], np.ndarray],
        known: Callable[[np.ndarray, np.ndarray], np.ndarray],
        count: int,
    ):
        self._solve, self._among, self._known = solve, among, known
        self._place = np.full(count, -1)  # of an unknown in `_block`
        self._block = np.empty((0, 0))
        self._prepared = False

    def prepare(self, unknowns: np.ndarray) -> None:
        """Keep the distinct `unknowns` (n,), as many as are kept at a time.

        Where `_MANY` of those asked for later are others, these are taken to come and go: they are
        solved each time and not kept.
        """
        self._keep(unknowns[:_MOST])
        self._prepared = True

    def among(self, unknowns: np.ndarray) -> np.ndarray:
        """(n, n) between distinct `unknowns` (n,)."""
        return self.blocks(unknowns[None])[0]

    def blocks(self, unknowns: np.ndarray) -> np.ndarray:
        """(T, n, n) between those in each row of (T, n), which may repeat some."""
        wanted = np.zeros(len(self._place), bool)
        wanted[unknowns] = True
        wanted = np.flatnonzero(wanted)
        missing = np.count_nonzero(self._place[wanted] < 0)
        if self._prepared and missing > _MANY * len(wanted):
            block = self._among(wanted) + self._known(wanted, wanted)
            place = np.searchsorted(wanted, unknowns)
        else:
            self._keep(wanted)
            block, place = self._block, self._place[unknowns]
        return block.ravel().take((len(block) * place)[:, :, None] + place[:, None, :])

    def _keep(self, unknowns: np.ndarray) -> None:
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
            column = self._solve(feed)[together] + self._known(together, part)
            self._block[:new, first : first + len(part)] = column
        self._block[old:new, :old] = self._block[:old, old:new].T
        self._place[missing] = np.arange(old, new)
