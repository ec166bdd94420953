"""What readings change by where an electrode lies aside of its place in the layout.

Electrode n is a disc of radius a at which the potential, next to it, is u = A ln(r / a) + B . x (1 -
a^2 / r^2): A goes with the current that it takes, B is the field that it stands in. A disc that moves
by d takes other currents (Hadamard's formula for moved boundaries; to first order in d, and in a over
the distance to all else):

    dY_mk = -(Y_nm B_nk + Y_nk B_nm) . d

with B_nm the field at n while electrode m is at 1 V. By the formula for rows (`forward`), with
E_ln = sum_m B_nm rho_lm the field at n in row l and Y rho_l = e_l / N_l, a floating electrode reads
the potential of its new place,

    d rho_ln = E_ln . d_n  (n is read),     d rho_l = Z_g B_l / N_l . d_l + (e_l - rho_l) E_ll . d_l

where l is grounded, Z_g = Z - z_l z_l^T / N_l. Each place acts on one column and on one row, like a
gain and a resistance. A disc whose radius grows by the part d has less resistance to the sheet around it,
which acts like one to ground, and bends the field more in which it stands:

    dY_mk = 2 d a^2 B_nm . B_nk / w,    dH_m(x) = -2 d a^2 B_nm . B_nx / w

with w = R / 2 pi, more at a rim (`SheetOperator.by_radius`), B_nx the field at n of a unit current at x.
"""

from __future__ import annotations

from itertools import product

import numpy as np

from tomotactile_ros.estimation.tables import PotentialTable, mirrored
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.outline import Outline

_RING = 8  # points around an electrode
# electrode radii: ring on which the field at an electrode is read: near enough to the rim of the
# sheet, and not so near that charges of its own rim matter
_AT = 2.0
_COMPLEX = np.array([1, 1j])  # x, y as x + i y


class Displacement:
    """Fields at the electrodes of a sheet.

    Parameters
    ----------
    layout, used (n,) : electrodes in use; resistance : ohm/sq
    potentials : of places (Q, 2), (Q, n), ohm (`PotentialTable`); inverse (n + 1, n + 1) of the
        bordered Green function

    Attributes
    ----------
    ring : (n _RING, 2) points around each electrode, m
    """

    def __init__(
        self,
        layout: Layout,
        used: np.ndarray,
        resistance: float,
        potentials: PotentialTable,
        inverse: np.ndarray,
    ):
        centres, radius = layout.positions[used], layout.radius
        self._radius = radius
        pitch, rectangular = float(np.median(layout.pitches)), layout.outline.is_uniform_rectangle
        mirrors = _rectangle if rectangular else _nearest
        self._mirrors = mirrors(layout.outline, centres, pitch)
        turn = 2 * np.pi / _RING * np.arange(_RING)
        self._ways = np.stack([np.cos(turn), np.sin(turn)], axis=1)
        ring = (centres[:, None] + _AT * radius * self._ways).reshape(-1, 2)
        self.ring = _inside(layout.outline, ring)
        shares = inverse[:-1, :-1] @ potentials(self.ring).T + inverse[:-1, -1:]
        self._alone = self._field(shares.T)

    def _field(self, on_ring: np.ndarray) -> np.ndarray:
        """(2, n, K) field at each electrode of potentials (n _RING, K) on `ring`."""
        size = _RING / 2 * self._radius * (_AT - 1 / _AT)
        around = on_ring.reshape(-1, _RING, on_ring.shape[1])
        return np.einsum("nak,ad->dnk", around, self._ways) / size

    def wider(self, by_radius: np.ndarray) -> np.ndarray:
        """(n, n) dY0, S, of wider discs as they bend fields, if all radii grow by one part; `by_radius`
        (n,) is w."""
        return self._bent(self._alone, by_radius)

    def wider_seen(self, by_radius: np.ndarray, on_ring: np.ndarray) -> np.ndarray:
        """(n, P) dH likewise at places whose unit currents have the potentials `on_ring` (n _RING, P),
        ohm, with all electrodes at 0 V."""
        return -self._bent(self._field(on_ring), by_radius)

    def _bent(self, field: np.ndarray, by_radius: np.ndarray) -> np.ndarray:
        dipole = 2 * self._radius**2 / by_radius[:, None]
        return np.einsum("dnm,dnk->mk", self._alone, dipole * field)

    def fields(self) -> np.ndarray:
        """(2, n, n) field at the first electrode while the second is at 1 V, 1/m, all others at 0."""
        return self._alone

    @property
    def mirrors(self) -> list[tuple[int, complex, complex, complex]]:
        """Each with the electrode that sees it, see `_rectangle`."""
        found = []
        for straight, turned, shift, near in self._mirrors:
            each = np.broadcast_arrays(near, straight, np.ravel(turned), np.ravel(shift))
            found += [(int(n), complex(s), complex(t), complex(h)) for n, s, t, h in zip(*each)]
        return found


def _inside(outline: Outline, places: np.ndarray) -> np.ndarray:
    """`places` (Q, 2), those beyond the rim mirrored in it."""
    if outline.is_uniform_rectangle:
        return mirrored(places, np.array(outline.size, float) / 2)
    depth, inwards = outline.depth(places)
    return places - 2 * np.minimum(depth, 0.0)[:, None] * inwards


def _rectangle(outline: Outline, centres: np.ndarray, within: float) -> list[tuple]:
    """Mirrors in rims and corners of a rectangle: for each what it does with x + i y, as factors of
    that and of its conjugate and what is added, and the electrodes at `centres` (n, 2) nearer to it
    than `within`, m. Farther ones see what is beyond a rim as something that changes slowly."""
    size, found = np.array(outline.size, float), []
    for i, j in product((-1, 0, 1), repeat=2):
        beside = [
            s * centres[:, axis] > size[axis] / 2 - within for axis, s in enumerate((i, j)) if s
        ]
        near = np.flatnonzero(np.all(beside, axis=0)) if beside else np.empty(0, int)
        if len(near):
            straight, turned = (0, -1) if not j else (0, 1) if not i else (-1, 0)
            found.append((straight, turned, i * size[0] + 1j * j * size[1], near))
    return found


def _nearest(outline: Outline, centres: np.ndarray, within: float) -> list[tuple]:
    """The same in the tangent of the nearest rim of any outline, another mirror for each electrode."""
    depth, inwards = outline.depth(centres)
    near = np.flatnonzero(depth < within)
    normal = inwards[near] @ _COMPLEX
    foot = centres[near] @ _COMPLEX - depth[near] * normal
    turned = -(normal**2)
    return [(0, turned[:, None], (foot - turned * foot.conj())[:, None], near)]
