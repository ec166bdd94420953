"""Contacts as the sheet feels them (`core/include/tomotactile/contact.hpp` and `touches.hpp`).

A contact (6,) has the place x, y, the logarithms of the conductance c that it has as a whole, the way
through the sheet included, and of its radius a, and two numbers p, q that stretch it.

`Touches(operator, contacts, across, sheet)` are all contacts (k, 6) of a fit on the sheet with the
coefficients (J,), each cut into `across` patches to its width:

parts : slices of the patches of each contact; owner (P,) the contact of each patch
share (n, P) H; impedance (P, P) D, ohm
weight (P,) parts of a contact's area on the sheet; direct (k, n) parts of each on electrodes
covered (k,) the part of each that lies on the sheet and its electrodes; mean (k,) mean D, ohm
stronger(contacts) : the same with contacts that differ in their conductance only; centre(i) (2,), m
"""

from __future__ import annotations

from typing import Any

import numpy as np

from tomotactile_ros.core import compiled

Touches: Any = compiled.Touches
conductance: Any = compiled.conductance
stretch: Any = compiled.stretch

PARAMETERS = 6  # x, y, ln c, ln a, p, q
X, Y, CONDUCTANCE, RADIUS, STRETCH, SHEAR = range(PARAMETERS)
# patches a spacing: mean D of a disc to 2 %; with 4.5 the forces of strong contacts on electrodes
# were up to 12 % off
_PER_PITCH = 6.0
_FEWEST_ACROSS, MOST_ACROSS = 2, 14  # patches to a contact's width
LONGEST = 2.0  # half the logarithm of the ratio of axes, at most
_MOST_ALONG = 48  # patches to a bar's length
_BAR = 0.8  # half the logarithm of the ratio of axes from which on a contact is a rectangle: 5 to 1
_NARROW = 0.5  # spacings: wider rectangles are ellipses, as their patches would be too large


def patches_for(radius: float, pitch: float) -> int:
    """How many patches a contact of `radius` (m) is wide on electrodes `pitch` (m) apart."""
    return int(np.clip(np.ceil(2 * radius * _PER_PITCH / pitch), _FEWEST_ACROSS, MOST_ACROSS))


def patches_of(contact: np.ndarray, pitch: float, bar: bool = False) -> int:
    """The same for a contact (6,) as its longer axis asks for; below 0 for a rectangle: what is so long and narrow, or
    narrow and taken for a `bar`."""
    long, radius = float(np.hypot(*contact[STRETCH:])), float(np.exp(contact[RADIUS]))
    side = np.sqrt(np.pi) * radius
    if (long < _BAR and not bar) or side * np.exp(-long) > _NARROW * pitch:
        return patches_for(radius * float(np.exp(long)), pitch)
    return -min(int(np.ceil(side * np.exp(long) * _PER_PITCH / pitch)), _MOST_ALONG)
