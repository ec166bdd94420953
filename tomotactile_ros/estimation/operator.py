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
from itertools import pairwise
from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from scipy.sparse import csr_matrix

from tomotactile_ros.core import compiled
from tomotactile_ros.estimation.as_cut import COUNT, AsCut, Tears
from tomotactile_ros.estimation.channels import ALIKE
from tomotactile_ros.estimation.disc import MOST_PATCHES, unit_patches
from tomotactile_ros.estimation.displacement import Displacement
from tomotactile_ros.estimation.field import SheetField
from tomotactile_ros.estimation.rim import Rim
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
from tomotactile_ros.sheet.fem import FemSheet

# couplings above this part of the largest admittance change by a factor, others by a sum
_SEEN = 2e-3
_KEPT = 4  # operators, the last that were asked for: one takes 0.6 s with 64 electrodes
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

    def __init__(self, layout: Layout, model: str = "auto", used: ArrayLike | None = None):
        self.layout, self._model = layout, model
        self.used = np.arange(layout.electrodes) if used is None else np.asarray(used, int)
        self.count = len(self.used)
        self.position = np.full(layout.electrodes, -1)
        self.position[self.used] = np.arange(self.count)
        self.resistance = float(layout.sheet_resistance)
        self.pitch = float(np.median(layout.pitches))
        self.lattice = Lattice(np.array(layout.outline.size, float), _LATTICE)
        self._cut = AsCut(layout, np.zeros(COUNT))
        self._solve()
        self._uneven(None)
        self._rest: Rest | None = None
        self._mean = np.zeros(self.modes)
        self._even: Solution | None = None
        self._tables = self._handed_over()

    @property
    def cut(self) -> Layout:
        return self._cut.layout

    def _solve(self) -> None:
        """The even sheet as it was cut."""
        cut = self.cut
        self.sheet = make_sheet(cut, "auto" if self._cut.tears else self._model)
        self._inverse = bordered_inverse(self.sheet.electrode_electrode, self.used)
        self.admittance = self._inverse[:-1, :-1].copy()
        size, fine = np.array(cut.outline.size, float), Lattice.fine(cut, self.pitch)
        sensed = Sensed(self.sheet, self.used, mirrored(fine.points, size / 2))
        self.potentials = PotentialTable(cut, self.used, fine, sensed)
        self.mutual = MutualTable(self.sheet, self.lattice, self.potentials, sensed, self._inverse)
        self.displacement = Displacement(
            cut, self.used, self.resistance, self.potentials, self._inverse
        )

    def about(self, sheet: np.ndarray, tears: Tears = ()) -> SheetOperator:
        """The same for a sheet whose coefficients are near `sheet` (J,): right beyond first order
        there, and with `tears`."""
        other, cut, fem = copy(self), AsCut(self.layout, sheet[self.of_cut], tears), None
        for known in ("expected", "untouched", "core", "own_impedance"):
            other.__dict__.pop(known, None)
        if not self._cut.near(cut):
            other._cut, other._even = cut, None
            other._solve()
            fem = other._uneven(self.field)
            other._tables = other._handed_over()
        other._expand(sheet, fem)
        return other

    def _expand(self, sheet: np.ndarray, fem: FemSheet | None) -> None:
        """Be right about the coefficients `sheet` (J,) of a sheet so cut; `fem` of the even one, where it is
        at hand."""
        size = np.array(self.cut.outline.size)
        places = off_electrodes(mirrored(self.lattice.points, size / 2), self.cut)
        if self._even is None:
            fem = fem or FemSheet(self.cut)
            self._mesh, self._even = fem.mesh, solution(fem, self.used, places, self.pitch)
        even, alone, drawn = self._even, sheet.copy(), np.zeros(self.modes)
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
        self._mean = sheet.copy()

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

    def cut_as(self, cut: np.ndarray) -> SheetOperator:
        """The same for a sheet of the geometry `cut` (9,)."""
        about = self._mean.copy()
        about[self.of_cut] = cut
        return self.about(about)

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
                "fine": self.potentials.lattice.core,
                "coarse": self.lattice.core,
                "potentials": self.potentials.rest,
                "own": self.mutual.own_rest,
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

    def admittance_change(self, sheet: np.ndarray) -> np.ndarray:
        """(J, n, n) derivative of `admittance_of`, S."""
        if self._rest is None and not sheet.any():
            return self._first_change
        scaled = self._scaled(self._changed(sheet))
        return _balanced(self._change * np.where(self.seen, scaled, 1.0))

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

    def _uneven(self, field: SheetField | None) -> FemSheet:
        """Modes of the sheet, those of `field` where there are some, and what they change, from finite
        elements, which are returned."""
        fem = self.sheet if isinstance(self.sheet, FemSheet) else FemSheet(self.cut)
        mesh, used = fem.mesh, self.used
        inverse = bordered_inverse(fem.electrode_electrode, used)
        fed = np.vstack([fem._to_electrodes.T[used], np.ones(len(fem.where))])
        shares = (inverse @ fed)[:-1].T[fem.unknown]
        corners, area, slope = _gradients(mesh.points, mesh.triangles)
        middles = corners.mean(axis=1)
        self.field = (
            field.on(middles) if field else SheetField(self.layout, middles, area, self.pitch)
        )
        order, ends = self.field.order, self.field.ends
        root = np.sqrt(area / self.resistance)[:, None, None]
        gradient = (root * np.einsum("tcd,tcn->tdn", slope, shares[mesh.triangles]))[order]
        cells = len(ends) - 1
        by_cell = np.empty((cells, self.count, self.count))
        for cell in range(cells):
            part = gradient[ends[cell] : ends[cell + 1]].reshape(-1, self.count)
            by_cell[cell] = part.T @ part
        along, across = gradient[:, 0], gradient[:, 1]
        mixed = along.T @ across
        modes = self.field.modes
        layout = self.layout
        cut_to = layout.tolerance.cut(layout.outline.size)
        self.rim = Rim(self.cut.outline, cut_to, mesh.points, mesh.triangles)
        strips, cut = self.rim.changes(shares, self.resistance)
        change = np.concatenate(
            [
                np.tensordot(modes.T, by_cell, 1),
                [along.T @ along - across.T @ across, mixed + mixed.T],
                cut,
            ]
        )
        wider = self.displacement.wider(_by_radius(self.cut)[used])
        seen = np.abs(self.admittance) > _SEEN * np.abs(self.admittance.diagonal()).max()
        np.fill_diagonal(seen, False)
        self.seen = seen
        parts = [(change, by_cell.sum(axis=0)), (wider[None], self.admittance)]
        self._change = np.concatenate(
            [np.where(seen, each / np.where(seen, total, 1.0), each) for each, total in parts]
        )
        for each in self._change:
            np.fill_diagonal(each, 0.0)
        self._first_change = _balanced(self._change * np.where(seen, self.admittance, 1.0))
        printed = float(np.sqrt(ALIKE)) * layout.tolerance.radius  # what is common to all radii
        self.deviation = np.concatenate([self.field.deviation, self.rim.deviation, [printed]])
        self._shares_on_lattice(fem, inverse, fed, slope, root, gradient, strips)
        return fem

    def _shares_on_lattice(
        self,
        fem: FemSheet,
        inverse: np.ndarray,
        fed: np.ndarray,
        slope: np.ndarray,
        root: np.ndarray,
        gradient: np.ndarray,
        strips: np.ndarray,
    ) -> None:
        mesh, order, ends = fem.mesh, self.field.order, self.field.ends
        size = np.array(self.cut.outline.size)
        places = mirrored(self.lattice.points, size / 2)
        element, weights = mesh.locate(places)
        corners = fem.unknown[mesh.triangles[element]]
        feed = np.zeros((len(fem.where), len(places)))
        for corner in range(3):
            np.add.at(feed, (corners[:, corner], np.arange(len(places))), weights[:, corner])
        at_places = np.einsum("kce,kc->ek", fem._to_electrodes[corners], weights)[self.used]
        at_places = np.vstack([at_places, np.ones(len(places))])
        potential = fem._solve(feed) - fed.T @ (inverse @ at_places)
        field = self.field.cell_values(places)
        count, unknowns = len(potential), fem.unknown[mesh.triangles[order]]  # (T, 3)
        slopes = (root * slope.transpose(0, 2, 1))[order]  # (T, 2, 3)
        # what the currents of H bring to the unknowns of each cell: fewer than elements
        inside = np.repeat(np.arange(len(ends) - 1), np.diff(ends))[:, None] * count + unknowns
        pairs, number = np.unique(inside, return_inverse=True)
        brought = _scattered(slopes, number.reshape(-1, 3), len(pairs)) @ _flat(gradient)
        at = np.searchsorted(pairs, np.arange(len(ends)) * count)
        by_cell = np.empty((len(ends) - 1, len(places), self.count))
        for cell, (low, high) in enumerate(pairwise(at)):
            by_cell[cell] = -potential[pairs[low:high] % count].T @ brought[low:high]
        change = np.tensordot(self.field.modes.T, by_cell, 1)
        change -= field.T[:, :, None] * by_cell.sum(axis=0)
        turned = gradient * [[1.0], [-1.0]], gradient[:, ::-1]  # along less across, and mixed
        gather = _scattered(slopes, unknowns, count)
        ways = [-potential.T @ (gather @ _flat(each)) for each in turned]
        begins, ends = potential[fem.unknown[self.rim.ends]]
        corners, weights = mesh.locate(self.displacement.ring)
        on_ring = np.einsum("rcp,rc->rp", potential[fem.unknown[mesh.triangles[corners]]], weights)
        wider = self.displacement.wider_seen(_by_radius(self.cut)[self.used], on_ring)
        self._share_change = np.concatenate(
            [change, ways, -(ends - begins).T @ strips, wider.T[None]]
        )


