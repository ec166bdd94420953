"""Contacts as the sheet feels them: an even conductance over a disc or an ellipse, cut into
patches.

A contact has the place x, y, the logarithms of the conductance c that it has as a whole, the way
through the sheet included, and of its radius a, and two numbers p, q that stretch it: its shape is
the unit disc times

    a exp([[p, q], [q, -p]]),    1/c = 1/g + mean D

Frames tell c and the place almost independently of the radius, g only together with it: with g in
the place of c the valley of equal misfit bends, and Gauss-Newton creeps along it. Where 1/c comes
near the mean of D the contact is as good as a bare conductor, and g is bounded smoothly.

A patch on an electrode feeds the electrode and nothing else. One that a rim crosses does so in
part, so that all derivatives exist.
"""

from __future__ import annotations

import math
from copy import copy
from dataclasses import dataclass
from functools import cached_property, wraps
from itertools import pairwise

import numpy as np

from tomotactile_ros.estimation.disc import cut
from tomotactile_ros.estimation.induced import RIM
from tomotactile_ros.estimation.operator import Patches, SheetOperator
from tomotactile_ros.estimation.pressure_modes import pressure_modes

PARAMETERS = 6  # x, y, ln c, ln a, p, q
X, Y, CONDUCTANCE, RADIUS, STRETCH, SHEAR = range(PARAMETERS)
MOVING = (X, Y, RADIUS, STRETCH, SHEAR)  # those that move patches
_BOUND = 0.05  # 1/g is bounded smoothly at this part of 1/c
_BARE = 0.005  # 1/g of a bare conductor in parts of 1/c
_PER_PITCH = 6.0  # patches along one spacing of the electrodes
_FEWEST_ACROSS, MOST_ACROSS = 4, 14  # patches to a contact's width
LONGEST = 2.0  # half the logarithm of the ratio of axes, at most
_MOST_ALONG = 48  # patches to a bar's length
_BAR = 0.8  # half the logarithm of the ratio of axes from which on a contact is a rectangle: 5 to 1
_NARROW = 0.5  # spacings: wider rectangles are ellipses, as their patches would be too large


def patches_for(radius: float, pitch: float) -> int:
    """How many patches a contact of `radius` (m) is wide on electrodes `pitch` (m) apart."""
    return int(np.clip(np.ceil(2 * radius * _PER_PITCH / pitch), _FEWEST_ACROSS, MOST_ACROSS))


def patches_of(contact: np.ndarray, pitch: float) -> int:
    """The same for a contact (6,) as its longer axis asks for; below 0 for what is so long and narrow that it
    is a rectangle."""
    long, radius = float(np.hypot(*contact[STRETCH:])), float(np.exp(contact[RADIUS]))
    side = np.sqrt(np.pi) * radius
    if long < _BAR or side * np.exp(-long) > _NARROW * pitch:
        return patches_for(radius * float(np.exp(long)), pitch)
    return -min(int(np.ceil(side * np.exp(long) * _PER_PITCH / pitch)), _MOST_ALONG)


def stretch(contact: np.ndarray) -> np.ndarray:
    """(2, 2) shape of a contact (6,) as a map of the unit disc, m."""
    return _shape(contact)[0]


def _shape(contact):
    """(4, 2, 2) `stretch` of a contact (6,) and its derivatives by ln a, p and q, m."""
    p, q = contact[STRETCH], contact[SHEAR]
    size = np.hypot(p, q)
    small = size < 1e-4
    ratio = 1 + size**2 / 6 if small else np.sinh(size) / size
    slope = 1 / 3 if small else (np.cosh(size) - ratio) / size**2  # of ratio, by size, over size
    turn = np.array([[p, q], [q, -p]])
    shape = np.cosh(size) * np.eye(2) + ratio * turn
    by_p = p * (ratio * np.eye(2) + slope * turn) + ratio * np.array([[1.0, 0.0], [0.0, -1.0]])
    by_q = q * (ratio * np.eye(2) + slope * turn) + ratio * np.array([[0.0, 1.0], [1.0, 0.0]])
    return np.exp(contact[RADIUS]) * np.array([shape, shape, by_p, by_q])


def _turned(contact):
    """The same as `_shape` but that what it stretches is turned as well, so that the sides of a square stay at
    right angles; of no stretch, along the axes."""
    p, q = contact[STRETCH], contact[SHEAR]
    size, angle = max(float(np.hypot(p, q)), 1e-6), np.arctan2(q, p) / 2
    way, aside = (
        np.array([[np.cos(angle)], [np.sin(angle)]]),
        np.array([[-np.sin(angle)], [np.cos(angle)]]),
    )
    longer, shorter = np.exp(size), np.exp(-size)
    shape = np.hstack([longer * way, shorter * aside])
    by_size = np.hstack([longer * way, -shorter * aside]) / size
    by_angle = np.hstack([longer * aside, -shorter * way]) / (2 * size**2)
    by_p, by_q = p * by_size - q * by_angle, q * by_size + p * by_angle
    return np.exp(contact[RADIUS]) * np.array([shape, shape, by_p, by_q])


