"""A third model of the sheet, for scoring: neither simulator nor reconstruction scores itself.

    -div(sigma grad phi) + g (phi - V0) = 0 in the sheet,    sigma dphi/dn = 0 on the rim

with quadratic triangles that are bent along the rims of electrodes and contacts (`reference_mesh`;
scikit-fem, Gustafsson and McBain 2020). Contacts are areas, the sheet's conductance is any field,
also anisotropic. Nothing is shared with `tomotactile_ros.sheet`.

The driving layer is the reference. All that the electrodes can tell is then one symmetric matrix,
the currents Y u that they draw at the potentials u, from one factorisation; with electrode l
grounded through R_l and the others floating,

    v_n = V0 (1 - Z_nl / (Z_ll + R_l)),    Z = Y^-1

A row of Y sums to the current y that the driving layer alone sends to the electrode, per volt.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy import sparse
from scipy.sparse.linalg import splu

from tomotactile_ros.bench.reference_mesh import (
    NEEDED,
    Shape,
    default_size,
    disc,
    make_mesh,
    rim_size,
)
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.region import Region
from tomotactile_ros.scenes.contact import Contact
from tomotactile_ros.support.errors import InputError

Conductance = Callable[[np.ndarray], np.ndarray]  # S (n,) or (n, 2, 2) at points (n, 2), m
_LAYERS = 0.5  # elements along a rim per length in which the potential falls under a contact


@dataclass(frozen=True, eq=False)
class Admittance:
    """What the electrodes see of one state of the sheet.

    between : (E, E) S, symmetric, conductances between electrodes; its diagonal is 0
    drive : (E,) S, y, from the driving layer to each electrode
    """

    between: np.ndarray
    drive: np.ndarray

    @property
    def matrix(self) -> np.ndarray:
        """(E, E) Y, S."""
        return np.diag(self.drive + self.between.sum(axis=1)) - self.between

    @property
    def packed(self) -> np.ndarray:
        """(E (E + 1) / 2,) the upper triangle of `between`, with `drive` as its diagonal.

        Y is made again from it by sums of like sign: rounding to single precision is harmless.
        """
        whole = self.between + np.diag(self.drive)
        return whole[np.triu_indices(len(whole))]

    @classmethod
    def unpack(cls, packed: ArrayLike) -> Admittance:
        """The inverse of `packed`."""
        packed = np.asarray(packed, float)
        count = (round((1 + 8 * len(packed)) ** 0.5) - 1) // 2
        whole = np.zeros((count, count))
        whole[np.triu_indices(count)] = packed
        drive = np.diagonal(whole).copy()
        np.fill_diagonal(whole, 0.0)
        return cls(whole + whole.T, drive)


class ReferenceSheet:
    """Reference model of `layout`.

    Parameters
    ----------
    conductance : of the sheet, S, function of points (n, 2) -> (n,) or (n, 2, 2); uniform, as the
        layout says, without it
    h : element size away from rims, m; those at rims shrink with it. A fiftieth of the longer side
        without it
    lines : polylines (V, 2) that elements follow, with the size of elements there, m: where the
        conductance jumps
    """

    def __init__(
        self,
        layout: Layout,
        conductance: Conductance | None = None,
        *,
        h: float | None = None,
        lines: Sequence[tuple[np.ndarray, float]] = (),
    ):
        self.layout = layout
        self.h = h or default_size(layout)
        self.lines = lines
        self._conductance = conductance

    def solve(self, contacts: Sequence[tuple[Shape | Contact, float]]) -> Admittance:
        """What the electrodes see of `contacts`.

        Each is a form and its conductance per area, S/m^2. Forms are `disc(...)`, an `Ellipse`, a
        `Region` or a `Contact`; where they overlap they conduct side by side. A conductance of infinity is a bare conductor at the drive voltage; it may not
        touch an electrode. What lies outside the outline does not touch.
        """
        placed = [(_shape(form), flow) for form, flow in contacts]
        mesh = self._mesh(placed)
        centres = mesh.p[:, mesh.t].mean(axis=1).T
        basis, matrix = self._stiffness(mesh)
        count = self.layout.electrodes
        group = self._electrode_dofs(basis, centres)
        layer = np.zeros(basis.N)
        for shape, flow in placed:
            inside = np.flatnonzero(shape.contains(centres))
            if np.isinf(flow):
                held = basis.element_dofs[:, inside]
                if (group[held] >= 0).any():
                    raise InputError("contacts: a bare conductor touches an electrode")
                group[held] = count
            elif len(inside):
                touch = _mass(mesh, inside, flow)
                matrix = matrix + touch
                layer += touch @ np.ones(basis.N)
        return _schur(matrix, layer, group, count)

    def _mesh(self, contacts):
        MeshTri2 = _skfem().MeshTri2
        sizes = []
        for shape, flow in contacts:
            size = rim_size(self.layout, shape, self.h)
            if 0 < flow < np.inf:
                depth = (self.layout.sheet_resistance * flow) ** -0.5
                size = min(size, _LAYERS * depth * self.h / default_size(self.layout))
            sizes.append(size)
        shapes = [shape for shape, _ in contacts]
        points, triangles = make_mesh(self.layout, shapes, sizes, self.h, self.lines)
        return MeshTri2(np.ascontiguousarray(points.T), np.ascontiguousarray(triangles.T))

    def _stiffness(self, mesh):
        skfem = _skfem()
        basis = skfem.Basis(mesh, skfem.ElementTriP2(), intorder=4)
        points = np.asarray(basis.global_coordinates())
        flat = points.reshape(2, -1).T
        if self._conductance is None:
            values = np.full(len(flat), 1 / self.layout.sheet_resistance)
        else:
            values = np.asarray(self._conductance(flat), float)
        if values.ndim == 1:
            values = values[:, None, None] * np.eye(2)
        sigma = np.moveaxis(values, 0, -1).reshape(2, 2, *points.shape[1:])

        @skfem.BilinearForm
        def flow(u, v, w):
            return np.einsum("ijkl,jkl,ikl->kl", w.sigma, u.grad, v.grad)

        return basis, flow.assemble(basis, sigma=sigma).tocsr()

    def _electrode_dofs(self, basis, centres):
        """(N,) electrode of each degree of freedom, -1 where it lies on none."""
        distance, nearest = self.layout.nearest(centres)
        group = np.full(basis.N, -1)
        for electrode in range(self.layout.electrodes):
            on = (nearest == electrode) & (distance < self.layout.radius)
            group[basis.element_dofs[:, on]] = electrode
        return group


def reference_frame(
    states: Admittance | Sequence[Admittance],
    drive_voltage: float,
    *,
    ground_resistance: ArrayLike = 0.0,
    grounded: ArrayLike | None = None,
) -> np.ndarray:
    """(L, E) voltages, V; NaN on the grounded electrode.

    Parameters
    ----------
    states : of the whole frame, or one for each row: contacts that move from row to row
    ground_resistance : between each electrode (E,), or all, and ground, ohm
    grounded : (L,) grounded electrode of each row; all in turn without it
    """
    electrodes = len((states if isinstance(states, Admittance) else states[0]).drive)
    grounded = np.arange(electrodes) if grounded is None else np.asarray(grounded, int)
    resistance = np.broadcast_to(np.asarray(ground_resistance, float), electrodes)[grounded]
    rows = np.arange(len(grounded))
    if isinstance(states, Admittance):
        columns = _impedance(states)[:, grounded]
    else:
        columns = np.column_stack(
            [_impedance(state)[:, ground] for state, ground in zip(states, grounded, strict=True)]
        )
    own = columns[grounded, rows]
    driven = np.isfinite(own)  # else nothing touches, and every reading is 0 V
    voltages = np.zeros((len(grounded), electrodes))
    share = columns[:, driven] / (own + resistance)[driven]
    voltages[driven] = drive_voltage * (1 - share.T)
    voltages[rows, grounded] = np.nan
    return voltages


def _impedance(state):
    """(E, E) Z, ohm; infinite where nothing touches."""
    if not state.drive.sum() > 0:
        return np.full(state.between.shape, np.inf)
    return np.linalg.inv(state.matrix)


def _skfem():
    try:
        import skfem
    except ImportError:
        raise InputError(NEEDED) from None
    return skfem


def _shape(form) -> Shape:
    if isinstance(form, Contact):
        return disc(form.center, form.radius) if form.shape == "disc" else Region(form.vertices)
    return form


def _mass(mesh, elements, flow):
    """Integral of g u v over `elements`."""
    skfem = _skfem()
    basis = skfem.Basis(mesh, skfem.ElementTriP2(), intorder=6, elements=elements)

    @skfem.BilinearForm
    def form(u, v, w):
        return flow * u * v

    return form.assemble(basis).tocsr()


def _schur(matrix, layer, group, count) -> Admittance:
    """Eliminate all but the electrodes, groups 0 to `count` - 1; group `count` is the driving
    layer.

    `matrix` (N, N) is that of the sheet with its contacts, `layer` (N,) its coupling to the driving
    layer.
    """
    free = np.flatnonzero(group < 0)
    tied = np.flatnonzero(group >= 0)
    ones = np.ones(len(tied))
    gather = sparse.csr_matrix((ones, (tied, group[tied])), (len(group), count + 1))
    right = (matrix[free] @ gather).toarray()
    own = (gather.T @ matrix @ gather).toarray()
    factor = splu(
        matrix[free][:, free].tocsc(),
        permc_spec="MMD_AT_PLUS_A",
        diag_pivot_thresh=0.0,
        options={"SymmetricMode": True},
    )
    solved = factor.solve(right[:, :count])
    # to the driving layer: what is tied to it, and what contacts feed
    feed = layer[free] - right[:, count]
    drive = gather[:, :count].T @ layer - own[:count, count] - solved.T @ feed
    between = right[:, :count].T @ solved - own[:count, :count]
    between = (between + between.T) / 2
    np.fill_diagonal(between, 0.0)
    return Admittance(between, drive)