def _by_radius(layout: Layout) -> np.ndarray:
    """`SheetOperator.by_radius` of a layout."""
    turn = 2 * np.pi / _ROUND * (np.arange(_ROUND) + 0.5)
    ring = layout.radius * np.stack([np.cos(turn), np.sin(turn)], axis=1)
    around = (layout.positions[:, None] + ring).reshape(-1, 2)
    inside = layout.outline.contains(around).reshape(-1, _ROUND).mean(axis=1)
    return layout.sheet_resistance / (2 * np.pi * inside)


def _flat(gradient: np.ndarray) -> np.ndarray:
    """(2 T, n) of (T, 2, n)."""
    return gradient.reshape(-1, gradient.shape[2])


def _scattered(slopes: np.ndarray, unknowns: np.ndarray, count: int) -> csr_matrix:
    """(count, 2 T) sums over elements of their `slopes` (T, 2, 3) at `unknowns` (T, 3)."""
    ends = np.arange(0, slopes.size + 1, 3)
    columns = np.repeat(unknowns, 2, axis=0).ravel()
    return csr_matrix((slopes.ravel(), columns, ends), (len(ends) - 1, count)).T


def _balanced(matrices: np.ndarray) -> np.ndarray:
    """The same (..., n, n) with diagonals that make the rows sum to 0."""
    own = np.arange(matrices.shape[-1])
    out = matrices.copy()
    out[..., own, own] = 0.0
    out[..., own, own] = -(out @ np.ones(len(own)))
    return out


