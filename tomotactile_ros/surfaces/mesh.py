"""The surface of a part, from its mesh: the sheet is laid onto it from its centre outwards.

A point of the sheet at distance r and angle a from the centre lies where the straightest geodesic
of the mesh ends that leaves the centre at angle a and is r long (Polthier and Schmies 1998): the
exponential map of the surface. On what can be unrolled (cylinders, cones, bent plates) it keeps all
lengths; elsewhere the sheet is stretched, and `check_stretch` refuses what no sheet stands.
"""

import io
import os
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import find_shared, read_limited
from tomotactile_ros.surfaces.point_grid import PointGrid

MAX_BYTES = 100_000_000
MAX_FACES = 2_000_000
KINDS = ("stl", "obj", "ply", "off")  # not what trimesh unpacks first, nor what names more files
_SAMPLES = 65  # a side of the grid that is laid down
_PACKAGE = "package://"
_STEEP = 0.1  # of its length is the least of the x axis that has to lie along the surface
_ASIDE = 1e-6  # from the centre towards the middle of its face, so that no line starts at a corner


@dataclass(frozen=True, eq=False, kw_only=True)
class Mesh(PointGrid):
    """A sheet on a mesh, as the points that were laid down; use :meth:`load`.

    Parameters
    ----------
    file : as given: a path, or ``package://NAME/...`` for a file that a ROS package shares.
    center : (3,) where the centre of the sheet is, in the mesh's frame, m; the nearest point of
        the mesh is taken.
    x_axis : (3,) where the sheet's x points there; projected onto the surface.
    scale : m per unit of the file.
    folder : which a path is relative to.
    """

    file: str
    center: tuple[float, float, float]
    x_axis: tuple[float, float, float]
    scale: float
    folder: Path

    kind = "mesh"

    @classmethod
    def load(cls, file, center, x_axis, scale, folder: Path, size: tuple[float, float]) -> "Mesh":
        """Read the mesh and lay a sheet of this size (m) onto it; InputError where it does not
        fit."""
        scale = checks.positive(scale, "mesh.scale", "number of m per unit")
        vertices, faces = _read(_resolve(file, folder))
        vertices *= scale
        if not (np.abs(vertices) <= checks.LONGEST).all():
            raise InputError(f"mesh.file: {file}: a corner has no finite lengths in m")
        points = _Drape(vertices, faces).lay(np.array(center), np.array(x_axis), size)
        given = {"center": tuple(center), "x_axis": tuple(x_axis), "scale": scale, "folder": folder}
        return cls(points, size, "mesh", file=file, **given)

    def to_dict(self, folder: Path) -> dict:
        """The surface as in a layout file in this folder."""
        file = self.file
        if not file.startswith(_PACKAGE) and not os.path.isabs(file):
            file = os.path.relpath(self.folder / file, folder)
        keys = {"file": file, "center": self.center, "x_axis": self.x_axis, "scale": self.scale}
        return {"mesh": keys}


def _resolve(file: str, folder: Path) -> Path:
    if file.startswith(_PACKAGE):
        package, _, rest = file[len(_PACKAGE) :].partition("/")
        return find_shared(package, rest, "mesh.file")
    return folder / file


def _read(path: Path) -> tuple[np.ndarray, np.ndarray]:
    """(V, 3) vertices and (F, 3) faces of a file of one of `KINDS`.

    What stands in the file is not repeated where it cannot be read.
    """
    try:
        import trimesh
    except ImportError:
        raise InputError(f"mesh.file: {path}: needs the Python package trimesh") from None
    kind = path.suffix.lower().lstrip(".")
    if kind not in KINDS:
        raise InputError(f"mesh.file: {path}: meshes are .{', .'.join(KINDS)}")
    data = read_limited(path, MAX_BYTES)
    try:
        with np.errstate(all="ignore"):
            mesh = trimesh.load_mesh(io.BytesIO(data), file_type=kind)
        vertices, faces = np.array(mesh.vertices, float), np.array(mesh.faces, int)
        if not len(faces):  # what is no mesh may be read as a text without any
            raise ValueError
    except Exception:  # noqa: BLE001 - a damaged file ends in errors of many kinds
        raise InputError(f"mesh.file: {path}: is damaged, or no {kind.upper()} file") from None
    if not 1 <= len(faces) <= MAX_FACES:
        raise InputError(f"mesh.file: {path}: {len(faces)} triangles, 1 to {MAX_FACES} work")
    return vertices, faces


