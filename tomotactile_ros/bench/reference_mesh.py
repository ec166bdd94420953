"""Curved quadratic triangles that follow electrodes, contacts and outline, made by Gmsh.

Gmsh (https://gmsh.info, Geuzaine and Remacle 2009) cuts the outline by the rims of all electrodes
and contacts and meshes what is between them; triangles along a circle or an ellipse are bent to it.
Elements are small at rims and grow with the distance from them.
"""

from __future__ import annotations

import math
import signal
from collections.abc import Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import chain, pairwise

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.layouts.region import Region, turned
from tomotactile_ros.support.errors import InputError

NEEDED = "the reference model needs Gmsh and scikit-fem: python3 -m pip install gmsh scikit-fem"
_GROWTH = 0.3  # of an element's size per distance from the next rim
_RIM_STEPS = 16  # elements along the rim of an electrode or a contact at the coarsest `h`
_BACKGROUND = 50  # elements along the longer side by default


@dataclass(frozen=True)
class Ellipse:
    """Rim of a contact: `semi_axes` (a, b), m, the first at `angle` (degrees) to the x axis."""

    center: tuple[float, float]
    semi_axes: tuple[float, float]
    angle: float = 0.0

    @property
    def perimeter(self) -> float:
        """About (Ramanujan), m."""
        a, b = self.semi_axes
        return math.pi * (3 * (a + b) - math.sqrt((3 * a + b) * (a + 3 * b)))

    def contains(self, points: np.ndarray) -> np.ndarray:
        """(n,) which of the points (n, 2) lie inside."""
        along = turned(points - self.center, -self.angle)
        return ((along / self.semi_axes) ** 2).sum(axis=1) < 1


def disc(center: Sequence[float] | np.ndarray, radius: float) -> Ellipse:
    """A disc as an `Ellipse`."""
    return Ellipse((center[0], center[1]), (radius, radius))


Shape = Ellipse | Region


def default_size(layout: Layout) -> float:
    """Element size between rims where none is asked for, m."""
    return max(layout.outline.size) / _BACKGROUND


def make_mesh(
    layout: Layout,
    shapes: Sequence[Shape],
    sizes: Sequence[float],
    h: float,
    lines: Sequence[tuple[np.ndarray, float]] = (),
):
    """Nodes (N, 2), m, and triangles (T, 6): corners, then the middles of the sides 01, 12, 20.

    Parameters
    ----------
    shapes, sizes : contacts, and the largest element along the rim of each, m
    h : element size away from all rims, m
    lines : polylines (V, 2) that elements follow, with the size of elements along them, m
    """
    with _gmsh() as gmsh:
        occ = gmsh.model.occ
        sheet = _surface(occ, layout.outline)
        discs = [(2, occ.addDisk(x, y, 0, *2 * [layout.radius])) for x, y in layout.positions]
        contacts = [(2, _surface(occ, shape)) for shape in shapes]
        cuts = [[(1, tag) for tag in _polyline(occ, points)] for points, _ in lines]
        tools = [*discs, *contacts, *chain.from_iterable(cuts)]
        _, made = occ.fragment([(2, sheet)], tools)
        inside = set(made[0])
        occ.remove([part for part in occ.getEntities(2) if part not in inside], recursive=True)
        occ.synchronize()
        kept = set(gmsh.model.getEntities(1))
        centres = [occ.addPoint(x, y, 0) for x, y in layout.positions]
        occ.synchronize()
        around = {"PointsList": centres}
        fields = [_near(gmsh, around, _rim_size(layout, h), h, layout.radius)]
        pieces = iter(made[1 + len(discs) :])
        curves = []
        for size in sizes:
            parts = [part for part in next(pieces) if part in inside]
            rim = gmsh.model.getBoundary(parts, combined=True, oriented=False)
            curves.append((rim, size))
        for (_, size), cut in zip(lines, cuts):
            curves.append(([each for _ in cut for each in next(pieces) if each in kept], size))
        for found, size in curves:
            if found and size < h:
                around = {"CurvesList": [tag for _, tag in found]}
                fields.append(_near(gmsh, around, size, h, 0.0))
        _generate(gmsh, fields, h)
        return _nodes_and_triangles(gmsh)


