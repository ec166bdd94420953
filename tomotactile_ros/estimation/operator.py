"""The sheet as the electrodes see it, for contacts anywhere and for a sheet that is not quite even.

All electrodes held at potentials u against the driving layer draw the currents Y u. Without
contacts Y is Y0; contacts add H (diag(1/g) + D)^-1 H^T (`reconstruction.grounded`, equation b). Y0
is the Dirichlet-to-Neumann map of the sheet at its electrodes, H holds the potentials of the sheet
with one electrode at 1 V and all others at 0 V, D the Green function with all electrodes at 0 V.

A sheet whose conductance is sigma exp(m(x)) instead of sigma changes them by (first order in m)

    dY0_nk = int sigma m grad H_n . grad H_k,     dH_n(x) = - int sigma m grad D_x . grad H_n

and D near x by the factor exp(-m(x)). What a rim does that is not where it was drawn, `rim` says, what
electrodes do that are wider, `displacement`; a sheet that is known to be cut otherwise is solved so. For
pairs of electrodes that see each other the first is taken as a change of the logarithm, which is right
to second order for a field that varies slowly between them. A uniform anisotropy exchanges m grad . grad for the difference of the parts along and
across (Polydorides and Lionheart 2002 derive such sensitivities for electrical impedance
tomography).
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.as_cut import COUNT, AsCut, Tears, torn
from tomotactile_ros.estimation.channels import ALIKE
from tomotactile_ros.estimation.disc import MOST_PATCHES, unit_patches
from tomotactile_ros.estimation.displacement import Displacement
from tomotactile_ros.estimation.field import SheetField
from tomotactile_ros.estimation.first_order import first_order
from tomotactile_ros.estimation.tables import (
    Around,
    Lattice,
    MutualTable,
    PotentialTable,
    Sensed,
    mirrored,
    off_electrodes,
)
from tomotactile_ros.estimation.uneven import (
    Rest,
    Solution,
    bordered_inverse,
    solution,
    uneven,
)
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.sheet import make_sheet
from tomotactile_ros.sheet.changed import ChangedSheet
from tomotactile_ros.sheet.fem import FemSheet

# couplings above this part of the largest admittance change by a factor, others by a sum
_SEEN = 2e-3
_KEPT = 4  # operators, the last that were asked for: the first of a layout takes 0.6 s with 64 electrodes
# charges on the rims of all electrodes of the closed form: eliminated in half a second; of one electrode, four of which
# give its dipole within 4 %, and sixteen the potentials beside it to a thousandth
_CHARGES, _RING = 1024, (4, 16)
_LATTICE = 21  # points along the longer side at which dH is known; it is smooth
# of an electrode's own impedance: what its rim, and a contact that covers part of it, differ by
# from frame to frame between this model and finite elements
_INEXACT = 2e-3
_LEAK = 1e-7  # of what electrodes conduct, of a sheet that is as good as untouched
# of a coefficient: distance from the field of the last expansion that asks for a new one; second
# order is then 1e-3
_NEAR = 0.03
_TOLERATED = 3.0  # deviations of how a sheet is made: up to that what it changes is of first order
_ROUND = 64  # points around an electrode, of which it is asked whether they are on the sheet
_NO_PATCHES = np.zeros((0, 2)), np.zeros(0), np.zeros(0)


class SheetOperator:
    """Layout, model of the sheet and the electrodes in use; immutable once made.

    Attributes
    ----------
    layout : Layout, as drawn; cut : as cut and printed, where it is right about another one
    used : (n,) electrodes whose wires are used; all others float
    admittance : (n, n) Y0 of the even sheet, S
    resistance : ohm/sq
    seen : (n, n) bool, which pairs of electrodes see each other
    displacement : fields at the electrodes, for places that are not quite theirs
    modes : number J of coefficients that describe a sheet: of `field`, two of anisotropy, the ways of
        `rim`, m, and the logarithm of what all radii have in common
    deviation : (J,) their standard deviation before anything is known
    """

    def __init__(self, layout: Layout, model: str = "auto"):
        self.layout, self._model = layout, model
        self.resistance = float(layout.sheet_resistance)
        self.pitch = float(np.median(layout.pitches))
        self.lattice = Lattice(np.array(layout.outline.size, float), _LATTICE)
        self._cut = AsCut(layout, np.zeros(COUNT))
        self._rest: Rest | None = None
        self._solve(None)
        self._mean = np.zeros(self.modes)
        self._use(np.arange(layout.electrodes))

    @property
    def cut(self) -> Layout:
        return self._cut.layout

    def _solve(self, field: SheetField | None) -> FemSheet:
        """The even sheet as it was cut, for all its electrodes, with the modes of `field` where there are
        some; its finite elements are returned."""
        cut = self.cut
        every = np.arange(cut.electrodes)
        ring = int(np.clip(_CHARGES // cut.electrodes, *_RING))
        self.sheet = make_sheet(cut, self._model, ring=ring)
        fem = self.sheet if isinstance(self.sheet, FemSheet) else FemSheet(cut)
        if self._cut.tears:
            whole, same = self.sheet, fem
            fem = self._torn(self._cut.tears)
            self.sheet = ChangedSheet(whole, same, fem)
        size, fine = np.array(cut.outline.size, float), Lattice.fine(cut, self.pitch)
        sensed = Sensed(self.sheet, mirrored(fine.points, size / 2))
        self._potentials = PotentialTable(cut, fine, sensed)
        self.mutual = MutualTable(self.sheet, self.lattice, self._potentials, sensed)
        inverse = bordered_inverse(self.sheet.electrode_electrode, every)
        self._fields = Displacement(cut, every, self.resistance, self._potentials, inverse)
        self._first = first_order(
            fem, self._fields, self.lattice, self.pitch, field, _by_radius(cut)
        )
        self.field, self.rim = self._first.field, self._first.rim
        printed = float(np.sqrt(ALIKE)) * cut.tolerance.radius  # what is common to all radii
        self.deviation = np.concatenate([self.field.deviation, self.rim.deviation, [printed]])
        self._mesh = fem.mesh
        return fem

    def _torn(self, tears: Tears) -> FemSheet:
        """Finite elements of the even sheet with `tears`; InputError where they leave it in pieces."""
        return FemSheet(self.cut, mesh=FemSheet(torn(self.cut, tears)).mesh)

    def _places(self) -> np.ndarray:
        """(M, 2) m, where it is known what a sheet changes: points of the lattice, off electrodes."""
        size = np.array(self.cut.outline.size)
        return off_electrodes(mirrored(self.lattice.points, size / 2), self.cut)

    def _use(self, used: np.ndarray) -> None:
        """Let all electrodes but `used` (n,) float."""
        self.used, self.count = used, len(used)
        self.position = np.full(self.layout.electrodes, -1)
        self.position[used] = np.arange(len(used))
        self._inverse = bordered_inverse(self.sheet.electrode_electrode, used)
        self.admittance = self._inverse[:-1, :-1].copy()
        self.potentials = self._potentials.of(used)
        self.displacement = self._fields
        if len(used) < self.layout.electrodes:
            self.displacement = Displacement(
                self.cut, used, self.resistance, self.potentials, self._inverse
            )
        seen = np.abs(self.admittance) > _SEEN * np.abs(self.admittance.diagonal()).max()
        np.fill_diagonal(seen, False)
        self.seen = seen
        first = self._first.of(used)
        of_elements, of_fields = np.split(first.change, [-1])
        known = (of_elements, first.energy), (of_fields, self.admittance)
        self._change = np.concatenate(
            [np.where(seen, each / np.where(seen, whole, 1.0), each) for each, whole in known]
        )
        for each in self._change:
            np.fill_diagonal(each, 0.0)
        self._first_change = _balanced(self._change * np.where(seen, self.admittance, 1.0))
        self._share_change = first.share_change
        self._even: Solution | None = None
        self._tables = self._handed_over()

    def of(self, used: np.ndarray) -> SheetOperator:
        """The same with all electrodes but `used` (n,) floating."""
        other = self._copied()
        other._use(used)
        if other._rest is not None:
            other._expand(self._mean, None)
        return other

    def _copied(self) -> SheetOperator:
        other = copy(self)
        for known in ("expected", "untouched", "core", "own_impedance"):
            other.__dict__.pop(known, None)
        return other

    def about(self, sheet: np.ndarray, tears: Tears = ()) -> SheetOperator:
        """The same for a sheet whose coefficients are near `sheet` (J,): right beyond first order
        there, and with `tears`."""
        other, cut, fem = self._copied(), AsCut(self.layout, sheet[self.of_cut], tears), None
        if not self._cut.near(cut):
            other._cut = cut
            fem = other._solve(self.field)
            other._use(self.used)
        other._expand(sheet, fem)
        return other

    def _expand(self, sheet: np.ndarray, fem: FemSheet | None) -> None:
        """Be right about the coefficients `sheet` (J,) of a sheet so cut; `fem` of the even one, where it is
        at hand."""
        places = self._places()
        even = self._even
        if even is None:
            fem = fem or FemSheet(self.cut, mesh=self._mesh)
            even = solution(fem, self.used, places, self.pitch)
        alone, drawn = sheet.copy(), np.zeros(self.modes)
        alone[self.of_cut] = 0.0
        drawn[self.of_cut] = self._cut.coefficients  # what was solved is right without a change
        fem = uneven(
            self.cut,
            self._mesh,
            lambda points: self.field.at(points) @ sheet[: self.field.count],
            sheet[self.field.count : self.of_cut.start],
        )
        found = solution(fem, self.used, places, self.pitch)
        seen = self.seen & (found.admittance * even.admittance > 0)
        ratio = np.where(seen, found.admittance / np.where(seen, even.admittance, 1.0), 1.0)
        first, cut = self._changed(alone), self._changed(drawn)
        term = found.admittance - even.admittance - np.tensordot(alone, self._first_change, 1)
        self._rest = Rest(
            np.log(ratio) - np.where(seen, first, 0.0) - np.where(self.seen, cut, 0.0),
            np.where(seen, 0.0, term) - np.where(self.seen, 0.0, cut),
            found.share - even.share - np.tensordot(alone + drawn, self._share_change, 1),
            found.own * np.exp(self.field_at(places) @ sheet) - even.own,
        )
        np.fill_diagonal(self._rest.term, 0.0)
        self._mean, self._even = sheet.copy(), even

    def near(self, sheet: np.ndarray, tears: Tears = ()) -> SheetOperator:
        """This one if it is right for the coefficients `sheet` (J,) and `tears`, else that `about` them."""
        apart = np.abs(sheet - self._mean)[: self.of_cut.start]
        cut = AsCut(self.layout, sheet[self.of_cut], tears)
        return self if apart.max() < _NEAR and self._cut.near(cut) else self.about(sheet, tears)

    def is_far(self, found: np.ndarray) -> bool:
        """Whether coefficients `found` (J,) are of a sheet that is cut or printed otherwise than tolerances let
        it, and not of one that this is right about to first order."""
        off = np.abs(found)[self.of_cut] / self.deviation[self.of_cut]
        if off.max() <= _TOLERATED:
            return False
        return not self._cut.near(AsCut(self.layout, found[self.of_cut]))

    def cut_as(self, cut: np.ndarray, tears: Tears = ()) -> SheetOperator:
        """The same for a sheet of the geometry `cut` (9,), with `tears`."""
        about = self._mean.copy()
        about[self.of_cut] = cut
        return self.about(about, tears)

    def torn_beside(self, tears: Tears) -> SheetOperator:
        """The same with `tears` a little beside those that it is right about: by what the finite elements of an
        even sheet change from these to those."""
        other, places = self._copied(), self._places()
        now, then = (
            solution(self._torn(each), self.used, places, self.pitch)
            for each in (self.tears, tears)
        )
        rest = self._rest or Rest(*(np.zeros(1) for _ in range(4)))
        other._rest = Rest(
            rest.factor + np.zeros(now.admittance.shape),
            rest.term + then.admittance - now.admittance,
            rest.share + then.share - now.share,
            rest.own + then.own - now.own,
        )
        return other

    @property
    def tears(self) -> Tears:
        """Those that it is right about."""
        return self._cut.tears

    @property
    def mean(self) -> np.ndarray:
        """(J,) coefficients of the sheet that it is right about."""
        return self._mean

    @cached_property
    def core(self) -> Any:
        """The same for the compiled core."""
        if self._rest is None:
            return compiled.Sheet(self._tables, self.untouched)
        rest = self._rest
        left = rest.factor, rest.term, rest.share, rest.own
        return compiled.Sheet(self._tables, self.untouched, self._mean, *left)

    def _handed_over(self) -> Any:
        """Tables of the even sheet and of what unevenness changes."""
        layout, outline = self.cut, self.cut.outline
        rings = [] if outline.kind == "circle" else [outline.shell]
        position = np.where(self.position < 0, self.count, self.position)
        return compiled.Tables(
            {
                "size": np.array(outline.size, float),
                "rectangle": outline.is_uniform_rectangle,
                "circle": float(outline.radius),
                "rings": [*rings, *outline.holes],
                "centres": layout.positions,
                "used": layout.positions[self.used],
                "position": position,
                "radius": layout.radius,
                "resistance": self.resistance,
                "pitch": self.pitch,
                "inverse": self._inverse,
                "admittance": self.admittance,
                "discs": [_NO_PATCHES, *(unit_patches(a) for a in range(1, MOST_PATCHES + 1))],
                "induced": self.mutual.induced,
                "fine": self.potentials.lattice.core,
                "coarse": self.lattice.core,
                "potentials": self.potentials.rest,
                "own": self.mutual.own_rest(self.used, self._inverse),
                "smooth": self.mutual.smooth,
                "fields": self.displacement.fields(),
                "mirrors": self.displacement.mirrors,
                "change": self._change,
                "seen": self.seen,
                "share_change": self._share_change,
                "inside": -_by_radius(layout)[self.used],
                "printed": self._cut.coefficients[-1],
                "cells": self.field.centres,
                "reach": self.field.reach,
                "nodes": self.field.nodes,
            }
        )

    def points(self, places: np.ndarray, radii: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """H (n, Q) and the diagonal of D (Q,), ohm, for discs of `radii` (Q,) at `places`
        (Q, 2), on the sheet that it is right about."""
        transfer = self.sheet.transfer(places, radii)
        fed = np.vstack([transfer.electrode_point[self.used], np.ones(len(places))])
        shares = self._inverse @ fed
        own = np.maximum(transfer.point_self - np.einsum("ek,ek->k", fed, shares), 0.0)
        if self._rest is None:
            return shares[:-1], own
        around = Around(self.lattice, places)
        shares = shares[:-1] + self.share_added(self._mean, around)
        own = np.maximum(own + self.own_added(around), 0.0)
        return shares, own * np.exp(-(self.field_at(places) @ self._mean))

    def shares(self, places: np.ndarray, radius: float) -> tuple[np.ndarray, np.ndarray]:
        """H (n, Q) of discs of `radius`, m, at `places` (Q, 2), on the sheet that it is right about,
        and its slopes (2, n, Q), 1/m: from tables."""
        share, slopes = self.core.discs(places, radius)
        return share, np.array(slopes)

    def admittance_of(self, sheet: np.ndarray) -> np.ndarray:
        """(n, n) Y0, S, of the sheet with coefficients `sheet` (J,)."""
        if self._rest is None and not sheet.any():
            return self.admittance
        changed = self._changed(sheet)
        out = np.where(self.seen, self._scaled(changed), self.admittance + changed)
        return _balanced(out if self._rest is None else out + self._rest.term)

    def _changed(self, sheet: np.ndarray) -> np.ndarray:
        """(n, n) what `sheet` adds: to the logarithm of Y0 where electrodes see each other, else
        to Y0, S."""
        return (sheet @ self._change.reshape(self.modes, -1)).reshape(self.admittance.shape)

    def _scaled(self, changed: np.ndarray) -> np.ndarray:
        """Y0 with the factor that follows from `_changed`, where electrodes see each other."""
        logarithm = changed if self._rest is None else changed + self._rest.factor
        return self.admittance * np.exp(np.clip(logarithm, -2, 2))

    def share_added(self, sheet: np.ndarray, around: Around) -> np.ndarray:
        """(n, Q) what the coefficients `sheet` (J,) add to H at places."""
        return self.added_at(sheet, around.nodes) @ around.weights.T

    def added_at(self, sheet: np.ndarray, nodes: np.ndarray) -> np.ndarray:
        """(n, m) what the coefficients `sheet` (J,) add to H at `nodes` (m,) of the lattice."""
        near = self._share_change[:, nodes]
        added = (sheet @ near.reshape(len(sheet), -1)).reshape(near.shape[1:]).T
        return added if self._rest is None else added + self._rest.share[nodes].T

    def own_added(self, around: Around) -> np.ndarray | float:
        """(Q,) what the sheet adds to D of a place with itself, ohm of an even one; beside the local
        conductance."""
        return 0.0 if self._rest is None else around.weights @ self._rest.own[around.nodes]

    def field_at(self, places: np.ndarray) -> np.ndarray:
        """(Q, J) logarithm of the sheet's conductance at `places` (Q, 2) for each coefficient."""
        out = np.zeros((len(places), self.modes))
        out[:, : self.field.count] = self.field.at(places)
        return out

    @property
    def modes(self) -> int:
        return len(self.deviation)

    @property
    def of_cut(self) -> slice:
        """Which of the coefficients are geometry: ways of the rim, then the radius."""
        return slice(self.field.count + 2, self.modes)

    @property
    def of_rim(self) -> slice:
        """Which of the coefficients are ways of the rim."""
        return slice(self.field.count + 2, self.modes - 1)

    @cached_property
    def expected(self) -> np.ndarray:
        """(n, n) Y0, S, of the sheet that it is right about."""
        return self.admittance_of(self._mean)

    @cached_property
    def own_impedance(self) -> np.ndarray:
        """(n,) impedance of each electrode against all others, ohm."""
        tied = np.trace(self.admittance) / self.count**2  # Y0 + tied 1 1^T is not singular
        own = np.linalg.inv(self.admittance + tied).diagonal()
        return own - 1 / (tied * self.count**2)

    @cached_property
    def by_radius(self) -> np.ndarray:
        """(E,) ohm that an electrode's impedance falls by per logarithm of its radius: what spreads
        from a half disc at the rim spreads twice as much, from a quarter four times."""
        return _by_radius(self.layout)

    @property
    def inexact(self) -> np.ndarray:
        """(n,) standard deviation of what the model errs in the impedance of each electrode, ohm: in
        every frame another one, like a resistance to ground of its own."""
        return _INEXACT * self.own_impedance

    @cached_property
    def untouched(self) -> np.ndarray:
        """(n, n) Z of a sheet that is as good as untouched, ohm."""
        least = _LEAK * np.trace(self.expected) / self.count**2
        inverse = np.linalg.inv(self.expected + least)
        return (inverse + inverse.T) / 2