class _Drape:
    """Straightest geodesics on triangles.

    Parameters
    ----------
    vertices : (V, 3) m.
    faces : (F, 3) numbers of vertices, counter-clockwise seen from outside.
    """

    def __init__(self, vertices: np.ndarray, faces: np.ndarray):
        corners = vertices[faces]
        normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        areas = np.linalg.norm(normals, axis=1)
        if not (areas > 0).any():
            raise InputError("mesh.file: no triangle has an area")
        solid = areas > 1e-12 * areas.max()  # triangles without area carry nothing
        self._faces, self._corners = faces[solid], corners[solid]
        self._normals = normals[solid] / areas[solid, None]
        along = np.roll(self._corners, -1, axis=1) - self._corners  # edge k: corner k to k + 1
        self._along = along / np.linalg.norm(along, axis=2, keepdims=True)
        self._inward = np.cross(self._normals[:, None], self._along)
        self._neighbours, self._entered = _neighbours(self._faces)

    def lay(self, center: np.ndarray, x_axis: np.ndarray, size: tuple[float, float]) -> np.ndarray:
        """(R, C, 3) positions of an even grid over a sheet of this size, m."""
        face, start = self._nearest(center)
        normal = self._normals[face]
        along_x = x_axis - normal * (x_axis @ normal)
        length = np.linalg.norm(along_x)
        if not length > _STEEP * np.linalg.norm(x_axis):
            raise InputError("mesh.x_axis: points out of the surface at the centre, not along it")
        along_x /= length
        steps = np.linspace(-0.5, 0.5, _SAMPLES)
        x, y = np.meshgrid(size[0] * steps, size[1] * steps)
        ways = x[..., None] * along_x + y[..., None] * np.cross(normal, along_x)
        ends = self._trace(face, start, ways.reshape(-1, 3))
        lost = np.flatnonzero(np.isnan(ends[:, 0]))
        if len(lost):
            raise InputError(
                f"mesh: the sheet ends beyond the rim of the mesh, at [{x.flat[lost[0]]:.3g}, "
                f"{y.flat[lost[0]]:.3g}] of {size[0]:g} m x {size[1]:g} m; are center and scale right?"
            )
        return ends.reshape(_SAMPLES, _SAMPLES, 3)

    def _nearest(self, place: np.ndarray) -> tuple[int, np.ndarray]:
        """The face nearest to a place, and the point of it."""
        from trimesh.triangles import closest_point

        points = closest_point(self._corners, np.tile(place, (len(self._corners), 1)))
        face = int(np.argmin(((points - place) ** 2).sum(axis=1)))
        middle = self._corners[face].mean(axis=0)
        return face, points[face] + _ASIDE * (middle - points[face])

    def _trace(self, face: int, start: np.ndarray, ways: np.ndarray) -> np.ndarray:
        """(N, 3) ends of lines that leave a point of a face in its plane by (N, 3); NaN beyond the
        rim."""
        left = np.linalg.norm(ways, axis=1)
        heading = ways / np.maximum(left, 1e-300)[:, None]
        at = np.tile(start, (len(ways), 1))
        on = np.full(len(ways), face)
        going = np.flatnonzero(left > 0)
        for _ in range(4 * len(self._faces) + 8):
            if not len(going):
                return at
            f, p, d = on[going], at[going], heading[going]
            inward = self._inward[f]
            room = np.maximum(np.einsum("nkj,nkj->nk", p[:, None] - self._corners[f], inward), 0.0)
            speed = np.einsum("nj,nkj->nk", d, inward)
            with np.errstate(divide="ignore", invalid="ignore"):
                reach = np.where(speed < 0, -room / speed, np.inf)
            edge = reach.argmin(axis=1)
            step = np.minimum(reach.min(axis=1), left[going])
            at[going] = p + step[:, None] * d
            left[going] -= step
            crossing = left[going] > 0
            going, f, edge, d = going[crossing], f[crossing], edge[crossing], d[crossing]
            new, entered = self._neighbours[f, edge], self._entered[f, edge]
            at[going[new < 0]] = np.nan
            inside = new >= 0
            going, f, edge, d = going[inside], f[inside], edge[inside], d[inside]
            new, entered = new[inside], entered[inside]
            along = self._along[f, edge]
            share = np.einsum("nj,nj->n", d, along)[:, None]
            across = -np.einsum("nj,nj->n", d, self._inward[f, edge])[:, None]
            heading[going] = share * along + across * self._inward[new, entered]
            on[going] = new
        raise InputError("mesh: the sheet cannot be laid onto it, lines on it never end")


def _neighbours(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(F, 3) face across each edge, -1 at the rim, and (F, 3) which of its edges that is."""
    edges = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2), axis=1)
    _, kind, count = np.unique(edges, axis=0, return_inverse=True, return_counts=True)
    kind = kind.ravel()
    if count.max() > 2:
        raise InputError("mesh.file: three triangles share an edge; one surface is needed")
    order = np.argsort(kind, kind="stable")
    pairs = order[np.flatnonzero(kind[order][1:] == kind[order][:-1])[:, None] + [0, 1]]
    other: np.ndarray = np.full(len(edges), -1)
    other[pairs[:, 0]], other[pairs[:, 1]] = pairs[:, 1], pairs[:, 0]
    other = other.reshape(-1, 3)
    return np.where(other >= 0, other // 3, -1), other % 3
