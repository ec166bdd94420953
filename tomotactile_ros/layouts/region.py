"""Plane regions: a simple polygon with holes, what lies in it, and its cells under a lattice.

The only module that uses shapely. Lengths in m, areas in m².
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely

from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

MAX_CELLS = 1_000_000
FAR_OFF = 10.0  # sizes of the sheet: what is so far away is probably in mm
_SLIVER = 1e-6  # cells with a smaller part in the region carry nothing and are left out


def enclosed(points: np.ndarray, by: np.ndarray, tolerance: float = 0.0) -> np.ndarray:
    """Which of (P, 2) points lie in the convex hull of the points ``by`` (Q, 2), or within
    ``tolerance``, m, of it."""
    hull = shapely.MultiPoint(by).convex_hull
    return shapely.distance(hull, shapely.points(points)) <= tolerance


@dataclass(frozen=True, eq=False)
class Region:
    """A simple polygon, possibly with holes.

    Parameters
    ----------
    shell : (V, 2) vertices of the rim, m, in any direction; kept counter-clockwise.
    holes : vertices of each hole, strictly inside the rim and apart from each other.
    """

    shell: np.ndarray
    holes: tuple[np.ndarray, ...] = ()

    def __post_init__(self):
        shell = ring(self.shell, "polygon")
        holes = tuple(ring(hole, f"holes[{i}]") for i, hole in enumerate(self.holes))
        object.__setattr__(self, "shell", shell)
        object.__setattr__(self, "holes", holes)
        for i, hole in enumerate(holes):
            rim = shapely.Polygon(shell)
            if not shapely.contains_properly(rim, shapely.Polygon(hole)):
                far = np.abs(hole).max() > FAR_OFF * np.ptp(shell, axis=0).max()
                fits = far and shapely.contains_properly(rim, shapely.Polygon(hole / 1e3))
                meant = "; is it in mm? It must be in m" if fits else ""
                raise InputError(f"holes[{i}]: does not lie wholly inside the outline{meant}")
            for j in range(i):
                if shapely.Polygon(holes[j]).intersects(shapely.Polygon(hole)):
                    raise InputError(f"holes[{i}]: touches or overlaps holes[{j}]")

    @cached_property
    def _polygon(self) -> shapely.Polygon:
        """The region as a prepared shapely polygon."""
        polygon = shapely.Polygon(self.shell, self.holes)
        shapely.prepare(polygon)
        return polygon

    @cached_property
    def area(self) -> float:
        """Area without the holes, m²."""
        return float(self._polygon.area)

    @cached_property
    def centroid(self) -> np.ndarray:
        """(2,) centre of mass, m."""
        return np.array(self._polygon.centroid.coords[0])

    @cached_property
    def bounds(self) -> tuple[float, float, float, float]:
        """xmin, ymin, xmax, ymax of the bounding box, m."""
        low, high = self.shell.min(axis=0), self.shell.max(axis=0)
        return float(low[0]), float(low[1]), float(high[0]), float(high[1])

    @property
    def size(self) -> tuple[float, float]:
        """Width and height of the bounding box, m."""
        xmin, ymin, xmax, ymax = self.bounds
        return xmax - xmin, ymax - ymin

    def contains(self, points: np.ndarray, tolerance: float = 0.0) -> np.ndarray:
        """Which of (P, 2) points lie in the region, on its rim or within ``tolerance`` of it."""
        points = np.asarray(points, dtype=np.float64)
        inside = shapely.intersects_xy(self._polygon, points[:, 0], points[:, 1])
        if tolerance > 0:
            inside |= self.rim_distance(points) <= tolerance
        return inside

    def rim_distance(self, points: np.ndarray) -> np.ndarray:
        """(P,) distance of (P, 2) points to the nearest rim, holes included, m, never negative."""
        return shapely.distance(self._polygon.boundary, shapely.points(points))

    def holds(self, points: np.ndarray, radius: np.ndarray | float) -> np.ndarray:
        """Which discs of so many m radius about (P, 2) points lie wholly in the region."""
        return self.contains(points) & (self.rim_distance(points) >= radius)

    def parts_of(self, line: np.ndarray) -> list[np.ndarray]:
        """The parts (V, 2) of a polyline (V, 2) that lie in the region."""
        found = shapely.intersection(self._polygon, shapely.linestrings(line))
        parts = shapely.get_parts(shapely.line_merge(found))
        return [shapely.get_coordinates(part) for part in parts if part.geom_type == "LineString"]

    def is_met_by(self, shell: np.ndarray, path: np.ndarray) -> bool:
        """Whether the polygon ``shell`` (V, 2) touches the region while it moves by ``path`` (2,).

        The swept area is the polygon at its start and what each of its sides passes over.
        """
        after = np.roll(shell, -1, axis=0)
        sides = np.stack([shell, after, after + path, shell + path], axis=1)
        swept = shapely.convex_hull(shapely.linestrings(sides))
        return bool(
            shapely.intersects(self._polygon, shapely.Polygon(shell))
            or shapely.intersects(self._polygon, swept).any()
        )

    def cells(self, columns: int, rows: int) -> tuple[np.ndarray, np.ndarray]:
        """Cut the region by a lattice of ``columns`` x ``rows`` cells over its bounding box.

        Returns
        -------
        points : (Q, 2) a point of each part, its centroid where that lies inside.
        areas : (Q,) area of each part, m²; their sum is the area of the region.
        """
        xmin, ymin, xmax, ymax = self.bounds
        x = np.linspace(xmin, xmax, columns + 1)
        y = np.linspace(ymin, ymax, rows + 1)
        left, low = (grid.ravel() for grid in np.meshgrid(x[:-1], y[:-1]))
        right, high = (grid.ravel() for grid in np.meshgrid(x[1:], y[1:]))
        cells = shapely.box(left, low, right, high)
        cut = ~shapely.contains_properly(self._polygon, cells)
        parts = cells.copy()
        parts[cut] = shapely.intersection(cells[cut], self._polygon)
        areas = shapely.area(parts)
        kept = areas > _SLIVER * self.area / (columns * rows)
        parts, areas = parts[kept], areas[kept]
        points = shapely.get_coordinates(shapely.centroid(parts))
        outside = ~self.contains(points)
        points[outside] = shapely.get_coordinates(shapely.point_on_surface(parts[outside]))
        return points, areas * (self.area / areas.sum())

    def overlaps(self, polygons: np.ndarray) -> np.ndarray:
        """(M,) area that each of the simple polygons (M, V, 2) has in the region, m²."""
        return shapely.area(shapely.intersection(self._polygon, shapely.polygons(polygons)))


def nearest(polygons: np.ndarray, points: np.ndarray) -> np.ndarray:
    """(P,) which of the simple polygons (M, V, 2) each of (P, 2) points lies in, or is nearest to."""
    tree = shapely.STRtree(shapely.polygons(polygons))
    return tree.query_nearest(shapely.points(points), all_matches=False)[1]


def proper(polygons: np.ndarray) -> np.ndarray:
    """(M,) which polygons (M, V, 2) do not cross themselves and go counter-clockwise around an area."""
    rims = shapely.linearrings(polygons)
    return shapely.is_simple(rims) & shapely.is_ccw(rims)


def regular_polygon(radius: float, vertices: int = 256) -> np.ndarray:
    """(vertices, 2) corners of the regular polygon around a circle, sides tangent at its axes."""
    angle = (np.arange(vertices) + 0.5) * (2 * np.pi / vertices)
    return radius / np.cos(np.pi / vertices) * np.column_stack([np.cos(angle), np.sin(angle)])


def ellipse_polygon(semi_axes: Sequence[float], vertices: int) -> np.ndarray:
    """(vertices, 2) corners of a polygon with the area of an ellipse, on both of its axes."""
    step = 2 * np.pi / vertices
    angle = step * np.arange(vertices)
    reach = math.sqrt(step / math.sin(step)) * np.asarray(semi_axes)
    return reach * np.column_stack([np.cos(angle), np.sin(angle)])


def turned(points: np.ndarray, degrees: float) -> np.ndarray:
    """(P, 2) points turned counter-clockwise about the origin."""
    cos, sin = math.cos(math.radians(degrees)), math.sin(math.radians(degrees))
    return points @ np.array([[cos, sin], [-sin, cos]])


def ring(vertices: Sequence | np.ndarray, key: str) -> np.ndarray:
    """Vertices (V, 2) of one closed line, m: checked to be simple and to have an area.

    They come back read-only, counter-clockwise, without a last point that repeats the first.
    """
    corners = checks.points(vertices, key, least=3)
    if np.array_equal(corners[0], corners[-1]):
        corners = corners[:-1]
    if len(corners) < 3:
        raise InputError(f"{key}: fewer than 3 different points")
    span = np.ptp(corners, axis=0).max()
    polygon = shapely.Polygon(corners)
    if not span > 0 or not polygon.area > 1e-12 * span**2:
        raise InputError(f"{key}: the points enclose no area")
    if not polygon.is_valid:
        raise InputError(f"{key}: not a simple polygon: {shapely.is_valid_reason(polygon)}")
    if not polygon.exterior.is_ccw:
        corners = corners[::-1]
    corners = np.ascontiguousarray(corners)
    corners.setflags(write=False)
    return corners
