"""What presses on the sheet: a region with a pressure, for a time, perhaps moving; its cells."""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tomotactile_ros.layouts.region import MAX_CELLS, Region, regular_polygon, ring, turned
from tomotactile_ros.scenes.cells import (
    cells_along,
    too_fine,
    unit_disc_cells,
    unit_disc_patches,
    unit_disc_pressures,
)
from tomotactile_ros.scenes.contact_law import ContactLaw
from tomotactile_ros.scenes.contact_patches import join, rim_of
from tomotactile_ros.scenes.course import Course, course_to_dict, read_course
from tomotactile_ros.scenes.load import Load
from tomotactile_ros.scenes.motion import Motion, along_path, straight
from tomotactile_ros.scenes.profile import PROFILES
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.yamlio import Reader

__all__ = ["Contact", "ContactLaw", "read_contact"]

SHAPES = {
    "disc": ("center", "radius"),
    "rectangle": ("center", "size", "angle"),
    "polygon": ("points",),
}
_ABSENT: Any = None  # what a contact of another shape has


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
    pressure : mean, Pa; or None.
    force : N, instead of the pressure; or None. With neither, a bare conductor at the drive
        voltage.
    profile : how the pressure varies inside a disc, of `profile.PROFILES`; "even" for all shapes.
    course : of the force from ``start`` on, see `course`; None: constant.
    start, end : s; the contact is there while start <= t < end.
    velocity : (2,) m/s, from ``start`` on.
    width : longer side of its bounding box, m (no parameter).
    path, speed, loop : way points (W, 2), m, to which the center goes one after the other from
        ``start`` on, with ``speed`` m/s; then it rests, or returns to where it began and goes on.
    """

    shape: str
    center: Any = None  # given as any sequence, kept as an array, and so is the velocity
    radius: float = _ABSENT
    size: Sequence[float] = _ABSENT
    angle: float = 0.0
    points: np.ndarray = _ABSENT
    pressure: float | None = None
    start: float = 0.0
    end: float = math.inf
    velocity: Any = (0.0, 0.0)
    force: float | None = None
    profile: str = "even"
    course: Course | None = None
    path: np.ndarray | None = None
    speed: float = _ABSENT
    loop: bool = False
    width: float = field(init=False)
    _form: Region = field(init=False, repr=False)  # about its centre; a disc has none
    _load: Load = field(init=False, repr=False)
    _motion: Motion | None = field(init=False, repr=False)
    _begin: np.ndarray = field(init=False, repr=False)  # (2,) m, where its centre is at first
    _law: ContactLaw | None = field(init=False, repr=False)
    _level: float = field(init=False, repr=False)
    _felt: float = field(init=False, repr=False)
    _cells: dict = field(init=False, repr=False)

    def __post_init__(self):
        if self.shape not in SHAPES:
            raise InputError(f"shape: {checks.show(self.shape)} is none of {', '.join(SHAPES)}")
        for key in ("center", "radius", "size", "points"):
            needed = key in SHAPES[self.shape]
            if needed and getattr(self, key) is None:
                raise InputError(f"{key}: is missing, a {self.shape} needs it")
            if not needed and key != "center" and getattr(self, key) is not None:
                raise InputError(f"{key}: a {self.shape} has none")
        checks.number(self.start, "from", "time in s")
        if self.end != math.inf and checks.number(self.end, "to", "time in s") <= self.start:
            raise InputError(f"to: {self.end:g} is not after 'from' ({self.start:g} s)")
        self._set("_cells", {})
        self._set("velocity", np.array(checks.pair(self.velocity, "velocity", "speed in m/s")))
        self._set_form()
        self._set_load()
        self._set("_begin", self.center)
        self._set("width", float(np.ptp(self.vertices, axis=0).max()))
        self._set("_motion", self._make_motion())

    def _set(self, name: str, value: object) -> None:
        object.__setattr__(self, name, value)

    def _copy(self) -> "Contact":
        """The same in a new object, which shares what is kept of the cells."""
        copy = object.__new__(Contact)
        copy.__dict__.update(self.__dict__)
        return copy

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
            self._set("radius", checks.length(self.radius, "radius"))
            return
        size = checks.pair(self.size, "size", "length in m")
        for i, side in enumerate(size):
            checks.length(side, f"size[{i}]")
        self._set("size", size)
        self._set("_form", Region(np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2 * size))
        checks.number(self.angle, "angle", "number of degrees")

    def _set_load(self) -> None:
        """What presses, and how much of it just now: all, until `at` knows better."""
        load = Load(
            self.area, self.end - self.start, self.pressure, self.force, self.profile, self.course
        )
        if load.profile != "even" and self.shape != "disc":
            raise InputError(f"profile: {load.profile} is that of a disc, not of a {self.shape}")
        self._set("_load", load)
        self._set("_law", None)
        self._set("_level", 1.0)
        self._set("_felt", 1.0)

    def _make_motion(self) -> Motion | None:
        if self.path is None:
            for key, given in (("speed", self.speed is not None), ("loop", self.loop)):
                if given:
                    raise InputError(f"{key}: is that of a path, and there is no path")
            return straight(self.velocity)
        if self.velocity.any():
            raise InputError("path: is given, and so is velocity; one of them says it all")
        return along_path(self.center, self.path, self.speed, self.loop)

    @property
    def area(self) -> float:
        """Area of the whole contact, m²."""
        return math.pi * self.radius**2 if self.shape == "disc" else self._form.area

    @property
    def centroid(self) -> np.ndarray:
        """(2,) centre of mass, m."""
        return self.center + self._form.centroid if self.shape == "polygon" else self.center.copy()

    @property
    def mean_pressure(self) -> float | None:
        """Pa, at the time of `at`, else the nominal one; None for a bare conductor."""
        mean = self._load.mean_pressure
        return None if mean is None else mean * self._level

    @property
    def peak_pressure(self) -> float | None:
        """Pa, likewise; of a punch, whose rim has no finite pressure, the mean."""
        return None if self.mean_pressure is None else self.mean_pressure * self._load.peak

    @property
    def total_force(self) -> float | None:
        """N, likewise."""
        return None if self.mean_pressure is None else self.mean_pressure * self.area

    @property
    def moves(self) -> bool:
        """Whether it moves while it is there."""
        return self._motion is not None

    @property
    def vertices(self) -> np.ndarray:
        """(V, 2) rim of the contact, m; a disc as a fine polygon around it."""
        if self.shape == "disc":
            return self.center + regular_polygon(self.radius)
        return self.center + turned(self._form.shell, self.angle)

    def under(self, law: ContactLaw | None) -> "Contact":
        """The contact as ``law`` feels it, whose memory `at` then knows of; itself without one."""
        law = law if law is not None and law.remembers else None
        if law is self._law or self._load.mean_pressure is None:
            return self
        mine = self._copy()
        mine._set("_law", law)
        return mine

    def at(self, t: float) -> "Contact | None":
        """The contact as it is at the time ``t`` (s), or None while it is not there.

        Where nothing about it changes in time this is the very same object. A course that goes
        down to no force lifts the contact off.
        """
        if not self.start <= t < self.end:
            return None
        age = t - self.start
        level = self._load.signal.value(age) if self.course is not None else 1.0
        if level <= 0:
            return None
        if self._constant:
            return self
        now = self._copy()
        now._set("_level", level)
        now._set("_felt", level if self._law is None else self._law.felt(self._load.signal, age))
        if self._motion is not None:
            now._move(self._begin + self._motion.shift(age))
        return now

    def during(self, times: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """What `at` says of (T,) ``times`` (s), all at once.

        Returns
        -------
        there : (T,) whether it is there; centers : (T, 2) m; felt : (T,) pressure that the law
        feels, in parts of the nominal one. Where it is not there, centers and felt mean nothing.
        """
        there = (self.start <= times) & (times < self.end)
        age = np.maximum(times - self.start, 0.0)
        centers = np.broadcast_to(self._begin, (len(times), 2))
        if self._motion is not None:
            centers = self._begin + self._motion.shift(age)
        felt = np.ones(len(times))
        if self.course is not None:
            signal = self._load.signal
            felt[there] = [signal.value(each) for each in age[there]]
            there = there & (felt > 0)
        if self._law is not None:
            felt[there] = [self._law.felt(self._load.signal, each) for each in age[there]]
        return there, centers, felt

    def changes(self, first: float, last: float) -> bool:
        """Whether anything about it is different at some time from ``first`` to ``last`` (s)."""
        if last < self.start or self.end <= first:
            return False
        there = self.start <= first and last < self.end
        return not there or (last > first and not self._constant)

    @property
    def _constant(self) -> bool:
        return self.course is None and self._motion is None and self._law is None

    def _move(self, center):
        if self.shape == "polygon":
            self._set("points", self.points + (center - self.center))
        self._set("center", center)

    @property
    def felt(self) -> float:
        """Pressure that the law feels, at the time of `at`, in parts of the nominal one."""
        return self._felt

    def conductance(
        self, law: ContactLaw | None, across: int, felt: np.ndarray | None = None
    ) -> np.ndarray:
        """Conductance per area of the `patches`, S/m², by a contact law.

        One number (1,) where the pressure is even, else (Q,), of the mean pressure on each patch.
        Infinite for a bare conductor, and without a law. With ``felt`` (T, 1) that of T times.
        """
        mean = self._load.mean_pressure
        if law is None or mean is None:
            return np.full(1, math.inf)
        even = self.profile == "even"
        pressure = np.ones(1) if even else unit_disc_pressures(self.profile, across)
        return law.conductance(mean * (self._felt if felt is None else felt) * pressure)

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
            points, areas = unit_disc_cells(cells_along(2 * self.radius, spacing))
            return self.center + self.radius * points, self.radius**2 * areas
        points, areas = self._form_cells(spacing)
        return self.center + points, areas

    def patches(self, across: int = 6) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Where the contact meets a sheet: about ``across`` patches to its width, see `patches`.

        Returns
        -------
        points : (Q, 2) m; areas : (Q,) m², in sum that of the contact; radii : (Q,) m.
        """
        points, areas, radii = self.patches_about_center(across)
        return self.center + points, areas, radii

    def patches_about_center(self, across: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The same with points (Q, 2) against the centre, wherever the contact is."""
        key = "patches", across
        if key not in self._cells:
            self._cells[key] = self._make_patches(across)
        return self._cells[key]

    def _make_patches(self, across: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """The patches about the centre."""
        if self.shape == "disc":
            points, areas, radii = unit_disc_patches(across)
            return self.radius * points, self.radius**2 * areas, self.radius * radii
        vertices = self.vertices - self.center
        spacing = np.ptp(vertices, axis=0).max() / across
        cells, areas = self.sample(spacing)
        return join(*rim_of(vertices, spacing), cells - self.center, areas, spacing)

    def legs(self, longest: float) -> list[tuple[np.ndarray, np.ndarray]]:
        """Straight parts of its way: vertices (V, 2) at the beginning of each, and the way (2,).

        A contact at rest has one of length 0; an endless way is cut at ``longest`` (m).
        """
        vertices = self.vertices - self.center + self._begin
        if self._motion is None:
            return [(vertices, np.zeros(2))]
        lasts = self.end - self.start
        return [(vertices + shift, way) for shift, way in self._motion.legs(lasts, longest)]

    def shifts(self, step: float, lasts: float, longest: float) -> np.ndarray:
        """(S, 2) where it will be, against its beginning, every ``step`` m; see `Motion.steps`."""
        if self._motion is None:
            return np.empty((0, 2))
        return self._motion.steps(step, min(lasts, self.end - self.start), longest)

    def _form_cells(self, spacing: float) -> tuple[np.ndarray, np.ndarray]:
        """Sample points about the centre and their areas, computed once per spacing."""
        if spacing not in self._cells:
            width, height = self._form.size
            columns, rows = cells_along(width, spacing), cells_along(height, spacing)
            if columns * rows > MAX_CELLS:
                raise InputError(too_fine(spacing))
            points, areas = self._form.cells(columns, rows)
            areas.setflags(write=False)
            self._cells[spacing] = turned(points, self.angle), areas
        return self._cells[spacing]

    def to_dict(self) -> dict:
        """The contact as in a scene file."""
        content: dict[str, Any] = {"shape": self.shape}
        content.update({key: getattr(self, key) for key in SHAPES[self.shape]})
        for key in ("pressure", "force"):
            if getattr(self, key) is not None:
                content[key] = float(getattr(self, key))
        if self.profile != "even":
            content["profile"] = self.profile
        if self.course is not None:
            content["course"] = course_to_dict(self.course)
        content["from"] = float(self.start)
        if math.isfinite(self.end):
            content["to"] = float(self.end)
        if self.path is None:
            content["velocity"] = self.velocity
        else:
            content.update(path=np.asarray(self.path), speed=float(self.speed), loop=self.loop)
        return content


def read_contact(reader: Reader) -> Contact:
    """The contact in a mapping of a scene file."""
    shape = reader.choice("shape", tuple(SHAPES))
    reader.only(
        "shape", *SHAPES[shape], "pressure", "force", "profile", "course", "from", "to",
        "velocity", "path", "speed", "loop",
    )  # fmt: skip
    form: dict[str, Any] = {}
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
        force=reader.number("force", None),
        profile=reader.choice("profile", PROFILES) if "profile" in reader else "even",
        course=_read_course(reader),
        start=reader.number("from", 0.0),
        end=reader.number("to", math.inf, infinite=True),
        velocity=reader.numbers("velocity", 2, (0.0, 0.0)),
        path=reader.points("path") if "path" in reader else None,
        speed=reader.number("speed", None),
        loop=reader.flag("loop"),
    )


def _read_course(reader: Reader) -> Course | None:
    return read_course(reader.section("course")) if "course" in reader else None
