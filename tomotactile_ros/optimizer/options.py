"""What an optimization can be told: one table, from which the command line makes its options and
the ROS node its parameters, and one way from their values to a start and a `Request`.

A value of None is one that nobody gave; on ROS, where a parameter always has a value, that is 0,
an empty text or an empty list.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any

from tomotactile_ros.evaluation.places import CONTACT_RADIUS
from tomotactile_ros.evaluation.point_spread import REGULARIZATION, RESOLUTION
from tomotactile_ros.evaluation.posterior import NOISE
from tomotactile_ros.layouts.arrangements import (
    MAX_SPREAD,
    USUAL_SIZE,
    spread_electrodes,
    usual_radius,
)
from tomotactile_ros.layouts.layout import Layout, equal_grid, load_layout
from tomotactile_ros.layouts.outline import Outline
from tomotactile_ros.optimizer.equalize import MODELS, SELECTIONS
from tomotactile_ros.optimizer.objective import DEFAULT_AIMS, Aims
from tomotactile_ros.optimizer.request import ALIASES, METHODS, Request, method_of
from tomotactile_ros.simulation import ROW_PERIOD
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError, doubt

SCAN, EXPLORE = "scan", "explore"  # what else can be done: rows chosen, numbers compared
NAMES = (*METHODS, SCAN, *ALIASES)
_MOVING = "touch", "free"  # methods that move electrodes one by one
_IMAGES = (*METHODS, SCAN)  # those that judge images
PLACE = 0.002  # m
MOST_PROCESSES = 1024
_SEEDS = 2**31 - 1  # the largest integer of a parameter of 32 bits


@dataclass(frozen=True)
class Option:
    """One of the table.

    Parameters
    ----------
    name : of the parameter; the option's has hyphens and `--`
    kind : bool, int, float or str
    help : one line, with the unit
    default : None where nothing is given
    choices : of a text
    high : of a number, which is not negative
    metavar : names of the numbers of a list
    repeated : a list of any length, its numbers in groups of `metavar`
    several : a list of any length, of single numbers
    methods : that know it, `explore` among them; (): all do
    """

    name: str
    kind: type
    help: str
    default: Any = None
    choices: tuple[str, ...] = ()
    high: float = 1e9
    metavar: tuple[str, ...] = ()
    repeated: bool = False
    several: bool = False
    methods: tuple[str, ...] = ()

    @property
    def is_list(self) -> bool:
        return bool(self.metavar) or self.several

    @property
    def unset(self) -> Any:
        """What a parameter that nobody gave is."""
        return () if self.is_list else self.kind()

    def given(self, value: Any) -> Any:
        """The value of a parameter as the command line has it: None if not given, in groups."""
        if value == self.unset and self.default is None:
            return None
        if not self.repeated:
            return list(value) if self.is_list else value
        count = len(self.metavar)
        if len(value) % count:
            raise InputError(
                f"{self.name}: {len(value)} numbers, {', '.join(self.metavar)} of each are needed"
            )
        return [list(value[i : i + count]) for i in range(0, len(value), count)]


def named(name: str, mark: str) -> str:
    """A name in a complaint: of a parameter, or of an option where there is a `mark`."""
    return mark + (name.replace("_", "-") if mark else name)


RESULT = (
    Option(
        "method",
        str,
        "touch (default): contacts best known; equalize (or paper): the paper's; free: least blur; "
        "scan: which electrodes to ground, and in which order",
        METHODS[0],
        choices=NAMES,
    ),
    Option("out", str, "Layout file (.yaml) to write"),
    Option("report", str, "Picture (.png) to write (default: beside the layout)"),
    Option(
        "workers",
        int,
        "Processes of the search (default: one for each processor)",
        high=MOST_PROCESSES,
    ),
    Option(
        "backend",
        str,
        "Scheduler of dask whose workers search, on any machines, instead: dask://HOST:PORT",
    ),
)
START = (
    Option("layout", str, "Layout to start from, a file or an installed name; none: an equal grid"),
    Option("rows", int, "Electrodes of the equal grid along y", high=256),
    Option("cols", int, "Electrodes of the equal grid along x", high=256),
    Option(
        "electrodes",
        int,
        "Number of electrodes spread evenly over the outline of layout, of circle or of size, in "
        "the place of a grid",
        high=MAX_SPREAD,
    ),
    Option("circle", float, "Radius of the round sheet of electrodes, m", high=1e3),
    Option(
        "size", float, "Width and height of its sheet, m (default: 0.2 0.2)", metavar=("A", "B")
    ),
    Option("radius", float, "Of its electrodes, m (default: as in the paper, where there is room)"),
    Option("inset", float, "From its rim to the outermost centres, m", 0.0, high=1e3),
    Option("sheet_resistance", float, "Of its sheet, ohm/sq", 1e4),
    Option("unusual_size", bool, "Its sheet really is above 5 m or below 5 mm", False),
)
SEARCH = (
    Option(
        "select",
        str,
        "Of equalize: which update is taken, that of the best mean HWHM (as in the paper) or that "
        "whose worst region is best",
        SELECTIONS[0],
        choices=SELECTIONS,
        methods=("equalize",),
    ),
    Option(
        "model",
        str,
        "Of equalize: closed form with electrodes as points with a radius, finite elements with "
        "electrodes as discs, or with electrodes as single nodes of a 40 x 40 mesh (as in the paper)",
        next(iter(MODELS)),
        choices=tuple(MODELS),
        methods=("equalize",),
    ),
    Option(
        "steps",
        int,
        "Rounds of touch (default: 2), updates of equalize (default: 5), or steps without a gradient "
        "at the end of free (default: none on rectangles, 30 on other outlines)",
        high=100_000,
        methods=METHODS,
    ),
    Option("regularization", float, "Lambda^2", REGULARIZATION, high=1e30, methods=_IMAGES),
    Option(
        "resolution",
        int,
        "Contact positions along the longer side",
        RESOLUTION,
        high=400,
        methods=_IMAGES,
    ),
    Option(
        "spacing",
        float,
        "Of touch and free: smallest distance of two centres, m (default: 2.2 radii)",
        methods=_MOVING,
    ),
    Option(
        "margin",
        float,
        "Of touch and free: smallest distance of a centre from the rim, m (default: 0, electrodes may reach beyond it)",
        0.0,
        methods=_MOVING,
    ),
    Option(
        "keep_out",
        float,
        "Of touch and free: disc without electrode centres, m; as many as wanted",
        default=(),
        metavar=("X", "Y", "R"),
        repeated=True,
        methods=_MOVING,
    ),
    Option(
        "asymmetric", bool, "Of touch and free: keep no symmetry (slow)", False, methods=_MOVING
    ),
    Option(
        "fixed",
        int,
        "Of touch: number of an electrode that stays where it is; as many as wanted",
        default=(),
        metavar=("N",),
        repeated=True,
        methods=("touch",),
    ),
    Option(
        "radius_range",
        float,
        "Of touch: electrodes may have any radius between these, one for all, m (default: as the "
        "start)",
        metavar=("MIN", "MAX"),
        methods=("touch",),
    ),
    Option(
        "noise",
        float,
        f"Of touch and explore: noise of a reading, V rms (default: {NOISE:g})",
        high=100.0,
        methods=("touch", EXPLORE),
    ),
    Option(
        "contact_radius",
        float,
        f"Of touch and explore: radius of the contacts, m (default: {CONTACT_RADIUS:g})",
        methods=("touch", EXPLORE),
    ),
    Option(
        "apart",
        float,
        "Of touch: distance of two contacts that are to be told apart, m (default: 0.6 spacings)",
        methods=("touch",),
    ),
    Option(
        "resume",
        bool,
        "Go on with a search of touch, free or equalize that was stopped",
        False,
        methods=METHODS,
    ),
    Option(
        "aims",
        float,
        "Of free, relative to the start: mean HWHM, worst tenth, mean position error, and position "
        "error at lambda^2 / 10 and * 10 (default: 0.8 0.8 0.72 1.0)",
        metavar=("MEAN", "WORST", "ERROR", "OTHER"),
        methods=("free",),
    ),
    Option(
        "scenes",
        float,
        "Of free: count the blur of scenes with two and with wide contacts, too, with this aim "
        "relative to the start, for instance 0.9",
        methods=("free",),
    ),
    Option(
        "starts",
        int,
        "Number of layouts to start from (default: 2 of touch, 8 of free)",
        high=10_000,
        methods=_MOVING,
    ),
    Option("seed", int, "Of the search of free", 0, high=_SEEDS, methods=("free",)),
    Option(
        "conditions",
        int,
        "Of scan: numbers of ground conditions to compare, the last of which is written (default: "
        "all down to 4 by halves, and all are written)",
        high=MAX_SPREAD,
        several=True,
        methods=(SCAN,),
    ),
    Option(
        "frame_time",
        float,
        "Of scan: time for a frame, s, instead of conditions; of explore: the longest",
        methods=(SCAN, EXPLORE),
    ),
    Option(
        "row_period",
        float,
        "Of scan and explore: time of a row, s",
        ROW_PERIOD,
        methods=(SCAN, EXPLORE),
    ),
    Option(
        EXPLORE,
        int,
        "Compare these numbers of electrodes, and numbers of rows, on this sheet instead: a table, a "
        "picture, and a layout of the fewest that do for place and frame_time",
        high=MAX_SPREAD,
        several=True,
    ),
    Option("place", float, "Of explore: error wanted, m", PLACE, methods=(EXPLORE,)),
)
OPTIONS = (*RESULT, *START, *SEARCH)


def start_of(values: Mapping[str, Any], mark: str = "") -> Layout:
    """The layout to start from, by the values of `START`; complaints put `mark` before names."""
    if values["layout"] is not None:
        anew = ("electrodes", "inset") if values["electrodes"] is not None else ()
        for option in START[1:]:
            if values[option.name] != option.default and option.name not in anew:
                raise InputError(
                    f"{named(option.name, mark)}: {mark}layout has its own, give only one"
                )
        layout = load_layout(values["layout"])
        return _spread(values, mark, layout) if anew else layout
    return _grid(values, mark) if values["electrodes"] is None else _spread(values, mark)


def _grid(values, mark):
    """Electrodes have 5 mm up to 4 x 4 and 2.5 mm beyond, as in the paper, where there is room for
    them, otherwise a tenth of the pitch."""
    rows, cols, size = values["rows"], values["cols"], values["size"] or USUAL_SIZE
    if rows is None or cols is None:
        raise InputError(
            f"{mark}rows and {mark}cols, or {mark}layout, or {mark}electrodes, are needed"
        )
    if values["circle"] is not None:
        raise InputError(f"{mark}circle: has no rows and columns, give {mark}electrodes")
    radius = values["radius"]
    if radius is None:
        checks.integer(rows, "rows", 2, 256)
        checks.integer(cols, "cols", 2, 256)
        a, b = checks.pair(size, "size", "length in m")
        pitch = checks.length(a, "size[0]") / (cols - 1), checks.length(b, "size[1]") / (rows - 1)
        radius = usual_radius(min(pitch), max(rows, cols) <= 4)
    grid = rows, cols, size, radius, values["sheet_resistance"], values["inset"]
    return equal_grid(*grid, unusual_size=values["unusual_size"])


def _spread(values, mark, layout: Layout | None = None):
    """Electrodes spread evenly over an outline: of `layout`, a circle or a rectangle."""
    for name in ("rows", "cols"):
        if values[name] is not None:
            raise InputError(f"{mark}{name}: {mark}electrodes are on no grid, give only one")
    if layout is not None:
        outline, radius, resistance = layout.outline, layout.radius, layout.sheet_resistance
    else:
        radius, resistance = values["radius"], values["sheet_resistance"]
        unusual = {"unusual_size": values["unusual_size"]}
        if values["circle"] is None:
            outline = Outline.rectangle(*(values["size"] or USUAL_SIZE), **unusual)
        elif values["size"] is None:
            outline = Outline.circle(values["circle"], **unusual)
        else:
            raise InputError(f"{mark}circle: the sheet has a {mark}size, give only one")
    spread = spread_electrodes(values["electrodes"], outline, radius, resistance, values["inset"])
    return spread if layout is None else replace(spread, surface=layout.surface)


def request_of(layout: Layout, method: str, values: Mapping[str, Any]) -> Request:
    """What to do with `layout`, by the values of `SEARCH`; its scan is that of other places."""
    if layout.scan:
        doubt("layout: its scan is left out, it was chosen for where the electrodes are")
        layout = replace(layout, scan=())
    given = {each.name: values[each.name] for each in fields(Request) if each.name in values}
    return Request(
        **given
        | {
            "layout": layout,
            "method": method_of(method),
            "keep_out": tuple(map(tuple, values["keep_out"] or ())),
            "symmetric": not values["asymmetric"],
            "aims": _aims(values["aims"], values["scenes"]),
            "fixed": tuple(dict.fromkeys(n for group in values["fixed"] or () for n in group)),
            "radius_range": values["radius_range"] and tuple(values["radius_range"]),
        }
    )


def refuse_unknown(task: str, values: Mapping[str, Any], mark: str = "") -> None:
    """Raise InputError for an option that was given and that `task`, a method or `explore`, would
    leave out."""
    for option in SEARCH:
        value = values[option.name]
        given = bool(value) if option.repeated else value != option.default
        if given and option.methods and task not in option.methods:
            words = " and ".join(
                mark + EXPLORE if each == EXPLORE else f"method {each}" for each in option.methods
            )
            raise InputError(f"{named(option.name, mark)}: is for {words} only")


def task_of(values: Mapping[str, Any]) -> str:
    """What is to be done: a method that moves electrodes, `scan` or `explore`."""
    if values[EXPLORE]:
        return EXPLORE
    return ALIASES.get(values["method"], values["method"])


def command_of(method: str, values: Mapping[str, Any]) -> str:
    """The command that does the same again, but for where to write it."""
    words = ["tomotactile", "optimize", "--method", method]
    for option in (*START, *SEARCH):
        value = values[option.name]
        if (
            value is None
            or value == option.default
            or option.name == "resume"
            or (option.repeated and not value)
        ):
            continue
        for each in value if option.repeated else [value]:
            words.append("--" + option.name.replace("_", "-"))
            if each is not True:
                words += map(str, each if isinstance(each, (list, tuple)) else [each])
    return " ".join(words)


def _aims(numbers, scenes) -> Aims:
    if scenes is not None:
        checks.positive(scenes, "scenes", "number")
    aims = replace(DEFAULT_AIMS, scenes=scenes)
    if numbers is None:
        return aims
    if len(numbers) != 4:
        raise InputError(f"aims: {len(numbers)} numbers, four are needed")
    for number in numbers:
        checks.positive(number, "aims", "number")
    *central, other = numbers
    return replace(aims, central=tuple(central), other=(*aims.other[:2], other))
