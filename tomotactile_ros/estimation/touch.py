"""Contacts as the sheet feels them: an even conductance over a disc or an ellipse, cut into patches.

A contact has the place x, y, the logarithms of the conductance c that it has as a whole, the way through the sheet
included, and of its radius a, and two numbers p, q that stretch it: its shape is the unit disc times

    a exp([[p, q], [q, -p]]),    1/c = 1/g + mean D

Frames tell c and the place almost independently of the radius, g only together with it: with g in the place of c the
valley of equal misfit bends, and Gauss-Newton creeps along it. Where 1/c comes near the mean of D the contact is as
good as a bare conductor, and g is bounded smoothly.

A patch on an electrode feeds the electrode and nothing else. One that a rim crosses does so in part, so that all
derivatives exist.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from itertools import pairwise

import numpy as np

from tomotactile_ros.contact import Contact
from tomotactile_ros.estimation.operator import SheetOperator

PARAMETERS = 6  # x, y, ln c, ln a, p, q
X, Y, CONDUCTANCE, RADIUS, STRETCH, SHEAR = range(PARAMETERS)
_STEPS = np.array([1e-4, 1e-4, 0.02, 0.02, 0.02])  # for differences: m, m, 1, 1, 1
_MOVING = (X, Y, RADIUS, STRETCH, SHEAR)
_BOUND = 0.05  # 1/g is bounded smoothly at this part of 1/c
_BARE = 0.005  # 1/g of a bare conductor in parts of 1/c
_RIM = (
    1.001  # radii from the centre of an electrode: patches on it are moved here and have no weight
)
_PER_PITCH = 4.5  # patches along one spacing of the electrodes
_ACROSS = 4, 14  # patches to a contact's width


@lru_cache(maxsize=32)
def unit_patches(across: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Patches of the disc of radius 1: points (P, 2), shares of its area (P,), radii (P,)."""
    points, areas, radii = Contact("disc", center=(0.0, 0.0), radius=1.0).patches(across)
    return points, areas / np.pi, radii


def patches_for(radius: float, pitch: float) -> int:
    """How many patches a contact of `radius` (m) is wide on electrodes `pitch` (m) apart."""
    return int(np.clip(np.ceil(2 * radius * _PER_PITCH / pitch), *_ACROSS))


def stretch(contact: np.ndarray) -> np.ndarray:
    """(2, 2) shape of a contact (6,) as a map of the unit disc, m."""
    p, q = contact[STRETCH], contact[SHEAR]
    size = np.hypot(p, q)
    ratio = np.sinh(size) / size if size > 1e-9 else 1.0
    turn = ratio * np.array([[p, q], [q, -p]])
    return np.exp(contact[RADIUS]) * (np.cosh(size) * np.eye(2) + turn)


@dataclass(frozen=True)
class Touch:
    """One contact at one place: what equation (b) needs, and its derivatives by x, y, ln a, p, q.

    share (n, P) H; impedance (P, P) D, ohm; weight (P,) parts of its area on the sheet; direct (n,) parts on
    electrodes; mean mean D, ohm; and, led by an axis of 5, their changes d_share, d_impedance, d_weight, d_direct.
    """

    places: np.ndarray
    share: np.ndarray
    impedance: np.ndarray
    weight: np.ndarray
    direct: np.ndarray
    d_share: np.ndarray
    d_impedance: np.ndarray
    d_weight: np.ndarray
    d_direct: np.ndarray

    @property
    def mean(self) -> float:
        """Mean of D over the contact, ohm; 0 on electrodes."""
        return float(self.weight @ self.impedance @ self.weight) / self.covered**2

    @property
    def covered(self) -> float:
        """The part of the contact that lies on the sheet and its electrodes, 0 to 1."""
        return float(max(self.weight.sum() + self.direct.sum(), 1e-9))

    def mean_change(self, k: int) -> float:
        """Derivative of `mean` by moving parameter k; what the mean of D gains, 1/g loses where c stays."""
        weight, covered = self.weight, self.covered
        change = weight @ self.d_impedance[k] @ weight
        change += 2 * (self.d_weight[k] @ self.impedance @ weight)
        parts = self.d_weight[k].sum() + self.d_direct[k].sum()
        return float(change / covered**2 - 2 * self.mean * parts / covered)

    def centre(self, operator: SheetOperator) -> np.ndarray:
        """(2,) centre of mass of what lies on the sheet, m."""
        on_electrodes = operator.layout.positions[operator.used]
        return (self.weight @ self.places + self.direct @ on_electrodes) / self.covered


