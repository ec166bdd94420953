"""In which order electrodes are grounded, row after row.

**Jumping**: a touch that begins between two rows is to be known after as few rows as possible,
wherever it is. Successive rows tell most where they look from different sides, so that the next row
is the one farthest from those just taken: the electrode e with the largest

    min over the rows before of (distance from e to their electrode) x (how many rows ago)

(farthest-point order, Gonzalez 1985, with a memory that fades).

**Adaptive**: what a row tells of the place of a known contact grows towards the electrode that it
grounds, and two rows of the same electrode tell nearly the same. So most rows of a frame ground the
electrodes nearest to the contacts, each once, the contacts in turn; the others go on in jumping
order from frame to frame, so that all of the sheet is looked at from all sides.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

_DIGITS = 9  # of a score: choices that rounding alone tells apart are the first of them
_NEAR = 0.75  # of the rows of an adaptive frame, those that ground electrodes near contacts
_PART, _FEWEST = 4, 8  # electrodes to a row of an adaptive frame; rows at least


def spread(positions: np.ndarray, chosen: Sequence[int]) -> list[int]:
    """`chosen` electrodes, each far from where those before it are; positions (E, 2), m."""
    order, left = [chosen[0]], list(chosen[1:])
    while left:
        ago = np.arange(len(order), 0, -1)
        away = np.linalg.norm(positions[left][:, None] - positions[order], axis=2)
        nearest = (away * ago).min(axis=1)
        order.append(left.pop(int(np.argmax(np.round(nearest / nearest.max(), _DIGITS)))))
    return order


class AdaptiveOrder:
    """Frames that look at known contacts most often; positions (E, 2) of the electrodes, m.

    They have a quarter as many rows as there are electrodes, and 8 at least.
    """

    def __init__(self, positions: np.ndarray):
        self._positions = np.asarray(positions, float)
        electrodes = len(self._positions)
        self._rows = min(max(_FEWEST, electrodes // _PART), electrodes)
        self._jumping = spread(self._positions, range(electrodes))
        self._next = 0  # of the jumping order

    def frame(self, contacts: np.ndarray) -> tuple[int, ...]:
        """Electrodes to ground in the next frame, row after row, each once.

        contacts (k, 2) places, m, strongest first; without any all go on in jumping order
        """
        near = self._near(np.asarray(contacts, float).reshape(-1, 2))
        return self._mixed(near, self._others(near))

    def _near(self, contacts: np.ndarray) -> list[int]:
        """Those nearest to contacts, the contacts in turn."""
        if not len(contacts):
            return []
        away = np.linalg.norm(contacts[:, None] - self._positions, axis=2)
        ranks = np.argsort(away, axis=1).T.ravel().tolist()
        return list(dict.fromkeys(ranks))[: int(_NEAR * self._rows)]

    def _others(self, near: list[int]) -> list[int]:
        """Those that are due in jumping order."""
        found: list[int] = []
        while len(near) + len(found) < self._rows:
            electrode = self._jumping[self._next]
            self._next = (self._next + 1) % len(self._jumping)
            if electrode not in near and electrode not in found:
                found.append(electrode)
        return found

    def _mixed(self, near: list[int], others: list[int]) -> tuple[int, ...]:
        """Both, each evenly over the frame."""
        near = spread(self._positions, near) if near else near
        due = [(i + 0.5) / len(some) for some in (near, others) for i in range(len(some))]
        return tuple(electrode for _, electrode in sorted(zip(due, [*near, *others])))