def _by_radius(layout: Layout) -> np.ndarray:
    """`SheetOperator.by_radius` of a layout."""
    turn = 2 * np.pi / _ROUND * (np.arange(_ROUND) + 0.5)
    ring = layout.radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    around = (layout.positions[:, None] + ring).reshape(-1, 2)
    inside = layout.outline.contains(around).reshape(-1, _ROUND).mean(axis=1)
    return layout.sheet_resistance / (2 * np.pi * inside)


def _balanced(matrices: np.ndarray) -> np.ndarray:
    """The same (..., n, n) with diagonals that make the rows sum to 0."""
    own = np.arange(matrices.shape[-1])
    out = matrices.copy()
    out[..., own, own] = 0.0
    out[..., own, own] = -(out @ np.ones(len(own)))
    return out


@dataclass(frozen=True)
class _Of:
    """A layout among those that are the `same` to an operator."""

    layout: Layout = field(compare=False)
    same: tuple


def operator_for(
    layout: Layout, model: str = "auto", used: ArrayLike | None = None
) -> SheetOperator:
    """The operator of a layout's sheet as drawn, made once for all who ask; all electrodes but `used`
    (n,) float."""
    same = layout.id, layout.sheet_resistance, layout.tolerance, layout.surface, layout.scan
    every = range(layout.electrodes)
    return made(
        _Of(layout, same), model, tuple(every if used is None else np.asarray(used).tolist())
    )


@lru_cache(maxsize=_KEPT)
def made(of: _Of, model: str, used: tuple[int, ...]) -> SheetOperator:
    """Those that were asked for; `made.cache_clear()` forgets them."""
    every = tuple(range(of.layout.electrodes))
    if used == every:
        return SheetOperator(of.layout, model)
    return made(of, model, every).of(np.array(used, int))