@contextmanager
def _gmsh():
    try:
        import gmsh
    except ImportError:
        raise InputError(NEEDED) from None
    except OSError as error:  # the wheel needs libraries of the system, such as libGLU
        raise InputError(f"the reference model needs Gmsh, which does not start: {error}") from None
    before = {number: signal.getsignal(number) for number in (signal.SIGPIPE, signal.SIGINT)}
    gmsh.initialize(readConfigFiles=False, interruptible=False)
    for number, handler in before.items():  # of which Gmsh makes what ends the process
        signal.signal(number, handler)
    try:
        gmsh.option.setNumber("General.Terminal", 0)
        gmsh.option.setNumber("General.NumThreads", 1)
        yield gmsh
    except Exception as error:
        if type(error) is not Exception:  # that is what Gmsh raises
            raise
        raise InputError(f"Gmsh finds no mesh: {' '.join(str(error).split())}") from None
    finally:
        gmsh.finalize()


def _surface(occ, shape: Shape) -> int:
    """Tag of a surface with the rim of `shape`."""
    if isinstance(shape, Ellipse):
        (x, y), (a, b) = shape.center, shape.semi_axes
        angle = math.radians(shape.angle)
        if b > a:  # Gmsh takes the longer one first
            a, b, angle = b, a, angle + math.pi / 2
        return occ.addDisk(x, y, 0, a, b, xAxis=[math.cos(angle), math.sin(angle), 0])
    if isinstance(shape, Outline) and shape.kind == "circle":
        sheet = occ.addDisk(0, 0, 0, shape.radius, shape.radius)
    else:
        sheet = _polygon(occ, shape.shell)
    holes = [(2, _polygon(occ, hole)) for hole in shape.holes]
    return occ.cut([(2, sheet)], holes)[0][0][1] if holes else sheet


def _polygon(occ, corners) -> int:
    points = [occ.addPoint(x, y, 0) for x, y in corners]
    sides = [occ.addLine(p, q) for p, q in zip(points, points[1:] + points[:1])]
    return occ.addPlaneSurface([occ.addCurveLoop(sides)])


def _polyline(occ, corners) -> list[int]:
    points = [occ.addPoint(x, y, 0) for x, y in corners]
    return [occ.addLine(p, q) for p, q in pairwise(points)]


def _rim_size(layout, h):
    """Elements along an electrode's rim, m: shorter as `h` is smaller than its default."""
    return min(h, 2 * math.pi * layout.radius / _RIM_STEPS * h / default_size(layout))


def rim_size(layout: Layout, shape: Shape, h: float) -> float:
    """Elements along a contact's rim that its form alone asks for, m."""
    if isinstance(shape, Region):
        return min(h, min(shape.size) / 4 * h / default_size(layout))
    return min(h, shape.perimeter / _RIM_STEPS * h / default_size(layout))


def _near(gmsh, around, size, h, start):
    """A field of sizes: `size` up to the distance `start`, m, from all that is `around`, then up to `h`."""
    distance = gmsh.model.mesh.field.add("Distance")
    for key, tags in around.items():
        gmsh.model.mesh.field.setNumbers(distance, key, tags)
    gmsh.model.mesh.field.setNumber(distance, "Sampling", 200)
    field = gmsh.model.mesh.field.add("Threshold")
    for key, value in {
        "InField": distance,
        "SizeMin": size,
        "SizeMax": h,
        "DistMin": start,
        "DistMax": start + max(h - size, 1e-3 * h) / _GROWTH,
    }.items():
        gmsh.model.mesh.field.setNumber(field, key, value)
    return field


def _generate(gmsh, fields, h):
    least = gmsh.model.mesh.field.add("Min")
    gmsh.model.mesh.field.setNumbers(least, "FieldsList", fields)
    gmsh.model.mesh.field.setAsBackgroundMesh(least)
    for key, value in {
        "Mesh.MeshSizeExtendFromBoundary": 0,
        "Mesh.MeshSizeFromPoints": 0,
        "Mesh.MeshSizeFromCurvature": 0,
        "Mesh.MeshSizeMax": h,
        "Mesh.Algorithm": 5,  # Delaunay: the fastest, takes graded sizes well
        "Mesh.ElementOrder": 2,
    }.items():
        gmsh.option.setNumber(key, value)
    gmsh.model.mesh.generate(2)


def _nodes_and_triangles(gmsh):
    tags, coordinates, _ = gmsh.model.mesh.getNodes()
    number = np.full(int(tags.max()) + 1, -1)
    number[tags.astype(int)] = np.arange(len(tags))
    _, nodes = gmsh.model.mesh.getElementsByType(9)  # triangles of six nodes
    triangles = number[nodes.astype(int)].reshape(-1, 6)
    used, triangles = np.unique(triangles, return_inverse=True)
    points = coordinates.reshape(-1, 3)[used, :2]
    return points, triangles.reshape(-1, 6)
