"""An optimization as the command line and the ROS node ask for it: plain values in, steps out."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

from tomotactile_ros.evaluation.places import has_room_for_pairs, usual_apart
from tomotactile_ros.evaluation.point_spread import LEAST_REGULARIZATION, MOST_CELLS
from tomotactile_ros.evaluation.posterior import Conditions
from tomotactile_ros.layouts.layout import Layout
from tomotactile_ros.layouts.region import Region, regular_polygon
from tomotactile_ros.optimizer.constraints import Constraints
from tomotactile_ros.optimizer.equalize import MODELS, SELECTIONS, equalize
from tomotactile_ros.optimizer.free import SPACING, free
from tomotactile_ros.optimizer.objective import DEFAULT_AIMS, Aims
from tomotactile_ros.optimizer.search import Effort, effort_for
from tomotactile_ros.optimizer.step import Step, finished
from tomotactile_ros.optimizer.touch import ROUNDS, STARTS, touch
from tomotactile_ros.optimizer.work import Work
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError

METHODS = ("touch", "equalize", "free")
ALIASES = {"paper": "equalize"}
_UPDATES = 5  # of equalize


def method_of(name: str) -> str:
    """The method that a name means; InputError for none."""
    method = ALIASES.get(name, name)
    if method not in METHODS:
        raise InputError(
            f"method: {checks.show(name)} is none of {', '.join((*METHODS, *ALIASES))}"
        )
    return method


@dataclass(frozen=True, eq=False)
class Request:
    """What to optimize and how.

    Parameters
    ----------
    layout : the start
    method : `touch`, `equalize` or `free`
    select : of equalize, the update that is taken: `mean` or `worst`
    model : of equalize, one of its `MODELS`
    steps : rounds of touch, updates of equalize, or steps without a gradient at the end of
        free; None for the default
    regularization : lambda^2 of images
    spacing : of touch and free, smallest distance of two centres, m; 2.2 radii by default
    margin : of touch and free, from the rim to a centre, m
    keep_out : of touch and free, discs (x, y, radius) without electrode centres, m
    symmetric : of touch and free, keep the symmetries of outline and layout
    aims : of free, what the figures should come to
    starts : of touch and free, layouts to start from; None for the default
    seed : of free
    resolution : contact positions along the longer side, of images
    fixed : of touch, electrodes that stay where they are
    radius_range : of touch, smallest and largest radius of electrodes, m; None: that of the layout
    noise : of touch, of a reading, V rms; None for the default
    contact_radius : of touch, of the contacts, m; None for the default
    apart : of touch, distance of two contacts that are to be told apart, m; None for the default
    """

    layout: Layout
    method: str
    select: str = SELECTIONS[0]
    model: str = next(iter(MODELS))
    steps: int | None = None
    regularization: float = 1000.0
    spacing: float | None = None
    margin: float = 0.0
    keep_out: tuple[tuple[float, float, float], ...] = ()
    symmetric: bool = True
    aims: Aims = DEFAULT_AIMS
    starts: int | None = None
    seed: int = 0
    resolution: int = 40
    fixed: tuple[int, ...] = ()
    radius_range: tuple[float, float] | None = None
    noise: float | None = None
    contact_radius: float | None = None
    apart: float | None = None

    def __post_init__(self):
        method_of(self.method)
        if self.select not in SELECTIONS:
            raise InputError(f"select: {self.select!r} is none of {', '.join(SELECTIONS)}")
        if self.model not in MODELS:
            raise InputError(f"model: {self.model!r} is none of {', '.join(MODELS)}")
        if self.steps is not None:
            checks.integer(self.steps, "steps", 0, 100000)
        if self.starts is not None:
            checks.integer(self.starts, "starts", 1, 10000)
        checks.integer(self.seed, "seed", 0, 2**32 - 1)
        checks.positive(self.regularization, "regularization", "number", LEAST_REGULARIZATION)
        checks.integer(self.resolution, "resolution", 2, MOST_CELLS)
        if self.method == "equalize" and (self.spacing or self.margin or self.keep_out):
            raise InputError("spacing, margin and keep_out: only methods touch and free know them")
        if self.method != "equalize":
            largest = self.radius_range[1] if self.radius_range else self.layout.radius
            self._constraints().check(self.layout.electrodes, largest)
        if self.method != "touch":
            for name in ("fixed", "radius_range", "noise", "contact_radius", "apart"):
                if getattr(self, name):
                    raise InputError(f"{name}: only method touch knows it")
            return
        conditions = self._conditions()  # refuses what cannot be
        if self.apart is not None and not has_room_for_pairs(
            self.layout, conditions.apart, conditions.radius
        ):
            raise InputError(
                f"apart: no pair of contacts that is tried has room on this sheet {self.apart:g} m from "
                "each other"
            )

    def _check_radii(self) -> None:
        if self.radius_range is None:
            return
        low, high = checks.pair(self.radius_range, "radius_range", "length in m")
        checks.length(low, "radius_range[0]")
        if high < low:
            raise InputError(f"radius_range: from {low:g} to {high:g} m is no range")

    @property
    def total(self) -> int:
        """Number of steps, the start not counted."""
        if self.method == "equalize":
            return _UPDATES if self.steps is None else self.steps
        if self.method == "touch":
            return ROUNDS if self.steps is None else self.steps
        return self._effort().total(self.layout)

    def steps_of(self, work: Work | None = None) -> Iterator[Step]:
        """Run it; `best_of` stops it and keeps the best. work : who does it; None: this process."""
        work = work or Work()
        work.begin(**self._asked())
        images: dict[str, Any] = {
            "regularization": self.regularization,
            "resolution": self.resolution,
        }
        if self.method == "equalize":
            how: dict[str, Any] = {"select": self.select, "model": MODELS[self.model]}
            return equalize(self.layout, self.total, work=work, **how, **images)
        if self.method == "touch":
            return touch(
                self.layout,
                constraints=self._constraints(),
                conditions=self._conditions(),
                radii=self.radius_range,
                symmetric=self.symmetric,
                rounds=self.total,
                starts=self.total_starts,
                work=work,
                **images,
            )
        return free(
            self.layout,
            aims=self.aims,
            constraints=self._constraints(),
            symmetric=self.symmetric,
            effort=self._effort(),
            seed=self.seed,
            work=work,
            **images,
        )

    def result(self, name: str, history: Sequence[Step], best: Step, **settings: object) -> Layout:
        """The best layout under its new name, with its origin, checked once more.

        Raises InputError where it violates the constraints: no such layout is ever written.
        """
        if self.method != "equalize":
            self._constraints().insist(best.layout)
        settings = {**settings, **self.settings()}
        return finished(best.layout, name, self.method, settings, history, best)

    def settings(self) -> dict:
        """Plain values for the layout's provenance."""
        out = {"start": self.layout.name, "steps": self.total}
        if self.method == "equalize":
            out |= {"select": self.select, "model": self.model}
        if self.method != "equalize":
            constraints = self._constraints()
            out |= {
                "spacing": constraints.spacing,
                "margin": constraints.margin,
                "keep_out": [list(disc) for disc in self.keep_out],
                "symmetric": self.symmetric,
            }
        if self.method == "touch":
            conditions = self._conditions()
            out |= {
                "radius_range": None if self.radius_range is None else list(self.radius_range),
                "fixed": list(self.fixed),
                "noise": conditions.noise,
                "contact_radius": conditions.radius,
                "apart": conditions.apart,
                "starts": self.total_starts,
            }
        if self.method == "free":
            out |= {
                "regularization": self.regularization,
                "aims": {key: value for key, value in vars(self.aims).items() if value is not None},
                "starts": self._effort().starts,
                "seed": self.seed,
            }
        return out

    @property
    def total_starts(self) -> int:
        """Layouts that touch starts from."""
        return STARTS if self.starts is None else self.starts

    def _conditions(self) -> Conditions:
        given: dict[str, Any] = {
            "noise": self.noise,
            "radius": self.contact_radius,
            "apart": self.apart,
        }
        kept = {key: each for key, each in given.items() if each is not None}
        return Conditions(**{"apart": usual_apart(self.layout), **kept})

    def _asked(self) -> dict:
        """Plain values that say which search this is."""
        return (
            {"method": self.method}
            | self.settings()
            | {
                "start": self.layout.id,
                "sheet_resistance": self.layout.sheet_resistance,
                "regularization": self.regularization,
                "resolution": self.resolution,
            }
        )

    def _effort(self) -> Effort:
        return effort_for(self.layout, self.steps, self.starts)

    def _constraints(self) -> Constraints:
        discs = []
        for i, disc in enumerate(self.keep_out):
            if len(disc) != 3:
                raise InputError(f"keep_out[{i}]: {checks.show(disc)} is not [x, y, radius] in m")
            x, y, radius = (checks.number(each, f"keep_out[{i}]", "length in m") for each in disc)
            discs.append(
                Region(regular_polygon(checks.length(radius, f"keep_out[{i}][2]")) + [x, y])
            )
        self._check_radii()
        largest = self.radius_range[1] if self.radius_range else self.layout.radius
        spacing = SPACING * largest if self.spacing is None else self.spacing
        return Constraints(self.layout.outline, spacing, self.margin, tuple(discs), self.fixed)
