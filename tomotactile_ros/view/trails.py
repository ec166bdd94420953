"""Where contacts have been of late, for pictures that show how they move.

A trail belongs to the id of a contact, which is the same as long as the contact lasts. Contacts
without an id, which nobody follows, have none.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

METRES_PER_NEWTON = 0.01  # length of an arrow
LASTING = 1.0  # s that a place stays in a picture
_SPACING = 0.001  # m between two places that are kept


class Trails:
    """Places of the last `LASTING` s of each contact, those that have ended among them."""

    def __init__(self) -> None:
        self._places: dict[int, deque[tuple[float, np.ndarray]]] = {}

    def add(self, contacts: Sequence, places: np.ndarray, now: float) -> None:
        """Take in where contacts are now.

        Parameters
        ----------
        contacts : with their ids.
        places : (N, 2) or (N, 3) m, of these contacts.
        now : s, on any clock; where it goes back, what was before is forgotten.
        """
        for contact, place in zip(contacts, places, strict=True):
            if not contact.id:
                continue
            trail = self._places.setdefault(contact.id, deque())
            if trail and now < trail[-1][0]:
                trail.clear()
            if len(trail) > 1 and np.linalg.norm(trail[-1][1] - trail[-2][1]) < _SPACING:
                trail.pop()  # its end follows the contact
            trail.append((now, np.array(place)))
        for number, trail in list(self._places.items()):
            while trail and not 0 <= now - trail[0][0] <= LASTING:
                trail.popleft()
            if not trail:
                del self._places[number]

    def items(self) -> list[tuple[int, np.ndarray]]:
        """The ids of contacts and their places, (M, 2) or (M, 3) m, the oldest first."""
        return [(k, np.array([p for _, p in trail])) for k, trail in self._places.items()]
