"""What presses on the sheet: a region with a pressure, for a time, perhaps moving; its cells.

The contact law is that of Holm: conductance per area g = c p^m.
"""

import copy
import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from tomotactile_ros import checks
from tomotactile_ros.errors import InputError
from tomotactile_ros.patches import disc_rim, join, rim_of
from tomotactile_ros.region import MAX_CELLS, Region, regular_polygon, ring
from tomotactile_ros.yamlio import Reader

SHAPES = {
    "disc": ("center", "radius"),
    "rectangle": ("center", "size", "angle"),
    "polygon": ("points",),
}
FASTEST = 1e6  # m/s
_LEAST_CELLS = 3  # along each side of a contact's bounding box; a disc keeps all 9


@dataclass(frozen=True, eq=False)
class Contact:
    """One thing that presses on the sheet, for a time, perhaps moving.

    Parameters
    ----------
    shape : "disc" (needs ``center``, ``radius``), "rectangle" (``center``, ``size``, ``angle``) or
        "polygon" (``points``; its ``center`` is then the middle of its bounding box).
    center : (2,) position at the time ``start``, m.
    radius : of a disc, m.
    size : width and height of a rectangle, m.
    angle : of a rectangle, degrees counter-clockwise.
    points : (V, 2) vertices of a polygon at the time ``start``, m.
    pressure : Pa, or None for a bare conductor at the drive voltage.
    start, end : s; the contact is there while start <= t < end.
    velocity : (2,) m/s, from ``start`` on.
    """

    shape: str
    center: Sequence[float] | None = None
    radius: float | None = None
    size: Sequence[float] | None = None
    angle: float = 0.0
    points: np.ndarray | None = None
    pressure: float | None = None
    start: float = 0.0
    end: float = math.inf
    velocity: Sequence[float] = (0.0, 0.0)

    def __post_init__(self):
        if self.shape not in SHAPES:
            raise InputError(f"shape: {checks.show(self.shape)} is none of {', '.join(SHAPES)}")
        for key in ("center", "radius", "size", "points"):
            needed = key in SHAPES[self.shape]
            if needed and getattr(self, key) is None:
                raise InputError(f"{key}: is missing, a {self.shape} needs it")
            if not needed and key != "center" and getattr(self, key) is not None:
                raise InputError(f"{key}: a {self.shape} has none")
        if self.pressure is not None:
            checks.not_negative(self.pressure, "pressure", "pressure in Pa")
        checks.number(self.start, "from", "time in s")
        if self.end != math.inf and checks.number(self.end, "to", "time in s") <= self.start:
            raise InputError(f"to: {self.end:g} is not after 'from' ({self.start:g} s)")
        self._set("_cells", {})
        velocity = np.array(checks.pair(self.velocity, "velocity", "speed in m/s"))
        if np.abs(velocity).max() > FASTEST:
            raise InputError(f"velocity: {velocity.tolist()} is faster than {FASTEST:g} m/s")
        self._set("velocity", velocity)
        self._set_form()

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _set_form(self) -> None:
        """Keep the contact's region about its own centre: it is the same wherever it moves."""
        if self.shape == "polygon":
            points = ring(self.points, "points")
            self._set("points", points)
            self._set("center", (points.min(axis=0) + points.max(axis=0)) / 2)
            self._set("_form", Region(points - self.center))
            return
        center = checks.pair(self.center, "center", "position in m")
        self._set("center", checks.points([center], "center")[0])
        if self.shape == "disc":
            radius = checks.length(self.radius, "radius")
            self._set("_form", None)
            self._set("radius", radius)
            return
        size = checks.pair(self.size, "size", "length in m")
        for i, side in enumerate(size):
            checks.length(side, f"size[{i}]")
        self._set("size", size)
        self._set("_form", Region(np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2 * size))
        checks.number(self.angle, "angle", "number of degrees")

    @property
    def area(self) -> float:
        """Area of the whole contact, m²."""
        return math.pi * self.radius**2 if self.shape == "disc" else self._form.area

    @property
    def centroid(self) -> np.ndarray:
        """(2,) centre of mass, m."""
        return self.center + self._form.centroid if self.shape == "polygon" else self.center.copy()

    @property
    def vertices(self) -> np.ndarray:
        """(V, 2) rim of the contact, m; a disc as a fine polygon around it."""
        if self.shape == "disc":
            return self.center + regular_polygon(self.radius)
        return self.center + self._turned(self._form.shell)

    def at(self, t: float) -> "Contact | None":
        """The contact where it is at the time ``t`` (s), or None while it is not there."""
        if not self.start <= t < self.end:
            return None
        if not self.velocity.any():
            return self
        shift = self.velocity * (t - self.start)
        moved = copy.copy(self)
        moved._set("center", self.center + shift)
        if self.shape == "polygon":
            moved._set("points", self.points + shift)
        moved._set("start", t)
        return moved

    def sample(self, spacing: float) -> tuple[np.ndarray, np.ndarray]:
        """Cut the contact into cells of a lattice that is fixed to it.

        Parameters
        ----------
        spacing : largest side of a cell, m; smaller where the contact is small.

        Returns
        -------
        points : (Q, 2) a point of each cell, m, inside the contact.
        areas : (Q,) area of each cell, m², in sum the area of the contact.
        """
        if self.shape == "disc":
            points, areas = _unit_disc_cells(_cells_along(2 * self.radius, spacing))
            return self.center + self.radius * points, self.radius**2 * areas
        points, areas = self._form_cells(spacing)
        return self.center + points, areas

    def patches(self, across: int = 6) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where the contact meets a sheet: about ``across`` patches to its width, see `patches`.

        Returns
        -------
        points : (Q, 2) m; areas : (Q,) m², in sum that of the contact; radii : (Q,) m.
        """
        if ("patches", across) not in self._cells:
            vertices = self.vertices - self.center
            spacing = np.ptp(vertices, axis=0).max() / across
            cells, areas = self.sample(spacing)
            rim = (
                disc_rim(self.radius, spacing)
                if self.shape == "disc"
                else rim_of(vertices, spacing)
            )
            self._cells["patches", across] = join(*rim, cells - self.center, areas, spacing)
        points, areas, radii = self._cells["patches", across]
        return self.center + points, areas, radii

    def _form_cells(self, spacing: float) -> tuple[np.ndarray, np.ndarray]:
        """Sample points about the centre and their areas, computed once per spacing."""
        if spacing not in self._cells:
            width, height = self._form.size
            columns, rows = _cells_along(width, spacing), _cells_along(height, spacing)
            if columns * rows > MAX_CELLS:
                raise InputError(_too_fine(spacing))
            points, areas = self._form.cells(columns, rows)
            areas.setflags(write=False)
            self._cells[spacing] = self._turned(points), areas
        return self._cells[spacing]

    def _turned(self, points: np.ndarray) -> np.ndarray:
        if not self.angle:
            return points
        angle = math.radians(self.angle)
        cos, sin = math.cos(angle), math.sin(angle)
        return points @ np.array([[cos, sin], [-sin, cos]])

    def to_dict(self) -> dict:
        """The contact as in a scene file."""
        content = {"shape": self.shape}
        content.update({key: getattr(self, key) for key in SHAPES[self.shape]})
        if self.pressure is not None:
            content["pressure"] = float(self.pressure)
        content["from"] = float(self.start)
        if math.isfinite(self.end):
            content["to"] = float(self.end)
        content["velocity"] = self.velocity
        return content


def _too_fine(spacing: float) -> str:
    return f"spacing: {spacing:g} m cuts a contact into more than {MAX_CELLS} cells"


def _cells_along(length: float, spacing: float) -> int:
    """Number of lattice cells over a length, none longer than ``spacing``."""
    count = length / spacing if spacing > 0 else math.nan
    if not count <= MAX_CELLS:
        checks.positive(spacing, "spacing", "length in m")
        raise InputError(_too_fine(spacing))
    return max(_LEAST_CELLS, math.ceil(count * (1 - 1e-12)))


@lru_cache(maxsize=64)
def _unit_disc_cells(count: int) -> tuple[np.ndarray, np.ndarray]:
    """Cells of the disc of radius 1 under a lattice of count x count: (Q, 2) points, (Q,) areas."""
    if count**2 > MAX_CELLS:
        raise InputError(_too_fine(2 / count) + " of a disc of radius 1")
    points, areas = Region(regular_polygon(1.0)).cells(count, count)
    return points, areas * (math.pi / areas.sum())


@dataclass(frozen=True)
class ContactLaw:
    """Contact conductance per area against pressure, g = c p^m (Holm).

    Both end at `checks.LARGEST`.

    Parameters
    ----------
    coefficient : c, in S/m² per Pa^m.
    exponent : m.
    """

    coefficient: float
    exponent: float

    def __post_init__(self):
        checks.positive(self.coefficient, "coefficient", "number")
        checks.positive(self.exponent, "exponent", "number")

    def conductance(self, pressure: np.ndarray | float) -> np.ndarray:
        """g in S/m² of a pressure in Pa; 0 where the pressure is not above 0."""
        with np.errstate(over="ignore"):
            g = self.coefficient * np.maximum(pressure, 0.0) ** self.exponent
        return np.minimum(g, checks.LARGEST)

    def pressure(self, conductance: np.ndarray | float) -> np.ndarray:
        """Pressure in Pa that belongs to g in S/m²; 0 where g is not above 0."""
        with np.errstate(over="ignore"):
            p = (np.maximum(conductance, 0.0) / self.coefficient) ** (1 / self.exponent)
        return np.minimum(p, checks.LARGEST)


def read_contact(reader: Reader) -> Contact:
    """The contact in a mapping of a scene file."""
    shape = reader.choice("shape", tuple(SHAPES))
    reader.only("shape", *SHAPES[shape], "pressure", "from", "to", "velocity")
    form = {}
    if shape == "polygon":
        form["points"] = reader.points("points")
    else:
        form["center"] = reader.numbers("center", 2)
    if shape == "disc":
        form["radius"] = reader.number("radius")
    if shape == "rectangle":
        form.update(size=reader.numbers("size", 2), angle=reader.number("angle", 0.0))
    return reader.build(
        Contact,
        shape,
        **form,
        pressure=reader.number("pressure", None),
        start=reader.number("from", 0.0),
        end=reader.number("to", math.inf, infinite=True),
        velocity=reader.numbers("velocity", 2, (0.0, 0.0)),
    )
