"""The states of sheets of which the benchmark keeps reference data: families, seeded.

A family is one layout, sheets of it, and states: what presses on which sheet. Pressures become
conductances by the contact law of the settings' default (g = 1e-4 p, S/m^2 and Pa).
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from functools import partial
from zlib import crc32

import numpy as np
import shapely

from tomotactile_ros.bench.reference_mesh import Ellipse, Shape, disc
from tomotactile_ros.bench.trials import LAW
from tomotactile_ros.layouts.layout import Layout, equal_grid, load_layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.layouts.region import Region, ellipse_polygon, regular_polygon, turned
from tomotactile_ros.scenes.sheet_field import Anisotropy, Gradient, SheetField, SheetVariation

SIDE, RESISTANCE = 0.2, 1e4  # m, ohm/sq
_LENGTH = 0.05  # m, correlation length of uneven sheets


@dataclass(frozen=True)
class Press:
    """One contact: its form, its words, and the pressure in Pa."""

    shape: Shape
    words: str
    pressure: float

    @property
    def conductance(self) -> float:
        """S/m^2."""
        return float(LAW.conductance(self.pressure))


@dataclass(frozen=True)
class State:
    """What presses, the number of the sheet that it presses on, and the case that it belongs to."""

    case: str
    contacts: list[Press]
    sheet: int = 0


@dataclass(frozen=True, eq=False)
class Sheet:
    """An uneven sheet and its words."""

    words: str = "even"
    field: SheetField = field(default_factory=SheetField)
    variation: SheetVariation | None = None


@dataclass(frozen=True, eq=False)
class Family:
    """States of one layout."""

    layout: Layout
    states: list[State]
    sheets: list[Sheet] = field(default_factory=lambda: [Sheet()])


def truth(press: Press, outline: Outline) -> dict:
    """What is there to be found: of the part that lies on the sheet.

    x, y : centroid, m; area : m^2; radius : of the disc of that area, m; pressure : Pa; force : N;
    conductance : S/m^2; shape, center, and disc_radius of a disc.
    """
    shape = press.shape
    region = shape if isinstance(shape, Region) else _polygon_of(shape)
    sheet = shapely.Polygon(outline.shell, outline.holes)
    part = shapely.Polygon(region.shell, region.holes).intersection(sheet)
    content = {
        "shape": press.words,
        "x": part.centroid.x,
        "y": part.centroid.y,
        "area": part.area,
        "radius": math.sqrt(part.area / math.pi),
        "pressure": press.pressure,
        "force": press.pressure * part.area,
        "conductance": press.conductance,
    }
    if isinstance(shape, Ellipse):
        content["center"] = [float(each) for each in shape.center]
        if press.words == "disc":
            content["disc_radius"] = shape.semi_axes[0]
    return content


def _polygon_of(ellipse: Ellipse) -> Region:
    points = ellipse_polygon(ellipse.semi_axes, 256)
    return Region(turned(points, ellipse.angle) + ellipse.center)


# -- layouts ------------------------------------------------------------------------------------


def void() -> Layout:
    """8 x 8 without its four central electrodes."""
    grid = load_layout("equal-8x8")
    kept = np.setdiff1d(np.arange(64), [27, 28, 35, 36])
    return Layout("void-60", grid.outline, RESISTANCE, grid.radius, grid.positions[kept])


def random_places() -> Layout:
    """40 electrodes at random places, 18 mm apart at least."""
    random = np.random.default_rng(40)
    places = apart(lambda: (random.random(2) - 0.5) * 0.19, 40, 0.018)
    return Layout("random-40", Outline.rectangle(SIDE, SIDE), RESISTANCE, 0.0025, places)


def l_shape() -> Layout:
    """An L of 200 mm with arms of 100 mm; those electrodes of an 8 x 8 grid that lie on it."""
    grid = equal_grid(8, 8, (SIDE, SIDE), 0.0025, RESISTANCE, inset=0.0125)
    half = SIDE / 2
    corners = [(-half, -half), (half, -half), (half, 0), (0, 0), (0, half), (-half, half)]
    outline = Outline.polygon(corners)
    on = outline.contains(grid.positions)
    return Layout("l-shape-48", outline, RESISTANCE, 0.0025, grid.positions[on])


def ring() -> Layout:
    """16 electrodes on the rim of a circle of 100 mm."""
    angle = 2 * np.pi / 16 * np.arange(16)
    places = 0.1 * np.column_stack([np.cos(angle), np.sin(angle)])
    return Layout("rim-16", Outline.circle(0.1), RESISTANCE, 0.005, places)


# -- contacts -----------------------------------------------------------------------------------


def apart(draw: Callable[[], np.ndarray], count: int, distance: float) -> np.ndarray:
    """(count, 2) places that are drawn, each farther than `distance`, m, from those before."""
    found: list[np.ndarray] = []
    while len(found) < count:
        place = draw()
        if all(np.linalg.norm(place - other) > distance for other in found):
            found.append(place)
    return np.array(found)


def _anywhere(random, outline: Outline, clearance: float, reach: float = 1.0) -> np.ndarray:
    """(2,) a place on the sheet, `clearance` (m) from its rim, within `reach` of its half size."""
    while True:
        place = (random.random(2) - 0.5) * outline.size * reach
        inside = outline.kind != "circle" or np.linalg.norm(place) <= reach * outline.radius
        if inside and outline.holds(place[None], clearance)[0]:
            return place


def _pressed(shape, words, random, least=5e3, most=5e4) -> Press:
    return Press(shape, words, float(least * (most / least) ** random.random()))


def textbook_states(layout, random, count, case="textbook", reach=1.0) -> list[State]:
    """Discs of 4 to 12 mm, 5 to 50 kPa, anywhere on the sheet."""
    states = []
    for _ in range(count):
        radius = 0.004 + 0.008 * random.random()
        place = _anywhere(random, layout.outline, radius + 1e-4, reach)
        states.append(State(case, [_pressed(disc(place, radius), "disc", random)]))
    return states


def crowd_states(layout, random, count) -> list[State]:
    """3 to 6 discs of 4 to 10 mm, 25 mm apart at least, the strongest ten times the weakest."""
    states = []
    for number in np.repeat((3, 4, 5, 6), count):
        places = apart(lambda: _anywhere(random, layout.outline, 0.011), number, 0.025)
        forces = 0.5 * 10 ** np.concatenate([[0, 1], random.random(number - 2)])
        presses = []
        for place, force in zip(places, forces):
            radius = 0.004 + 0.006 * random.random()
            pressure = float(force / (math.pi * radius**2))
            presses.append(Press(disc(place, radius), "disc", pressure))
        states.append(State(f"{number} contacts", presses))
    return states


def beside_states(layout, random, count) -> list[State]:
    """A disc alone and the same beside a second, by turns, `count` times; 30 mm apart at least."""
    states = []
    for _ in range(count):
        places: list[np.ndarray] = []
        presses: list[Press] = []
        while len(presses) < 2:
            radius = 0.004 + 0.004 * random.random()
            place = _anywhere(random, layout.outline, radius + 1e-4)
            if all(np.linalg.norm(place - other) >= 0.03 for other in places):
                places.append(place)
                presses.append(_pressed(disc(place, radius), "disc", random, 1e4, 3e4))
        states += [State("one", presses[:1]), State("two", presses)]
    return states


def pair_states(layout, random, distances, count) -> list[State]:
    """Two discs of 5 mm, 20 kPa, at each of the `distances`, m."""
    states = []
    for distance in np.repeat(distances, count):
        while True:
            middle = _anywhere(random, layout.outline, 0.01)
            angle = math.pi * random.random()
            way = distance / 2 * np.array([math.cos(angle), math.sin(angle)])
            places = np.array([middle + way, middle - way])
            if layout.outline.holds(places, 0.006).all():
                break
        presses = [Press(disc(place, 0.005), "disc", 2e4) for place in places]
        states.append(State(f"{1e3 * distance:g} mm apart", presses))
    return states


def wide_states(layout, random, count) -> list[State]:
    """Wide contacts of many forms, `count` each, and plates and the whole sheet at 20 to 400 N."""
    states = []

    def add(case, shape, words=None):
        states.append(State(case, [_pressed(shape, words or case, random, 5e3, 2e4)]))

    for radius in np.repeat((0.015, 0.02, 0.03, 0.04), count):
        place = _anywhere(random, layout.outline, radius + 1e-4)
        add(f"disc of {1e3 * radius:g} mm", disc(place, radius), "disc")
    for _ in range(count):
        add("rectangle 80 x 50", _rectangle(random, layout, 0.08, 0.05))
        add("line 100 x 5", _rectangle(random, layout, 0.1, 0.005))
        corners = np.array([[-30, -30], [30, -30], [30, -10], [-10, -10], [-10, 30], [-30, 30]])
        add("L", Region(_placed(random, layout, corners / 1e3, 0.043)))
        centre = _anywhere(random, layout.outline, 0.0305)
        holes = (centre + regular_polygon(0.02, 72),)
        add("ring", Region(centre + regular_polygon(0.03, 72), holes))
        states.append(_hand(random))
    for side in (0.06, 0.08, 0.1, 0.14):
        for force in 20.0 * 20.0 ** (np.arange(count) / max(count - 1, 1)):
            press = Press(_rectangle(random, layout, side, side), "plate", float(force / side**2))
            states.append(State(f"plate of {1e3 * side:g} mm", [press]))
    everything = Region(2 * layout.outline.shell)
    for force in (20.0, 50.0, 100.0, 200.0, 400.0):
        press = Press(everything, "sheet", force / layout.outline.area)
        states.append(State(f"whole sheet, {force:g} N", [press]))
    return states


def _placed(random, layout, corners, reach):
    """`corners` (V, 2), turned at random, somewhere on the sheet; `reach` is their furthest, m."""
    angle = 360 * random.random()
    return turned(corners, angle) + _anywhere(random, layout.outline, reach + 1e-4)


def _rectangle(random, layout, width, height) -> Region:
    corners = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]]) / 2 * [width, height]
    reach = math.hypot(width, height) / 2
    if reach > 0.45 * min(layout.outline.size):  # too large to be turned
        return Region(corners + 0.01 * (random.random(2) - 0.5))
    return Region(_placed(random, layout, corners, reach))


def _hand(random) -> State:
    """A palm of 70 x 56 mm and five fingertips around one half of it."""
    turn, shift = 360 * random.random(), 0.03 * (random.random(2) - 0.5)
    presses = [Press(Ellipse(tuple(shift), (0.035, 0.028), turn), "palm", 6e3)]
    for degrees, reach in zip((-75, -32, -4, 24, 52), (0.052, 0.062, 0.066, 0.063, 0.056)):
        place = turned(np.array([[reach, 0.0]]), turn + degrees)[0] + shift
        press = _pressed(disc(place, 0.006 + 0.002 * random.random()), "disc", random, 1e4, 3e4)
        presses.append(press)
    return State("hand", presses)


# -- sheets and families ------------------------------------------------------------------------

EVEN = [Sheet()]
UNEVEN = [
    *(
        Sheet(f"random {relative:.0%}", variation=SheetVariation(relative, _LENGTH, seed))
        for relative in (0.1, 0.2)
        for seed in (1, 2, 3)
    ),
    *(Sheet("gradient 20%", SheetField(gradient=Gradient(0.2, to))) for to in (0.0, 120.0)),
    *(
        Sheet("anisotropy 1.5", SheetField(anisotropy=Anisotropy(1.5, to)))
        for to in (0.0, 30.0, 45.0, 90.0)
    ),
]
_ROUGH, _TURNED = SheetVariation(0.2, _LENGTH, 11), SheetField(anisotropy=Anisotropy(1.5, 30.0))
WORN = [
    Sheet("random 20%", variation=_ROUGH),
    Sheet("anisotropy 1.5", _TURNED),
    Sheet("both", _TURNED, _ROUGH),
]
_DISTANCES = 0.016, 0.02, 0.024, 0.028, 0.034, 0.04
_LARGE, _SMALL = partial(load_layout, "equal-8x8"), partial(load_layout, "equal-4x4")
FAMILIES: dict[str, tuple] = {  # layout, sheets, states of each sheet, and how many, in this order
    "textbook-8x8": (_LARGE, EVEN, textbook_states, 120),
    "sheets-8x8": (_LARGE, UNEVEN, textbook_states, 10),
    "crowd-8x8": (_LARGE, EVEN, crowd_states, 10),
    "pairs-8x8": (_LARGE, EVEN, pair_states, _DISTANCES, 5),
    "wide-8x8": (_LARGE, EVEN, wide_states, 5),
    "beside-8x8": (_LARGE, EVEN, beside_states, 12),
    "textbook-4x4": (_SMALL, EVEN, textbook_states, 60),
    "crowd-4x4": (_SMALL, EVEN, crowd_states, 6),
    "layout-void-60": (void, EVEN, textbook_states, 24),
    "layout-random-40": (random_places, EVEN, textbook_states, 24),
    "layout-l-shape-48": (l_shape, EVEN, textbook_states, 24),
    "layout-rim-16": (ring, EVEN, textbook_states, 24, "textbook", 0.6),
    "learning-8x8": (_LARGE, WORN, textbook_states, 46),
    "learning-4x4": (_SMALL, WORN[2:], textbook_states, 76),
    "learning-rim-16": (ring, WORN[2:], textbook_states, 76, "textbook", 0.6),
}


def family(name: str) -> Family:
    """One of `FAMILIES`, seeded; states on uneven sheets are cases of the names of these."""
    make_layout, sheets, make, *given = FAMILIES[name]
    layout, random, states = make_layout(), np.random.default_rng(crc32(name.encode())), []
    for number, sheet in enumerate(sheets):
        for state in make(layout, random, *given):
            case = state.case if sheets is EVEN else sheet.words
            states.append(replace(state, case=case, sheet=number))
    return Family(layout, states, sheets)