@dataclass(frozen=True)
class Form:
    """How the patches of one contact lie: what follows from its parameters alone.

    places (P, 2), m; radii (P,), m; area (P,) shares of its area; moves (5, P, 2) of the places, by
        `MOVING`
    """

    places: np.ndarray
    radii: np.ndarray
    area: np.ndarray
    moves: np.ndarray

    @classmethod
    def of(cls, contact: np.ndarray, across: int) -> Form:
        """Of a contact (6,), a disc or an ellipse `across` patches wide; below 0: a rectangle of the same
        area and stretch, so many patches long."""
        unit, area, radius = cut(across)
        shape, *changes = _shape(contact) if across > 0 else _turned(contact)
        moves = np.zeros((len(MOVING), len(unit), 2))
        moves[0, :, 0] = moves[1, :, 1] = 1.0
        for k, change in enumerate(changes):
            moves[2 + k] = unit @ change.T
        return cls(contact[:2] + unit @ shape.T, np.exp(contact[RADIUS]) * radius, area, moves)


def _once(method):
    """Of a `Touches`: worked out once for each contact."""

    @wraps(method)
    def known(self, i: int):
        key = method.__name__, i
        if key not in self._known:
            self._known[key] = method(self, i)
        return self._known[key]

    return known


class Touches:
    """All contacts of a fit on the sheet: what equation (b) needs, and its derivatives.

    Attributes
    ----------
    parts : slices of the patches of each contact
    share (n, P) H; impedance (P, P) D, ohm, on the sheet with the coefficients given
    weight (P,) parts of a contact's area on the sheet; direct (k, n) parts of each contact on
        electrodes
    covered (k,) the part of each that lies on the sheet and its electrodes
    mean (k,) mean D of each, ohm; 0 on electrodes
    """

    def __init__(self, operator: SheetOperator, contacts: np.ndarray, across, sheet: np.ndarray):
        self.operator, self.contacts = operator, contacts
        self._known: dict[tuple[str, int], object] = {}
        self.forms = [Form.of(each, parts) for each, parts in zip(contacts, across)]
        ends = np.cumsum([0] + [len(form.area) for form in self.forms])
        self.parts = [slice(a, b) for a, b in pairwise(ends)]
        self.owner = np.repeat(np.arange(len(contacts)), np.diff(ends))
        self._place(*(np.concatenate([getattr(f, n) for f in self.forms]) for n in _FORM))
        self.patches = Patches(
            operator, self.places, self.radii, self.parts, contacts[:, [X, Y, RADIUS]], sheet
        )
        self.covered = np.array([self.weight[p].sum() for p in self.parts])
        self.covered = np.maximum(self.covered + self.direct.sum(axis=1), 1e-9)
        self._take(sheet)

    def _take(self, sheet: np.ndarray) -> None:
        """What depends on the coefficients of the sheet."""
        self._sheet = sheet
        self.share, self.impedance = self.patches.share, self.patches.impedance
        mean = [self.weight[p] @ self.impedance[p, p] @ self.weight[p] for p in self.parts]
        self.mean = np.array(mean) / self.covered**2

    def stronger(self, contacts: np.ndarray) -> Touches:
        """The same with contacts (k, 6) that differ in their conductance only."""
        other = copy(self)
        other.contacts = contacts
        return other

    def on(self, sheet: np.ndarray) -> Touches:
        """The same on the sheet with other coefficients (J,)."""
        if sheet is self._sheet:
            return self
        other = copy(self)
        other._known, other.patches = {}, self.patches.on(sheet)
        other._take(sheet)
        return other

    def _place(self, places, radii, area):
        """Places moved off electrodes and into the outline, and what part of each patch lies
        where."""
        layout, operator = self.operator.layout, self.operator
        beyond, inwards = layout.outline.depth(places)
        there, grows = part_beyond(beyond / radii)
        self._moving = np.abs(places) < np.array(layout.outline.size) / 2
        self.places, distance, nearest, way, inside = operator.placed(places)
        longer = RIM * layout.radius / np.maximum(distance, 1e-12)
        self._on_rims = inside, way, np.where(distance > 1e-6 * layout.radius, longer, 0.0)
        off, rises = part_beyond((distance - layout.radius) / radii)
        self.radii = radii
        self.weight = area * there * off
        used = operator.position[nearest]
        self._electrode = np.where(used >= 0, used, operator.count)
        self.direct = np.zeros((len(self.parts), operator.count + 1))
        np.add.at(self.direct, (self.owner, self._electrode), area * there * (1 - off))
        self.direct = self.direct[:, :-1]
        # by the place and by the logarithm of the radius: of what is on the sheet and electrodes,
        # and off electrodes
        steep = (area * grows / radii)[:, None] * inwards, -area * grows * beyond / radii
        rising = (rises / radii)[:, None] * way, -rises * (distance - layout.radius) / radii
        self._on = there * area, off, steep, rising

    @cached_property
    def kernel(self) -> np.ndarray:
        """(n, P) of `Displacement`, at all patches."""
        return self.operator.displacement.kernel(self.places)

    @_once
    def moves(self, i: int) -> np.ndarray:
        """(5, p, 2) how the patches of contact i move with its parameters `MOVING`, m; along the rims
        of electrodes where they were moved to these."""
        part = self.parts[i]
        moves = self.forms[i].moves * self._moving[part]
        inside, way, longer = (each[part] for each in self._on_rims)
        if inside.any():
            outwards = np.einsum("kpd,pd->kp", moves[:, inside], way[inside])
            moves[:, inside] -= outwards[..., None] * way[inside]
            moves[:, inside] *= longer[inside, None]
        return moves

    @_once
    def d_covered(self, i: int) -> tuple[np.ndarray, np.ndarray]:
        """(5, p) change of the weights of contact i by `MOVING`, and (5, n) of what it has on
        electrodes."""
        part, moves = self.parts[i], self.forms[i].moves
        on, off, steep, rising = self._on
        on, off = on[part], off[part]
        by_rim = np.einsum("kpd,pd->kp", moves, steep[0][part])
        by_electrode = np.einsum("kpd,pd->kp", moves, rising[0][part])
        by_rim[2] += steep[1][part]  # radii of patches grow with the contact
        by_electrode[2] += rising[1][part]
        direct = np.zeros((len(MOVING), self.operator.count + 1))
        np.add.at(direct.T, self._electrode[part], (by_rim * (1 - off) - on * by_electrode).T)
        return by_rim * off + on * by_electrode, direct[:, :-1]

    def d_pressure(self, i: int, across: int) -> tuple[np.ndarray, np.ndarray]:
        """(Q, p) change of the weights of disc i, `across` patches wide, by its `pressure_modes`, and
        (Q, n) of what it has on electrodes."""
        part, modes = self.parts[i], pressure_modes(across)
        on, off = (each[part] for each in self._on[:2])
        direct = np.zeros((len(modes), self.operator.count + 1))
        np.add.at(direct.T, self._electrode[part], (modes * (on * (1 - off))).T)
        return modes * self.weight[part], direct[:, :-1]

    @_once
    def d_impedance(self, i: int) -> np.ndarray:
        """(5, p, m) E with dD = E + E^T by `MOVING` of contact i, ohm: its patches, and the patches
        `near(i)`."""
        part, near = self.parts[i], self.near(i)
        slope, grown = self.patches.impedance_slope(part, near)
        moved = self.moves(i)
        out = moved[..., 0][:, :, None] * slope[0] + moved[..., 1][:, :, None] * slope[1]
        own = slice(self._first(i), self._first(i) + part.stop - part.start)
        out[2, :, own] -= grown[:, own] / 2
        return out

    def near(self, i: int) -> np.ndarray:
        """(m,) patches that feel those of contact i, its own among them; electrodes screen the
        others."""
        return self.patches.near[i]

    def _first(self, i) -> int:
        """Where in `near(i)` the patches of contact i begin."""
        return int(np.searchsorted(self.near(i), self.parts[i].start))

    @_once
    def mean_changes(self, i: int) -> np.ndarray:
        """(5,) derivatives of `mean` of contact i by `MOVING`, ohm."""
        by_impedance, (d_weight, d_direct) = self.d_impedance(i), self.d_covered(i)
        part, covered = self.parts[i], self.covered[i]
        weight, first = self.weight[part], self._first(i)
        found = 2 * (by_impedance[:, :, first : first + len(weight)] @ weight) @ weight
        found += 2 * d_weight @ (self.impedance[part, part] @ weight)
        parts = d_weight.sum(axis=1) + d_direct.sum(axis=1)
        return found / covered**2 - 2 * self.mean[i] * parts / covered

    def centre(self, i: int) -> np.ndarray:
        """(2,) centre of mass of what lies on the sheet, m."""
        on_electrodes = self.operator.layout.positions[self.operator.used]
        part = self.parts[i]
        mass = self.weight[part] @ self.places[part] + self.direct[i] @ on_electrodes
        return mass / self.covered[i]

    def conductance(self, i: int) -> tuple[float, float, float]:
        """g of contact i as a whole, S, and the derivatives of ln g by ln c and by the mean of D
        (1/ohm)."""
        way, mean = math.exp(-self.contacts[i, CONDUCTANCE]), float(self.mean[i])
        rest = (way - mean) / (_BOUND * way)
        small = math.exp(-abs(rest))
        slope = (1.0 if rest > 0 else small) / (1 + small)
        left = way * (_BOUND * (max(rest, 0.0) + math.log1p(small)) + _BARE)
        return 1 / left, 1 + slope * mean / left, slope / left


def part_beyond(depth: np.ndarray):
    """What part of a patch lies beyond a line that it is `depth` radii beyond, and its slope."""
    inside = np.clip(depth + 0.5, 0.0, 1.0)
    return inside**2 * (3 - 2 * inside), 6 * inside * (1 - inside)


_FORM = "places", "radii", "area"
