"""Touches that slide, by the reference model: every row of a scan is solved where the touch is then.

`benchmark/data/slides/NAME.npz`, made once and kept as the states of `reference_data` are:

    rows    (S, V, N L, E) float32, V per volt of drive: of each slide at each of the speeds, N scans
            of L rows; row i has electrode i mod L grounded, and NaN for its own reading
    slides  JSON, for each slide {"direction": (2,), "contact": what `reference_cases.truth` says of
            the touch at the time of the first row}
    speeds  JSON, m/s
    layout, made  as of `reference_data`; `made` has the row period, s

All speeds of a slide begin at one place, so that rows at the same place share a solution.
"""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from zlib import crc32

import numpy as np

from tomotactile_ros.bench import reference_data
from tomotactile_ros.bench.reference import reference_frame
from tomotactile_ros.bench.reference_cases import Family, Press, State, truth
from tomotactile_ros.bench.reference_mesh import Ellipse, disc
from tomotactile_ros.bench.sensor.states import solved
from tomotactile_ros.layouts.layout import Layout, load_layout
from tomotactile_ros.simulation import ROW_PERIOD

FOLDER = reference_data.FOLDER / "slides"
SPEEDS = 0.2, 0.5, 1.0  # m/s
SCANS = 2  # of a slide
COUNT = 2  # slides
_RADII = 0.004, 0.008  # m, from and to
_PRESSURES = 10e3, 30e3  # Pa


@dataclass(frozen=True)
class Slide:
    """A disc (`press`, where it begins) that slides straight along the unit vector `direction`."""

    press: Press
    direction: tuple[float, float]

    def at(self, way: float) -> Press:
        """The disc after a way of so many m."""
        shape = self.press.shape
        assert isinstance(shape, Ellipse)
        x, y = np.add(shape.center, np.multiply(way, self.direction))
        return replace(self.press, shape=replace(shape, center=(x, y)))


@dataclass(frozen=True, eq=False)
class SlideData:
    """Rows of slides; keys as in the file."""

    layout: Layout
    rows: np.ndarray
    slides: list[dict]
    speeds: list[float]
    made: dict


def slides(name: str) -> tuple[Layout, list[Slide]]:
    """The slides of an installed layout, seeded: wholly on the sheet at the highest speed."""
    layout = load_layout(name)
    random = np.random.default_rng(crc32(f"slides {name}".encode()))
    longest = max(SPEEDS) * ROW_PERIOD * (SCANS * layout.electrodes - 1)
    ways = np.linspace(0, longest, 16)[:, None]
    made: list[Slide] = []
    outline = layout.outline
    while len(made) < COUNT:
        radius, pressure = random.uniform(*_RADII), random.uniform(*_PRESSURES)
        start = (random.random(2) - 0.5) * outline.size
        angle = random.uniform(0, 2 * np.pi)
        direction = np.array([np.cos(angle), np.sin(angle)])
        path = start + ways * direction
        if outline.holds(path, radius).all():
            press = Press(disc(start, radius), "disc", pressure)
            made.append(Slide(press, tuple(direction.tolist())))
    return layout, made


def make(
    name: str, path: str | os.PathLike, h: float | None = None, most: int | None = None
) -> None:
    """Solve the slides of an installed layout, the first `most` of them, and write them; an existing file
    is replaced whole or not at all."""
    layout, made = slides(name)
    made = made[:most]
    numbers = np.arange(SCANS * layout.electrodes)
    ways = np.round(ROW_PERIOD * np.outer(SPEEDS, numbers), 9)
    places, which = np.unique(ways, return_inverse=True)
    rows = []
    for slide in made:
        states = [State("slide", [slide.at(way)]) for way in places.tolist()]
        seen = solved(Family(layout, states), h).seen
        grounded = numbers % layout.electrodes
        for speed in which.reshape(ways.shape):
            rows.append(reference_frame([seen[k] for k in speed], 1.0, grounded=grounded))
    shape = len(made), len(SPEEDS), len(numbers), layout.electrodes
    texts = {
        "slides": [
            {"direction": list(slide.direction), "contact": truth(slide.press, layout.outline)}
            for slide in made
        ],
        "speeds": list(SPEEDS),
        "made": {"model": "reference", "row_period": ROW_PERIOD},
    }
    packed = np.array(rows, np.float32).reshape(shape)
    reference_data.write(path, layout, {"rows": packed}, texts)


def load(name: str | os.PathLike) -> SlideData:
    """Read the slides of an installed layout by its name, or by the path of their file."""
    layout, content = reference_data.read(name, ("rows",), ("slides", "speeds", "made"), FOLDER)
    return SlideData(layout, **content)
