"""How the conductance of a real sheet differs from an even one: described, read from a scene,
evaluated.

Sheet resistances multiply: a random field, a gradient, patches and tears. Anisotropy turns the
scalar conductance sigma into a tensor with sigma_1 / sigma_2 = ratio and sigma_1 sigma_2 = sigma^2:
in coordinates that are shortened by ratio^(1/4) along its direction, and lengthened by it across,
the sheet is isotropic with conductance sigma. Temperature is one factor of all resistances, in
time.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.region import Region, ellipse_polygon, ring, turned
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

INSULATING = 1e6  # sheet resistance in a tear, in parts of that of the sheet
_WAVES = 256  # of a random field
_MOST_RATIO = 100.0

Field = Callable[[np.ndarray], np.ndarray]  # at points (n, 2), m


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
        checks.integer(self.seed, "seed", 0, 2**32 - 1)


@dataclass(frozen=True)
class Anisotropy:
    """Conductance along ``direction`` (degrees counter-clockwise from x) over that across it."""

    ratio: float
    direction: float = 0.0

    def __post_init__(self):
        checks.positive(self.ratio, "ratio", "number", 1 / _MOST_RATIO, _MOST_RATIO)
        checks.number(self.direction, "direction", "number of degrees")

    @cached_property
    def axes(self) -> np.ndarray:
        """(2, 2), rows: unit vectors along the direction and across it."""
        return turned(np.eye(2), self.direction)

    @cached_property
    def tensor(self) -> np.ndarray:
        """(2, 2) of determinant 1, which the conductance is multiplied by."""
        return self.axes.T @ np.diag([self.ratio**0.5, self.ratio**-0.5]) @ self.axes

    @cached_property
    def stretch(self) -> np.ndarray:
        """(2, 2) symmetric: points times it are where the sheet is isotropic."""
        return self.axes.T @ np.diag([self.ratio**-0.25, self.ratio**0.25]) @ self.axes


@dataclass(frozen=True)
class Gradient:
    """Sheet resistance that rises evenly: by ``relative`` from the middle to the far end.

    Parameters
    ----------
    relative : change in parts of the mean, -``relative`` at the near end; below 1.
    direction : in which it rises, degrees counter-clockwise from x.
    """

    relative: float
    direction: float = 0.0

    def __post_init__(self):
        if not abs(checks.number(self.relative, "relative", "number")) < 1:
            raise InputError(f"relative: {self.relative:g} is not between -1 and 1")
        checks.number(self.direction, "direction", "number of degrees")


@dataclass(frozen=True)
class Tear:
    """A cut: `INSULATING` times the sheet resistance along a ``line`` of a ``width``, m."""

    line: tuple[tuple[float, float], tuple[float, float]]
    width: float

    def __post_init__(self):
        ends = checks.points(self.line, "line")
        if len(ends) != 2 or not np.linalg.norm(ends[1] - ends[0]) > 0:
            raise InputError(f"line: {checks.show(self.line)} is not two different points [x, y]")
        object.__setattr__(self, "line", _tuples(ends))
        checks.length(self.width, "width")

    def widened(self, least: float) -> Tear:
        """The same tear, ``least`` (m) wide at least."""
        return replace(self, width=max(self.width, least))

    @cached_property
    def corners(self) -> np.ndarray:
        """(4, 2) of the rectangle that it is, m."""
        start, end = np.array(self.line)
        way = (end - start) / np.linalg.norm(end - start)
        side = self.width / 2 * np.array([-way[1], way[0]])
        return np.array([start - side, end - side, end + side, start + side])

    def contains(self, points: np.ndarray) -> np.ndarray:
        """(n,) which of the points (n, 2) lie in it."""
        return Region(self.corners).contains(points)


@dataclass(frozen=True)
class Patch:
    """A disc (``center``, ``radius``, m) or a polygon (``points``) of another sheet resistance.

    ``factor`` is that resistance in parts of the sheet's.
    """

    factor: float
    center: tuple[float, float] | None = None
    radius: float | None = None
    points: tuple[tuple[float, float], ...] | None = None

    def __post_init__(self):
        checks.positive(self.factor, "factor", "number", 1 / INSULATING, INSULATING)
        if (self.points is None) == (self.center is None) or (self.center is None) != (
            self.radius is None
        ):
            raise InputError("factor: its patch needs a center and a radius, or points")
        if self.points is not None:
            points = checks.points(self.points, "points", least=3)
            object.__setattr__(self, "points", _tuples(points))
            ring(points, "points")
        else:
            checks.pair(self.center, "center", "position in m")
            checks.length(self.radius, "radius")

    @cached_property
    def corners(self) -> np.ndarray:
        """(V, 2) of its rim, m; a disc as a polygon of the same area."""
        if self.points is not None:
            return np.array(self.points)
        assert self.center is not None and self.radius is not None
        return self.center + ellipse_polygon([self.radius] * 2, 64)

    def contains(self, points: np.ndarray) -> np.ndarray:
        """(n,) which of the points (n, 2) lie in it."""
        if self.points is not None:
            return Region(self.corners).contains(points)
        return np.linalg.norm(points - np.asarray(self.center), axis=1) <= self.radius


@dataclass(frozen=True)
class Temperature:
    """One factor of the whole sheet's resistance, in time.

    Parameters
    ----------
    relative, period : 1 + relative sin(2 pi t / period), s; ``relative`` below 1.
    rate : instead, exp(rate t), 1/s.
    """

    relative: float | None = None
    period: float | None = None
    rate: float | None = None

    def __post_init__(self):
        if (self.rate is None) == (self.relative is None):
            raise InputError("rate: needed, or relative and period, but not both")
        if (self.relative is None) != (self.period is None):
            raise InputError("period: belongs together with relative")
        if self.rate is not None:
            checks.number(self.rate, "rate", "number in 1/s")
            return
        if not abs(checks.number(self.relative, "relative", "number")) < 1:
            raise InputError(f"relative: {self.relative:g} is not between -1 and 1")
        checks.positive(self.period, "period", "time in s")

    def factor(self, t: np.ndarray | float) -> np.ndarray | float:
        """Sheet resistance at the time ``t`` (s), in parts of that of the layout."""
        if self.rate is not None:
            return np.exp(np.clip(self.rate * np.asarray(t), -20, 20))
        assert self.relative is not None and self.period is not None
        return 1 + self.relative * np.sin(2 * np.pi * np.asarray(t) / self.period)


@dataclass(frozen=True)
class SheetField:
    """What is wrong with a sheet beside `SheetVariation`; each part only if it is named."""

    anisotropy: Anisotropy | None = None
    gradient: Gradient | None = None
    tears: tuple[Tear, ...] = ()
    patches: tuple[Patch, ...] = ()
    temperature: Temperature | None = None

    def __bool__(self) -> bool:
        return any(vars(self).values())

    def rims(self, least_width: float = 0.0) -> list[np.ndarray]:
        """(V, 2) closed lines, m, along which the conductance jumps; see `resistance_of`."""
        tears = [tear.widened(least_width) for tear in self.tears]
        parts: list[Patch | Tear] = [*self.patches, *tears]
        return [np.vstack([part.corners, part.corners[:1]]) for part in parts]

    def check(self, layout: Layout, place: str = "") -> None:
        """Refuse tears and patches that lie outside the sheet."""
        for key in ("tears", "patches"):
            for i, part in enumerate(getattr(self, key)):
                if not layout.outline.is_met_by(part.corners, np.zeros(2)):
                    raise InputError(
                        f"{place}{key}[{i}]: lies outside the outline of {layout.name}"
                    )


def resistance_of(
    layout: Layout,
    field: SheetField,
    variation: SheetVariation | None = None,
    least_width: float = 0.0,
) -> Field | None:
    """Sheet resistance (n,), ohm/sq, at points (n, 2); None where it is even.

    Anisotropy and temperature are left out. Tears are `least_width` (m) wide at least: what a mesh
    resolves; an insulating slit disturbs by its length.
    """
    factors: list[Field] = []
    if variation is not None and variation.relative > 0:
        factors.append(random_sheet(variation))
    if field.gradient is not None and field.gradient.relative:
        factors.append(_gradient(field.gradient, layout))
    factors += [_within(patch, patch.factor) for patch in field.patches]
    factors += [_within(tear.widened(least_width), INSULATING) for tear in field.tears]
    if not factors:
        return None

    def resistance(points):
        values = np.full(len(points), float(layout.sheet_resistance))
        for factor in factors:
            values *= factor(points)
        return values

    return resistance


def conductance_of(
    layout: Layout, field: SheetField, variation: SheetVariation | None = None
) -> Field | None:
    """Conductance (n,) or, of an anisotropic sheet, (n, 2, 2), S, at points (n, 2); None: even."""
    resistance = resistance_of(layout, field, variation)
    if field.anisotropy is None:
        return resistance and (lambda points: 1 / resistance(points))
    even = 1 / layout.sheet_resistance

    def conductance(points):
        scalar = np.full(len(points), even) if resistance is None else 1 / resistance(points)
        return scalar[:, None, None] * field.anisotropy.tensor

    return conductance


def random_sheet(variation: SheetVariation) -> Field:
    """Sheet resistance at points (n, 2) in parts of the mean: log-normal.

    Its logarithm is a Gaussian field with covariance exp(-d^2 / (2 length^2)), as a sum of waves
    with random directions, lengths and phases: the same field at every point of every mesh.
    """
    random = np.random.default_rng(variation.seed)
    waves = random.standard_normal((_WAVES, 2)) / variation.length
    phases = 2 * np.pi * random.random(_WAVES)
    spread = np.sqrt(np.log1p(variation.relative**2))

    def resistance(points):
        field = np.cos(points @ waves.T + phases).sum(axis=1) * np.sqrt(2 / _WAVES)
        return np.exp(spread * field - spread**2 / 2)

    return resistance


def _gradient(gradient, layout):
    way, _ = turned(np.eye(2), gradient.direction)
    xmin, ymin, xmax, ymax = layout.outline.bounds
    reach = np.abs(way) @ np.array([xmax - xmin, ymax - ymin]) / 2
    middle = np.array([xmin + xmax, ymin + ymax]) / 2
    return lambda points: 1 + gradient.relative * ((points - middle) @ way) / reach


def _within(part, factor):
    return lambda points: np.where(part.contains(points), factor, 1.0)


def _tuples(points):
    return tuple(map(tuple, points.tolist()))
