"""The outline of a sheet: rectangle, circle or polygon, centred on the origin, with holes."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tomotactile_ros.layouts.region import Region, regular_polygon
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

_SLOPE = 1e-6  # of the size: differences of the depth are taken over this length
_CROSS = np.array([[1.0, 0.0], [-1.0, 0.0], [0.0, 1.0], [0.0, -1.0]])
SMALLEST, LARGEST = 0.005, 5.0  # m, longer sides of sheets that people build
_CENTRED = 1e-6  # how far the middle of a polygon's bounding box may be off, in parts of its size


@dataclass(frozen=True, eq=False)
class Outline(Region):
    """The sheet as a region; use the constructors `rectangle`, `circle` and `polygon`.

    A circle's ``shell`` is a polygon of 256 sides around it, so that the circle lies in it; its
    area, what it contains and the distance to its rim are those of the true circle.

    Parameters
    ----------
    kind : "rectangle", "circle" or "polygon".
    radius : of a circle, m; otherwise 0.
    """

    kind: str = "polygon"
    radius: float = 0.0

    @classmethod
    def rectangle(
        cls, a: float, b: float, holes: Sequence = (), unusual_size: bool = False
    ) -> "Outline":
        """``a`` wide (x) and ``b`` high (y), m.

        Here and below, ``unusual_size`` says that a sheet really is below 5 mm or above 5 m; such a
        length is refused otherwise: it was probably not given in m.
        """
        a = checks.length(a, "rectangle[0]")
        b = checks.length(b, "rectangle[1]")
        _check_usual_size((a, b), "rectangle", unusual_size)
        shell = np.array([[-a, -b], [a, -b], [a, b], [-a, b]]) / 2
        return cls(shell, tuple(holes), "rectangle")

    @classmethod
    def circle(cls, radius: float, holes: Sequence = (), unusual_size: bool = False) -> "Outline":
        """A disc of the given radius, m."""
        radius = checks.length(radius, "circle")
        _check_usual_size((2 * radius, 2 * radius), "circle", unusual_size)
        return cls(regular_polygon(radius), tuple(holes), "circle", radius)

    @classmethod
    def polygon(
        cls, points: Sequence | np.ndarray, holes: Sequence = (), unusual_size: bool = False
    ) -> "Outline":
        """A simple polygon (V, 2), m, whose bounding box is centred on the origin."""
        outline = cls(points, tuple(holes), "polygon")  # type: ignore[arg-type] # checked there
        _check_usual_size(outline.size, "polygon", unusual_size)
        xmin, ymin, xmax, ymax = outline.bounds
        shift = np.array([-(xmin + xmax) / 2, -(ymin + ymax) / 2])
        if np.any(np.abs(shift) > _CENTRED * max(outline.size)):
            raise InputError(
                "polygon: its bounding box is not centred on the origin; "
                f"move all points (and electrodes) by [{shift[0]:g}, {shift[1]:g}] m"
            )
        return outline

    @property
    def area(self) -> float:
        """Area of the sheet, holes taken off, m²."""
        if self.kind != "circle":
            return float(self._polygon.area)
        return float(np.pi * self.radius**2 - sum(Region(hole).area for hole in self.holes))

    @property
    def is_uniform_rectangle(self) -> bool:
        """Whether the outline is a rectangle without holes."""
        return self.kind == "rectangle" and not self.holes

    def contains(self, points: np.ndarray, tolerance: float = 0.0) -> np.ndarray:
        """Which of the (P, 2) points lie on the sheet, on its rim or within ``tolerance`` of it."""
        if self.is_uniform_rectangle:
            beyond = np.maximum(np.abs(points) - 0.5 * np.array(self.size), 0.0)
            return np.hypot(*beyond.T) <= tolerance
        inside = super().contains(points, tolerance)
        if self.kind == "circle":
            inside &= np.linalg.norm(points, axis=1) <= self.radius + tolerance
        return inside

    def rim_distance(self, points: np.ndarray) -> np.ndarray:
        """(P,) distance of (P, 2) points to the nearest rim, holes included, m, never negative."""
        if self.kind != "circle":
            return super().rim_distance(points)
        distance = np.abs(self.radius - np.linalg.norm(points, axis=1))
        for hole in self.holes:
            distance = np.minimum(distance, Region(hole).rim_distance(points))
        return distance

    def signed_distance(self, points: np.ndarray) -> np.ndarray:
        """(P,) how deep (P, 2) points lie inside, m, negative outside."""
        if self.is_uniform_rectangle:
            return (0.5 * np.array(self.size) - np.abs(points)).min(axis=1)
        return np.where(self.contains(points), 1, -1) * self.rim_distance(points)

    def depth(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P,) as `signed_distance`, and (P, 2) its gradient."""
        if self.is_uniform_rectangle:
            inside = 0.5 * np.array(self.size) - np.abs(points)
            nearest = inside.argmin(axis=1)
            own = np.arange(len(points))
            gradient = np.zeros(points.shape)
            gradient[own, nearest] = -np.sign(points[own, nearest])
            return inside[own, nearest], gradient
        step = _SLOPE * max(self.size)
        values = [self.signed_distance(points + step * each) for each in _CROSS]
        slopes = [(values[i] - values[i + 1]) / (2 * step) for i in (0, 2)]
        return self.signed_distance(points), np.stack(slopes, axis=-1)

    def to_dict(self) -> dict:
        """The outline as in a layout file."""
        content: dict[str, object]
        if self.kind == "rectangle":
            content = {"rectangle": list(self.size)}
        elif self.kind == "circle":
            content = {"circle": self.radius}
        else:
            content = {"polygon": self.shell}
        if self.holes:
            content["holes"] = list(self.holes)
        return content


def is_usual_size(size: tuple[float, float]) -> bool:
    """Whether a sheet of this width and height, m, is of a size that people build."""
    return SMALLEST <= max(size) <= LARGEST


def _check_usual_size(size: tuple[float, float], key: str, meant: bool) -> None:
    """Refuse a size, m, that was probably given in another unit, unless it is `meant`."""
    if meant or is_usual_size(size):
        return
    a, b = size
    instead = f"{a / 1e3:g} m x {b / 1e3:g} m" if max(size) > LARGEST else "another unit"
    raise InputError(
        f"{key}: a sheet of {a:g} m x {b:g} m: lengths are in m, was {instead} meant? If not, set "
        "unusual_size (option --unusual-size)"
    )
