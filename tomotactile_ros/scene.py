"""What touches the sheet and what is wrong with the measurement; YAML in and out.

Anything a scene does not name is not modelled.
"""

import copy
import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path

import numpy as np

from tomotactile_ros import checks
from tomotactile_ros.errors import InputError
from tomotactile_ros.layout import Layout
from tomotactile_ros.region import MAX_CELLS, Region, regular_polygon, ring
from tomotactile_ros.yamlio import Reader, find_config, write_mapping

FORMAT = "tomotactile-scene/1"
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
        return self.coefficient * np.maximum(pressure, 0.0) ** self.exponent

    def pressure(self, conductance: np.ndarray | float) -> np.ndarray:
        """Pressure in Pa that belongs to g in S/m²; 0 where g is not above 0."""
        return (np.maximum(conductance, 0.0) / self.coefficient) ** (1 / self.exponent)


@dataclass(frozen=True)
class Noise:
    """Gaussian noise of every reading: ``rms`` in V, and the seed of the random numbers."""

    rms: float
    seed: int = 0

    def __post_init__(self):
        checks.not_negative(self.rms, "rms", "voltage in V")
        _check_seed(self.seed)


@dataclass(frozen=True)
class Adc:
    """Analog-digital conversion: 2^bits steps from 0 V to ``range`` V."""

    bits: int
    range: float

    def __post_init__(self):
        checks.integer(self.bits, "bits", 1, 32)
        checks.positive(self.range, "range", "voltage in V")


@dataclass(frozen=True)
class Drift:
    """Slow wandering of the readings: ``amplitude`` in V, ``period`` in s, seed of its phases."""

    amplitude: float
    period: float
    seed: int = 0

    def __post_init__(self):
        checks.not_negative(self.amplitude, "amplitude", "voltage in V")
        checks.positive(self.period, "period", "time in s")
        _check_seed(self.seed)


@dataclass(frozen=True)
class Hum:
    """Mains hum on the readings: ``amplitude`` in V, ``frequency`` in Hz."""

    amplitude: float
    frequency: float

    def __post_init__(self):
        checks.not_negative(self.amplitude, "amplitude", "voltage in V")
        checks.positive(self.frequency, "frequency", "number of Hz")


@dataclass(frozen=True)
class SheetVariation:
    """Random field of the sheet resistance.

    Parameters
    ----------
    relative : standard deviation in parts of the mean, 0 to 1.
    length : correlation length, m.
    seed : of the random numbers.
    """

    relative: float
    length: float
    seed: int = 0

    def __post_init__(self):
        if checks.not_negative(self.relative, "relative", "number") > 1:
            raise InputError(f"relative: {self.relative:g} is above 1")
        checks.length(self.length, "length")
        _check_seed(self.seed)


@dataclass(frozen=True)
class Defects:
    """What is wrong with the sensor; each part is modelled only if it is named.

    Parameters
    ----------
    dead : electrodes without a valid reading.
    swapped : pairs of electrodes whose wires are exchanged.
    drift, hum, sheet_variation : see there; None for none.
    switch_resistance : between the grounded electrode and ground, ohm.
    """

    dead: tuple[int, ...] = ()
    swapped: tuple[tuple[int, int], ...] = ()
    drift: Drift | None = None
    hum: Hum | None = None
    switch_resistance: float = 0.0
    sheet_variation: SheetVariation | None = None

    def __post_init__(self):
        checks.not_negative(self.switch_resistance, "switch_resistance", "resistance in ohm")
        wires = [wire for pair in self.swapped for wire in pair]
        for key, numbers in (("dead", self.dead), ("swapped", wires)):
            if len(set(numbers)) < len(numbers):
                raise InputError(f"{key}: {checks.show(list(numbers))} names an electrode twice")
            if min(numbers, default=0) < 0:
                raise InputError(f"{key}: {min(numbers)} is not an electrode, they count from 0")


def _check_seed(seed: int) -> None:
    checks.integer(seed, "seed", 0, 2**32 - 1)


