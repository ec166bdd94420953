"""Where the electrodes are: outline, positions, radius and sheet resistance; YAML in and out."""

import os
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from tomotactile_ros.layouts.layout_ids import make_id
from tomotactile_ros.layouts.outline import Outline, is_usual_size
from tomotactile_ros.layouts.region import FAR_OFF, Region
from tomotactile_ros.layouts.tolerance import Tolerance, read_tolerance
from tomotactile_ros.support import checks
from tomotactile_ros.support.checks import plain
from tomotactile_ros.support.errors import InputError, complaints_at, doubt
from tomotactile_ros.support.files import find_config
from tomotactile_ros.support.yamlio import Reader, write_mapping
from tomotactile_ros.surfaces import Cylinder, Flat, Mesh, PointGrid, Surface

FORMAT = "tomotactile-layout/1"
MAX_ELECTRODES = 65535  # a ground condition is numbered by a uint16
MAX_ROWS = 65535  # of a frame: rows are counted by a uint16
LOW_RESISTANCE = 50.0  # ohm/sq; probing layers have hundreds to some 100,000
_DECIMALS = 12  # of lengths that are computed, m: they read well, and are the same on every machine
_ON_RIM = 1e-9  # how far outside an electrode's centre may be, in parts of the outline's size


@dataclass(frozen=True, eq=False)
class Layout:
    """A sensor's electrodes on its sheet.

    Parameters
    ----------
    name : identifies the layout in messages, together with a hash of the geometry.
    outline : the sheet.
    sheet_resistance : of the probing layer, ohm/sq.
    radius : of every electrode, m.
    positions : (E, 2) centres, m, inside the outline or on its rim, more than 2 radius apart.
    provenance : how the layout came about; free-form, kept in the file.
    surface : how the sheet is bent.
    scan : electrodes that are grounded, row after row: any of them, as often as one likes; empty
        for all in turn. Devices that take an order scan so, simulated frames have these rows.
    tolerance : how well the sheet is made.
    """

    name: str
    outline: Outline
    sheet_resistance: float
    radius: float
    positions: np.ndarray
    provenance: dict = field(default_factory=dict)
    surface: Surface = field(default_factory=Flat)
    scan: tuple[int, ...] = ()
    tolerance: Tolerance = field(default_factory=Tolerance)

    def __post_init__(self):
        if not isinstance(self.name, str) or not self.name.strip():
            raise InputError(f"name: {checks.show(self.name)} is not a text")
        if not self.name.isprintable():
            raise InputError(f"name: {checks.show(self.name)} has characters that nothing shows")
        checks.positive(self.sheet_resistance, "sheet_resistance", "number in ohm/sq")
        _doubt_low_resistance(self.sheet_resistance, f"{self.name}: sheet_resistance")
        checks.length(self.radius, "electrodes.radius")
        positions = checks.points(self.positions, "electrodes.positions", least=2)
        object.__setattr__(self, "positions", positions)
        self._check_inside()
        check_on_sheet(self, self.radius, "electrodes.radius")
        self._check_apart()
        with complaints_at("surface."):
            self.surface.check(self.outline.size)
        with complaints_at("tolerance."):
            self.tolerance.check(self.outline.size)
        if len(self.scan):
            order = checks.order(self.scan, "scan.order", self.electrodes)
            if len(order) > MAX_ROWS:
                raise InputError(f"scan.order: {len(order)} rows, a frame has at most {MAX_ROWS}")
            object.__setattr__(self, "scan", tuple(order.tolist()))

    @property
    def electrodes(self) -> int:
        """Number of electrodes E."""
        return len(self.positions)

    @property
    def grounded(self) -> np.ndarray:
        """(L,) electrode that is grounded in each row of a frame: the scan's, or all in turn."""
        return np.array(self.scan, np.intp) if self.scan else np.arange(self.electrodes)

    @cached_property
    def id(self) -> str:
        """What a voltage frame names to say which layout it was measured with: ``name#1a2b3c4d``.

        The hash is of what the readings depend on: outline, holes, positions and radius. How the
        sheet is bent changes none, and which rows there are stands in each frame.
        """
        outline = self.outline
        rim = np.array([outline.radius]) if outline.kind == "circle" else outline.shell
        lengths = [rim, *outline.holes, self.positions, np.array(self.radius)]
        return make_id(self.name, outline.kind, lengths)

    @cached_property
    def pitches(self) -> np.ndarray:
        """(E,) distance from each electrode to the next one, m, between centres."""
        return self._tree.query(self.positions, k=2)[0][:, 1]

    def nearest(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(P,) distance, m, and (P,) number of the electrode nearest to each of (P, 2) points."""
        return self._tree.query(points)

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self.positions)

    def save(self, path: str | os.PathLike) -> None:
        """Write the layout as YAML; an existing file is replaced whole or not at all."""
        content = {
            "format": FORMAT,
            "name": self.name,
            "outline": self.outline.to_dict(),
            "sheet_resistance": float(self.sheet_resistance),
            "electrodes": {"radius": float(self.radius), "positions": self.positions},
        }
        if self.scan:
            content["scan"] = {"order": list(self.scan)}
        if self.surface != Flat():
            content["surface"] = self.surface.to_dict(Path(os.path.realpath(path)).parent)
        if self.tolerance != Tolerance():
            content["tolerance"] = self.tolerance.to_dict()
        if not is_usual_size(self.outline.size):
            content["unusual_size"] = True
        if self.provenance:
            content["provenance"] = self.provenance
        write_mapping(path, content)

    def _check_inside(self) -> None:
        tolerance = _ON_RIM * max(self.outline.size)
        outside = np.flatnonzero(~self.outline.contains(self.positions, tolerance))
        if len(outside):
            x, y = self.positions[outside[0]]
            a, b = self.outline.size
            at = f"electrodes.positions[{outside[0]}]: [{x:g}, {y:g}]"
            for i, hole in enumerate(self.outline.holes):
                if Region(hole).contains(self.positions[outside[:1]])[0]:
                    raise InputError(f"{at} lies in holes[{i}] of the outline")
            raise InputError(
                f"{at} lies outside the outline ({self.outline.kind}, {a:g} m x {b:g} m around the origin)"
                + self._what_was_meant(tolerance)
            )

    def _what_was_meant(self, tolerance: float) -> str:
        """Which other unit or origin puts all electrodes on the sheet, if one does."""
        middle = np.array(self.outline.size) / 2
        if self.outline.contains(self.positions - middle, tolerance).all():
            return "; was the origin a corner of the sheet? It is its middle"
        far = np.abs(self.positions).max() > FAR_OFF * max(self.outline.size)
        if far and self.outline.contains(self.positions / 1e3, tolerance).all():
            return "; are the positions in mm? They must be in m"
        return ""

    def _check_apart(self) -> None:
        if self.electrodes > MAX_ELECTRODES:
            raise InputError(
                f"electrodes.positions: {self.electrodes} electrodes, at most {MAX_ELECTRODES} work"
            )
        first = int(np.argmin(self.pitches))
        nearest = self.pitches[first]
        if nearest <= 2 * self.radius:
            # coinciding points may each list the other or themselves first
            neighbours = self._tree.query(self.positions[first], k=2)[1]
            second = int(next(n for n in neighbours if n != first))
            low, high = sorted((first, second))
            raise InputError(
                f"electrodes.positions: electrodes {low} and {high} overlap: {plain(1e3 * nearest, 4)} mm"
                f" apart, they need more than {plain(2e3 * self.radius, 4)} mm"
            )


def check_layout(value: object) -> None:
    """Refuse what is no layout, as the name of a file."""
    checks.instance(value, "layout", Layout, "load_layout reads one from its file")


def check_on_sheet(layout: Layout, radius: float, key: str) -> None:
    """Refuse what is wider than the sheet, a `radius` in m that was probably given in mm."""
    if 2 * radius > max(layout.outline.size):
        raise InputError(
            f"{key}: a radius of {radius:g} m is wider than the sheet: lengths are in m, was {radius:g} mm "
            f"meant? That is {radius / 1e3:g}"
        )


def _doubt_low_resistance(sheet_resistance: float, key: str) -> None:
    """Doubt a resistance, ohm/sq, that was probably given in kilohm."""
    if 0 < sheet_resistance < LOW_RESISTANCE:
        doubt(
            f"{key}: {sheet_resistance:g} ohm/sq is low for a probing layer; "
            f"was {sheet_resistance:g} kohm/sq meant? That is {1e3 * sheet_resistance:g}"
        )


def load_layout(path: str | os.PathLike, content: dict | None = None) -> Layout:
    """Read a layout from a path, or by the name of an installed one.

    ``content`` is the file's mapping where it was read already.
    """
    path = find_config("layouts", path)
    reader = Reader.open(path, FORMAT, content=content)
    reader.only(
        "format",
        "name",
        "outline",
        "sheet_resistance",
        "electrodes",
        "provenance",
        "scan",
        "surface",
        "tolerance",
        "unusual_size",
    )
    electrodes = reader.section("electrodes")
    electrodes.only("radius", "positions")
    outline = read_outline(reader.section("outline", OUTLINE), reader.flag("unusual_size"))
    surface: Surface = Flat()
    if "surface" in reader:
        surface = _read_surface(reader.section("surface"), path.resolve().parent, outline.size)
    scan: tuple[int, ...] = ()
    if "scan" in reader:
        section = reader.section("scan")
        section.only("order")
        scan = section.integers("order")
        if not scan:
            section.refuse("order", [], "names no electrode; without scan all are grounded in turn")
    return reader.build(
        Layout,
        name=reader.text("name"),
        outline=outline,
        sheet_resistance=reader.number("sheet_resistance"),
        radius=electrodes.number("radius"),
        positions=electrodes.points("positions"),
        provenance=reader.free("provenance"),
        surface=surface,
        scan=scan,
        tolerance=read_tolerance(reader),
    )


def equal_grid(
    rows: int,
    cols: int,
    size: tuple[float, float],
    radius: float,
    sheet_resistance: float,
    inset: float = 0.0,
    name: str | None = None,
    unusual_size: bool = False,
    hexagonal: bool = False,
) -> Layout:
    """Electrodes on an equally spaced grid over a rectangle.

    Parameters
    ----------
    rows, cols : number of electrodes along y and along x, each at least 2.
    size : width (x) and height (y) of the sheet, m.
    radius, sheet_resistance : as in :class:`Layout`.
    inset : distance of the outermost centres from the rim, m.
    unusual_size : as of :class:`Outline`.
    hexagonal : every second row, the first one, is shorter by one and lies in the gaps of the others.
        Every electrode is as far from all its neighbours where the rows are 0.866 times as far apart as
        the electrodes of a row, (width - 2 inset) / (cols - 1).

    The order is row by row from the lower left: electrode ``r * cols + c`` is in row ``r`` from
    below and column ``c`` from the left.
    """
    rows = checks.integer(rows, "rows", 2, 256)
    cols = checks.integer(cols, "cols", 2, 256)
    width, height = checks.pair(size, "size", "length in m")
    outline = Outline.rectangle(width, height, unusual_size=unusual_size)
    half_width, half_height = half_sides(outline, inset)
    lines = []
    for row, y in enumerate(np.arange(1 - rows, rows, 2) / (rows - 1) * half_height):
        count = cols - (hexagonal and row % 2 == 0)
        x = np.arange(1 - count, count, 2) / (cols - 1) * half_width
        lines.append(np.column_stack([x, np.full(count, y)]))
    positions = rounded(np.concatenate(lines))
    usual = f"hex-{len(positions)}" if hexagonal else f"equal-{rows}x{cols}"
    return Layout(name or usual, outline, sheet_resistance, radius, positions)


def rounded(lengths: np.ndarray | float) -> np.ndarray:
    """Computed lengths, m, to a picometre, as they stand in a file."""
    return np.round(lengths, _DECIMALS) + 0.0  # no -0.0


def half_sides(outline: Outline, inset: float) -> tuple[float, float]:
    """Half of the width and height that an inset (m) leaves; InputError where it leaves none."""
    inset = checks.not_negative(inset, "inset", "length in m")
    a, b = outline.size
    if inset >= min(a, b) / 2:
        raise InputError(
            f"inset: {inset:g} leaves no room, it must be below {min(a, b) / 2:g}, half the sheet"
        )
    return a / 2 - inset, b / 2 - inset


OUTLINE = "{rectangle: [0.2, 0.2]}"  # for who wrote something else


def read_outline(reader: Reader, unusual_size: bool) -> Outline:
    """The outline in a mapping of a layout or scene file."""
    kind = reader.the_one_of("rectangle", "circle", "polygon", beside=("holes",))
    holes = [entry.points(key) for key, entry in reader.entries("holes")]
    if kind == "rectangle":
        sides = reader.numbers("rectangle", 2)
        return reader.build(Outline.rectangle, *sides, holes=holes, unusual_size=unusual_size)
    if kind == "circle":
        radius = reader.number("circle")
        return reader.build(Outline.circle, radius, holes=holes, unusual_size=unusual_size)
    points = reader.points("polygon")
    return reader.build(Outline.polygon, points, holes=holes, unusual_size=unusual_size)


def _read_surface(reader: Reader, folder: Path, size: tuple[float, float]) -> Surface:
    kind = reader.the_one_of("flat", "cylinder", "grid", "mesh")
    section = reader.section(kind)
    if kind == "cylinder":
        section.only("radius")
        return reader.build(Cylinder, section.number("radius"))
    if kind == "grid":
        section.only("points")
        return reader.build(PointGrid, section.grid("points", 3), size, "grid")
    if kind == "mesh":
        section.only("file", "center", "x_axis", "scale")
        return reader.build(
            Mesh.load,
            section.text("file"),
            section.numbers("center", 3),
            section.numbers("x_axis", 3),
            section.number("scale", 1.0),
            folder,
            size,
        )
    section.only()
    return Flat()
