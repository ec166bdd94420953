"""A layout as its sheet was cut and its electrodes were printed, for a `SheetOperator` about it.

Nine of a sheet's coefficients are geometry: the eight ways of `rim`, m, and the logarithm of what all
radii have in common. What they change is known to first order; where they are large and learned, the
sheet is solved anew with its own size and radius. Its sides then lie as far out as both of a pair do
in the mean: a rectangle stays one, and its centre stays where it was drawn. How far it lies aside of
that, and what is askew, remains first order. A sheet that is torn is solved with its tears as cuts.
"""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property

import numpy as np
import shapely

from tomotactile_ros.estimation.rim import SIDES, WAYS
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.outline import Outline

COUNT = WAYS + 1
# of the way from the outermost electrode to the rim, its radius at least: second order is then 1e-2
# of what the rim does to that electrode
_CLOSE = 0.1
_SAME = 0.02  # of the logarithm of the radius: second order is then 4e-4
_APART = 0.9  # of half the shortest spacing: electrodes that are printed too large do not touch
_GAPE = 5e-4  # m, between the sides of a tear
_SLIVER = 2e-4  # m: what is narrower carries no current worth telling
# radii around an electrode that a tear leaves whole: how it is held there is not known
_BESIDE = 1.2
_STEPS = 10  # in which a sheet grows until it holds its electrodes


Tears = tuple[tuple[float, float, float, float], ...]  # x, y of both ends of each, m


class AsCut:
    """What `layout` is with the nearest geometry to that of `coefficients` (9,) that can be solved.

    Attributes
    ----------
    coefficients : (9,) that it has itself
    tears : of the sheet
    """

    def __init__(self, layout: Layout, coefficients: np.ndarray, tears: Tears = ()):
        self.tears = tears
        outline, sides = layout.outline, coefficients[: len(SIDES)]
        out = np.repeat(sides.reshape(2, 2).mean(axis=1), 2)
        if outline.kind == "circle":
            out[:] = sides.mean()
        half = np.repeat(outline.size, 2) / 2
        for axes in [[0, 1, 2, 3]] if outline.kind == "circle" else [[0, 1], [2, 3]]:
            out[axes] *= _most(layout, out / half, axes)
        widest = np.log(_APART * layout.pitches.min() / 2 / layout.radius)
        radius = min(float(coefficients[WAYS]), max(widest, 0.0))
        self.coefficients = np.concatenate([out, np.zeros(WAYS - len(SIDES)), [radius]])
        self._drawn, self._out = layout, out / half

    @cached_property
    def layout(self) -> Layout:
        """So cut and printed, with the electrodes where they were; without tears."""
        drawn, radius = self._drawn, float(np.exp(self.coefficients[WAYS]))
        outline = _scaled(drawn.outline, self._out)
        return replace(drawn, outline=outline, radius=radius * drawn.radius)

    @cached_property
    def _reach(self) -> float:
        """m, over which the rim is felt by the electrode nearest to it."""
        nearest = self._drawn.outline.rim_distance(self._drawn.positions).min()
        return max(self._drawn.radius, float(nearest))

    def near(self, other: AsCut) -> bool:
        """Whether the geometry of `other`, of the same layout, is this one to first order."""
        if self.tears != other.tears:
            return False
        apart = np.abs(self.coefficients - other.coefficients)
        return bool(apart[:WAYS].max() < _CLOSE * self._reach and apart[WAYS] < _SAME)


def torn(layout: Layout, tears: Tears) -> Layout:
    """A layout whose sheet has `tears`, which leave its electrodes whole; InputError where some of these are
    no longer on the same piece as the others."""
    outline = layout.outline
    whole = shapely.Polygon(outline.shell, outline.holes)
    lines = (shapely.LineString([each[:2], each[2:]]) for each in tears)
    cuts = shapely.union_all([line.buffer(_GAPE / 2, cap_style="flat") for line in lines])
    around = shapely.buffer(shapely.points(layout.positions), _BESIDE * layout.radius)
    left = whole.difference(cuts.difference(shapely.union_all(around)))
    # without slivers between tear and rim: elements would be as small
    left = left.buffer(-_SLIVER / 2, join_style="mitre").buffer(_SLIVER / 2, join_style="mitre")
    left = shapely.get_parts(left)
    largest = max(left, key=lambda part: part.area)
    shell, *holes = (np.array(ring.coords)[:-1] for ring in (largest.exterior, *largest.interiors))
    return replace(layout, outline=Outline.polygon(shell, holes, unusual_size=True))


def _most(layout: Layout, out: np.ndarray, axes: list[int]) -> float:
    """The largest part of `out` (4,), of half a size, along `axes` with which all electrodes are still on
    the sheet."""
    if (out[axes] >= 0).all():
        return 1.0
    parts, shrunk = np.arange(_STEPS + 1) / _STEPS, np.zeros(len(out))
    for part in parts[::-1]:
        shrunk[axes] = part * out[axes]
        if _scaled(layout.outline, shrunk).contains(layout.positions).all():
            return float(part)
    return 0.0


def _scaled(outline: Outline, out: np.ndarray) -> Outline:
    """An outline and its holes with sides `out` (4,) farther out, of half its size."""
    scale = (1 + out)[[0, 2]]
    holes = tuple(hole * scale for hole in outline.holes)
    if outline.kind == "circle":
        return Outline.circle(outline.radius * float(scale[0]), holes, unusual_size=True)
    if outline.kind == "rectangle":
        width, height = np.array(outline.size) * scale
        return Outline.rectangle(float(width), float(height), holes, unusual_size=True)
    return Outline.polygon(outline.shell * scale, holes, unusual_size=True)
