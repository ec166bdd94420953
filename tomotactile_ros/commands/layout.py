"""`tomotactile layout`: electrodes on an equal grid, a hexagonal one or a ring, as a layout
file."""

from __future__ import annotations

import math
from argparse import ArgumentParser, Namespace
from dataclasses import replace
from pathlib import Path

from tomotactile_ros.commands.inspect import describe_layout
from tomotactile_ros.layouts.arrangements import (
    USUAL_SIZE,
    electrode_ring,
    usual_radius,
)
from tomotactile_ros.layouts.layout import Layout, equal_grid
from tomotactile_ros.support import checks
from tomotactile_ros.support.errors import InputError
from tomotactile_ros.support.files import YAML, check_out

HELP = "write a layout file: an equal grid, a hexagonal one, or a ring"
_FEW = 4  # rows and columns of the grid up to which electrodes are large
_OPTIONS = (
    "rows",
    "cols",
    "hex",
    "ring",
    "size",
    "circle",
    "inset",
    "radius",
    "sheet_resistance",
    "unusual_size",
    "name",
)


def add_arguments(parser: ArgumentParser) -> None:
    add_grid(parser)
    parser.add_argument(
        "--hex",
        action="store_true",
        help="rows of COLS - 1 and COLS electrodes in turn, each in the gaps of its neighbours",
    )
    parser.add_argument("--ring", type=int, metavar="N", help="N electrodes on a circle")
    parser.add_argument(
        "--circle", type=float, metavar="R", help="radius of the round sheet of a ring, m"
    )
    parser.add_argument(
        "--inset",
        type=float,
        default=0.0,
        help="from the rim to the outermost centres, m (default: 0)",
    )
    parser.add_argument(
        "--radius",
        type=float,
        help="of an electrode, m (default: 0.005 up to 4 x 4, 0.0025 beyond, at most a tenth of the "
        "pitch)",
    )
    parser.add_argument(
        "--sheet-resistance", type=float, default=1e4, help="ohm/sq (default: 10000)"
    )
    parser.add_argument("--name", help="of the layout (default: that of the file)")
    parser.add_argument("--out", required=True, help="layout file (.yaml) to write")
    parser.set_defaults(default_of=parser.get_default)


def run(args: Namespace) -> None:
    name = args.name or Path(args.out).stem
    layout = _ring(args, name) if args.ring is not None else _grid(args, name)
    check_out(args.out, *YAML)
    provenance = {
        "algorithm": _algorithm(args),
        "settings": {"command": _command(args)},
        "software": "tomotactile_ros",
    }
    replace(layout, provenance=provenance).save(args.out)
    print("\n".join(describe_layout(layout)))
    print(args.out)


def add_grid(parser: ArgumentParser) -> None:
    """Add the options of an equal grid: electrodes, and the sheet's size, which may be unusual."""
    parser.add_argument("--rows", type=int, help="electrodes along y")
    parser.add_argument("--cols", type=int, help="electrodes along x")
    parser.add_argument(
        "--size",
        type=float,
        nargs=2,
        metavar=("A", "B"),
        help="width and height of the sheet, m (default: 0.2 0.2)",
    )
    parser.add_argument(
        "--unusual-size", action="store_true", help="the sheet really is above 5 m or below 5 mm"
    )


def _grid(args: Namespace, name: str) -> Layout:
    if args.circle is not None:
        raise InputError("--circle: only a ring has one, --ring N is missing")
    if args.rows is None or args.cols is None:
        raise InputError("--rows and --cols, or --ring and --circle, are needed")
    size = args.size or USUAL_SIZE
    radius = _grid_radius(args, size) if args.radius is None else args.radius
    sheet = size, radius, args.sheet_resistance, args.inset
    return equal_grid(args.rows, args.cols, *sheet, name, args.unusual_size, args.hex)


def _grid_radius(args, size):
    """The usual one; what is wrong with rows and columns is said where the grid is made."""
    rows, cols = max(args.rows, 2), max(args.cols, 2)
    width, height = (side - 2 * args.inset for side in size)
    steps = width / (cols - 1), height / (rows - 1)
    pitch = math.hypot(steps[0] / 2, steps[1]) if args.hex else steps[1]
    pitch = min(steps[0], pitch)
    return usual_radius(pitch, max(rows, cols) <= _FEW) if pitch > 0 else 1e-3


def _ring(args: Namespace, name: str) -> Layout:
    for option in ("rows", "cols", "size", "hex"):
        if getattr(args, option):
            raise InputError(f"--{option}: is of a grid, --ring has its own; give only one")
    if args.circle is None:
        raise InputError("--circle: is missing, a ring needs the radius of its sheet, m")
    checks.integer(args.ring, "ring", 3, 65535)
    radius = args.radius
    if radius is None:
        pitch = 2 * math.sin(math.pi / args.ring) * (args.circle - args.inset)
        radius = usual_radius(pitch, args.ring <= _FEW**2) if pitch > 0 else 1e-3
    sheet = args.circle, radius, args.sheet_resistance, args.inset
    return electrode_ring(args.ring, *sheet, name, args.unusual_size)


def _algorithm(args):
    if args.ring is not None:
        return "ring"
    return "hexagonal grid" if args.hex else "equal grid"


def _command(args):
    """The command that makes the same layout again, but for --out."""
    words = ["tomotactile", "layout"]
    for key in _OPTIONS:
        value = getattr(args, key)
        if value in (None, args.default_of(key)):
            continue
        words.append("--" + key.replace("_", "-"))
        if value is not True:
            words += map(str, value if isinstance(value, (list, tuple)) else [value])
    return " ".join(words)