@dataclass(frozen=True, eq=False)
class Scene:
    """What a sensor measures: contacts, drive and defects.

    Parameters
    ----------
    name : for people.
    drive_voltage : of the driving layer, V.
    contacts : any number, also none; they may coincide.
    contact_law : makes a pressure a conductance; None: all contacts are bare conductors at the
        drive voltage and their pressure is only part of the truth.
    noise, adc, defects : of the measurement.
    layout : name of the layout that the scene was made for, or None for any.
    """

    name: str
    drive_voltage: float
    contacts: tuple[Contact, ...] = ()
    contact_law: ContactLaw | None = None
    noise: Noise | None = None
    adc: Adc | None = None
    defects: Defects = field(default_factory=Defects)
    layout: str | None = None

    def __post_init__(self):
        checks.positive(self.drive_voltage, "drive_voltage", "voltage in V")
        object.__setattr__(self, "contacts", tuple(self.contacts))

    def check(self, layout: Layout) -> None:
        """Refuse a layout that the scene does not fit."""
        place = f"scene {self.name}: "
        if self.layout is not None and self.layout != layout.name:
            raise InputError(
                f"{place}layout: the scene is for '{self.layout}', not for '{layout.name}'"
            )
        for i, contact in enumerate(self.contacts):
            if not _reaches(contact, layout):
                raise InputError(f"{place}contacts[{i}]: never touches the sheet of {layout.name}")
        wires = [wire for pair in self.defects.swapped for wire in pair]
        for key, numbers in (("dead", self.defects.dead), ("swapped", wires)):
            if max(numbers, default=0) >= layout.electrodes:
                raise InputError(
                    f"{place}defects.{key}: electrode {max(numbers)} does not exist, "
                    f"{layout.name} has 0 to {layout.electrodes - 1}"
                )

    def truth(self, t: float) -> list[dict]:
        """What really touches at the time ``t`` (s), in the order of the scene.

        For each contact x, y (centroid, m), force (N), pressure (Pa), area (m²) and radius (of the
        disc of the same area, m); force and pressure are None where the scene names no pressure.
        """
        return [_describe(now) for contact in self.contacts if (now := contact.at(t)) is not None]

    def save(self, path: str | os.PathLike) -> None:
        """Write the scene as YAML; an existing file is replaced whole or not at all."""
        content = {"format": FORMAT, "drive_voltage": float(self.drive_voltage)}
        if self.layout is not None:
            content["layout"] = self.layout
        content["contacts"] = [contact.to_dict() for contact in self.contacts]
        for key in ("contact_law", "noise", "adc"):
            if getattr(self, key) is not None:
                content[key] = dict(vars(getattr(self, key)))
        defects = {
            key: dict(vars(value)) if hasattr(value, "__dict__") else value
            for key, value in vars(self.defects).items()
            if value
        }
        if defects:
            content["defects"] = defects
        write_mapping(path, content)


def load_scene(path: str | os.PathLike) -> Scene:
    """Read a scene from a path, or by the name of an installed one."""
    path = find_config("scenes", path)
    reader = Reader.open(path, FORMAT)
    reader.only(
        "format", "drive_voltage", "layout", "contacts", "contact_law", "noise", "adc", "defects"
    )
    return reader.build(
        Scene,
        name=Path(path).stem,
        drive_voltage=reader.number("drive_voltage"),
        contacts=[_read_contact(contact) for contact in reader.sections("contacts")],
        contact_law=_read(reader, "contact_law", ContactLaw, ("coefficient", "exponent")),
        noise=_read(reader, "noise", Noise, ("rms",), seed=True),
        adc=_read_adc(reader),
        defects=_read_defects(reader.section("defects")) if "defects" in reader else Defects(),
        layout=reader.text("layout", None),
    )


def _read_contact(reader: Reader) -> Contact:
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


def _read(reader: Reader, key: str, kind: type, numbers: tuple[str, ...], seed: bool = False):
    """An object of numbers (and a seed) under a key, or None if the key is not there."""
    if key not in reader:
        return None
    section = reader.section(key)
    section.only(*numbers, *(["seed"] if seed else []))
    values = {name: section.number(name) for name in numbers}
    if seed:
        values["seed"] = section.integer("seed", 0)
    return section.build(kind, **values)


def _read_adc(reader: Reader) -> Adc | None:
    if "adc" not in reader:
        return None
    section = reader.section("adc")
    section.only("bits", "range")
    return section.build(Adc, section.integer("bits"), section.number("range"))


def _read_defects(reader: Reader) -> Defects:
    reader.only("dead", "swapped", "drift", "hum", "switch_resistance", "sheet_variation")
    swapped = []
    for key, entry in reader.entries("swapped"):
        swapped.append(entry.integers(key))
        if len(swapped[-1]) != 2:
            reader.refuse(key, list(swapped[-1]), "is not a pair of electrodes")
    return reader.build(
        Defects,
        dead=reader.integers("dead", ()),
        swapped=tuple(swapped),
        drift=_read(reader, "drift", Drift, ("amplitude", "period"), seed=True),
        hum=_read(reader, "hum", Hum, ("amplitude", "frequency")),
        switch_resistance=reader.number("switch_resistance", 0.0),
        sheet_variation=_read(
            reader, "sheet_variation", SheetVariation, ("relative", "length"), seed=True
        ),
    )


def _reaches(contact: Contact, layout: Layout) -> bool:
    """Whether the contact touches the sheet at any time."""
    vertices = contact.vertices
    speed = float(np.linalg.norm(contact.velocity))
    path = np.zeros(2)
    if speed > 0:
        farthest = np.linalg.norm(vertices, axis=1).max() + np.linalg.norm(layout.outline.size)
        distance = min(speed * (contact.end - contact.start), 2 * farthest)
        path = contact.velocity / speed * distance
    return layout.outline.is_met_by(vertices, path)


def _describe(contact: Contact) -> dict:
    x, y = contact.centroid
    pressure = None if contact.pressure is None else float(contact.pressure)
    return {
        "x": float(x),
        "y": float(y),
        "force": None if pressure is None else pressure * contact.area,
        "pressure": pressure,
        "area": contact.area,
        "radius": math.sqrt(contact.area / math.pi),
    }