def _gradients(
    points: np.ndarray, triangles: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Corners (T, 3, 2), areas (T,) and gradients (T, 3, 2) of the shape functions of triangles."""
    corners = points[triangles]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    u, v = b - a, c - a
    area = 0.5 * (u[:, 0] * v[:, 1] - u[:, 1] * v[:, 0])
    edges = np.stack([c - b, a - c, b - a], axis=1)
    slope = np.stack([-edges[:, :, 1], edges[:, :, 0]], axis=-1) / (2 * area)[:, None, None]
    return corners, area, slope


@dataclass(frozen=True)
class _Of:
    """A layout among those that are the `same` to an operator."""

    layout: Layout = field(compare=False)
    same: tuple


def operator_for(
    layout: Layout, model: str = "auto", used: ArrayLike | None = None
) -> SheetOperator:
    """The operator of a layout's sheet as drawn, made once for all who ask; arguments as of `SheetOperator`."""
    same = layout.id, layout.sheet_resistance, layout.tolerance, layout.surface, layout.scan
    used = np.arange(layout.electrodes) if used is None else np.asarray(used, int)
    return made(_Of(layout, same), model, tuple(used.tolist()))


@lru_cache(maxsize=_KEPT)
def made(of: _Of, model: str, used: tuple[int, ...]) -> SheetOperator:
    """Those that were asked for; `made.cache_clear()` forgets them."""
    return SheetOperator(of.layout, model, used)