def touches(
    operator: SheetOperator, contacts: np.ndarray, across, free: np.ndarray, sheet: np.ndarray
):
    """`Touch` of each of `contacts` (k, 6) on a sheet with coefficients `sheet` (J,), and D of all patches.

    Derivatives are those by the parameters that `free` (k, 6) names, others 0. D (Q, Q), ohm, is for the patches of all
    contacts in turn.
    """
    cut = _cut(contacts, across, free)
    places, radii, areas = (np.concatenate([piece[i] for _, piece in cut]) for i in range(3))
    places, on_sheet, on_electrode, electrode = _placed(operator, places, radii, areas)
    ends = np.cumsum([0] + [len(piece[1]) for _, piece in cut])
    parts = [slice(a, b) for a, b in pairwise(ends)]
    base = np.concatenate([np.arange(p.start, p.stop) for (w, _), p in zip(cut, parts) if w < 0])
    share, impedance = operator.on_demand(places, radii)
    mutual = impedance(base)
    factor = np.ones(len(contacts))
    if sheet.any():
        share = share + operator.share_added(sheet, places)
        factor = np.exp(-operator.field_at(contacts[:, :2]) @ sheet)
    found, first = [], 0
    for (which, _), part in zip(cut, parts):
        direct = np.bincount(electrode[part], on_electrode[part], operator.count + 1)[:-1]
        if which < 0:
            block = slice(first, first + part.stop - part.start)
            first, own, scale = block.stop, part, factor[len(found)]
            now = Touch(
                places[part],
                share[:, part],
                mutual[block, block] * scale,
                on_sheet[part],
                direct,
                *_no_change(operator.count, block.stop - block.start),
            )
            found.append(now)
        else:
            step = _STEPS[which]
            now.d_share[which] = (share[:, part] - share[:, own]) / step
            moved = impedance(np.arange(part.start, part.stop)) * scale
            now.d_impedance[which] = (moved - now.impedance) / step
            now.d_weight[which] = (on_sheet[part] - now.weight) / step
            now.d_direct[which] = (direct - now.direct) / step
    scale = np.sqrt(np.repeat(factor, [len(touch.weight) for touch in found]))
    return found, mutual * np.multiply.outer(scale, scale)


def _cut(contacts, across, free):
    """Patches (points, radii, areas) of each contact, then of it with each free parameter moved: (-1 or which, ...)."""
    out = []
    for contact, parts, moving in zip(contacts, across, free):
        unit, area, radius = unit_patches(parts)
        for which in (-1, *(i for i, each in enumerate(_MOVING) if moving[each])):
            moved = contact.copy()
            if which >= 0:
                moved[_MOVING[which]] += _STEPS[which]
            points = moved[:2] + unit @ stretch(moved).T
            out.append((which, (points, np.exp(moved[RADIUS]) * radius, area)))
    return out


def _no_change(count, patches):
    """Zeros for the derivatives of a contact."""
    moving = len(_MOVING)
    shapes = (count, patches), (patches, patches), (patches,), (count,)
    return [np.zeros((moving, *shape)) for shape in shapes]


def _placed(operator, places, radii, areas):
    """Places moved off electrodes and into the outline, and what part of each patch lies where.

    Returns places (Q, 2), shares on the sheet (Q,), on an electrode (Q,), and which electrode in use (Q,), the
    number of electrodes where it is not in use.
    """
    layout = operator.layout
    inside = layout.outline.contains(places, 1e-9)
    half = np.array(layout.outline.size) / 2
    places = np.clip(places, -half, half)
    distance, nearest = layout.nearest(places)
    depth = np.clip((distance - layout.radius) / radii + 0.5, 0.0, 1.0)
    off = depth**2 * (3 - 2 * depth)
    rim = _RIM * layout.radius
    way = (places - layout.positions[nearest]) / np.maximum(distance, 1e-12)[:, None]
    places = np.where((distance < rim)[:, None], layout.positions[nearest] + rim * way, places)
    used = operator.position[nearest]
    areas = areas * inside
    return places, areas * off, areas * (1 - off), np.where(used >= 0, used, operator.count)


def conductance(touch: Touch, contact: np.ndarray) -> tuple[float, float, float]:
    """g of a whole contact, S, and the derivatives of ln g by ln c and by the mean of D (1/ohm)."""
    way = np.exp(-contact[CONDUCTANCE])
    rest = (way - touch.mean) / (_BOUND * way)
    slope = 1 / (1 + np.exp(-np.clip(rest, -500, 500)))
    left = way * (_BOUND * np.logaddexp(0.0, rest) + _BARE)
    return 1 / left, 1 + slope * touch.mean / left, slope / left
